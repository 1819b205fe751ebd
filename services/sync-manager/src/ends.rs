//! Near which cells the beams of a scan end.

use flockslam_evidence::{CellIndex, floor};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};

/// Cells around the lidar, to each side: a power of two.
const REACH_CELLS: i32 = 512;
const SIDE: usize = 2 * REACH_CELLS as usize;

/// Cells within `near` cells of the end of a beam, on a square around the lidar; farther away there are none.
#[derive(Debug)]
pub(crate) struct Ends {
    cell_size_m: f64,
    near: i32,
    /// Cell of the lidar.
    middle: CellIndex,
    /// The number of the last scan of which a beam ended near.
    marks: Vec<u32>,
    scan: u32,
}

impl Ends {
    /// Of no scan.
    pub fn new(cell_size_m: f64, near: i32) -> Self {
        let middle = CellIndex::new(0, 0);
        Self { cell_size_m, near, middle, marks: vec![0; SIDE * SIDE], scan: 0 }
    }

    /// Those of a scan from `at`, in place of those before.
    pub fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew, map_from_base: Pose, at: Point) {
        if self.scan == u32::MAX {
            self.marks.fill(0);
            self.scan = 0;
        }
        self.scan += 1;
        self.middle = self.cell(at);
        for beam in 0..scan.len() {
            let Some(range_m) = scan.valid_range_m(beam) else { continue };
            let end = self.cell(map_from_base.apply(deskew.end_in_base(scan, beam, range_m)));
            for dy in -self.near..=self.near {
                for dx in -self.near..=self.near {
                    let cell = CellIndex::new(end.x.saturating_add(dx), end.y.saturating_add(dy));
                    if let Some(place) = self.place(cell) {
                        self.marks[place] = self.scan;
                    }
                }
            }
        }
    }

    /// Whether a beam ends near a cell.
    pub fn is_near(&self, cell: CellIndex) -> bool {
        self.place(cell).is_some_and(|place| self.marks[place] == self.scan)
    }

    fn cell(&self, at: Point) -> CellIndex {
        CellIndex::new(floor(at.x_m / self.cell_size_m), floor(at.y_m / self.cell_size_m))
    }

    fn place(&self, cell: CellIndex) -> Option<usize> {
        let place = |index: i32, middle: i32| {
            let away = i64::from(index) - i64::from(middle) + i64::from(REACH_CELLS);
            usize::try_from(away).ok().filter(|away| *away < SIDE)
        };
        Some(place(cell.y, self.middle.y)? * SIDE + place(cell.x, self.middle.x)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn cells_around_the_last_scans_ends_are_near() {
        let mut ends = Ends::new(0.05, 2);
        let mut look = |range_m: f32, at: Pose| {
            let scan = ScanBuffer::from_ranges(&[range_m, f32::INFINITY], 0.0, 0.1);
            let view = scan.view().unwrap();
            ends.look(view, &Deskew::new(view, Twist::default()), at, at.position());
            [38, 39, 41, 43, 44].map(|x| ends.is_near(CellIndex::new(x, 2)))
        };
        let at = Pose::new(0.01, 0.01, 0.0);
        assert_eq!(look(2.05, at), [false, true, true, true, false]);
        assert_eq!(look(4.0, at), [false; 5], "those of the scan before are forgotten");
        assert_eq!(look(1000.0, at), [false; 5]);
        assert_eq!(look(1002.05, Pose::new(-1000.0, 0.01, 0.0)), [false; 5], "too far from the lidar");
    }
}
