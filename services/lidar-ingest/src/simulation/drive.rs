use super::Settings;
use flockslam_geometry::{Point, Pose, Twist, wrap_angle};

/// The robot steers towards the point of its way this far ahead, metres.
const LOOK_AHEAD_M: f64 = 0.5;
/// Changes of speed and of turn rate, m/s² and rad/s².
const ACCELERATION: (f64, f64) = (0.8, 3.0);
/// Beyond this angle to its way the robot turns on the spot, radians.
const TURN_ON_SPOT_RAD: f64 = 1.0;
/// How strongly it turns towards its way on the spot, 1/s.
const TURN_GAIN: f64 = 2.0;

/// The robot's exact motion: a constant twist within each tick.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    tick_s: f64,
    poses: Vec<Pose>,
    twists: Vec<Twist>,
}

impl Drive {
    /// Drives along `path` for so many ticks (pure pursuit: Coulter 1992), and stands still at its end.
    pub(super) fn along(path: &[Point], settings: &Settings, tick_s: f64, ticks: usize) -> Self {
        let ahead = path.iter().find(|point| point.distance_m(path[0]) > LOOK_AHEAD_M).unwrap_or(&path[0]);
        let heading_rad = (ahead.y_m - path[0].y_m).atan2(ahead.x_m - path[0].x_m);
        let mut pose = Pose::new(path[0].x_m, path[0].y_m, heading_rad);
        let (mut target, mut twist) = (0, Twist::default());
        let (mut poses, mut twists) = (Vec::with_capacity(ticks + 1), Vec::with_capacity(ticks));
        for _ in 0..ticks {
            while target + 1 < path.len() && path[target].distance_m(pose.position()) < LOOK_AHEAD_M {
                target += 1;
            }
            let arrived = target + 1 == path.len() && path[target].distance_m(pose.position()) < 0.1;
            let wanted = if arrived { Twist::default() } else { pursue(pose, path[target], settings) };
            twist = approach(twist, wanted, tick_s);
            poses.push(pose);
            twists.push(twist);
            pose = pose * twist.motion_after(tick_s);
        }
        poses.push(pose);
        Self { tick_s, poses, twists }
    }

    /// `world_from_base` at the beginning of a tick.
    pub(super) fn pose(&self, tick: usize) -> Pose {
        self.poses[tick]
    }

    /// `world_from_base` so many seconds after the beginning of a tick.
    pub(super) fn pose_after(&self, tick: usize, seconds: f64) -> Pose {
        let ticks = seconds / self.tick_s;
        let whole = (ticks as usize).min(self.twists.len() - 1 - tick);
        let rest_s = (ticks - whole as f64) * self.tick_s;
        self.poses[tick + whole] * self.twists[tick + whole].motion_after(rest_s)
    }

    /// The body's velocity during a tick.
    pub(super) fn twist(&self, tick: usize) -> Twist {
        self.twists[tick]
    }

    /// How long a tick lasts, seconds.
    pub(super) fn tick_s(&self) -> f64 {
        self.tick_s
    }
}

/// The velocity that leads along the arc to the target, slower the more it must turn.
fn pursue(pose: Pose, target: Point, settings: &Settings) -> Twist {
    let (dx, dy) = (target.x_m - pose.x_m, target.y_m - pose.y_m);
    let bearing_rad = wrap_angle(dy.atan2(dx) - pose.heading_rad);
    if bearing_rad.abs() > TURN_ON_SPOT_RAD {
        let turn_rad_s = (TURN_GAIN * bearing_rad).clamp(-settings.turn_rad_s, settings.turn_rad_s);
        return Twist { turn_rad_s, ..Twist::default() };
    }
    let curvature = 2.0 * bearing_rad.sin() / dx.hypot(dy).max(0.1);
    let slow_down = 1.0 - 0.7 * bearing_rad.abs() / TURN_ON_SPOT_RAD;
    let speed = (settings.speed_m_s * slow_down).min(settings.turn_rad_s / curvature.abs().max(1e-9));
    Twist { x_m_s: speed, y_m_s: 0.0, turn_rad_s: curvature * speed }
}

/// Changes the velocity as fast as the robot can.
fn approach(now: Twist, wanted: Twist, tick_s: f64) -> Twist {
    let towards =
        |now: f64, wanted: f64, limit: f64| now + (wanted - now).clamp(-limit * tick_s, limit * tick_s);
    Twist {
        x_m_s: towards(now.x_m_s, wanted.x_m_s, ACCELERATION.0),
        y_m_s: 0.0,
        turn_rad_s: towards(now.turn_rad_s, wanted.turn_rad_s, ACCELERATION.1),
    }
}
