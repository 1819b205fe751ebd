//! The store of scan points: valid points of each kept scan, thinned out, without the robot's own motion during the scan, four bytes each.

use crate::segment::CLOUD_RANGE_M;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Twist};
use flockslam_messages::{BeamRange, ScanView};
use flockslam_registration::cloud::{PackedPoint, Placement};

/// Of neighbouring points of a scan closer than this only one is kept, metres.
const SPACING_M: f64 = 0.02;
/// Farther points are not used where enough are near, metres …
const RANGE_MAX_M: f64 = 20.0;
/// … nor points farther than this of any scan: the points of a few nodes must fit on a grid's torus.
const SPARSE_RANGE_MAX_M: f64 = 32.0;
/// A scan with fewer points than this within the usual range of clouds is sparse.
const SPARSE_POINTS: usize = 80;
/// Nearer points are never used, metres: the robot's own body.
const RANGE_MIN_M: f64 = 0.3;
/// Most points kept of one scan.
const POINTS_MAX: usize = 720;

/// Whether a scan has few points near the robot, as in the open.
fn is_sparse(points: &[PackedPoint]) -> bool {
    let near = points.iter().filter(|p| p.squared_range_m2() <= CLOUD_RANGE_M * CLOUD_RANGE_M).count();
    near < SPARSE_POINTS
}

/// The points of a scan that belong into a cloud: those near the robot, or all where few are near.
pub fn cloud_points(points: &[PackedPoint]) -> impl Iterator<Item = &PackedPoint> {
    let range_m = if is_sparse(points) { SPARSE_RANGE_MAX_M } else { CLOUD_RANGE_M };
    points.iter().filter(move |p| p.squared_range_m2() <= range_m * range_m)
}

/// The points of all scans that were kept, in the robot's frame, four bytes each.
#[derive(Default)]
pub struct ScanStore {
    points: Vec<PackedPoint>,
    ends: Vec<usize>,
    directions: Directions,
}

/// Sines and cosines of the beams of the last scan: those of the next one mostly leave at the same angles.
#[derive(Default)]
struct Directions(Vec<(f64, (f64, f64))>);

impl Directions {
    /// Sine and cosine of a beam's angle.
    fn of(&mut self, beam: usize, angle_rad: f64) -> (f64, f64) {
        if self.0.len() <= beam {
            self.0.resize(beam + 1, (f64::NAN, (0.0, 0.0)));
        }
        if self.0[beam].0 != angle_rad {
            self.0[beam] = (angle_rad, sin_cos(angle_rad));
        }
        self.0[beam].1
    }
}

impl ScanStore {
    /// Keeps the valid points of a scan but those on what moves, thinned out, as seen from where the robot, which had this velocity, was
    /// at its stamp; gives its number in the store. `moving` is in order. In the open far points and lone ones, as those of trees are, are
    /// kept.
    pub fn keep(&mut self, scan: ScanView<'_>, twist: Twist, moving: &[BeamRange], is_open: bool) -> usize {
        let first = self.points.len();
        let mount = Placement::from(scan.header().base_from_laser);
        let takes_time = scan.takes_time() && twist != Twist::default();
        let mut last = (f64::INFINITY, f64::INFINITY);
        // Scans with very many beams are read in strides before anything else.
        let stride = scan.len().div_ceil(8 * POINTS_MAX).max(1);
        let mut moving = moving.iter().peekable();
        for (place, i) in (0..scan.len()).step_by(stride).enumerate() {
            while moving.next_if(|range| range.end as usize <= i).is_some() {}
            if moving.peek().is_some_and(|range| range.first as usize <= i) {
                continue;
            }
            let Some(range_m) = scan.valid_range_m(i) else { continue };
            if !(RANGE_MIN_M..=SPARSE_RANGE_MAX_M).contains(&range_m) {
                continue;
            }
            if !is_open && scan.is_isolated(i) {
                continue;
            }
            let (sin, cos) = self.directions.of(place, scan.angle_rad(i));
            let (mut x, mut y) = mount.apply(range_m * cos, range_m * sin);
            if takes_time {
                Point { x_m: x, y_m: y } = twist.carried(Point::new(x, y), scan.time_s(i));
            }
            let (dx, dy) = (x - last.0, y - last.1);
            if dx * dx + dy * dy >= SPACING_M * SPACING_M
                && let Some(point) = PackedPoint::from_metres(x, y)
            {
                self.points.push(point);
                last = (x, y);
            }
        }
        if !is_open {
            self.leave_out_far(first);
        }
        self.halve_to_fit(first);
        self.ends.push(self.points.len());
        self.ends.len() - 1
    }

    /// Leaves out the far points of a scan, which begins at `first`, unless it is sparse.
    fn leave_out_far(&mut self, first: usize) {
        if is_sparse(&self.points[first..]) {
            return;
        }
        let mut kept = first;
        for i in first..self.points.len() {
            if self.points[i].squared_range_m2() <= RANGE_MAX_M * RANGE_MAX_M {
                self.points[kept] = self.points[i];
                kept += 1;
            }
        }
        self.points.truncate(kept);
    }

    fn halve_to_fit(&mut self, first: usize) {
        while self.points.len() - first > POINTS_MAX {
            let half = (self.points.len() - first).div_ceil(2);
            for k in 0..half {
                self.points[first + k] = self.points[first + 2 * k];
            }
            self.points.truncate(first + half);
        }
    }

    /// Keeps points as they are; gives their number in the store.
    pub fn keep_points(&mut self, points: impl Iterator<Item = PackedPoint>) -> usize {
        self.points.extend(points);
        self.ends.push(self.points.len());
        self.ends.len() - 1
    }

    /// Whether none is kept.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of scans kept.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Drops the scans that are not `wanted`, and gives the new numbers of the others (of those dropped, any).
    pub fn retain(&mut self, wanted: &[bool]) -> Vec<usize> {
        let (mut renamed, mut ends) = (Vec::with_capacity(wanted.len()), Vec::new());
        let (mut start, mut filled) = (0, 0);
        for (&end, wanted) in self.ends.iter().zip(wanted) {
            renamed.push(ends.len());
            if *wanted {
                // Points only move forward, over those that have gone.
                self.points.copy_within(start..end, filled);
                filled += end - start;
                ends.push(filled);
            }
            start = end;
        }
        self.points.truncate(filled);
        self.points.shrink_to_fit();
        self.ends = ends;
        renamed
    }

    /// The points of a scan.
    pub fn points(&self, scan: usize) -> &[PackedPoint] {
        let start = if scan == 0 { 0 } else { self.ends[scan - 1] };
        &self.points[start..self.ends[scan]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn keeps_valid_points_in_the_robots_frame() {
        let mut scan =
            ScanBuffer::from_ranges(&[1.0, f32::NAN, 1.9, 50.0, 0.1], 0.0, std::f64::consts::FRAC_PI_2);
        scan.header.base_from_laser.x_m = 0.5;
        let mut store = ScanStore::default();
        assert_eq!(store.keep(scan.view().unwrap(), Twist::default(), &[], false), 0);
        let metres: Vec<_> = store.points(0).iter().map(|p| (p.x_m(), p.y_m())).collect();
        let expected = [(1.5, 0.0), (-1.4, 0.0)];
        assert_eq!(metres.len(), 2);
        assert!(
            metres.iter().zip(expected).all(|(a, b)| (a.0 - b.0).abs() < 1e-9 && a.1 == b.1),
            "{metres:?}"
        );
    }

    #[test]
    fn leaves_out_beams_on_what_moves() {
        let scan = ScanBuffer::from_ranges(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 0.0, 0.5);
        let moving = [BeamRange { first: 1, end: 3 }, BeamRange { first: 4, end: 5 }];
        let mut store = ScanStore::default();
        store.keep(scan.view().unwrap(), Twist::default(), &moving, false);
        let kept = store.points(0).iter().map(|p| p.x_m().hypot(p.y_m()).round());
        assert_eq!(kept.collect::<Vec<_>>(), [1.0, 4.0, 6.0]);
    }

    #[test]
    fn takes_the_robots_own_motion_out_of_a_scan() {
        let mut scan = ScanBuffer::from_ranges(&[2.0, 2.0, 1.9], 0.0, 0.0);
        scan.header.time_increment_s = 0.05;
        // Driving at 1 m/s towards a wall, whose ranges shrink by 5 cm a beam; the second beam came early.
        scan.numbers[1] = 1.95;
        let twist = Twist { x_m_s: 1.0, ..Twist::default() };
        let mut store = ScanStore::default();
        store.keep(scan.view().unwrap(), twist, &[], false);
        assert_eq!(store.points(0).len(), 1, "all three beams hit the same point");
    }

    #[test]
    fn a_robot_that_turns_while_it_drives_moves_along_an_arc() {
        let twist = Twist { x_m_s: 0.4, turn_rad_s: 2.0, ..Twist::default() };
        // A post, and where the lidar has it after a tenth of a second.
        let post = Point::new(2.0, 1.0);
        let then = twist.motion_after(0.1).inverse().apply(post);
        let mut scan = ScanBuffer::from_ranges(&[3.0, then.norm_m() as f32, then.norm_m() as f32], 0.0, 0.0);
        scan.header.angle_min_rad = then.y_m.atan2(then.x_m);
        scan.header.time_increment_s = 0.1;
        scan.numbers[0] = f32::NAN;
        let mut store = ScanStore::default();
        store.keep(scan.view().unwrap(), twist, &[], false);
        let seen = store.points(0)[0];
        assert!(Point::new(seen.x_m(), seen.y_m()).distance_m(post) < 0.001, "{} {}", seen.x_m(), seen.y_m());
    }

    #[test]
    fn scans_that_are_not_wanted_go_and_the_others_stay_as_they_are() {
        let mut store = ScanStore::default();
        for range in [2.0, 3.0, 4.0, 5.0] {
            let scan = ScanBuffer::from_ranges(&[range, range + 0.1, range], 0.0, 0.3);
            store.keep(scan.view().unwrap(), Twist::default(), &[], false);
        }
        let (second, fourth) = (store.points(1).to_vec(), store.points(3).to_vec());
        let renamed = store.retain(&[false, true, false, true]);
        assert_eq!((renamed[1], renamed[3], store.len()), (0, 1, 2));
        assert_eq!((store.points(0), store.points(1)), (&second[..], &fourth[..]));
    }

    #[test]
    fn bounds_what_it_keeps_of_a_huge_scan() {
        let scan = ScanBuffer::from_ranges(&vec![15.0; 100_000], 0.0, std::f64::consts::TAU / 1e5);
        let mut store = ScanStore::default();
        store.keep(scan.view().unwrap(), Twist::default(), &[], false);
        let kept = store.points(0).len();
        assert!((POINTS_MAX / 2..=POINTS_MAX).contains(&kept), "{kept}");
    }
}
