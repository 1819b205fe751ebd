//! Cells of a map that stand occupied although beams have gone through them since they were last hit: ghosts of a real log, where
//! nobody knows the truth.

use super::Outputs;
use super::moved_map::{Map, Share, around};
use flockslam_evidence::CellIndex;
use flockslam_geometry::{Point, Pose};
use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::carmen::CarmenReader;
use flockslam_messages::{ScanBuffer, ScanView};
use flockslam_ray_insertion::Ray;
use std::collections::BTreeMap;
use std::path::Path;

/// Beams are followed so far, metres: farther away they are too far apart.
const REACH_M: f64 = 12.0;
/// A beam goes through what it ends this far behind, metres.
const BEHIND_M: f64 = 0.3;
/// A hit this near to a cell is one of what stands there, cells: poses and ranges have errors.
const NEAR_CELLS: i32 = 2;
/// Scans at least so far apart are views of their own, nanoseconds.
const VIEW_EVERY_NS: i64 = 300_000_000;
/// Views after which what has gone should be gone from the map.
const VIEWS: u32 = 3;

/// What became of an occupied cell since it was hit last.
#[derive(Clone, Copy, Default)]
struct Views {
    count: u32,
    last_ns: i64,
}

/// Of the occupied cells of a run's map, those (`good`) that were viewed free at least three times since they were last hit.
pub fn later_free(outputs: &Outputs, log: &Path) -> Share {
    let map = Map::read(outputs, None);
    let mut cells: BTreeMap<(i32, i32), Views> =
        map.occupied_indices().map(|cell| ((cell.y, cell.x), Views::default())).collect();
    let bytes = std::fs::read(log).unwrap();
    let mut reader = CarmenReader::new(bytes.as_slice(), "log", Settings::default());
    let (mut scan, poses) = (ScanBuffer::default(), outputs.trajectory("trajectory.tum"));
    for pose in poses {
        assert!(reader.next_scan(&mut scan).unwrap(), "a pose for each scan");
        let map_from_laser = pose.map_from_base * scan.header.base_from_laser;
        view(&map, &mut cells, scan.view().unwrap(), map_from_laser);
    }
    let stale = cells.values().filter(|views| views.count >= VIEWS).count();
    Share { good: stale, of: cells.len() }
}

/// Counts what a scan looks through, then drops what it hits.
fn view(map: &Map, cells: &mut BTreeMap<(i32, i32), Views>, scan: ScanView<'_>, map_from_laser: Pose) {
    let now_ns = scan.header().times.sensor_ns;
    let in_cells = |point: Point| map.in_cells(point);
    let beams = || {
        (0..scan.len()).filter_map(|beam| {
            let range_m = scan.valid_range_m(beam)?;
            let (sin, cos) = scan.angle_rad(beam).sin_cos();
            let along = move |metres: f64| map_from_laser.apply(Point::new(metres * cos, metres * sin));
            Some((range_m, along))
        })
    };
    for (range_m, along) in beams() {
        let end = in_cells(along((range_m - BEHIND_M).clamp(0.0, REACH_M)));
        for cell in Ray::new(in_cells(map_from_laser.position()), end) {
            if let Some(views) = cells.get_mut(&(cell.y, cell.x))
                && (views.last_ns == 0 || (now_ns - views.last_ns).abs() >= VIEW_EVERY_NS)
            {
                *views = Views { count: views.count + 1, last_ns: now_ns };
            }
        }
    }
    for (range_m, along) in beams().filter(|(range_m, _)| *range_m <= REACH_M) {
        let end = in_cells(along(range_m));
        let hit = CellIndex::new(end.x_m.floor() as i32, end.y_m.floor() as i32);
        for near in around(hit, NEAR_CELLS) {
            if let Some(views) = cells.get_mut(&(near.y, near.x)) {
                *views = Views { count: 0, last_ns: now_ns };
            }
        }
    }
}
