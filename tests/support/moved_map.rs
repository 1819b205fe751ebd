//! How well the map of a simulated drive keeps what stands and clears what has left, cell by cell against the exact truth.

use super::Outputs;
use flockslam_evidence::CellIndex;
use flockslam_geometry::{Point, Pose};
use flockslam_simulation::{CellTruth, GroundTruth};
use std::fmt;

/// What stands may be shown so many cells beside its place: ranges have errors.
const OFF_CELLS: i32 = 2;
/// An object that has left this near to a static one cannot be distinguished from it, cells.
const NEAR_CELLS: i32 = 3;
/// The true trajectory of a simulated drive.
const TRUTH: &str = "truth.tum";
/// Views after which what has left should be gone.
pub const VIEWS: u8 = 3;

/// A share of cells.
#[derive(Clone, Copy, Debug, Default)]
pub struct Share {
    pub good: usize,
    pub of: usize,
}

/// Figures of a map.
#[derive(Clone, Copy, Debug, Default)]
pub struct MapFigures {
    /// Cells of the world itself that the map has, of those that a map has from which nothing is removed.
    pub kept: Share,
    /// Of those, cells that were seen at grazing angles or from far away alone.
    pub kept_hard: Share,
    /// Cells that something has left, viewed free at least three times since, that the map does not show as occupied.
    pub removed: Share,
    /// Of those, cells that a map shows from which nothing is removed.
    pub removed_ghosts: Share,
}

impl Share {
    fn count(&mut self, good: bool) {
        self.of += 1;
        self.good += usize::from(good);
    }

    /// In percent; of nothing: all.
    pub fn percent(self) -> f64 {
        if self.of == 0 { 100.0 } else { 100.0 * self.good as f64 / self.of as f64 }
    }
}

impl MapFigures {
    /// Compares the map of a run with the truth of its drive, and with the map of a run that removed nothing.
    pub fn of(outputs: &Outputs, uncleaned: &Outputs, truth: &GroundTruth) -> Self {
        let (map, uncleaned) = (Map::read(outputs, Some(TRUTH)), Map::read(uncleaned, Some(TRUTH)));
        let mut figures = Self::default();
        for (index, cell) in truth.cells() {
            let shown_in = |map: &Map, reach: i32| map.shows(truth.center(index), cell.met_by, reach);
            if cell.is_static() && shown_in(&uncleaned, 0) {
                let kept = shown_in(&map, OFF_CELLS);
                figures.kept.count(kept);
                if !cell.is_plain {
                    figures.kept_hard.count(kept);
                }
            } else if has_left(cell) && !stands_near(truth, index) {
                let removed = !shown_in(&map, 0);
                figures.removed.count(removed);
                if shown_in(&uncleaned, 0) {
                    figures.removed_ghosts.count(removed);
                }
            }
        }
        figures
    }

    /// Harmonic mean of cells kept and cells removed, percent (HA).
    pub fn harmonic(&self) -> f64 {
        let (kept, removed) = (self.kept.percent(), self.removed.percent());
        2.0 * kept * removed / (kept + removed)
    }
}

impl fmt::Display for MapFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "SA {:.2} % of {} (hard to see: {:.2} % of {}), DA {:.2} % of {} (of ghosts otherwise: {:.2} % of {}), HA {:.2}",
            self.kept.percent(),
            self.kept.of,
            self.kept_hard.percent(),
            self.kept_hard.of,
            self.removed.percent(),
            self.removed.of,
            self.removed_ghosts.percent(),
            self.removed_ghosts.of,
            self.harmonic()
        )
    }
}

fn has_left(cell: &CellTruth) -> bool {
    cell.was_taken && cell.clear_views >= VIEWS
}

pub(super) fn around(index: CellIndex, reach: i32) -> impl Iterator<Item = CellIndex> {
    (-reach..=reach)
        .flat_map(move |y| (-reach..=reach).map(move |x| CellIndex::new(index.x + x, index.y + y)))
}

fn stands_near(truth: &GroundTruth, index: CellIndex) -> bool {
    around(index, NEAR_CELLS).any(|near| truth.cell(near).is_static())
}

/// The map that a user gets.
pub(super) struct Map {
    picture: image::GrayImage,
    cell_size_m: f64,
    origin: Point,
    /// Where it has what a scan saw: errors of poses move what stands, they neither remove nor keep it.
    map_from_world: Vec<Pose>,
}

impl Map {
    /// Reads a map; `truth` is the name of the true trajectory, if it matters where a scan saw something.
    pub(super) fn read(outputs: &Outputs, truth: Option<&str>) -> Self {
        let yaml = String::from_utf8(outputs.bytes("map.yaml")).unwrap();
        let value =
            |key: &str| yaml.lines().find_map(|line| line.strip_prefix(key)).unwrap().trim().to_owned();
        let origin = value("origin:");
        let numbers: Vec<f64> =
            origin.trim_matches(['[', ']']).split(',').map(|number| number.trim().parse().unwrap()).collect();
        let truth = truth.map_or_else(Vec::new, |name| outputs.trajectory(name));
        let poses = outputs.trajectory("trajectory.tum");
        assert!(truth.is_empty() || poses.len() == truth.len());
        let map_from_world = poses.iter().zip(&truth);
        Self {
            picture: image::open(outputs.directory.join("map.pgm")).unwrap().into_luma8(),
            cell_size_m: value("resolution:").parse().unwrap(),
            origin: Point::new(numbers[0], numbers[1]),
            map_from_world: map_from_world
                .map(|(pose, truth)| pose.map_from_base * truth.map_from_base.inverse())
                .collect(),
        }
    }

    /// Whether a cell around a point of the world is occupied, where a scan saw it.
    fn shows(&self, point: Point, scan: u32, reach: i32) -> bool {
        let in_map = self.map_from_world[scan as usize].apply(point);
        let index = |metres: f64| (metres / self.cell_size_m).floor() as i32;
        let middle = CellIndex::new(index(in_map.x_m - self.origin.x_m), index(in_map.y_m - self.origin.y_m));
        around(middle, reach).any(|cell| self.is_occupied(cell))
    }

    fn is_occupied(&self, cell: CellIndex) -> bool {
        let (width, height) = (self.picture.width() as i32, self.picture.height() as i32);
        let inside = (0..width).contains(&cell.x) && (0..height).contains(&cell.y);
        inside && self.picture.get_pixel(cell.x as u32, (height - 1 - cell.y) as u32).0[0] == 0
    }

    /// All occupied cells, counted from the lower left corner of the picture.
    pub(super) fn occupied_indices(&self) -> impl Iterator<Item = CellIndex> {
        let (width, height) = (self.picture.width() as i32, self.picture.height() as i32);
        let cells = (0..height).flat_map(move |y| (0..width).map(move |x| CellIndex::new(x, y)));
        cells.filter(|cell| self.is_occupied(*cell))
    }

    /// A point of the map's frame in cells from the lower left corner of the picture.
    pub(super) fn in_cells(&self, point: Point) -> Point {
        let cells = |metres: f64| metres / self.cell_size_m;
        Point::new(cells(point.x_m - self.origin.x_m), cells(point.y_m - self.origin.y_m))
    }

    /// Centres of all occupied cells, in the frame of the map.
    fn occupied(&self) -> Vec<Point> {
        let middle = |origin: f64, index: i32| origin + (f64::from(index) + 0.5) * self.cell_size_m;
        self.occupied_indices()
            .map(|cell| Point::new(middle(self.origin.x_m, cell.x), middle(self.origin.y_m, cell.y)))
            .collect()
    }
}

/// Centres of the occupied cells of a run's map, in the frame of the map.
pub fn occupied_cells(outputs: &Outputs) -> impl Iterator<Item = Point> {
    Map::read(outputs, None).occupied().into_iter()
}
