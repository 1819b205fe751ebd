//! Logs that the simulation writes, for tests that need a file.

use flockslam_lidar_ingest::carmen::write_scan;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings, Simulation, World};

/// A CARMEN log of the simulated building: one ROBOTLASER1 line a scan, ten scans a second.
pub fn simulated_log(duration_s: f64) -> String {
    let settings = Settings { duration_s, beams: 180, ..Settings::default() };
    let mut simulation = Simulation::new(&settings, World::floor_plan()).unwrap();
    let (mut scan, mut log) = (ScanBuffer::default(), Vec::new());
    while simulation.next_scan(&mut scan).is_some() {
        write_scan(&mut log, scan.view().unwrap()).unwrap();
    }
    String::from_utf8(log).unwrap()
}
