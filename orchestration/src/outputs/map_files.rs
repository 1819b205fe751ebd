//! The map as `map.pgm` and `map.yaml`, by the conventions of nav2's map server.

use super::{CellState, OccupancyImage, OutputError, put, put_by};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Above this share of black a pixel is read as occupied.
const OCCUPIED_THRESHOLD: f64 = 0.65;
/// Below this share of black a pixel is read as free. The grey of unknown cells, 205, has a share of 50/255 = 0.1961:
/// with the often seen 0.25 map servers would read it as free.
const FREE_THRESHOLD: f64 = 0.196;

/// Writes `map.pgm` and then `map.yaml` into `directory`, by the conventions of nav2's map server.
///
/// # Errors
/// When the disk refuses.
pub fn write_map(directory: &Path, map: &OccupancyImage) -> Result<(), OutputError> {
    put_by(&directory.join("map.pgm"), |file| {
        let mut file = BufWriter::new(file);
        write_pgm(map, &mut file)?;
        file.flush()
    })?;
    put(&directory.join("map.yaml"), render_yaml(map, "map.pgm").as_bytes())
}

/// The map as binary PGM: 254 free, 0 occupied, 205 unknown, the topmost row of cells first.
pub fn render_pgm(map: &OccupancyImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_pgm(map, &mut bytes).expect("memory takes any bytes");
    bytes
}

/// As [`render_pgm`], row by row.
fn write_pgm(map: &OccupancyImage, to: &mut impl Write) -> io::Result<()> {
    write!(to, "P5\n{} {}\n255\n", map.width(), map.height())?;
    let mut row = Vec::with_capacity(map.width());
    for y in (0..map.height()).rev() {
        row.clear();
        row.extend(map.row(y).map(pixel));
        to.write_all(&row)?;
    }
    Ok(())
}

/// The description that belongs to it; `image_name` is relative to the place of the description.
pub fn render_yaml(map: &OccupancyImage, image_name: &str) -> String {
    format!(
        "image: {image_name}\nmode: trinary\nresolution: {:.6}\norigin: [{:.6}, {:.6}, 0.000000]\nnegate: 0\n\
         occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n",
        map.cell_size_m(),
        map.origin().x_m,
        map.origin().y_m
    )
}

fn pixel(cell: CellState) -> u8 {
    match cell {
        CellState::Free => 254,
        CellState::Occupied => 0,
        CellState::Unknown => 205,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use CellState::{Free, Occupied, Unknown};
    use flockslam_geometry::Point;

    fn map() -> OccupancyImage {
        let cells = vec![Free, Occupied, Unknown, Free, Free, Free];
        OccupancyImage::new(3, 2, 0.05, Point::new(-1.5, 2.0), cells)
    }

    #[test]
    fn the_topmost_row_comes_first() {
        assert_eq!(render_pgm(&map()), b"P5\n3 2\n255\n\xfe\xfe\xfe\xfe\x00\xcd");
    }

    #[test]
    fn a_map_server_reads_every_state_back() {
        let read = |pixel: u8| match f64::from(255 - pixel) / 255.0 {
            share if share > OCCUPIED_THRESHOLD => Occupied,
            share if share < FREE_THRESHOLD => Free,
            _ => Unknown,
        };
        for state in [Free, Occupied, Unknown] {
            assert_eq!(read(pixel(state)), state);
        }
    }

    #[test]
    fn the_files_lie_side_by_side() {
        let dir = tempfile::tempdir().unwrap();
        write_map(dir.path(), &map()).unwrap();
        let yaml = std::fs::read_to_string(dir.path().join("map.yaml")).unwrap();
        assert_eq!(
            yaml,
            "image: map.pgm\nmode: trinary\nresolution: 0.050000\norigin: [-1.500000, 2.000000, 0.000000]\n\
             negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        );
        let decoded = image::open(dir.path().join("map.pgm")).unwrap().into_luma8();
        assert_eq!((decoded.width(), decoded.height(), decoded.get_pixel(1, 1).0), (3, 2, [0]));
    }

    #[test]
    fn a_map_without_cells_is_one_unknown_pixel() {
        let empty = OccupancyImage::new(0, 0, 0.05, Point::default(), Vec::new());
        assert_eq!(render_pgm(&empty), b"P5\n1 1\n255\n\xcd");
        assert_eq!((empty.known_box(), empty.known_area_m2()), (None, 0.0));
        assert_eq!(map().known_box(), Some((0, 2, 0, 1)));
    }
}
