//! The map of another node of the graph, as a file that the set can read.

use flockslam_journal::{Durability, replace_file};
use flockslam_ros::messages::OccupancyGrid;
use std::path::{Path, PathBuf};

/// Names of the files in the results of the set.
const PICTURE: &str = "graph-map.pgm";
const DESCRIPTION: &str = "graph-map.yaml";
/// Cells with at least this probability are occupied, those with at most this are free, in percent: the thresholds of nav2's map server.
const OCCUPIED_MIN: i8 = 65;
const FREE_MAX: i8 = 25;
/// A map has at most so many cells along a side.
const SIDE_MAX: u32 = 100_000;

/// Writes a grid as a map of nav2's kind into a directory; the path of its description.
///
/// # Errors
/// When the grid has no cells or more than it says, or the disk refuses; in one line.
pub fn write_grid(directory: &Path, grid: &OccupancyGrid) -> Result<PathBuf, String> {
    let info = &grid.info;
    let sides = 1..=SIDE_MAX;
    let has_sides = sides.contains(&info.width) && sides.contains(&info.height);
    if !has_sides || grid.data.len() as u64 != u64::from(info.width) * u64::from(info.height) {
        let (width, height, cells) = (info.width, info.height, grid.data.len());
        return Err(format!("a map of {width} x {height} cells has {cells}"));
    }
    let origin = &info.origin;
    let numbers = [origin.position.x, origin.position.y, origin.orientation.heading_rad()];
    if !(info.resolution.is_finite() && info.resolution > 0.0 && numbers.iter().all(|v| v.is_finite())) {
        return Err(format!("a map with cells of {} m at {numbers:?}", info.resolution));
    }
    let [x, y, yaw] = numbers;
    let mut picture = format!("P5\n{} {}\n255\n", info.width, info.height).into_bytes();
    // A picture begins at its top.
    let rows = grid.data.chunks_exact(info.width as usize).rev();
    picture.extend(rows.flatten().map(|cell| match *cell {
        OCCUPIED_MIN.. => 0,
        0..=FREE_MAX => 254,
        _ => 205,
    }));
    let description = format!(
        "image: {PICTURE}\nmode: trinary\nresolution: {}\norigin: [{x}, {y}, {yaw}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.1\n",
        info.resolution
    );
    let put = |name: &str, bytes: &[u8]| {
        let path = directory.join(name);
        replace_file(&path, bytes, Durability::Process).map(|()| path).map_err(|error| error.to_string())
    };
    put(PICTURE, &picture)?;
    put(DESCRIPTION, description.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::read_nav2_map;
    use flockslam_evidence::CellState;
    use flockslam_ros::messages::{MapMetaData, Pose};

    fn grid(width: u32, height: u32, data: Vec<i8>) -> OccupancyGrid {
        let origin = Pose::planar(1.0, -2.0, 0.0);
        let info = MapMetaData { width, height, resolution: 0.05, origin, ..MapMetaData::default() };
        OccupancyGrid { info, data, ..OccupancyGrid::default() }
    }

    #[test]
    fn the_cells_and_the_place_of_a_grid_are_those_of_the_file() {
        let directory = tempfile::tempdir().unwrap();
        let (free, wall, unknown) = (CellState::Free, CellState::Occupied, CellState::Unknown);
        let path = write_grid(directory.path(), &grid(3, 2, vec![0, 100, -1, 25, 50, 65])).unwrap();
        let map = read_nav2_map(&path).unwrap();
        assert_eq!((map.width, map.height, map.origin.x_m, map.origin.y_m), (3, 2, 1.0, -2.0));
        let mut rows = Vec::new();
        map.for_each_row(|row| rows.extend(row.iter().map(CellState::of)));
        assert_eq!(rows, [free, wall, unknown, free, unknown, wall]);
    }

    #[test]
    fn a_grid_that_is_none_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        for (width, height, cells) in [(0, 0, 0), (3, 2, 5), (u32::MAX, u32::MAX, 1)] {
            let refused = write_grid(directory.path(), &grid(width, height, vec![0; cells]));
            assert!(refused.unwrap_err().contains(&format!("has {cells}")));
        }
        let mut turned = grid(1, 1, vec![0]);
        turned.info.resolution = f32::NAN;
        assert!(write_grid(directory.path(), &turned).is_err());
    }
}
