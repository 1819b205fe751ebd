//! Where a lidar sees its own robot: returns that stay at one place near it, with nothing ever seen behind, while the robot drives.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::{cos, sin};
use flockslam_messages::ScanView;
use std::f64::consts::{PI, TAU};

/// Directions that are distinguished, half a degree each.
const DIRECTIONS: usize = 720;
/// A robot does not reach farther than this from its lidar, metres.
const REACH_M: f64 = 2.0;
/// Ranges are counted in steps of this, metres.
const STEP_M: f64 = 0.02;
const STEPS: usize = (REACH_M / STEP_M) as usize;
/// Returns of one place scatter by so many steps to either side.
const SCATTER_STEPS: usize = 2;
/// The body is returned in at least this share of the scans, and something behind it in at most that one.
const RETURNED_MIN: f64 = 0.2;
const BEHIND_MAX: f64 = 0.02;
/// Scans are compared with one that is so much older, nanoseconds.
const APART_NS: i64 = 1_000_000_000;
/// The robot has moved when so great a share of the returns from farther away has changed by so much, metres.
const CHANGED_SHARE: f64 = 0.3;
const CHANGED_M: f64 = 0.1;
/// Scans of a robot that drives that are needed.
const MOVING_MIN: u32 = 100;
/// Neighbours that are this near to each other, metres and directions, are one part of the body.
const TOGETHER_M: f64 = 0.1;
const TOGETHER_DIRECTIONS: usize = 4;
/// Boxes are larger than what was seen by this, metres.
const MARGIN_M: f64 = 0.03;

/// Why no mask was learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MaskError {
    /// A robot that stands sees everything at one place.
    #[error(
        "the robot moved in {moving} scans only: {MOVING_MIN} are needed to tell its body from what stands around it"
    )]
    HardlyMoved {
        /// Scans in which it moved.
        moving: u32,
    },
}

/// Learns where one lidar sees its robot.
///
/// ```
/// use flockslam_calibration::BodyMask;
/// use flockslam_messages::ScanBuffer;
///
/// let mut learned = BodyMask::default();
/// for k in 0..300_u16 {
///     // A wall comes nearer; one beam ends at a post.
///     let far_m = 9.0 - 0.02 * f32::from(k);
///     let mut scan = ScanBuffer::from_ranges(&[far_m, far_m, 0.3, far_m, far_m], -1.0, 0.5);
///     scan.header.times.sensor_ns = i64::from(k) * 100_000_000;
///     learned.push(scan.view()?);
/// }
/// let boxes = learned.boxes()?;
/// assert_eq!(boxes.len(), 1);
/// assert!(boxes[0][0] < 0.3 && 0.3 < boxes[0][1] && boxes[0][2] < 0.0 && 0.0 < boxes[0][3]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct BodyMask {
    /// Of each direction: near ranges, by steps.
    near: Vec<u32>,
    /// Of each direction: scans with a return, near or far.
    returns: Vec<u32>,
    /// Scans while the robot moved.
    moving: u32,
    /// An older scan: its stamp and ranges by direction.
    older: Option<(i64, Vec<f32>)>,
    /// One between it and now, which comes after it.
    next_older: Option<(i64, Vec<f32>)>,
    base_from_laser: Pose,
}

impl Default for BodyMask {
    fn default() -> Self {
        Self {
            near: vec![0; DIRECTIONS * STEPS],
            returns: vec![0; DIRECTIONS],
            moving: 0,
            older: None,
            next_older: None,
            base_from_laser: Pose::IDENTITY,
        }
    }
}

impl BodyMask {
    /// Takes a scan of the lidar.
    pub fn push(&mut self, scan: ScanView<'_>) {
        let (stamp_ns, ranges) = (scan.header().times.sensor_ns, by_direction(scan));
        self.base_from_laser = scan.header().base_from_laser;
        let has_moved = self.older.as_ref().is_some_and(|(_, older)| has_moved(older, &ranges));
        if has_moved {
            self.moving += 1;
            for (direction, range_m) in ranges.iter().enumerate().filter(|(_, range_m)| range_m.is_finite()) {
                self.returns[direction] += 1;
                let step = (f64::from(*range_m) / STEP_M) as usize;
                if step < STEPS {
                    self.near[direction * STEPS + step] += 1;
                }
            }
        }
        let is_old =
            |scan: &Option<(i64, Vec<f32>)>| scan.as_ref().is_some_and(|(at, _)| stamp_ns - at >= APART_NS);
        if self.older.is_none() {
            self.older = Some((stamp_ns, ranges));
        } else if self.next_older.is_none() {
            self.next_older = Some((stamp_ns, ranges));
        } else if is_old(&self.next_older) {
            self.older = self.next_older.take();
        }
    }

    /// Boxes around what was seen of the robot, as `lidar_ingest.self_mask` has them: the least and the greatest x, the least and the
    /// greatest y in the frame of the robot, metres.
    ///
    /// # Errors
    /// When the robot hardly moved.
    pub fn boxes(&self) -> Result<Vec<[f64; 4]>, MaskError> {
        if self.moving < MOVING_MIN {
            return Err(MaskError::HardlyMoved { moving: self.moving });
        }
        let mut parts: Vec<Vec<(usize, Pose)>> = Vec::new();
        let body = (0..DIRECTIONS).filter_map(|direction| Some((direction, self.body_m(direction)?)));
        for (direction, range_m) in body {
            let angle_rad = (direction as f64 + 0.5) * TAU / DIRECTIONS as f64 - PI;
            let place = Pose::new(range_m * cos(angle_rad), range_m * sin(angle_rad), 0.0);
            let belongs = |part: &&mut Vec<(usize, Pose)>| {
                part.last().is_some_and(|(last, at)| {
                    direction - last <= TOGETHER_DIRECTIONS && at.distance_m(place) < TOGETHER_M
                })
            };
            match parts.last_mut().filter(belongs) {
                Some(part) => part.push((direction, place)),
                None => parts.push(vec![(direction, place)]),
            }
        }
        Ok(parts.iter().map(|part| self.around(part)).collect())
    }

    /// At which range the robot's body is in a direction.
    fn body_m(&self, direction: usize) -> Option<f64> {
        let counts = &self.near[direction * STEPS..(direction + 1) * STEPS];
        let sum = |from: usize, to: usize| counts[from..to.min(STEPS)].iter().sum::<u32>();
        let window = |middle: usize| sum(middle.saturating_sub(SCATTER_STEPS), middle + SCATTER_STEPS + 1);
        let place = (0..STEPS).max_by_key(|step| (window(*step), counts[*step]))?;
        let nearer = sum(0, place + SCATTER_STEPS + 1);
        let behind = self.returns[direction] - nearer;
        let is_body = f64::from(window(place)) >= RETURNED_MIN * f64::from(self.moving)
            && f64::from(behind) <= BEHIND_MAX * f64::from(self.moving);
        is_body.then_some((place as f64 + 0.5) * STEP_M)
    }

    fn around(&self, part: &[(usize, Pose)]) -> [f64; 4] {
        let places = part.iter().map(|(_, place)| self.base_from_laser * *place);
        let none = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let [x, to_x, y, to_y] = places.fold(none, |[x, to_x, y, to_y], place| {
            [x.min(place.x_m), to_x.max(place.x_m), y.min(place.y_m), to_y.max(place.y_m)]
        });
        [x - MARGIN_M, to_x + MARGIN_M, y - MARGIN_M, to_y + MARGIN_M]
    }
}

/// The nearest return of each direction; infinite where there is none.
fn by_direction(scan: ScanView<'_>) -> Vec<f32> {
    let mut ranges = vec![f32::INFINITY; DIRECTIONS];
    for beam in 0..scan.len() {
        let Some(range_m) = scan.valid_range_m(beam) else { continue };
        let turns = (scan.angle_rad(beam) + PI) / TAU;
        let direction = (turns.rem_euclid(1.0) * DIRECTIONS as f64) as usize;
        let nearest = &mut ranges[direction.min(DIRECTIONS - 1)];
        *nearest = nearest.min(range_m as f32);
    }
    ranges
}

fn has_moved(older: &[f32], ranges: &[f32]) -> bool {
    let is_far = |range_m: f32| range_m.is_finite() && f64::from(range_m) > REACH_M;
    let far = older.iter().zip(ranges).filter(|(older, now)| is_far(**older) && is_far(**now));
    let (mut compared, mut changed) = (0_u32, 0_u32);
    for (older, now) in far {
        compared += 1;
        changed += u32::from(f64::from((older - now).abs()) > CHANGED_M);
    }
    f64::from(changed) > CHANGED_SHARE * f64::from(compared)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    /// A room of 8 by 6 m, the lidar somewhere in it, 0.2 m ahead of the middle of the robot, with two posts behind it.
    fn scan(at: Pose, stamp_ns: i64, returned: bool) -> ScanBuffer {
        let beams = 360;
        let ranges: Vec<f32> = (0..beams)
            .map(|beam| {
                let angle_rad = f64::from(beam) * TAU / f64::from(beams) - PI;
                if (2.70..2.80).contains(&angle_rad) || (-2.80..-2.70).contains(&angle_rad) {
                    return if returned { 0.35 } else { f32::INFINITY };
                }
                let (sin, cos) = (angle_rad + at.heading_rad).sin_cos();
                let wall =
                    |along: f64, place: f64, half: f64| ((half * along.signum() - place) / along).abs();
                wall(cos, at.x_m, 4.0).min(wall(sin, at.y_m, 3.0)) as f32
            })
            .collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -PI, TAU / f64::from(beams));
        scan.header.base_from_laser = Pose::new(0.2, 0.0, 0.0);
        scan.header.times.sensor_ns = stamp_ns;
        scan
    }

    fn learned(moves: bool) -> BodyMask {
        let mut learned = BodyMask::default();
        for k in 0..600 {
            let way = if moves { 0.03 * f64::from(k) } else { 0.0 };
            let at = Pose::new(2.0 * way.sin(), 1.5 * (1.3 * way).cos(), 0.7 * way);
            // A dark post returns every third time.
            learned.push(scan(at, i64::from(k) * 100_000_000, k % 3 == 0).view().unwrap());
        }
        learned
    }

    #[test]
    fn posts_of_the_robot_are_found_and_walls_are_not() {
        let boxes = learned(true).boxes().unwrap();
        assert_eq!(boxes.len(), 2, "{boxes:?}");
        for [x, to_x, y, to_y] in boxes {
            let middle = Pose::new(0.5 * (x + to_x), 0.5 * (y + to_y), 0.0);
            let expected = Pose::new(
                0.2 - 0.35 * 2.75_f64.cos().abs(),
                0.35 * 2.75_f64.sin() * middle.y_m.signum(),
                0.0,
            );
            assert!(middle.distance_m(expected) < 0.03, "{middle:?}");
            assert!(to_x - x < 0.15 && to_y - y < 0.15);
        }
    }

    #[test]
    fn a_robot_that_stands_learns_nothing() {
        assert!(matches!(learned(false).boxes(), Err(MaskError::HardlyMoved { moving: 0 })));
    }
}
