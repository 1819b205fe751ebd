//! Poses: the group SE(2). They are composed, inverted, compared, interpolated, and applied to points.

use crate::elementary::sin_cos;
use crate::{Point, wrap_angle};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A rigid motion of the plane, SE(2): `a_from_b` maps a point p of frame b to `R(heading)·p + (x, y)` in frame a.
///
/// ```
/// use flockslam_geometry::{Point, Pose};
/// use std::f64::consts::FRAC_PI_2;
///
/// let odom_from_base = Pose::new(2.0, 1.0, FRAC_PI_2);
/// let base_from_laser = Pose::new(0.5, 0.0, 0.0);
/// let odom_from_laser = odom_from_base * base_from_laser;
/// // The robot looks along y: what is in front of it has a greater y in odom.
/// assert!(odom_from_laser.position().distance_m(Point::new(2.0, 1.5)) < 1e-12);
/// assert!(odom_from_laser.apply(Point::new(1.0, 0.0)).distance_m(Point::new(2.0, 2.5)) < 1e-12);
/// assert!(odom_from_base.to(odom_from_laser).distance_m(base_from_laser) < 1e-12);
/// ```
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Pose {
    /// Metres along x of the parent frame.
    pub x_m: f64,
    /// Metres along y of the parent frame.
    pub y_m: f64,
    /// Counter-clockwise rotation, radians, in `[-π, π)`.
    pub heading_rad: f64,
}

impl Pose {
    /// The identity.
    pub const IDENTITY: Pose = Pose { x_m: 0.0, y_m: 0.0, heading_rad: 0.0 };

    /// A pose from metres and radians; the heading is wrapped.
    pub fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        Self { x_m, y_m, heading_rad: wrap_angle(heading_rad) }
    }

    /// `self ∘ other`: with `self` = a_from_b and `other` = b_from_c the result is a_from_c.
    pub fn compose(self, other: Pose) -> Pose {
        let moved = self.apply(Point::new(other.x_m, other.y_m));
        Pose::new(moved.x_m, moved.y_m, self.heading_rad + other.heading_rad)
    }

    /// The inverse motion: b_from_a of a_from_b.
    pub fn inverse(self) -> Pose {
        let (sin, cos) = sin_cos(self.heading_rad);
        Pose::new(-cos * self.x_m - sin * self.y_m, sin * self.x_m - cos * self.y_m, -self.heading_rad)
    }

    /// The pose of `other` as seen from `self`: `self⁻¹ ∘ other`.
    pub fn to(self, other: Pose) -> Pose {
        let (sin, cos) = sin_cos(self.heading_rad);
        let (dx, dy) = (other.x_m - self.x_m, other.y_m - self.y_m);
        Pose::new(cos * dx + sin * dy, -sin * dx + cos * dy, other.heading_rad - self.heading_rad)
    }

    /// Maps a point of the child frame into the parent frame.
    pub fn apply(self, point: Point) -> Point {
        let (sin, cos) = sin_cos(self.heading_rad);
        Point::new(cos * point.x_m - sin * point.y_m + self.x_m, sin * point.x_m + cos * point.y_m + self.y_m)
    }

    /// The translation as a point.
    pub fn position(self) -> Point {
        Point::new(self.x_m, self.y_m)
    }

    /// Distance between the two origins, metres.
    pub fn distance_m(self, other: Pose) -> f64 {
        self.position().distance_m(other.position())
    }

    /// Absolute difference of heading, radians in `[0, π]`.
    pub fn turn_rad(self, other: Pose) -> f64 {
        wrap_angle(other.heading_rad - self.heading_rad).abs()
    }

    /// The pose a share `t` of the way from `self` to `other` (0 → self, 1 → other): position linear, heading along
    /// the shorter arc.
    pub fn interpolate(self, other: Pose, t: f64) -> Pose {
        Pose::new(
            self.x_m + t * (other.x_m - self.x_m),
            self.y_m + t * (other.y_m - self.y_m),
            self.heading_rad + t * wrap_angle(other.heading_rad - self.heading_rad),
        )
    }

    /// Whether all three numbers are finite.
    pub fn is_finite(self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.heading_rad.is_finite()
    }
}

impl std::ops::Mul for Pose {
    type Output = Pose;

    fn mul(self, other: Pose) -> Pose {
        self.compose(other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> Vec<Pose> {
        (0..40).map(|i| f64::from(i) * 0.37).map(|v| Pose::new(3.0 * v.sin(), v - 4.0, 2.0 * v)).collect()
    }

    fn close(a: Pose, b: Pose) -> bool {
        a.distance_m(b) < 1e-9 && a.turn_rad(b) < 1e-9
    }

    #[test]
    fn group_laws_hold() {
        for a in samples() {
            assert!(close(a * a.inverse(), Pose::IDENTITY) && close(a.inverse() * a, Pose::IDENTITY));
            assert!(close(a * Pose::IDENTITY, a) && close(Pose::IDENTITY * a, a));
            for b in samples() {
                assert!(close(a.to(b), a.inverse() * b));
                assert!(close(a * a.to(b), b));
                for c in samples().into_iter().step_by(7) {
                    assert!(close((a * b) * c, a * (b * c)));
                }
                let p = Point::new(0.3, -2.0);
                assert!((a * b).apply(p).distance_m(a.apply(b.apply(p))) < 1e-9);
            }
        }
    }

    #[test]
    fn interpolation_takes_the_shorter_arc() {
        let middle = Pose::new(0.0, 0.0, 3.1).interpolate(Pose::new(1.0, 0.0, -3.1), 0.5);
        assert!((middle.heading_rad.abs() - std::f64::consts::PI).abs() < 1e-9 && middle.x_m == 0.5);
    }
}
