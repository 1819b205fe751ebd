//! Maps of others: reads what nav2's map server reads, a YAML file beside a picture.

use flockslam_evidence::{Cell, CellState};
use flockslam_geometry::{Point, Pose};
use flockslam_results::StoredMap;
use image::{DynamicImage, GenericImageView};
use std::path::{Path, PathBuf};

/// Weight of what a picture says of a cell, nat.
const WEIGHT_NAT: f64 = 4.0;
/// Most cells: 10 km² of 5 cm.
const CELLS_MAX: u64 = 4_000_000_000;
/// Beside it lies a map that is the output of a run.
const REPORT: &str = "report.json";
/// Least share of the ends of free space that are walls, in a map that shows walls.
const WALLS_MIN: f64 = 0.1;
/// A map that is turned by less than this is not turned, radians.
const TURN_MIN_RAD: f64 = 1e-6;

/// Why a map could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct Nav2MapError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// How grey values become cells (map_server's `mode`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PixelMode {
    /// Free, occupied or unknown by two thresholds.
    Trinary,
    /// The same, and transparent pixels are unknown.
    Scale,
    /// The value is the occupancy in per cent, above 100 unknown.
    Raw,
}

/// What the YAML file says.
#[derive(Clone, Debug, PartialEq)]
struct Description {
    image: PathBuf,
    resolution_m: f64,
    origin: Pose,
    is_negated: bool,
    mode: PixelMode,
    occupied_min: f64,
    free_max: f64,
}

/// Reads a map of nav2's map server. The result is along the axes of the map frame, also when the picture's origin is turned.
///
/// # Errors
/// When the YAML lacks a key or has a wrong one, or the picture cannot be read.
pub fn read_nav2_map(yaml: &Path) -> Result<StoredMap, Nav2MapError> {
    let wrong = |path: &Path, reason: String| Nav2MapError { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(yaml).map_err(|error| wrong(yaml, error.to_string()))?;
    let description = description(&text).map_err(|reason| wrong(yaml, reason))?;
    let path = yaml.parent().unwrap_or(Path::new(".")).join(&description.image);
    let picture = image::open(&path).map_err(|error| wrong(&path, error.to_string()))?;
    let (width, height) = picture.dimensions();
    if u64::from(width) * u64::from(height) > CELLS_MAX {
        return Err(wrong(&path, format!("{width} × {height} pixels are more than a map has")));
    }
    let map = if description.origin.heading_rad.abs() < TURN_MIN_RAD {
        straight(&description, &picture)
    } else {
        turned(&description, &picture)
    };
    // A run's own map shows its walls. Outdoors it has few, and many single unknown cells.
    let is_output = yaml.with_file_name(REPORT).is_file();
    Ok(if is_output { map } else { with_walls(map) })
}

/// A map whose free space ends at unknown cells nearly everywhere shows its walls as unknown: they are taken for occupied where free space
/// is beside them.
fn with_walls(map: StoredMap) -> StoredMap {
    let mut rows: Vec<Vec<CellState>> = Vec::with_capacity(map.height);
    map.for_each_row(|row| rows.push(row.iter().map(CellState::of).collect()));
    let is_beside_free = |rows: &[Vec<CellState>], x: usize, y: usize| {
        let free = |x: usize, y: usize| {
            rows.get(y).and_then(|row| row.get(x)).is_some_and(|state| *state == CellState::Free)
        };
        free(x.wrapping_sub(1), y) || free(x + 1, y) || free(x, y.wrapping_sub(1)) || free(x, y + 1)
    };
    let ends = |state: CellState| {
        let cells = (0..map.height).flat_map(|y| (0..map.width).map(move |x| (x, y)));
        cells.filter(|&(x, y)| rows[y][x] == state && is_beside_free(&rows, x, y)).count()
    };
    let (occupied, unknown) = (ends(CellState::Occupied), ends(CellState::Unknown));
    if unknown == 0 || occupied as f64 > WALLS_MIN * (occupied + unknown) as f64 {
        return map;
    }
    tracing::warn!(
        "the map shows hardly any wall: free space is taken to end at walls where nothing is known"
    );
    let mut walled = StoredMap::of_width(map.width, map.cell_size_m, map.origin);
    for (y, row) in rows.iter().enumerate() {
        let state = |x: usize| match row[x] {
            CellState::Unknown if is_beside_free(&rows, x, y) => CellState::Occupied,
            state => state,
        };
        walled.push_row(&(0..map.width).map(|x| evidence(state(x))).collect::<Vec<_>>());
    }
    walled
}

fn description(text: &str) -> Result<Description, String> {
    let value = |key: &str| {
        let of_key = |line: &str| {
            let rest = line.trim().strip_prefix(key)?.trim_start().strip_prefix(':')?;
            let rest = rest.split(" #").next().unwrap_or_default();
            Some(rest.trim().trim_matches(['"', '\'']).to_owned())
        };
        text.lines().find_map(of_key)
    };
    let needed = |key: &str| value(key).ok_or_else(|| format!("no '{key}:' line"));
    let number = |key: &str, text: &str| {
        let text = text.trim();
        let number: f64 = text.parse().map_err(|_| format!("{key}: '{text}' is not a number"))?;
        if number.is_finite() { Ok(number) } else { Err(format!("{key}: {text} is not a number")) }
    };
    let resolution_m = number("resolution", &needed("resolution")?)?;
    if !(1e-3..=10.0).contains(&resolution_m) {
        return Err(format!("resolution: a pixel of {resolution_m} m is not a map's"));
    }
    let origin = needed("origin")?;
    let parts: Vec<&str> = origin.trim_matches(['[', ']']).split(',').collect();
    let [x, y, heading] = parts.as_slice() else {
        return Err(format!("origin: '{origin}' is not [x, y, yaw]"));
    };
    let (x, y, heading) = (number("origin", x)?, number("origin", y)?, number("origin", heading)?);
    let threshold = |key: &str, usual: f64| value(key).map_or(Ok(usual), |text| number(key, &text));
    let mode = match value("mode").as_deref() {
        None | Some("trinary") => PixelMode::Trinary,
        Some("scale") => PixelMode::Scale,
        Some("raw") => PixelMode::Raw,
        Some(other) => return Err(format!("mode: '{other}' is none of trinary, scale, raw")),
    };
    Ok(Description {
        image: needed("image")?.into(),
        resolution_m,
        origin: Pose::new(x, y, heading),
        is_negated: matches!(value("negate").as_deref(), Some("1" | "true")),
        mode,
        occupied_min: threshold("occupied_thresh", 0.65)?,
        free_max: threshold("free_thresh", 0.196)?,
    })
}

impl Description {
    /// What a pixel says, by its colours and how opaque it is.
    fn state(&self, [red, green, blue, alpha]: [u8; 4]) -> CellState {
        if self.mode == PixelMode::Scale && alpha < u8::MAX {
            return CellState::Unknown;
        }
        let grey = (f64::from(red) + f64::from(green) + f64::from(blue)) / 3.0;
        let occupancy = match (self.mode, self.is_negated) {
            (PixelMode::Raw, _) if grey > 100.0 => return CellState::Unknown,
            (PixelMode::Raw, _) => grey / 100.0,
            (_, true) => grey / 255.0,
            (_, false) => (255.0 - grey) / 255.0,
        };
        if occupancy > self.occupied_min {
            CellState::Occupied
        } else if occupancy < self.free_max {
            CellState::Free
        } else {
            CellState::Unknown
        }
    }
}

/// What a picture says of a cell, as evidence.
pub(super) fn evidence(state: CellState) -> Cell {
    match state {
        CellState::Occupied => Cell::from_weights(WEIGHT_NAT, 0.0),
        CellState::Free => Cell::from_weights(0.0, WEIGHT_NAT),
        CellState::Unknown => Cell::UNKNOWN,
    }
}

/// The cells of a picture, by column and row from its upper left corner. A grey picture, the usual kind, is read by a table of its 256
/// values: it may have millions of pixels.
fn cells_of<'a>(
    description: &'a Description,
    picture: &'a DynamicImage,
) -> Box<dyn Fn(u32, u32) -> Cell + 'a> {
    match picture {
        DynamicImage::ImageLuma8(grey) => {
            let of_grey: Vec<Cell> =
                (0..=u8::MAX).map(|grey| evidence(description.state([grey, grey, grey, u8::MAX]))).collect();
            let (width, pixels) = (grey.width() as usize, grey.as_raw());
            Box::new(move |column, row| of_grey[usize::from(pixels[row as usize * width + column as usize])])
        }
        _ => Box::new(|column, row| evidence(description.state(picture.get_pixel(column, row).0))),
    }
}

/// A picture that is along the axes of the map: its last row is the lowest.
fn straight(description: &Description, picture: &DynamicImage) -> StoredMap {
    let (width, height) = picture.dimensions();
    let origin = Point::new(description.origin.x_m, description.origin.y_m);
    let mut map = StoredMap::of_width(width as usize, description.resolution_m, origin);
    let cell = cells_of(description, picture);
    for row in (0..height).rev() {
        map.push_row(&(0..width).map(|column| cell(column, row)).collect::<Vec<_>>());
    }
    map
}

/// A picture that is turned: each cell takes the pixel under its middle.
fn turned(description: &Description, picture: &DynamicImage) -> StoredMap {
    let (width, height) = picture.dimensions();
    let Description { resolution_m: side_m, origin, .. } = *description;
    let far = (f64::from(width) * side_m, f64::from(height) * side_m);
    let corners = [(0.0, 0.0), (far.0, 0.0), (0.0, far.1), far].map(|(x, y)| origin.apply(Point::new(x, y)));
    let low = |pick: fn(&Point) -> f64| corners.iter().map(pick).fold(f64::INFINITY, f64::min);
    let high = |pick: fn(&Point) -> f64| corners.iter().map(pick).fold(f64::NEG_INFINITY, f64::max);
    let corner = Point::new(low(|p| p.x_m), low(|p| p.y_m));
    let cells = |from: f64, to: f64| ((to - from) / side_m - 1e-6).ceil().max(1.0) as usize;
    let (columns, rows) = (cells(corner.x_m, high(|p| p.x_m)), cells(corner.y_m, high(|p| p.y_m)));
    let mut map = StoredMap::of_width(columns, side_m, corner);
    let picture_from_map = origin.inverse();
    let of_pixel = cells_of(description, picture);
    let cell = |column: usize, row: usize| {
        let along = |from: f64, cell: usize| from + (cell as f64 + 0.5) * side_m;
        let at = picture_from_map.apply(Point::new(along(corner.x_m, column), along(corner.y_m, row)));
        let (x, y) = ((at.x_m / side_m).floor(), (at.y_m / side_m).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height);
        if inside { of_pixel(x as u32, height - 1 - y as u32) } else { Cell::UNKNOWN }
    };
    for row in 0..rows {
        map.push_row(&(0..columns).map(|column| cell(column, row)).collect::<Vec<_>>());
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;
    use CellState::{Free, Occupied, Unknown};

    /// A picture of 3 × 2 pixels and its description.
    fn read(pixels: [u8; 6], rest: &str) -> Result<StoredMap, Nav2MapError> {
        let directory = tempfile::tempdir().unwrap();
        let picture = image::GrayImage::from_raw(3, 2, pixels.to_vec()).unwrap();
        picture.save(directory.path().join("plan.png")).unwrap();
        let yaml = directory.path().join("plan.yaml");
        std::fs::write(&yaml, format!("image: plan.png # a plan\nresolution: 0.1\n{rest}\n")).unwrap();
        read_nav2_map(&yaml)
    }

    fn states(map: &StoredMap) -> Vec<Vec<CellState>> {
        let mut rows = Vec::new();
        map.for_each_row(|row| rows.push(row.iter().map(CellState::of).collect()));
        rows
    }

    #[test]
    fn a_coloured_picture_of_greys_says_what_the_grey_one_says() {
        let greys: Vec<u8> = (0..=u8::MAX).collect();
        let grey = DynamicImage::from(image::GrayImage::from_raw(256, 1, greys).unwrap());
        let coloured = DynamicImage::from(grey.to_rgba8());
        for mode in [PixelMode::Trinary, PixelMode::Scale, PixelMode::Raw] {
            let description = Description {
                image: PathBuf::new(),
                resolution_m: 0.05,
                origin: Pose::IDENTITY,
                mode,
                is_negated: false,
                occupied_min: 0.65,
                free_max: 0.25,
            };
            let read = |picture: &DynamicImage| states(&straight(&description, picture));
            assert!(read(&grey) == read(&coloured), "{mode:?}");
            assert_eq!(read(&grey)[0][0], if mode == PixelMode::Raw { Free } else { Occupied });
        }
    }

    #[test]
    fn trinary_raw_and_negated_pictures() {
        let origin = "origin: [1.0, -2.0, 0]";
        let map = read([0, 205, 254, 254, 254, 0], origin).unwrap();
        assert_eq!(states(&map), [[Free, Free, Occupied], [Occupied, Unknown, Free]]);
        assert_eq!((map.origin, map.cell_size_m), (Point::new(1.0, -2.0), 0.1));
        let negated = read([255, 60, 0, 0, 0, 255], &format!("{origin}\nnegate: 1")).unwrap();
        assert_eq!(states(&negated), [[Free, Free, Occupied], [Occupied, Unknown, Free]]);
        let raw = read([100, 255, 0, 0, 10, 70], &format!("{origin}\nmode: raw")).unwrap();
        assert_eq!(states(&raw), [[Free, Free, Occupied], [Occupied, Unknown, Free]]);
    }

    #[test]
    fn a_picture_that_is_turned_lies_where_it_lay() {
        let map = read([0, 205, 254, 254, 254, 0], "origin: [1.0, -2.0, 1.5707963267948966]").unwrap();
        // Columns of the picture are rows of the map now, its lowest row the column on the right.
        assert_eq!(states(&map), [[Occupied, Free], [Unknown, Free], [Free, Occupied]]);
        assert!((map.origin.x_m - 0.8).abs() < 1e-6 && (map.origin.y_m + 2.0).abs() < 1e-6);
    }

    #[test]
    fn a_map_without_walls_gets_them_where_free_space_ends() {
        let map = read([254, 205, 205, 254, 205, 205], "origin: [0, 0, 0]").unwrap();
        assert_eq!(states(&map), [[Free, Occupied, Unknown], [Free, Occupied, Unknown]]);
    }

    #[test]
    fn the_map_of_a_run_is_read_as_it_is() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        image::GrayImage::from_raw(3, 1, vec![254, 205, 205]).unwrap().save(at("map.pgm")).unwrap();
        let text = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
        std::fs::write(at("map.yaml"), text).unwrap();
        assert_eq!(states(&read_nav2_map(&at("map.yaml")).unwrap()), [[Free, Occupied, Unknown]]);
        std::fs::write(at(REPORT), "{}").unwrap();
        assert_eq!(states(&read_nav2_map(&at("map.yaml")).unwrap()), [[Free, Unknown, Unknown]]);
    }

    #[test]
    fn errors_are_reported_with_their_position() {
        for (rest, reason) in [
            ("", "no 'origin:' line"),
            ("origin: [1, 2]", "not [x, y, yaw]"),
            ("origin: [1, 2, x]", "'x' is not a number"),
            ("origin: [0, 0, 0]\nmode: colour", "none of trinary, scale, raw"),
        ] {
            let error = read([0; 6], rest).unwrap_err().to_string();
            assert!(error.contains("plan.yaml") && error.contains(reason), "{error}");
        }
        let error = read_nav2_map(Path::new("/nowhere/map.yaml")).unwrap_err().to_string();
        assert!(error.contains("/nowhere/map.yaml"), "{error}");
    }
}
