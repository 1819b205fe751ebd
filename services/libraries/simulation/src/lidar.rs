//! The simulated lidar: casts the beams of a scan and adds the errors of a real sensor.

use super::drive::Turn;
use super::dynamics::Dynamics;
use super::outdoors::Tilt;
use super::{BeamLabel, Errors, Settings, World};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{ScanBuffer, ScanHeader};
use flockslam_random::Random;
use std::f64::consts::TAU;

/// Neighbouring beams whose ranges differ by more than this have an edge between them, metres.
const EDGE_M: f64 = 0.2;

/// The lidar looks out so far ahead of the robot's centre, metres: on small robots it is not quite in the middle.
const MOUNT_M: f64 = 0.1;
/// Nothing nearer than this is measured (-Inf), metres: small lidars are blind there.
const RANGE_MIN_M: f32 = 0.1;
/// No lidar turns more slowly than this, seconds: at lower rates of scans some turns give none.
const TURN_MAX_S: f64 = 0.1;

/// A rotating lidar with the errors of real ones. It sees the whole circle or a part of it that is ahead, and turns
/// counter-clockwise.
#[derive(Clone, Debug)]
pub(super) struct Lidar {
    settings: Settings,
    errors: Errors,
    mount: Pose,
    angle_min_rad: f64,
    angle_increment_rad: f64,
    /// Seconds from beam to beam.
    time_increment_s: f32,
    random: Random,
    /// For what outdoors differs from scan to scan.
    returns: Random,
    /// True ranges of the scan at hand, infinite where nothing is in reach.
    ranges_m: Vec<f64>,
    /// Label of each beam of the present scan.
    labels: Vec<BeamLabel>,
}

impl Lidar {
    /// A lidar that gives a scan every `period_s` seconds.
    pub(super) fn new(settings: &Settings, errors: &Errors, period_s: f64) -> Self {
        let view_rad = settings.field_of_view_deg.to_radians();
        let angle_increment_rad = view_rad / f64::from(settings.beams);
        Self {
            settings: settings.clone(),
            errors: errors.clone(),
            mount: Pose::new(MOUNT_M, 0.0, 0.0),
            angle_min_rad: -view_rad / 2.0,
            angle_increment_rad,
            time_increment_s: (period_s.min(TURN_MAX_S) * angle_increment_rad / TAU) as f32,
            random: Random::new(settings.seed, "lidar"),
            returns: Random::new(settings.seed, "returns"),
            ranges_m: Vec::with_capacity(settings.beams as usize),
            labels: Vec::with_capacity(settings.beams as usize),
        }
    }

    /// Takes a scan during a turn. Its name, times and odometry are left to the caller.
    pub(super) fn take(&mut self, world: &World, dynamics: &Dynamics, turn: &Turn, scan: &mut ScanBuffer) {
        scan.header = ScanHeader {
            base_from_laser: self.mount,
            angle_min_rad: self.angle_min_rad,
            angle_increment_rad: self.angle_increment_rad,
            range_min_m: RANGE_MIN_M,
            range_max_m: self.settings.range_max_m,
            time_increment_s: self.time_increment_s,
            beam_count: self.settings.beams,
            ..ScanHeader::default()
        };
        self.cast_all(world, dynamics, turn);
        scan.numbers.clear();
        for beam in 0..self.ranges_m.len() {
            let range = self.measure(beam);
            scan.numbers.push(range);
        }
    }

    /// Puts it elsewhere on the robot.
    pub(super) fn put(&mut self, base_from_laser: Pose) {
        self.mount = base_from_laser;
    }

    /// Its pose on the robot, `base_from_laser`.
    pub(super) fn mount(&self) -> Pose {
        self.mount
    }

    /// Label of each beam of the last scan.
    pub(super) fn labels(&self) -> &[BeamLabel] {
        &self.labels
    }

    fn cast_all(&mut self, world: &World, dynamics: &Dynamics, turn: &Turn) {
        self.ranges_m.clear();
        self.labels.clear();
        let tilt = if world.is_outdoors() { Tilt::drawn(&mut self.returns) } else { Tilt::default() };
        for beam in 0..self.settings.beams {
            let seconds = f64::from(beam) * f64::from(self.time_increment_s);
            let laser = turn.pose_after(seconds) * self.mount;
            let direction_rad =
                laser.heading_rad + self.angle_min_rad + f64::from(beam) * self.angle_increment_rad;
            let (sin, cos) = sin_cos(direction_rad);
            // A little farther than the lidar reaches, so that edges there look like all others.
            let reach_m = f64::from(self.settings.range_max_m) + 1.0;
            let (from, direction) = (laser.position(), Point::new(cos, sin));
            let wall = world.range_m((from, direction), tilt, reach_m, &mut self.returns);
            let wall = wall.unwrap_or(f64::INFINITY);
            let other = dynamics.cast(from, direction, seconds).filter(|(range_m, _)| *range_m < wall);
            let (range_m, label) = other.unwrap_or((wall, BeamLabel::Static));
            self.ranges_m.push(range_m);
            self.labels.push(label);
        }
    }

    /// The range that the lidar gives for a beam: metres, or an infinity as REP-117 has it.
    fn measure(&mut self, beam: usize) -> f32 {
        let mut true_m = self.ranges_m[beam];
        let next = (beam + 1) % self.ranges_m.len();
        let next_m = self.ranges_m[next];
        let at_edge = next_m.is_finite() && (true_m - next_m).abs() > EDGE_M;
        if at_edge && true_m.is_finite() && self.random.happens(self.errors.mixed_pixel_share) {
            true_m += self.random.share() * (next_m - true_m);
            // The last beam's neighbour is the first, whose range may have been lost.
            self.labels[beam] = self.labels[beam].max(self.labels[next]);
        }
        let range = self.returned(true_m);
        if !range.is_finite() {
            self.labels[beam] = BeamLabel::NoReturn;
        }
        range
    }

    /// The measured value for a true range.
    fn returned(&mut self, true_m: f64) -> f32 {
        if self.random.happens(self.errors.dropout_share) {
            return f32::INFINITY;
        }
        let errors = &self.errors;
        let noise_m = errors.range_sigma_m * self.random.normal() + errors.range_bias_m;
        match (true_m + noise_m) as f32 {
            range if range > self.settings.range_max_m => f32::INFINITY,
            range if range < RANGE_MIN_M => f32::NEG_INFINITY,
            range => range,
        }
    }
}
