//! Exact labels of the cells of a simulated world after a drive, for measurements.

use super::{BeamLabel, Settings, Simulation, SimulationError, World};
use flockslam_evidence::{Cell, CellIndex, TILE_CELLS, TileDirectory, floor};
use flockslam_geometry::elementary::{atan2, sin_cos};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{ScanBuffer, ScanView};
use flockslam_ray_insertion::Ray;

/// A scan counts towards the evidence after this much travel, metres, or turning, radians: as often as scans enter maps.
const EVIDENCE_EVERY: (f64, f64) = (0.2, 0.35);
/// Evidence of a beam for the cell that it ends in, and for those before it, nat.
const EVIDENCE_NAT: (f64, f64) = (1.5, 0.3);
/// Two views of a cell count when they are at least so far apart, nanoseconds.
const VIEW_EVERY_NS: i64 = 300_000_000;
/// A surface is hard to see from farther away than this, metres, …
const FAR_M: f64 = 8.0;
/// … or when beams meet it at less than this angle, radians.
const GRAZING_RAD: f64 = 0.26;
/// A cell is occupied above this share of evidence: where maps draw the line.
const OCCUPIED: f64 = 0.65;

/// What is true of the cells of a simulated world after a drive, as far as its lidar could see it: exact labels, for
/// measurements. No message carries them.
#[derive(Debug)]
pub struct GroundTruth {
    cell_size_m: f64,
    tiles: TileDirectory<Box<[CellTruth; TILE_CELLS]>>,
}

/// The true state of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellTruth {
    /// Evidence of all beams at their exact ends, those on movers leaving none for "occupied".
    evidence: Cell,
    /// The scan that gave it evidence last, from 1.
    observed_by: u32,
    /// When it was seen to be free last, sensor stamp plus one.
    viewed_ns: i64,
    /// Whether anything stood in it that is not part of the world.
    pub was_taken: bool,
    /// How often it was looked through, at least 0.3 s apart, since that left or from the start; it saturates.
    pub clear_views: u8,
    /// Sequence of the scan that met something in it last.
    pub met_by: u32,
    /// Whether some beam met the world in it from near and not at a grazing angle.
    pub is_plain: bool,
}

impl CellTruth {
    /// Whether the world itself stands in it, so that a perfect map of the drive has it occupied.
    pub fn is_static(&self) -> bool {
        self.evidence.masses().occupancy().is_some_and(|share| share > OCCUPIED)
    }
}

impl GroundTruth {
    /// Drives a simulation once more with a lidar without errors. Cells lie in the frame of the world.
    ///
    /// # Errors
    /// When there is no such simulation.
    pub fn of_drive(settings: &Settings, world: World, cell_size_m: f64) -> Result<Self, SimulationError> {
        let mut simulation = Simulation::with_errors(settings, world, &settings.errors().of_wheels())?;
        let mut truth = Self { cell_size_m, tiles: TileDirectory::default() };
        let (mut scan, mut entered, mut number) = (ScanBuffer::default(), None::<Pose>, 0);
        while let Some(pose) = simulation.next_scan(&mut scan) {
            number += 1;
            let enters = entered.is_none_or(|last| {
                last.distance_m(pose) >= EVIDENCE_EVERY.0 || last.turn_rad(pose) >= EVIDENCE_EVERY.1
            });
            entered = if enters { Some(pose) } else { entered };
            let view = scan.view().expect("the simulation makes whole scans");
            truth.enter(view, &simulation, if enters { Some(number) } else { None });
        }
        Ok(truth)
    }

    /// Side of a cell, metres.
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    /// The true state of a cell.
    pub fn cell(&self, index: CellIndex) -> CellTruth {
        self.tiles.get(index.tile()).map_or_else(CellTruth::default, |tile| tile[index.offset()])
    }

    /// All cells that a beam has touched, in a fixed order.
    pub fn cells(&self) -> impl Iterator<Item = (CellIndex, &CellTruth)> {
        let untouched = CellTruth::default();
        self.tiles.iter().flat_map(move |(key, tile)| {
            let touched = tile.iter().enumerate().filter(move |(_, truth)| **truth != untouched);
            touched.map(move |(offset, truth)| (key.cell(offset), truth))
        })
    }

    /// Centre of a cell, in the frame of the world.
    pub fn center(&self, cell: CellIndex) -> Point {
        let middle = |index: i32| (f64::from(index) + 0.5) * self.cell_size_m;
        Point::new(middle(cell.x), middle(cell.y))
    }

    /// Enters a scan: what stands where, then what was looked through; as evidence under a number, if at all.
    fn enter(&mut self, scan: ScanView<'_>, simulation: &Simulation, evidence: Option<u32>) {
        let now_ns = scan.header().times.sensor_ns;
        let beam_at = |beam: usize| Some((simulation.laser_at(scan.time_s(beam)), scan.valid_range_m(beam)?));
        let in_cells = |point: Point| Point::new(point.x_m / self.cell_size_m, point.y_m / self.cell_size_m);
        let rays: Vec<_> = (0..scan.len())
            .filter_map(|beam| {
                let (laser, range_m) = beam_at(beam)?;
                let (sin, cos) = sin_cos(scan.angle_rad(beam));
                // A hair behind the surface, so that walls on borders between cells stand in their own.
                let end = laser.apply(Point::new((range_m + 1e-3) * cos, (range_m + 1e-3) * sin));
                Some((beam, in_cells(laser.position()), in_cells(end)))
            })
            .collect();
        for (beam, _, end) in &rays {
            let is_plain = is_plain(scan, *beam);
            let Some(cell) = self.cell_mut(*end) else { continue };
            cell.met_by = scan.header().id.sequence as u32;
            if simulation.labels()[*beam] == BeamLabel::Static {
                cell.is_plain |= is_plain;
                cell.add(Cell::from_weights(EVIDENCE_NAT.0, 0.0), evidence);
            } else {
                (cell.was_taken, cell.clear_views, cell.viewed_ns) = (true, 0, now_ns + 1);
            }
        }
        for (_, from, end) in rays {
            for cell in Ray::new(from, end) {
                let Some(cell) = self.at_mut(cell) else { continue };
                cell.add(Cell::from_weights(0.0, EVIDENCE_NAT.1), evidence);
                if cell.viewed_ns == 0 || now_ns + 1 - cell.viewed_ns >= VIEW_EVERY_NS {
                    cell.clear_views = cell.clear_views.saturating_add(1);
                    cell.viewed_ns = now_ns + 1;
                }
            }
        }
    }

    fn cell_mut(&mut self, point: Point) -> Option<&mut CellTruth> {
        self.at_mut(CellIndex::new(floor(point.x_m), floor(point.y_m)))
    }

    /// `None` absurdly far away.
    fn at_mut(&mut self, cell: CellIndex) -> Option<&mut CellTruth> {
        if self.tiles.get(cell.tile()).is_none() {
            self.tiles.set(cell.tile(), Box::new([CellTruth::default(); TILE_CELLS])).ok()?;
        }
        self.tiles.get_mut(cell.tile()).map(|tile| &mut tile[cell.offset()])
    }
}

impl CellTruth {
    /// Once per scan: hits come first.
    fn add(&mut self, evidence: Cell, scan: Option<u32>) {
        if let Some(number) = scan.filter(|number| *number != self.observed_by) {
            self.observed_by = number;
            self.evidence = self.evidence.combine(evidence);
        }
    }
}

/// Whether a beam meets its surface from near and not at a grazing angle.
fn is_plain(scan: ScanView<'_>, beam: usize) -> bool {
    let next = if beam + 1 < scan.len() { beam + 1 } else { beam - 1 };
    let (Some(range_m), Some(next_m)) = (scan.valid_range_m(beam), scan.valid_range_m(next)) else {
        return false;
    };
    let between_rad = (scan.angle_rad(next) - scan.angle_rad(beam)).abs();
    range_m < FAR_M && atan2(range_m * between_rad, (range_m - next_m).abs()) > GRAZING_RAD
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(settings: Settings) -> GroundTruth {
        let settings = Settings { duration_s: 60.0, ..settings };
        GroundTruth::of_drive(&settings, World::floor_plan(), 0.05).unwrap()
    }

    #[test]
    fn static_cells_are_those_of_walls_and_others_were_taken_and_left_again() {
        let truth = drive(Settings { walkers: 8, ..Settings::default() });
        let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
        let (mut stands, mut taken, mut left) = (0, 0, 0);
        for (index, cell) in truth.cells() {
            let off_m = plan.distance_m(truth.center(index));
            if cell.is_static() {
                stands += 1;
                assert!(off_m < 0.08, "{off_m}");
            }
            taken += usize::from(cell.was_taken && off_m > 0.2);
            left += usize::from(cell.was_taken && cell.clear_views >= 3);
        }
        assert!(stands > 2000 && taken > 500 && left > taken / 2, "{stands} {taken} {left}");
        assert!(truth.cells().filter(|(_, cell)| cell.is_static() && !cell.is_plain).count() > 10);
    }

    #[test]
    fn an_empty_world_was_never_taken() {
        assert!(drive(Settings::default()).cells().all(|(_, cell)| !cell.was_taken));
    }
}
