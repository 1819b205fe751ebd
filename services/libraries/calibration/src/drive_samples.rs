//! The poses of one lidar on a drive: as its scans were fitted, and by odometry at any time.

use flockslam_geometry::{Pose, wrap_angle};

/// Samples that are kept: five hours at ten scans a second tell enough.
const SAMPLES_MAX: usize = 200_000;
/// Across a longer gap odometry is not interpolated, nanoseconds.
const GAP_MAX_NS: i64 = 1_000_000_000;

/// A scan of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveSample {
    /// Its stamp, nanoseconds.
    pub stamp_ns: i64,
    /// The pose of the robot that its fit has found, in any fixed frame; `None` where odometry alone gave it.
    pub world_from_base: Option<Pose>,
    /// `odom_from_base` by odometry at the stamp.
    pub odometry: Pose,
    /// Poses of different trajectories have nothing to do with each other.
    pub trajectory: u32,
}

/// Scans of a lidar in order of time.
#[derive(Clone, Debug, Default)]
pub struct DriveSamples {
    samples: Vec<DriveSample>,
}

impl DriveSamples {
    /// Takes a scan. One that is not later than the one before is left out, since odometry is interpolated between them.
    pub fn push(&mut self, sample: DriveSample) {
        let is_later = self.samples.last().is_none_or(|last| last.stamp_ns < sample.stamp_ns);
        if is_later && self.samples.len() < SAMPLES_MAX && sample.odometry.is_finite() {
            self.samples.push(sample);
        }
    }

    /// Number of scans.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// All scans.
    pub fn iter(&self) -> impl Iterator<Item = &DriveSample> {
        self.samples.iter()
    }

    /// `odom_from_base` at a time, by a cubic through the neighbours: a robot that speeds up is a millimetre off a straight line between
    /// two scans. `None` outside of the drive and in gaps.
    pub fn odometry_at(&self, at_ns: i64) -> Option<Pose> {
        let after = self.samples.partition_point(|sample| sample.stamp_ns <= at_ns);
        let (from, to) = (self.samples.get(after.checked_sub(1)?)?, self.samples.get(after)?);
        let gap_ns = to.stamp_ns - from.stamp_ns;
        if gap_ns > GAP_MAX_NS {
            return None;
        }
        let near = |at: Option<usize>, other: &DriveSample| {
            let sample = at.and_then(|at| self.samples.get(at))?;
            ((sample.stamp_ns - other.stamp_ns).abs() <= GAP_MAX_NS).then_some(sample)
        };
        let before = near(after.checked_sub(2), from).unwrap_or(from);
        let behind = near(Some(after + 1), to).unwrap_or(to);
        let share = (at_ns - from.stamp_ns) as f64 / gap_ns as f64;
        // Changes over the gap, by the slopes at both of its ends.
        let (start, end) = (slope(before, to, gap_ns), slope(from, behind, gap_ns));
        let step = difference(from.odometry, to.odometry);
        let cubic = |axis: usize| {
            let (s2, s3) = (share * share, share * share * share);
            (s3 - 2.0 * s2 + share) * start[axis] + (3.0 * s2 - 2.0 * s3) * step[axis] + (s3 - s2) * end[axis]
        };
        let origin = from.odometry;
        Some(Pose::new(origin.x_m + cubic(0), origin.y_m + cubic(1), origin.heading_rad + cubic(2)))
    }
}

fn difference(from: Pose, to: Pose) -> [f64; 3] {
    [to.x_m - from.x_m, to.y_m - from.y_m, wrap_angle(to.heading_rad - from.heading_rad)]
}

/// The mean change from one scan to another, over a time.
fn slope(from: &DriveSample, to: &DriveSample, over_ns: i64) -> [f64; 3] {
    let share = over_ns as f64 / (to.stamp_ns - from.stamp_ns).max(1) as f64;
    difference(from.odometry, to.odometry).map(|change| share * change)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn odometry_follows_a_robot_that_speeds_up_and_turns() {
        let pose = |at_s: f64| Pose::new(0.5 * at_s * at_s, 0.0, 3.0 + at_s);
        let mut samples = DriveSamples::default();
        for k in 0..20 {
            let odometry = pose(0.1 * f64::from(k));
            samples.push(DriveSample {
                stamp_ns: i64::from(k) * 100 * MS,
                odometry,
                ..DriveSample::default()
            });
        }
        for at_ms in [110, 150, 777, 1333] {
            let (found, exact) = (samples.odometry_at(at_ms * MS).unwrap(), pose(at_ms as f64 * 1e-3));
            assert!(found.distance_m(exact) < 1e-9 && found.turn_rad(exact) < 1e-9, "{at_ms} ms");
        }
        assert_eq!(samples.odometry_at(-1), None);
        assert_eq!(samples.odometry_at(1900 * MS), None);
    }

    #[test]
    fn scans_out_of_order_are_left_out_and_gaps_are_not_filled() {
        let mut samples = DriveSamples::default();
        for stamp_ms in [0, 100, 50, 1300] {
            samples.push(DriveSample { stamp_ns: stamp_ms * MS, ..DriveSample::default() });
        }
        assert_eq!(samples.len(), 3);
        assert!(samples.odometry_at(60 * MS).is_some() && samples.odometry_at(200 * MS).is_none());
    }
}
