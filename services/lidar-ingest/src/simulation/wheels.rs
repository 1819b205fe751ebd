use super::Settings;
use super::drive::Drive;
use crate::random::Random;
use flockslam_geometry::{Pose, Twist};

/// How long a wheel slips, seconds.
const SLIP_S: (f64, f64) = (0.5, 1.5);
/// Largest false turn rate of a slip, rad/s, and the smallest as a share of it.
const SLIP_TURN: (f64, f64) = (0.8, 0.4);
/// Largest share of distance that a slip invents.
const SLIP_DISTANCE: f64 = 0.6;
/// Standing still nothing slips, m/s.
const MOVING_M_S: f64 = 0.05;

/// A time in which the wheels turn without moving the robot as they should.
#[derive(Clone, Copy, Debug)]
struct Slip {
    start_s: f64,
    end_s: f64,
    turn_rad_s: f64,
    distance: f64,
}

/// `odom_from_base` at each scan: the true motion with constant scale errors, a random walk and slips. It begins at the
/// identity.
pub(super) fn dead_reckoning(
    drive: &Drive,
    settings: &Settings,
    ticks_per_scan: usize,
    scans: usize,
) -> Vec<Pose> {
    let mut random = Random::new(settings.seed, "wheels");
    let scale = [0; 2].map(|_| 1.0 + settings.odometry_scale_error * random.normal());
    let slips = draw_slips(settings, &mut random);
    let mut pose = Pose::IDENTITY;
    let mut poses = Vec::with_capacity(scans);
    for scan in 0..scans {
        poses.push(pose);
        for tick in scan * ticks_per_scan..(scan + 1) * ticks_per_scan {
            let felt = feel(drive.twist(tick), scale, slips.iter().find(|slip| slip.covers(tick, drive)));
            pose = pose * felt.motion_after(drive.tick_s());
        }
        let driven_m = drive.pose(scan * ticks_per_scan).distance_m(drive.pose((scan + 1) * ticks_per_scan));
        pose = pose * walk(driven_m, settings, &mut random);
    }
    poses
}

/// One slip at a random time of each of as many equal parts of the drive.
fn draw_slips(settings: &Settings, random: &mut Random) -> Vec<Slip> {
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

impl Slip {
    fn covers(&self, tick: usize, drive: &Drive) -> bool {
        (self.start_s..self.end_s).contains(&(tick as f64 * drive.tick_s()))
    }
}

/// What the wheels feel of a motion.
fn feel(twist: Twist, scale: [f64; 2], slip: Option<&Slip>) -> Twist {
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

/// A random step whose variance grows with the distance.
fn walk(driven_m: f64, settings: &Settings, random: &mut Random) -> Pose {
    let [sigma_m, sigma_deg] = settings.odometry_walk;
    let root = driven_m.sqrt();
    let mut step = |sigma: f64| sigma * root * random.normal();
    Pose::new(step(sigma_m), step(sigma_m), step(sigma_deg.to_radians()))
}
