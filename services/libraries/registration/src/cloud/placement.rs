//! Poses with their rotation worked out, for placing many points.

use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Pose, wrap_angle};

/// A pose with its rotation worked out, for placing many points.
///
/// A [`Pose`] works it out anew for each point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Metres along x of the parent frame.
    pub x_m: f64,
    /// Metres along y of the parent frame.
    pub y_m: f64,
    /// Counter-clockwise rotation, radians in `[-π, π)`.
    pub heading_rad: f64,
    cos: f64,
    sin: f64,
}

impl Placement {
    /// The identity.
    pub const IDENTITY: Placement = Placement { x_m: 0.0, y_m: 0.0, heading_rad: 0.0, cos: 1.0, sin: 0.0 };

    /// A placement from metres and radians.
    pub fn new(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        let heading_rad = wrap_angle(heading_rad);
        let (sin, cos) = sin_cos(heading_rad);
        Self { x_m, y_m, heading_rad, cos, sin }
    }

    /// The same motion as a plain pose.
    pub fn pose(self) -> Pose {
        Pose { x_m: self.x_m, y_m: self.y_m, heading_rad: self.heading_rad }
    }

    /// `self ∘ other`: with `self` = a_from_b and `other` = b_from_c the result is a_from_c.
    pub fn compose(self, other: Placement) -> Placement {
        let (x_m, y_m) = self.apply(other.x_m, other.y_m);
        Self::new(x_m, y_m, self.heading_rad + other.heading_rad)
    }

    /// `self⁻¹ ∘ other`: the pose of `other` as seen from `self`.
    pub fn to(self, other: Placement) -> Placement {
        let (x_m, y_m) = self.unrotate(other.x_m - self.x_m, other.y_m - self.y_m);
        Self::new(x_m, y_m, other.heading_rad - self.heading_rad)
    }

    /// The inverse motion.
    pub fn inverse(self) -> Placement {
        self.to(Self::IDENTITY)
    }

    /// A point of the child frame in the parent frame, metres.
    #[inline]
    pub fn apply(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        let (x, y) = self.rotate(x_m, y_m);
        (x + self.x_m, y + self.y_m)
    }

    /// A direction of the child frame in the parent frame.
    #[inline]
    pub fn rotate(&self, x: f64, y: f64) -> (f64, f64) {
        (self.cos * x - self.sin * y, self.sin * x + self.cos * y)
    }

    /// A direction of the parent frame in the child frame.
    #[inline]
    pub fn unrotate(&self, x: f64, y: f64) -> (f64, f64) {
        (self.cos * x + self.sin * y, -self.sin * x + self.cos * y)
    }

    /// Distance between the two origins, metres.
    pub fn distance_m(&self, other: &Placement) -> f64 {
        let (dx, dy) = (self.x_m - other.x_m, self.y_m - other.y_m);
        (dx * dx + dy * dy).sqrt()
    }

    /// Absolute difference of heading, radians in `[0, π]`.
    pub fn turn_rad(&self, other: &Placement) -> f64 {
        wrap_angle(other.heading_rad - self.heading_rad).abs()
    }

    /// The pose a share `t` of the way from `self` (0) to `other` (1): position linear, heading along the
    /// shorter arc.
    pub fn interpolate(&self, other: &Placement, t: f64) -> Placement {
        Self::new(
            self.x_m + t * (other.x_m - self.x_m),
            self.y_m + t * (other.y_m - self.y_m),
            self.heading_rad + t * wrap_angle(other.heading_rad - self.heading_rad),
        )
    }
}

impl From<Pose> for Placement {
    fn from(pose: Pose) -> Self {
        Self::new(pose.x_m, pose.y_m, pose.heading_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(a: Pose, b: Pose) -> bool {
        a.distance_m(b) < 1e-9 && a.turn_rad(b) < 1e-9
    }

    fn poses() -> impl Strategy<Value = Pose> {
        (-50.0..50.0, -50.0..50.0, -9.0..9.0f64).prop_map(|(x, y, heading)| Pose::new(x, y, heading))
    }

    proptest! {
        #[test]
        fn agrees_with_the_plain_pose(a in poses(), b in poses(), t in 0.0..1.0f64) {
            let (pa, pb) = (Placement::from(a), Placement::from(b));
            prop_assert!(close(pa.compose(pb).pose(), a * b));
            prop_assert!(close(pa.to(pb).pose(), a.to(b)));
            prop_assert!(close(pa.inverse().pose(), a.inverse()));
            prop_assert!(close(pa.interpolate(&pb, t).pose(), a.interpolate(b, t)));
        }
    }
}
