//! A simulated world: a robot drives through it, and its lidar, its wheels and the exact truth are known.
//!
//! The world is made of line segments (a built-in one, see [`WorldName`]) or of the pixels of a map image. A planner finds a
//! smooth tour that comes back to places seen before; the lidar casts every beam from where the robot is at that very
//! instant, so scans are distorted by motion as real ones are. People walk in it, doors open and close, pallets come and go, if
//! asked for ([`Settings::walkers`] and those beside it). Everything follows from the settings and their seed, and is
//! made scan by scan: a drive of any length takes the same memory.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod axis;
mod built_in;
mod drawing;
mod drive;
mod dynamics;
mod errors;
mod floor_plan;
mod free_space;
mod ground_truth;
mod image;
mod index;
mod label;
mod lidar;
mod outdoors;
mod planner;
mod settings;
mod terrain;
mod tour;
mod wheels;
mod world;

pub use dynamics::MoverTruth;
pub use errors::Errors;
pub use ground_truth::{CellTruth, GroundTruth};
pub use image::{ImageWorld, SimulationError};
pub use label::BeamLabel;
pub use settings::{Settings, WorldName};
pub use world::World;

use drive::Drive;
use dynamics::Dynamics;
use flockslam_geometry::{Pose, Twist};
use flockslam_messages::{ScanBuffer, ScanId, Times};
use flockslam_random::Random;
use lidar::Lidar;
use wheels::Wheels;

/// Steps of the robot's motion in one turn of the lidar.
const TICKS_PER_SCAN: usize = 10;

/// A drive through a simulated world, scan by scan.
///
/// ```
/// use flockslam_simulation::{Settings, Simulation, World};
///
/// let settings = Settings { duration_s: 1.0, beams: 90, ..Settings::default() };
/// let simulation = Simulation::new(&settings, World::floor_plan())?;
/// assert_eq!(simulation.scans(), 10);
/// let drive: Vec<_> = simulation.collect();
/// let ((first, start), (last, end)) = (&drive[0], &drive[9]);
/// assert_eq!((first.header.beam_count, last.header.id.sequence), (90, 9));
/// assert!(start.distance_m(*end) > 0.1, "the robot has begun to drive");
/// # Ok::<(), flockslam_simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Simulation {
    world: World,
    drive: Drive,
    dynamics: Dynamics,
    wheels: Wheels,
    lidar: Lidar,
    /// When the robot is kidnapped, seconds, the last first.
    kidnaps_s: Vec<f64>,
    kidnapper: Random,
    period_s: f64,
    scans: usize,
    next: usize,
}

impl Simulation {
    /// A drive through `world`.
    ///
    /// # Errors
    /// When a setting is out of its range or the world has no room for the robot to drive in.
    pub fn new(settings: &Settings, world: World) -> Result<Self, SimulationError> {
        Self::with_errors(settings, world, &settings.errors())
    }

    /// As [`Simulation::new`], with these errors of lidar and wheels in place of those that are usual in the world.
    ///
    /// # Errors
    /// As [`Simulation::new`].
    pub fn with_errors(settings: &Settings, world: World, errors: &Errors) -> Result<Self, SimulationError> {
        settings.check().map_err(SimulationError::Setting)?;
        let period_s = 1.0 / settings.scan_rate_hz;
        let tour = world.tour(Random::new(settings.seed, "tour"))?;
        let mut kidnaps_s = settings.kidnap_at_s.clone();
        kidnaps_s.sort_by(|a, b| b.total_cmp(a));
        let mut drive = Drive::new(settings, tour, period_s / TICKS_PER_SCAN as f64);
        for _ in 0..(settings.lead_s * settings.scan_rate_hz).round() as usize {
            drive.advance(TICKS_PER_SCAN);
        }
        let dynamics = Dynamics::new(settings, &world, drive.room().clone(), drive.pose(), period_s);
        Ok(Self {
            world,
            drive,
            dynamics,
            wheels: Wheels::new(settings, errors),
            lidar: Lidar::new(settings, errors, period_s),
            kidnaps_s,
            kidnapper: Random::new(settings.seed, "kidnapper"),
            period_s,
            scans: (settings.duration_s * settings.scan_rate_hz).round().max(1.0) as usize,
            next: 0,
        })
    }

    /// With the lidar elsewhere on the robot: `base_from_laser`.
    #[must_use]
    pub fn mounted(mut self, base_from_laser: Pose) -> Self {
        self.lidar.put(base_from_laser);
        self
    }

    /// How many scans the whole drive has.
    pub fn scans(&self) -> usize {
        self.scans
    }

    /// Takes the next scan into `scan`, whose memory is used again. Returns the exact pose `world_from_base` at its stamp,
    /// or `None` when the drive is over.
    pub fn next_scan(&mut self, scan: &mut ScanBuffer) -> Option<Pose> {
        if self.next == self.scans {
            return None;
        }
        let now_s = self.next as f64 * self.period_s;
        while self.kidnaps_s.pop_if(|at_s| *at_s <= now_s).is_some() {
            self.drive.kidnap(&mut self.kidnapper);
        }
        let turn = self.drive.advance(TICKS_PER_SCAN);
        self.dynamics.advance(&self.world, turn);
        self.lidar.take(&self.world, &self.dynamics, turn, scan);
        scan.header.id = ScanId { sequence: self.next as u64, ..ScanId::default() };
        let sensor_ns = self.next as i64 * (self.period_s * 1e9).round() as i64;
        scan.header.times = Times { sensor_ns, ..Times::default() };
        (scan.header.odometry, scan.header.has_odometry) = (self.wheels.pose(), 1);
        self.wheels.advance(turn);
        self.next += 1;
        Some(turn.start())
    }

    /// What each beam of the last scan ended on: exact, for measurements. No message carries it.
    pub fn labels(&self) -> &[BeamLabel] {
        self.lidar.labels()
    }

    /// The robot's exact velocity at the last scan's stamp.
    pub fn twist(&self) -> Twist {
        self.drive.last_turn().twists().next().unwrap_or_default()
    }

    /// Exact pose `world_from_laser`, so many seconds after the last scan's stamp.
    pub fn laser_at(&self, seconds: f64) -> Pose {
        self.drive.last_turn().pose_after(seconds) * self.lidar.mount()
    }

    /// Who moved, and how, at the last scan's stamp: exact, for measurements. No message carries it.
    pub fn movers(&self) -> impl Iterator<Item = MoverTruth> {
        self.dynamics.movers()
    }
}

impl Iterator for Simulation {
    type Item = (ScanBuffer, Pose);

    fn next(&mut self) -> Option<Self::Item> {
        let mut scan = ScanBuffer::default();
        let truth = self.next_scan(&mut scan)?;
        Some((scan, truth))
    }
}

#[cfg(test)]
mod tests;
