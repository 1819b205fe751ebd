//! The simulated wheels: odometry with scale errors, random walk and slips.

use super::drive::Turn;
use super::{Errors, Settings};
use flockslam_geometry::{Pose, Twist};
use flockslam_random::Random;
use std::collections::VecDeque;

/// How long a wheel slips, seconds.
const SLIP_S: (f64, f64) = (0.5, 1.5);
/// Largest false turn rate of a slip, rad/s, and the smallest as a share of it.
const SLIP_TURN: (f64, f64) = (0.8, 0.4);
/// Largest share of distance that a slip invents.
const SLIP_DISTANCE: f64 = 0.6;
/// Standing still nothing slips, m/s.
const MOVING_M_S: f64 = 0.05;

/// Dead reckoning: the true motion with constant scale errors, a random walk and slips. It begins at the identity.
#[derive(Clone, Debug)]
pub(super) struct Wheels {
    random: Random,
    /// Of distances and of turns.
    scale: [f64; 2],
    /// Slips that are not over yet, in the order of their starts.
    slips: VecDeque<Slip>,
    walk: [f64; 2],
    /// Radians per metre of driving.
    drift_rad_m: f64,
    ticks: usize,
    odom_from_base: Pose,
}

/// A time in which the wheels turn without moving the robot as they should.
#[derive(Clone, Copy, Debug)]
struct Slip {
    start_s: f64,
    end_s: f64,
    turn_rad_s: f64,
    distance: f64,
}

impl Wheels {
    pub(super) fn new(settings: &Settings, errors: &Errors) -> Self {
        let mut random = Random::new(settings.seed, "wheels");
        let scale = [0; 2].map(|_| 1.0 + errors.odometry_scale_error * random.normal());
        let slips = draw_slips(settings, &mut random);
        let drift_rad_m = errors.heading_drift_deg_m.to_radians();
        let to_the_left = drift_rad_m == 0.0 || random.happens(0.5);
        Self {
            random,
            scale,
            slips,
            walk: errors.odometry_walk,
            drift_rad_m: if to_the_left { drift_rad_m } else { -drift_rad_m },
            ticks: 0,
            odom_from_base: Pose::IDENTITY,
        }
    }

    /// `odom_from_base` now.
    pub(super) fn pose(&self) -> Pose {
        self.odom_from_base
    }

    /// Feels a motion.
    pub(super) fn advance(&mut self, turn: &Turn) {
        for twist in turn.twists() {
            let time_s = self.ticks as f64 * turn.tick_s();
            while self.slips.front().is_some_and(|slip| slip.end_s <= time_s) {
                self.slips.pop_front();
            }
            let begun = self.slips.iter().take_while(|slip| slip.start_s <= time_s);
            let slip = begun.copied().find(|slip| time_s < slip.end_s);
            let felt = feel(twist, self.scale, slip);
            self.odom_from_base = self.odom_from_base * felt.motion_after(turn.tick_s());
            self.ticks += 1;
        }
        let driven_m = turn.start().distance_m(turn.end());
        let drift = Pose::new(0.0, 0.0, self.drift_rad_m * driven_m);
        self.odom_from_base =
            self.odom_from_base * random_step(driven_m, self.walk, &mut self.random) * drift;
    }
}

/// One slip at a random time of each of as many equal parts of the drive.
fn draw_slips(settings: &Settings, random: &mut Random) -> VecDeque<Slip> {
    let part_s = settings.duration_s / f64::from(settings.wheel_slips.max(1));
    let draw = |i| {
        let start_s = (f64::from(i) + random.share()) * part_s;
        let turn_rad_s = SLIP_TURN.0 * random.between(SLIP_TURN.1, 1.0);
        Slip {
            start_s,
            end_s: start_s + random.between(SLIP_S.0, SLIP_S.1),
            turn_rad_s: if random.happens(0.5) { turn_rad_s } else { -turn_rad_s },
            distance: random.between(0.0, SLIP_DISTANCE),
        }
    };
    (0..settings.wheel_slips).map(draw).collect()
}

/// The motion as the wheels measure it.
fn feel(twist: Twist, scale: [f64; 2], slip: Option<Slip>) -> Twist {
    let scaled = Twist { x_m_s: twist.x_m_s * scale[0], y_m_s: 0.0, turn_rad_s: twist.turn_rad_s * scale[1] };
    match slip {
        Some(slip) if twist.x_m_s > MOVING_M_S => Twist {
            x_m_s: scaled.x_m_s * (1.0 + slip.distance),
            turn_rad_s: scaled.turn_rad_s + slip.turn_rad_s,
            ..scaled
        },
        _ => scaled,
    }
}

/// A random step whose variance grows with the distance: metres and degrees over one metre.
fn random_step(driven_m: f64, [sigma_m, sigma_deg]: [f64; 2], random: &mut Random) -> Pose {
    let root = driven_m.sqrt();
    let mut step = |sigma: f64| sigma * root * random.normal();
    Pose::new(step(sigma_m), step(sigma_m), step(sigma_deg.to_radians()))
}
