//! The exact motion of the simulated robot along its tour: pure pursuit with bounded accelerations (Coulter 1992).

use super::free_space::FreeSpace;
use super::tour::Tour;
use super::{Settings, WorldName};
use flockslam_geometry::elementary::{atan2, hypot, sin};
use flockslam_geometry::{Point, Pose, Twist, wrap_angle};
use flockslam_random::Random;
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::sync::Arc;

/// Fastest driving, m/s: an easy walking pace.
pub(super) const SPEED_M_S: f64 = 0.8;
/// On the campus scans are at most this far apart, metres: with a slow lidar the robot drives and turns slower.
const APART_M: f64 = 0.3;
/// Fastest turning, rad/s: faster, a lidar of 10 Hz shears its scans by more than 6°.
pub(super) const TURN_RAD_S: f64 = 1.0;
/// The robot steers towards the point of its way this far ahead, metres.
const LOOK_AHEAD_M: f64 = 0.5;
/// Changes of speed and of turn rate, m/s² and rad/s².
const ACCELERATION: (f64, f64) = (0.8, 3.0);
/// Beyond this angle to its way the robot turns on the spot, radians.
const TURN_ON_SPOT_RAD: f64 = 1.0;
/// How strongly it turns towards its way on the spot, 1/s.
const TURN_GAIN: f64 = 2.0;
/// On the campus the robot pauses every so often, seconds.
const PAUSE_EVERY_S: f64 = 1000.0;
/// How long a pause takes, seconds.
const PAUSE_S: (f64, f64) = (60.0, 180.0);
/// A kidnapped robot is put down at least this far off, metres, where the world is large enough.
const CARRIED_M: f64 = 5.0;
/// Legs that may be planned before one must lead away from the start.
const LEGS_TO_LEAVE: usize = 1000;

/// The robot's exact motion, one turn of the lidar after another: a constant twist within each tick.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    tick_s: f64,
    limits: Limits,
    /// Times at which it stands still, seconds since the start, in their order: from, to.
    pauses_s: VecDeque<(f64, f64)>,
    now_s: f64,
    tour: Tour,
    /// What is planned and not yet driven; its first point is steered towards.
    way: VecDeque<Point>,
    pose: Pose,
    twist: Twist,
    turn: Turn,
}

/// How fast the robot drives and turns.
#[derive(Clone, Copy, Debug)]
struct Limits {
    speed_m_s: f64,
    turn_rad_s: f64,
}

impl Limits {
    fn of(settings: &Settings) -> Self {
        let is_careful = settings.world == WorldName::Campus;
        let speed_m_s = if is_careful { SPEED_M_S.min(APART_M * settings.scan_rate_hz) } else { SPEED_M_S };
        Self { speed_m_s, turn_rad_s: TURN_RAD_S * speed_m_s / SPEED_M_S }
    }
}

/// The motion during one turn of the lidar.
#[derive(Clone, Debug, Default)]
pub(super) struct Turn {
    tick_s: f64,
    /// `world_from_base` at the start of each tick, and the twist in the body frame during it.
    ticks: Vec<(Pose, Twist)>,
    end: Pose,
}

impl Drive {
    /// Stands at the start of a tour.
    pub(super) fn new(settings: &Settings, mut tour: Tour, tick_s: f64) -> Self {
        let mut way = VecDeque::new();
        let mut ahead = None;
        for _ in 0..LEGS_TO_LEAVE {
            way.extend(tour.next_leg());
            let leaves = |point: &&Point| point.distance_m(way[0]) > LOOK_AHEAD_M;
            ahead = way.iter().find(leaves).copied();
            if ahead.is_some() {
                break;
            }
        }
        let (start, ahead) = (way[0], ahead.unwrap_or(way[0]));
        let heading_rad = atan2(ahead.y_m - start.y_m, ahead.x_m - start.x_m);
        Self {
            tick_s,
            limits: Limits::of(settings),
            pauses_s: draw_pauses(settings),
            now_s: 0.0,
            tour,
            way,
            pose: Pose::new(start.x_m, start.y_m, heading_rad),
            twist: Twist::default(),
            turn: Turn::default(),
        }
    }

    /// Drives on for so many ticks (pure pursuit: Coulter 1992).
    pub(super) fn advance(&mut self, ticks: usize) -> &Turn {
        self.turn.tick_s = self.tick_s;
        self.turn.ticks.clear();
        for _ in 0..ticks {
            let wanted =
                if self.pauses() { Twist::default() } else { pursue(self.pose, self.target(), self.limits) };
            self.twist = approach(self.twist, wanted, self.tick_s);
            self.turn.ticks.push((self.pose, self.twist));
            self.pose = self.pose * self.twist.motion_after(self.tick_s);
            self.now_s += self.tick_s;
        }
        self.turn.end = self.pose;
        &self.turn
    }

    /// The motion during the turn that was driven last.
    pub(super) fn last_turn(&self) -> &Turn {
        &self.turn
    }

    /// Whether it is to stand still now.
    fn pauses(&mut self) -> bool {
        while self.pauses_s.front().is_some_and(|(_, to_s)| *to_s <= self.now_s) {
            self.pauses_s.pop_front();
        }
        self.pauses_s.front().is_some_and(|(from_s, _)| *from_s <= self.now_s)
    }

    /// The next point of the way that is not reached yet.
    fn target(&mut self) -> Point {
        loop {
            // Short legs follow each other; each call of `next_leg` gives at least one point.
            while self.way.len() < 2 {
                self.way.extend(self.tour.next_leg());
            }
            if self.way[0].distance_m(self.pose.position()) >= LOOK_AHEAD_M {
                return self.way[0];
            }
            self.way.pop_front();
        }
    }

    /// The free space that it drives in.
    pub(super) fn room(&self) -> &Arc<FreeSpace> {
        self.tour.room()
    }

    /// Where it is now, `world_from_base`.
    pub(super) fn pose(&self) -> Pose {
        self.pose
    }

    /// Puts the robot down, at rest, at another free place with another heading; it goes on with its tour from there.
    pub(super) fn kidnap(&mut self, random: &mut Random) {
        let place = self.tour.room().place_away_from(self.pose.position(), CARRIED_M, random);
        self.pose = Pose::new(place.x_m, place.y_m, random.between(-PI, PI));
        self.twist = Twist::default();
        self.way.clear();
        self.way.extend(self.tour.leg_from(place));
    }
}

impl Turn {
    /// `world_from_base` at its start.
    pub(super) fn start(&self) -> Pose {
        self.ticks[0].0
    }

    /// `world_from_base` at its end.
    pub(super) fn end(&self) -> Pose {
        self.end
    }

    /// `world_from_base` so many seconds after its start.
    pub(super) fn pose_after(&self, seconds: f64) -> Pose {
        let ticks = seconds / self.tick_s;
        let whole = (ticks as usize).min(self.ticks.len() - 1);
        let rest_s = (ticks - whole as f64) * self.tick_s;
        let (pose, twist) = self.ticks[whole];
        pose * twist.motion_after(rest_s)
    }

    /// The body's velocity during each tick.
    pub(super) fn twists(&self) -> impl Iterator<Item = Twist> {
        self.ticks.iter().map(|(_, twist)| *twist)
    }

    /// How long a tick lasts, seconds.
    pub(super) fn tick_s(&self) -> f64 {
        self.tick_s
    }
}

/// On the campus: one pause at a random time of each of as many equal parts of the drive.
fn draw_pauses(settings: &Settings) -> VecDeque<(f64, f64)> {
    if settings.world != WorldName::Campus {
        return VecDeque::new();
    }
    let mut random = Random::new(settings.seed, "pauses");
    let count = (settings.duration_s / PAUSE_EVERY_S) as u32;
    let draw = |i| {
        let from_s = (f64::from(i) + random.between(0.2, 0.7)) * PAUSE_EVERY_S;
        (from_s, from_s + random.between(PAUSE_S.0, PAUSE_S.1))
    };
    (0..count).map(draw).collect()
}

/// The velocity that leads along the arc to the target, slower the more it must turn.
fn pursue(pose: Pose, target: Point, limits: Limits) -> Twist {
    let (dx, dy) = (target.x_m - pose.x_m, target.y_m - pose.y_m);
    let bearing_rad = wrap_angle(atan2(dy, dx) - pose.heading_rad);
    if bearing_rad.abs() > TURN_ON_SPOT_RAD {
        let turn_rad_s = (TURN_GAIN * bearing_rad).clamp(-limits.turn_rad_s, limits.turn_rad_s);
        return Twist { turn_rad_s, ..Twist::default() };
    }
    let curvature = 2.0 * sin(bearing_rad) / hypot(dx, dy).max(0.1);
    let slow_down = 1.0 - 0.7 * bearing_rad.abs() / TURN_ON_SPOT_RAD;
    let speed = (limits.speed_m_s * slow_down).min(limits.turn_rad_s / curvature.abs().max(1e-9));
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
