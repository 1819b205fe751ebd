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
    pub fn motion_after(self, seconds: f64) -> Pose {
        let (x, y, turn) = (self.x_m_s * seconds, self.y_m_s * seconds, self.turn_rad_s * seconds);
        let (s, c) = if turn.abs() < 1e-6 {
            (1.0 - turn * turn / 6.0, 0.5 * turn)
        } else {
            (turn.sin() / turn, (1.0 - turn.cos()) / turn)
        };
        Pose::new(s * x - c * y, c * x + s * y, turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
