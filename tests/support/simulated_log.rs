//! Logs that the simulation writes, for tests that need a file.

use flockslam::outputs::TrajectoryPoint;
use flockslam_lidar_ingest::carmen::write_scan;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings, Simulation, World};
use std::path::{Path, PathBuf};

/// A CARMEN log of the simulated building: one ROBOTLASER1 line a scan, ten scans a second.
pub fn simulated_log(duration_s: f64) -> String {
    simulated(duration_s).0
}

/// As [`simulated_log`], as a file in a directory, with the true pose of each scan.
pub fn simulated_drive(directory: &Path, duration_s: f64) -> (PathBuf, Vec<TrajectoryPoint>) {
    let (log, truth) = simulated(duration_s);
    let path = directory.join("drive.log");
    std::fs::write(&path, log).unwrap();
    (path, truth)
}

fn simulated(duration_s: f64) -> (String, Vec<TrajectoryPoint>) {
    let settings = Settings { duration_s, beams: 180, ..Settings::default() };
    let mut simulation = Simulation::new(&settings, World::floor_plan()).unwrap();
    let (mut scan, mut log, mut truth) = (ScanBuffer::default(), Vec::new(), Vec::new());
    while let Some(map_from_base) = simulation.next_scan(&mut scan) {
        write_scan(&mut log, scan.view().unwrap()).unwrap();
        truth.push(TrajectoryPoint { stamp_ns: scan.header.times.sensor_ns, map_from_base });
    }
    (String::from_utf8(log).unwrap(), truth)
}
