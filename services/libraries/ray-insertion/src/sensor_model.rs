//! The inverse sensor model: origin and end points of a scan in, evidence for the cells along the beams out. One variant is
//! that of vinySLAM.

use crate::Ray;
use flockslam_evidence::{Cell, CellIndex, Masses, floor};
use flockslam_geometry::Point;

/// Steps in which the blur before a hit is tabulated.
const BLUR_STEPS: usize = 32;

/// A map of cells that takes the observations of one scan at a time.
///
/// Of several observations of a cell in one scan the first counts. Hits are given before misses, so a hit beats a
/// miss and each cell gets evidence once per scan.
pub trait ObservedCells {
    /// Evidence for a cell from the current scan.
    fn observe(&mut self, cell: CellIndex, evidence: Cell);

    /// The same evidence for all cells that a ray crosses. Nothing but rays with the same evidence follows in this scan.
    fn observe_ray(&mut self, ray: Ray, evidence: Cell) {
        for cell in ray {
            self.observe(cell, evidence);
        }
    }
}

/// Inverse sensor model: the evidence of a beam along its path.
///
/// ```
/// use flockslam_evidence::{Cell, CellIndex};
/// use flockslam_ray_insertion::{ObservedCells, SensorModel};
/// use flockslam_geometry::Point;
/// use std::collections::BTreeMap;
///
/// #[derive(Default)]
/// struct Scan(BTreeMap<CellIndex, Cell>);
///
/// impl ObservedCells for Scan {
///     fn observe(&mut self, cell: CellIndex, evidence: Cell) {
///         self.0.entry(cell).or_insert(evidence);
///     }
/// }
///
/// let (hit, miss) = (Cell { occupied: 9000, free: 0 }, Cell { occupied: 0, free: 800 });
/// let mut scan = Scan::default();
/// SensorModel::new(hit, miss).insert(0.05, Point::new(0.01, 0.01), &[Point::new(1.01, 0.01)], &mut scan);
/// assert_eq!(scan.0[&CellIndex::new(20, 0)], hit);
/// assert_eq!(scan.0[&CellIndex::new(19, 0)], miss);
/// assert_eq!(scan.0.len(), 21);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SensorModel {
    hit: Cell,
    miss: Cell,
    blur: Option<Blur>,
}

/// Graded evidence before a hit [vinySLAM]: at distance d < h the probability of "occupied" is `peak (1 - d²/h²)`.
#[derive(Clone, Debug, PartialEq)]
struct Blur {
    distance_m: f64,
    steps: [Cell; BLUR_STEPS],
}

impl SensorModel {
    /// Beams that add `hit` to the cell they end in and `miss` to the cells before it.
    pub fn new(hit: Cell, miss: Cell) -> Self {
        Self { hit, miss, blur: None }
    }

    /// vinySLAM's model: hit probability .95 at quality .04, miss .01 at .003, a blur of 0.3 m at the miss' quality,
    /// all at the scan quality (.9 after a correction of the pose).
    pub fn vinyslam(scan_quality: f64) -> Self {
        let observation = |probability, quality| {
            Cell::from_masses(Masses::observation(probability, quality * scan_quality))
        };
        let steps = std::array::from_fn(|i| {
            let share = (i as f64 + 0.5) / BLUR_STEPS as f64;
            observation(0.95 * (1.0 - share * share), 0.003)
        });
        let blur = Some(Blur { distance_m: 0.3, steps });
        Self { hit: observation(0.95, 0.04), miss: observation(0.01, 0.003), blur }
    }

    /// Inserts a scan: beams from `origin_m` to each of `ends_m`, both in the frame of the lattice, metres.
    ///
    /// Beams without return carry no information and are not given.
    pub fn insert(&self, cell_size_m: f64, origin_m: Point, ends_m: &[Point], map: &mut impl ObservedCells) {
        self.insert_hits(cell_size_m, origin_m, ends_m, ends_m.len(), map);
    }

    /// As [`SensorModel::insert`], but only the first `hits` beams leave something where they end; the others leave free
    /// space on their way alone.
    ///
    /// # Panics
    /// When there are fewer beams.
    pub fn insert_hits(
        &self,
        cell_size_m: f64,
        origin_m: Point,
        ends_m: &[Point],
        hits: usize,
        map: &mut impl ObservedCells,
    ) {
        let per_metre = 1.0 / cell_size_m;
        let in_cells = |point: Point| Point::new(point.x_m * per_metre, point.y_m * per_metre);
        let origin = in_cells(origin_m);
        for &end_m in &ends_m[..hits] {
            let end = in_cells(end_m);
            map.observe(CellIndex::new(floor(end.x_m), floor(end.y_m)), self.hit);
        }
        if let Some(blur) = &self.blur {
            for &end_m in ends_m[..hits].iter().filter(|end| end.distance_m(origin_m) > blur.distance_m) {
                blur.insert(per_metre, origin, in_cells(end_m), map);
            }
        }
        // Of neighbouring beams that end in the same cell, as in scans of millions of beams, one ray is enough.
        let mut before = None;
        for &end_m in ends_m {
            let end = in_cells(end_m);
            let end_cell = CellIndex::new(floor(end.x_m), floor(end.y_m));
            if before.replace(end_cell) == Some(end_cell) {
                continue;
            }
            map.observe_ray(Ray::new(origin, end), self.miss);
        }
    }
}

impl Blur {
    fn insert(&self, per_metre: f64, origin: Point, end: Point, map: &mut impl ObservedCells) {
        let length = end.distance_m(origin);
        let reach = self.distance_m * per_metre;
        let back = reach / length;
        let start =
            Point::new(end.x_m + back * (origin.x_m - end.x_m), end.y_m + back * (origin.y_m - end.y_m));
        for cell in Ray::new(start, end) {
            let distance = end.distance_m(Point::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5));
            let step = (distance / reach * BLUR_STEPS as f64) as usize;
            if let Some(evidence) = self.steps.get(step) {
                map.observe(cell, *evidence);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    #[derive(Default)]
    struct OneScan(BTreeMap<CellIndex, Cell>);

    impl ObservedCells for OneScan {
        fn observe(&mut self, cell: CellIndex, evidence: Cell) {
            self.0.entry(cell).or_insert(evidence);
        }
    }

    /// Ends in as many cells: of neighbouring beams that end in one cell, the first alone leaves a ray.
    fn points() -> impl Strategy<Value = Vec<Point>> {
        let points = proptest::collection::vec((-10.0..10.0f64, -10.0..10.0f64), 1..60);
        points.prop_map(|points| {
            let cell = |(x, y): (f64, f64)| ((x / 0.05).floor() as i32, (y / 0.05).floor() as i32);
            let by_cell: BTreeMap<_, _> = points.into_iter().map(|point| (cell(point), point)).collect();
            by_cell.into_values().map(|(x, y)| Point::new(x, y)).collect()
        })
    }

    proptest! {
        #[test]
        fn a_hit_beats_a_miss_and_the_order_of_beams_does_not_matter(mut ends in points()) {
            let model = SensorModel::new(Cell { occupied: 9000, free: 0 }, Cell { occupied: 0, free: 800 });
            let origin = Point::new(0.3, -0.2);
            let (mut forward, mut backward) = (OneScan::default(), OneScan::default());
            model.insert(0.05, origin, &ends, &mut forward);
            ends.reverse();
            model.insert(0.05, origin, &ends, &mut backward);
            prop_assert_eq!(&forward.0, &backward.0);
            for end in ends {
                let cell = CellIndex::new((end.x_m / 0.05).floor() as i32, (end.y_m / 0.05).floor() as i32);
                prop_assert_eq!(forward.0.get(&cell).map(|c| c.occupied), Some(9000));
            }
        }
    }

    #[test]
    fn beams_that_leave_no_hit_leave_their_ray() {
        let model = SensorModel::new(Cell { occupied: 9000, free: 0 }, Cell { occupied: 0, free: 800 });
        let (origin, ends) = (Point::new(0.01, 0.01), [Point::new(1.01, 0.01), Point::new(0.01, 1.01)]);
        let mut scan = OneScan::default();
        model.insert_hits(0.05, origin, &ends, 1, &mut scan);
        let at = |x, y| scan.0.get(&CellIndex::new(x, y)).copied();
        assert_eq!((at(20, 0), at(0, 20)), (Some(model.hit), None));
        assert_eq!((at(19, 0), at(0, 19)), (Some(model.miss), Some(model.miss)));
    }

    #[test]
    fn vinyslams_masses_survive_fixed_point() {
        let model = SensorModel::vinyslam(0.9);
        let hit = model.hit.masses();
        assert!((hit.occupied - 0.95 * 0.036).abs() < 2e-4 && (hit.unknown - 0.964).abs() < 2e-4);
        let mut scan = OneScan::default();
        model.insert(0.1, Point::new(0.05, 0.05), &[Point::new(2.05, 0.05)], &mut scan);
        let evidence = |x: i32| scan.0[&CellIndex::new(x, 0)];
        assert_eq!((evidence(20), evidence(5)), (model.hit, model.miss));
        assert!(evidence(19).occupied > evidence(18).occupied && evidence(18).occupied > 0);
        assert_eq!(scan.0.len(), 21);
    }
}
