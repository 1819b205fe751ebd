//! A simulated building: a robot drives through it, and its lidar, its wheels and the exact truth are known.
//!
//! The world is made of line segments (a built-in floor plan) or of the pixels of a map image. A planner finds a smooth
//! tour that comes back to places seen before; the lidar casts every beam from where the robot is at that very instant, so
//! scans are distorted by motion as real ones are. Everything follows from the settings and their seed.

mod drive;
mod floor_plan;
mod image;
mod lidar;
mod planner;
mod settings;
mod wheels;
mod world;

pub use image::{ImageWorld, SimulationError};
pub use settings::Settings;
pub use world::World;

use crate::random::Random;
use drive::Drive;
use flockslam_geometry::Pose;
use flockslam_messages::{ScanBuffer, ScanId, Times};
use lidar::Lidar;

/// Steps of the robot's motion in one turn of the lidar.
const TICKS_PER_SCAN: usize = 10;

/// A drive through a simulated world, scan by scan.
#[derive(Clone, Debug)]
pub struct Simulation {
    world: World,
    drive: Drive,
    lidar: Lidar,
    /// Dead reckoning of the wheels at each scan.
    odometry: Vec<Pose>,
    period_ns: i64,
    next: usize,
}

impl Simulation {
    /// A drive through `world`.
    ///
    /// # Errors
    /// When a setting is out of its range or the world has no room for the robot to drive in.
    pub fn new(settings: &Settings, world: World) -> Result<Self, SimulationError> {
        settings.check().map_err(SimulationError::Setting)?;
        let scans = (settings.duration_s * settings.scan_rate_hz).round().max(1.0) as usize;
        let period_s = 1.0 / settings.scan_rate_hz;
        let tick_s = period_s / TICKS_PER_SCAN as f64;
        let tour =
            world.tour(settings.speed_m_s * settings.duration_s, &mut Random::new(settings.seed, "tour"))?;
        // One turn more, for the beams of the last scan.
        let drive = Drive::along(&tour, settings, tick_s, (scans + 1) * TICKS_PER_SCAN);
        let odometry = wheels::dead_reckoning(&drive, settings, TICKS_PER_SCAN, scans);
        let lidar = Lidar::new(settings, period_s);
        Ok(Self { world, drive, lidar, odometry, period_ns: (period_s * 1e9).round() as i64, next: 0 })
    }

    /// How many scans the whole drive has.
    pub fn scans(&self) -> usize {
        self.odometry.len()
    }

    /// Takes the next scan into `scan`, whose memory is used again. Returns the exact pose `world_from_base` at its stamp,
    /// or `None` when the drive is over.
    pub fn next_scan(&mut self, scan: &mut ScanBuffer) -> Option<Pose> {
        let odometry = *self.odometry.get(self.next)?;
        let tick = self.next * TICKS_PER_SCAN;
        self.lidar.take(&self.world, &self.drive, tick, scan);
        scan.header.id = ScanId { sequence: self.next as u64, ..ScanId::default() };
        scan.header.times = Times { sensor_ns: self.next as i64 * self.period_ns, ..Times::default() };
        (scan.header.odometry, scan.header.has_odometry) = (odometry, 1);
        self.next += 1;
        Some(self.drive.pose(tick))
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
