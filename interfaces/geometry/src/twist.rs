use crate::Pose;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Velocity in the body frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Twist {
    /// Forward, metres per second.
    pub x_m_s: f64,
    /// Leftward, metres per second.
    pub y_m_s: f64,
    /// Counter-clockwise, radians per second.
    pub turn_rad_s: f64,
}

/// Below this series are quicker than sines and as exact, radians.
const SMALL_TURN_RAD: f64 = 0.05;

impl Twist {
    /// The constant body velocity that leads along `motion` (a relative pose) in `seconds`; zero when
    /// `seconds` is not positive.
    pub fn from_motion(motion: Pose, seconds: f64) -> Self {
        if seconds.is_nan() || seconds <= 0.0 {
            return Self::default();
        }
        let turn = motion.heading_rad;
        // Inverse of the exponential map: the chord (x, y) belongs to an arc.
        let half = 0.5 * turn;
        let shrink = if half.abs() < 1e-6 { 1.0 - half * half / 3.0 } else { half / half.tan() };
        Self {
            x_m_s: (shrink * motion.x_m + half * motion.y_m) / seconds,
            y_m_s: (-half * motion.x_m + shrink * motion.y_m) / seconds,
            turn_rad_s: turn / seconds,
        }
    }

    /// The relative pose reached after moving with this velocity for `seconds` (exponential map of SE(2)).
    #[inline]
    pub fn motion_after(self, seconds: f64) -> Pose {
        let (x, y, turn) = (self.x_m_s * seconds, self.y_m_s * seconds, self.turn_rad_s * seconds);
        let (s, c) = if turn.abs() < SMALL_TURN_RAD {
            // The series of both: what they lack is below what numbers hold.
            let t = turn * turn;
            (
                1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0)),
                0.5 * turn * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0))),
            )
        } else {
            (turn.sin() / turn, (1.0 - turn.cos()) / turn)
        };
        Pose::new(s * x - c * y, c * x + s * y, turn)
    }

    /// The velocity that a point of the body has in its own frame, which lies at `mount` in that of the body (the adjoint).
    pub fn at(self, mount: Pose) -> Self {
        let (x, y) = (self.x_m_s - self.turn_rad_s * mount.y_m, self.y_m_s + self.turn_rad_s * mount.x_m);
        let (sin, cos) = mount.heading_rad.sin_cos();
        Self { x_m_s: cos * x + sin * y, y_m_s: cos * y - sin * x, turn_rad_s: self.turn_rad_s }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_turns_are_as_exact_as_large_ones() {
        let twist = Twist { x_m_s: 1.0, y_m_s: 0.0, turn_rad_s: 1.0 };
        for step in 1..100_u32 {
            let turn = f64::from(step) * 1e-3;
            let motion = twist.motion_after(turn);
            // (1 - cos t) of a small angle, without the loss of figures.
            let exact = (turn.sin(), 2.0 * (0.5 * turn).sin().powi(2));
            assert!((motion.x_m - exact.0).abs() < 1e-16 && (motion.y_m - exact.1).abs() < 1e-16, "{turn}");
        }
    }

    #[test]
    fn every_point_of_a_body_moves_with_it() {
        let twist = Twist { x_m_s: 0.7, y_m_s: -0.2, turn_rad_s: 0.9 };
        let mount = Pose::new(0.3, -0.1, 2.0);
        let expected = mount.inverse() * twist.motion_after(0.4) * mount;
        let motion = twist.at(mount).motion_after(0.4);
        assert!(motion.distance_m(expected) < 1e-12 && (motion.heading_rad - 0.36).abs() < 1e-12);
    }

    #[test]
    fn motion_and_velocity_are_inverse() {
        for (x, y, turn) in [(0.3, -0.1, 0.7), (1.0, 0.0, 0.0), (0.0, 0.0, -2.0), (0.2, 0.3, 1e-9)] {
            let motion = Pose::new(x, y, turn);
            let back = Twist::from_motion(motion, 0.25).motion_after(0.25);
            assert!(motion.distance_m(back) < 1e-9 && (back.heading_rad - turn).abs() < 1e-12);
        }
        assert_eq!(Twist::from_motion(Pose::new(1.0, 0.0, 0.0), 0.0), Twist::default());
    }
}
