//! A picture of the map of a set that runs: closed submaps where the solution has them, around them the grid that is being built, and the
//! way of the robot.

use crate::outputs::{PictureTracks, TrajectoryPoint, render_picture};
use crate::recording::request_tiles;
use crate::ros_bridge::MapPainter;
use crate::supervisor::SetFile;
use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_geometry::Pose;
use flockslam_map_fusion::FusedMap;
use flockslam_messages::{Commit, PoseFlags, TileMessage};
use flockslam_results::{SubmapStore, read_live_poses};
use flockslam_stage::JournalReader;
use std::time::{Duration, Instant};

/// A set that scans gives its grid within this.
const GRID: Duration = Duration::from_secs(3);
const LOOK: Duration = Duration::from_millis(20);
/// Side of a cell of the picture, metres.
const RESOLUTION_M: f64 = 0.05;

/// The picture, a PNG.
///
/// # Errors
/// Why there is none, in words.
pub fn picture_of(runtime: &RuntimeDir) -> Result<Vec<u8>, String> {
    let file = SetFile::read(&runtime.configuration()).map_err(|error| error.to_string())?;
    let cell_size_m = file.configuration.mapper.cell_size_m;
    let mut painter = MapPainter::new(RESOLUTION_M.max(cell_size_m), cell_size_m);
    take_grid(runtime, &mut painter)?;
    let fused = fused_map(runtime, cell_size_m);
    let (track, map_from_odom) = way(runtime)?;
    let picture = painter.paint(Some(&fused), map_from_odom).ok_or("nothing is in the map yet")?;
    let tracks = PictureTracks { main: &track, other: &[] };
    render_picture(&picture.image(), tracks).map_err(|error| error.to_string())
}

/// Tiles of the grid; a set that gets no scans sends none.
fn take_grid(runtime: &RuntimeDir, painter: &mut MapPainter) -> Result<(), String> {
    let name = format!("doctor-{}", std::process::id());
    let wrong = |error: flockslam_bus::BusError| error.to_string();
    // Sizes matter to publishers only.
    let bus = Bus::join(runtime, &name, Capacity::default()).map_err(wrong)?;
    let tiles = bus.subscriber::<TileMessage>().map_err(wrong)?;
    let commits = bus.subscriber::<Commit>().map_err(wrong)?;
    let _tile_request = request_tiles(&bus).map_err(wrong)?;
    let (until, mut taken) = (Instant::now() + GRID, 0);
    while Instant::now() < until {
        while let Some(tile) = tiles.receive().map_err(wrong)? {
            painter.take(&tile);
            taken += 1;
        }
        if commits.receive().map_err(wrong)?.is_some() && taken > 0 {
            break;
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}

fn fused_map(runtime: &RuntimeDir, cell_size_m: f64) -> FusedMap {
    let mut fused = FusedMap::new(cell_size_m);
    let store = SubmapStore::new(&runtime.submaps());
    for row in read_live_poses(&runtime.results()).unwrap_or_default().submaps {
        let Ok(submap) = store.load(row.number) else { continue };
        let [x_m, y_m, heading_rad] = row.map_from_odom;
        // A submap that is too far away for a map is left out of the picture.
        let _ = fused.add(&submap, Pose::new(x_m, y_m, heading_rad) * submap.odom_from_submap);
    }
    fused
}

/// Poses of the journal, and the last correction.
fn way(runtime: &RuntimeDir) -> Result<(Vec<TrajectoryPoint>, Pose), String> {
    let mut reader = JournalReader::open(&runtime.journal()).map_err(|error| error.to_string())?;
    let (mut track, mut map_from_odom) = (Vec::new(), Pose::IDENTITY);
    while let Some(record) = reader.read_next().map_err(|error| error.to_string())? {
        if record.pose.has(PoseFlags::IMPORTED) {
            continue;
        }
        map_from_odom = record.pose.map_from_odom;
        let map_from_base = map_from_odom * record.pose.odom_from_base;
        track.push(TrajectoryPoint { stamp_ns: record.pose.times.sensor_ns, map_from_base });
    }
    Ok((track, map_from_odom))
}
