//! Which submaps make up the fused map, step by step with a changing solution: takes outlines of submaps and their poses, and gives the next
//! steps.

use crate::Footprint;
use crate::coverage::Coverage;
use flockslam_evidence::{Submap, SubmapOutline, TILE_SIDE};
use flockslam_geometry::{Point, Pose};
use std::collections::{BTreeMap, BTreeSet};

/// Where a submap of the mapper belongs. Submaps that nothing but driving connects with the map have no place in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedSubmap {
    /// Its number.
    pub number: u32,
    /// Takes the coordinates that its evidence was inserted in (the front end's `odom`) to the final map.
    pub map_from_odom: Pose,
}

/// A submap is moved in the map once one of its corners is this many cells away from its pose in the solution: resampling to
/// whole cells displaces evidence by as much anyway.
const MOVED_CELLS: f64 = 0.5;
/// Submaps that are brought in or moved after each closed one.
const STEPS_PER_SUBMAP: usize = 2;
/// Submaps that are looked at for retirement after each closed one.
const CHECKS_PER_SUBMAP: usize = 4;
/// Share of a submap's blocks that newer ones must know before it retires.
const COVERED_SHARE: f64 = 0.98;

/// The parts of the fused map, kept up with the solution while the robot drives: submaps come in as they are closed, move when the
/// solution moves them, and retire when newer ones know all that they know.
///
/// It holds no evidence, only outlines, and requests those that it needs. The map itself is made at the end, of the submaps at their final
/// poses: [`crate::FinalMap`].
#[derive(Debug)]
pub struct Fusion {
    /// Side of a cell of the map, metres; that of the first submap.
    cell_size_m: Option<f64>,
    fused: BTreeMap<u32, Fused>,
    coverage: Coverage,
    retired: BTreeSet<u32>,
    /// So many newer submaps must cover one that retires; 0 = none ever does.
    retire_covered_by: usize,
    /// The submap that is checked next for retirement.
    next_check: u32,
}

/// A submap as it is in the map.
#[derive(Debug)]
struct Fused {
    map_from_odom: Pose,
    outline: SubmapOutline,
    footprint: Footprint,
    /// Corners of the box around it, in odom.
    corners: [Point; 4],
}

/// A step for one submap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Bring it to its place in the solution.
    Place(PlacedSubmap),
    /// Take it out: the solution has no place for it.
    Remove(u32),
}

impl Step {
    /// The submap's number.
    pub fn number(&self) -> u32 {
        match self {
            Self::Place(placed) => placed.number,
            Self::Remove(number) => *number,
        }
    }
}

impl Fusion {
    /// A map of nothing. Submaps retire when so many newer ones cover them, 0 = never.
    pub fn new(retire_covered_by: usize) -> Self {
        Self {
            cell_size_m: None,
            fused: BTreeMap::new(),
            coverage: Coverage::default(),
            retired: BTreeSet::new(),
            retire_covered_by,
            next_check: 0,
        }
    }

    /// Area that something is known of, in blocks of 8 × 8 cells, m². An estimate: see [`Footprint::of_outline`].
    pub fn area_m2(&self) -> f64 {
        let block_m = self.cell_size_m.map_or(0.0, |cell_size_m| 8.0 * cell_size_m);
        self.coverage.blocks() as f64 * block_m * block_m
    }

    /// Numbers of the submaps that have retired.
    pub fn retired(&self) -> impl Iterator<Item = u32> + '_ {
        self.retired.iter().copied()
    }

    /// A few steps towards a solution, of which the first `closed` submaps can be had: those missing first, then those farthest from
    /// their places.
    pub fn steps(&self, submaps_in_map: &[PlacedSubmap], closed: u32) -> Vec<Step> {
        let mut steps: Vec<(f64, Step)> = self
            .wanted(submaps_in_map, closed)
            .map(|placed| (self.displacement_cells(placed), Step::Place(*placed)))
            .filter(|(cells, _)| *cells > MOVED_CELLS)
            .collect();
        steps.extend(self.strays(submaps_in_map).map(|number| (f64::INFINITY, Step::Remove(number))));
        steps.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.number().cmp(&b.1.number())));
        steps.into_iter().take(STEPS_PER_SUBMAP).map(|(_, step)| step).collect()
    }

    /// The submaps of a final solution that its map is the sum of, of which the first `closed` can be had: the newest first, so that the map
    /// holds all newer ones when the turn of a submap comes.
    pub fn parts(&self, submaps_in_map: &[PlacedSubmap], closed: u32) -> Vec<PlacedSubmap> {
        self.wanted(submaps_in_map, closed).rev().copied().collect()
    }

    /// Does a step for a submap that is known; gives whether it was one.
    pub fn take_known(&mut self, step: Step) -> bool {
        match (self.remove(step.number()), step) {
            (None, _) => return false,
            (Some(_), Step::Remove(_)) => {}
            (Some(fused), Step::Place(placed)) => self.add(fused.outline, placed.map_from_odom),
        }
        true
    }

    /// Brings a submap that is not known to its place.
    pub fn take(&mut self, placed: PlacedSubmap, outline: SubmapOutline) {
        self.remove(placed.number);
        self.add(outline, placed.map_from_odom);
    }

    /// Looks at a few submaps, in turn, and names those that newer ones cover; those with numbers below `kept_below` never retire.
    pub fn covered(&mut self, kept_below: u32) -> Vec<u32> {
        if self.retire_covered_by == 0 {
            return Vec::new();
        }
        let in_turn = self.fused.range(self.next_check..).chain(self.fused.range(..self.next_check));
        let looked_at: Vec<u32> = in_turn.map(|(number, _)| *number).take(CHECKS_PER_SUBMAP).collect();
        self.next_check = looked_at.last().map_or(0, |last| last + 1);
        looked_at.into_iter().filter(|number| *number >= kept_below && self.is_covered(*number)).collect()
    }

    /// Removes a submap that [`Self::covered`] has named for good, and gives the submap to be stored in its place: the same without evidence.
    pub fn retire(&mut self, number: u32) -> Option<Submap> {
        let fused = self.remove(number)?;
        self.retired.insert(number);
        Some(fused.outline.emptied)
    }

    fn wanted<'a>(
        &'a self,
        submaps_in_map: &'a [PlacedSubmap],
        closed: u32,
    ) -> impl DoubleEndedIterator<Item = &'a PlacedSubmap> {
        submaps_in_map
            .iter()
            .filter(move |placed| placed.number < closed && !self.retired.contains(&placed.number))
    }

    fn is_covered(&self, number: u32) -> bool {
        let footprint = &self.fused[&number].footprint;
        let covered = self.coverage.covered(number, footprint, self.retire_covered_by);
        f64::from(covered) >= COVERED_SHARE * f64::from(footprint.blocks())
    }

    /// How far a submap is from its place, cells; infinitely far when it is not in the map.
    fn displacement_cells(&self, placed: &PlacedSubmap) -> f64 {
        self.fused.get(&placed.number).map_or(f64::INFINITY, |fused| {
            let moved = |corner: &Point| {
                fused.map_from_odom.apply(*corner).distance_m(placed.map_from_odom.apply(*corner))
            };
            fused.corners.iter().map(moved).fold(0.0, f64::max) / fused.outline.emptied.cell_size_m
        })
    }

    /// Submaps in the map that a solution has no place for.
    fn strays<'a>(&'a self, submaps_in_map: &'a [PlacedSubmap]) -> impl Iterator<Item = u32> + 'a {
        let placed: BTreeSet<u32> = submaps_in_map.iter().map(|placed| placed.number).collect();
        self.fused.keys().copied().filter(move |number| !placed.contains(number))
    }

    fn add(&mut self, outline: SubmapOutline, map_from_odom: Pose) {
        let Submap { number, cell_size_m, .. } = outline.emptied;
        let cell_size_m = *self.cell_size_m.get_or_insert(cell_size_m);
        let footprint = Footprint::of_outline(&outline, map_from_odom, cell_size_m);
        self.coverage.add(number, &footprint);
        let corners = corners(&outline);
        self.fused.insert(number, Fused { map_from_odom, outline, footprint, corners });
    }

    fn remove(&mut self, number: u32) -> Option<Fused> {
        let fused = self.fused.remove(&number)?;
        self.coverage.remove(number, &fused.footprint);
        Some(fused)
    }
}

/// Corners of the box around a submap's tiles, in odom.
fn corners(outline: &SubmapOutline) -> [Point; 4] {
    let side_m = outline.emptied.cell_size_m * TILE_SIDE as f64;
    let bounds = |pick: fn(&flockslam_evidence::TileKey) -> i32| {
        let keys = || outline.blocks.iter().map(|(key, _)| f64::from(pick(key)));
        (
            keys().fold(f64::INFINITY, f64::min) * side_m,
            (keys().fold(f64::NEG_INFINITY, f64::max) + 1.0) * side_m,
        )
    };
    let ((left, right), (bottom, top)) = (bounds(|key| key.x), bounds(|key| key.y));
    [(left, bottom), (right, bottom), (left, top), (right, top)].map(|(x, y)| Point::new(x, y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, SubmapTile, TILE_CELLS, TileKey};
    use proptest::prelude::*;

    /// Submaps as a mapper stores them: a square room each, one beside the other.
    fn store(count: u32) -> Vec<Submap> {
        let tile = |x: i32, number: u32| {
            let cell = |i: usize| match (i % 64, i / 64) {
                (8..56, 8..56) => PackedCell { occupied: 0, free: 900 + (i * 7 % 40) as u16 },
                (7..57, 7..57) => PackedCell { occupied: 5000 + number as u16, free: 3 },
                _ => PackedCell::UNKNOWN,
            };
            SubmapTile::new(TileKey { x, y: 0 }, Box::new(std::array::from_fn::<_, TILE_CELLS, _>(cell)))
        };
        let submap = |number: u32| Submap {
            number,
            trajectory: 0,
            insertions: 1,
            first: u64::from(number),
            last: u64::from(number),
            odom_from_submap: Pose::new(f64::from(number), 0.5, 0.3),
            cell_size_m: 0.05,
            tiles: (0..2).map(|k| tile(number as i32 + k, number)).collect(),
        };
        (0..count).map(submap).collect()
    }

    fn follow(fusion: &mut Fusion, submaps: &[Submap], submaps_in_map: &[PlacedSubmap], closed: u32) {
        for step in fusion.steps(submaps_in_map, closed) {
            if !fusion.take_known(step)
                && let Step::Place(placed) = step
            {
                fusion.take(placed, SubmapOutline::of(&submaps[placed.number as usize]));
            }
        }
    }

    fn placed(number: u32, x: f64, y: f64, turn: f64) -> PlacedSubmap {
        PlacedSubmap { number, map_from_odom: Pose::new(x, y, turn) }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn whatever_came_before_what_is_known_is_what_the_solution_covers(
            moves in proptest::collection::vec((0u32..6, -0.3..0.3f64, -0.1..0.1f64, any::<bool>()), 6..24),
        ) {
            let submaps = store(6);
            let mut submaps_in_map: Vec<PlacedSubmap> = (0..6).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
            let mut fusion = Fusion::new(0);
            for (round, (number, shift, turn, detached)) in moves.iter().enumerate() {
                let moved = &mut submaps_in_map[*number as usize];
                moved.map_from_odom = Pose::new(*shift, 2.0 * turn, *turn) * moved.map_from_odom;
                let partly = submaps_in_map.iter().filter(|placed| !detached || placed.number != 2).copied();
                follow(&mut fusion, &submaps, &partly.collect::<Vec<_>>(), round as u32 + 1);
            }
            while !fusion.steps(&submaps_in_map, 6).is_empty() {
                follow(&mut fusion, &submaps, &submaps_in_map, 6);
            }
            let mut anew = Coverage::default();
            for (placed, submap) in submaps_in_map.iter().zip(&submaps) {
                let fused = &fusion.fused[&placed.number];
                prop_assert!(fusion.displacement_cells(placed) <= MOVED_CELLS);
                let footprint = Footprint::of_outline(&SubmapOutline::of(submap), fused.map_from_odom, 0.05);
                prop_assert_eq!(&fused.footprint, &footprint);
                anew.add(placed.number, &footprint);
            }
            prop_assert_eq!(fusion.coverage.blocks(), anew.blocks());
            let newest_first: Vec<_> = submaps_in_map.iter().rev().copied().collect();
            prop_assert_eq!(fusion.parts(&submaps_in_map, 6), newest_first);
        }
    }

    #[test]
    fn a_submap_moves_only_when_it_is_worth_it_and_the_farthest_first() {
        let submaps = store(4);
        let mut fusion = Fusion::new(0);
        let submaps_in_map: Vec<_> = (0..4).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
        assert_eq!(fusion.steps(&submaps_in_map, 1), [Step::Place(submaps_in_map[0])]);
        (0..3).for_each(|_| follow(&mut fusion, &submaps, &submaps_in_map, 4));
        assert_eq!(fusion.steps(&submaps_in_map, 4), []);
        let moved = [
            placed(0, 0.02, 0.0, 0.0),
            placed(1, 0.1, 0.0, 0.0),
            placed(2, 0.0, -0.3, 0.0),
            submaps_in_map[3],
        ];
        assert_eq!(fusion.steps(&moved, 4), [Step::Place(moved[2]), Step::Place(moved[1])]);
        assert_eq!(fusion.steps(&submaps_in_map[1..], 4), [Step::Remove(0)]);
    }

    #[test]
    fn what_newer_submaps_cover_retires_for_good() {
        // All in the same place, but the last, which sees something else.
        let mut submaps = store(5);
        for submap in &mut submaps[..4] {
            submap.tiles.iter_mut().zip(0..).for_each(|(tile, x)| tile.key = TileKey { x, y: 0 });
        }
        submaps[4].tiles.iter_mut().for_each(|tile| tile.key.x += 9);
        let submaps_in_map: Vec<_> = (0..5).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
        let mut fusion = Fusion::new(2);
        let mut retired = Vec::new();
        for closed in 1..=5 {
            follow(&mut fusion, &submaps, &submaps_in_map, closed);
            for number in fusion.covered(0) {
                let emptied = fusion.retire(number).unwrap();
                assert!(emptied.tiles.is_empty() && emptied.number == number);
                retired.push(number);
            }
        }
        assert_eq!(retired, [0, 1]);
        assert_eq!(fusion.retired().collect::<Vec<_>>(), retired);
        let parts: Vec<u32> = fusion.parts(&submaps_in_map, 5).iter().map(|placed| placed.number).collect();
        assert_eq!(parts, [4, 3, 2]);
        assert_eq!(fusion.retire(0), None);
    }

    #[test]
    fn the_area_of_three_rooms_that_overlap_is_known() {
        let submaps = store(3);
        let submaps_in_map: Vec<_> = (0..3).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
        let mut fusion = Fusion::new(0);
        (0..3).for_each(|_| follow(&mut fusion, &submaps, &submaps_in_map, 3));
        // Each tile has a room of 50 × 50 cells in 8 × 8 blocks of 0.4 m; the three have four tiles together.
        assert!((fusion.area_m2() - 4.0 * 64.0 * 0.16).abs() < 1e-9, "{}", fusion.area_m2());
    }
}
