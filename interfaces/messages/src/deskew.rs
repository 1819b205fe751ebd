use crate::{ScanHeader, ScanView};
use flockslam_geometry::{Point, Pose, Twist};
use std::f64::consts::{FRAC_PI_2, PI};

/// Slopes below this are few terms of a series away from their angles.
const SMALL_SLOPE: f64 = 0.1;

/// Takes the robot's own motion out of a scan: beams are given as if all had left at the scan's stamp.
///
/// At 30°/s and 10 Hz a wall 3 m away is off by about 8 cm at the end of a scan without this.
#[derive(Clone, Copy, Debug)]
pub struct Deskew {
    base_from_laser: Pose,
    twist: Twist,
    /// The lidar's own velocity, in its frame at the stamp.
    laser_twist: Twist,
    laser_speed_m_s: f64,
    moves: bool,
}

impl Deskew {
    /// For a scan taken while the robot moved with `twist` (its own velocity, in `base_link`).
    pub fn new(scan: ScanView<'_>, twist: Twist) -> Self {
        Self::of_header(scan.header(), twist, scan.takes_time())
    }

    fn of_header(header: &ScanHeader, twist: Twist, takes_time: bool) -> Self {
        let laser_twist = twist.at(header.base_from_laser);
        Self {
            base_from_laser: header.base_from_laser,
            twist,
            laser_twist,
            laser_speed_m_s: laser_twist.x_m_s.hypot(laser_twist.y_m_s),
            moves: takes_time && twist != Twist::default(),
        }
    }

    /// `base_from_laser` of a beam that left `seconds` after the stamp, seen from the base at the stamp.
    fn laser_at(&self, seconds: f64) -> Pose {
        if self.moves {
            self.twist.motion_after(seconds) * self.base_from_laser
        } else {
            self.base_from_laser
        }
    }

    /// Where beam `beam` of `scan` ends at `range_m`, in `base_link` at the stamp.
    pub fn end_in_base(&self, scan: ScanView<'_>, beam: usize, range_m: f64) -> Point {
        let laser = self.laser_at(if self.moves { scan.time_s(beam) } else { 0.0 });
        let (sin, cos) = (laser.heading_rad + scan.angle_rad(beam)).sin_cos();
        Point::new(laser.x_m + range_m * cos, laser.y_m + range_m * sin)
    }

    /// Direction (not wrapped) and range under which the lidar at the stamp would see the end of a beam; a beam without return keeps
    /// its direction in space.
    #[inline]
    pub fn beam_at_stamp(&self, scan: ScanView<'_>, beam: usize) -> (f64, Option<f64>) {
        let (angle_rad, range_m) = (scan.angle_rad(beam), scan.valid_range_m(beam));
        if !self.moves {
            return (angle_rad, range_m);
        }
        // A body that turns and goes evenly does so seen from any point of it.
        let laser = self.laser_twist.motion_after(scan.time_s(beam));
        let direction_rad = angle_rad + laser.heading_rad;
        let Some(range_m) = range_m else { return (direction_rad, None) };
        let (sin, cos) = direction_rad.sin_cos();
        let along = range_m + cos * laser.x_m + sin * laser.y_m;
        let across = cos * laser.y_m - sin * laser.x_m;
        (direction_rad + small_atan2(across, along), Some((along * along + across * across).sqrt()))
    }

    /// No more than this, radians, lies between the direction in which a beam left and that which [`Self::beam_at_stamp`] gives.
    #[inline]
    pub fn shift_max_rad(&self, scan: ScanView<'_>, beam: usize) -> f64 {
        self.shift_within_rad(scan.time_s(beam).abs(), scan.valid_range_m(beam))
    }

    /// The same for any beam of the scan.
    pub fn greatest_shift_rad(&self, scan: ScanView<'_>) -> f64 {
        self.shift_within_rad(scan.longest_time_s(), scan.shortest_range_m())
    }

    #[inline]
    fn shift_within_rad(&self, seconds: f64, range_m: Option<f64>) -> f64 {
        if !self.moves {
            return 0.0;
        }
        let way_m = self.laser_speed_m_s * seconds;
        // An arc sine is at most π / 2 times its sine.
        let parallax_rad = range_m.map_or(0.0, |range_m| (FRAC_PI_2 * way_m / range_m).min(PI));
        self.twist.turn_rad_s.abs() * seconds + parallax_rad
    }
}

/// The angle of (x, y), radians; quick where it is small, as it is for beams that end far away compared with the way of the lidar.
#[inline]
fn small_atan2(y: f64, x: f64) -> f64 {
    if y.abs() < SMALL_SLOPE * x {
        // The series; what it lacks is below what numbers hold.
        let slope = y / x;
        let s = slope * slope;
        let tail = s * (1.0 / 9.0 - s * (1.0 / 11.0 - s * (1.0 / 13.0)));
        slope * (1.0 - s * (1.0 / 3.0 - s * (1.0 / 5.0 - s * (1.0 / 7.0 - tail))))
    } else {
        y.atan2(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ScanBuffer;
    use flockslam_geometry::wrap_angle;

    #[test]
    fn a_wall_seen_while_turning_is_straight_again() {
        let (rate, step) = (1.0, 0.01);
        let twist = Twist { x_m_s: 0.5, turn_rad_s: rate, ..Twist::default() };
        let mount = Pose::new(0.1, 0.05, 0.3);
        let angles: Vec<f64> = (0..50).map(|i| -0.8 + 0.02 * f64::from(i)).collect();
        // A wall at x = 3 in the base frame at the stamp.
        let ranges = angles.iter().enumerate().map(|(i, angle)| {
            let laser = twist.motion_after(step * i as f64) * mount;
            ((3.0 - laser.x_m) / (laser.heading_rad + angle).cos()) as f32
        });
        let mut scan = ScanBuffer::from_ranges(&ranges.collect::<Vec<_>>(), -0.8, 0.02);
        (scan.header.base_from_laser, scan.header.time_increment_s) = (mount, step as f32);
        let view = scan.view().unwrap();
        let deskew = Deskew::new(view, twist);
        for beam in 0..view.len() {
            let range = view.valid_range_m(beam).unwrap();
            assert!((deskew.end_in_base(view, beam, range).x_m - 3.0).abs() < 1e-4);
            let (angle, range) = deskew.beam_at_stamp(view, beam);
            let shift_rad = wrap_angle(angle - view.angle_rad(beam)).abs();
            let shift_max_rad = deskew.shift_max_rad(view, beam);
            assert!(shift_rad <= shift_max_rad + 1e-12, "{beam}: {shift_rad}");
            assert!(shift_max_rad <= deskew.greatest_shift_rad(view), "{beam}: {shift_max_rad}");
            let (sin, cos) = angle.sin_cos();
            let end = mount.apply(Point::new(range.unwrap() * cos, range.unwrap() * sin));
            assert!((end.x_m - 3.0).abs() < 1e-4);
        }
    }

    #[test]
    fn small_angles_are_as_exact_as_large_ones() {
        for step in -2000..2000 {
            let (y, x) = (f64::from(step) * 1e-4, 1.0);
            assert!((small_atan2(y, x) - y.atan2(x)).abs() < 1e-15, "{y}");
            assert_eq!(small_atan2(y, -x), y.atan2(-x));
        }
        assert_eq!(small_atan2(0.0, 0.0), 0.0);
    }

    #[test]
    fn a_scan_taken_at_once_is_left_alone() {
        let scan = ScanBuffer::from_ranges(&[1.0, 2.0], 0.5, 0.1);
        let view = scan.view().unwrap();
        let deskew = Deskew::new(view, Twist { turn_rad_s: 3.0, ..Twist::default() });
        assert_eq!(deskew.beam_at_stamp(view, 1), (0.6, Some(2.0)));
    }
}
