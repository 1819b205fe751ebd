//! Which submaps make up the fused map, step by step with a changing solution, and at the end the map itself: takes submaps and their
//! poses, and gives the next steps.

use crate::coverage::Coverage;
use crate::footprint::KnownCells;
use crate::fused_map::{Added, NotFused};
use crate::{Footprint, FusedMap};
use flockslam_evidence::{CellIndex, ClearedCells, Submap, TILE_SIDE, TooFar};
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
/// It holds no submaps: it requests those that it needs. While the robot drives it holds no evidence either, only where each
/// submap knows something: the map is made at the end, by the [`Fusion::last_steps`], as the sum of the submaps at their final poses.
#[derive(Debug)]
pub struct Fusion {
    /// The sum of evidence, once it is requested.
    map: Option<FusedMap>,
    /// The last steps are on: evidence is summed.
    sums: bool,
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
    /// The cells that were masked when it was brought in: others may be by now.
    cleared: ClearedCells,
    footprint: Footprint,
    /// Where it has evidence for "occupied"; nothing while no evidence is summed.
    occupied: Footprint,
    /// What a step needs of a submap while no evidence is summed: so it need not be read again.
    known: Option<KnownCells>,
    /// Corners of the box around it, in odom.
    corners: [Point; 4],
    cell_size_m: f64,
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
            map: None,
            sums: false,
            cell_size_m: None,
            fused: BTreeMap::new(),
            coverage: Coverage::default(),
            retired: BTreeSet::new(),
            retire_covered_by,
            next_check: 0,
        }
    }

    /// The map; `None` before the last steps.
    pub fn map(&self) -> Option<&FusedMap> {
        self.map.as_ref()
    }

    /// Area that something is known of, in blocks of 8 × 8 cells, m².
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

    /// The map is made for a final solution, of which the first `closed` submaps can be had: all that is to be done, the newest
    /// first, so that the map holds all newer ones when the turn of a submap comes.
    pub fn last_steps(&mut self, submaps_in_map: &[PlacedSubmap], closed: u32) -> Vec<Step> {
        self.start_over();
        self.sums = true;
        self.wanted(submaps_in_map, closed).rev().copied().map(Step::Place).collect()
    }

    /// The submaps of a solution that are in the map and have evidence for "occupied" in the blocks of these cells.
    pub fn occupying(&self, submaps_in_map: &[PlacedSubmap], cells: &[CellIndex]) -> Vec<PlacedSubmap> {
        let blocks = Footprint::of_cells(cells);
        let is_there = |placed: &&PlacedSubmap| {
            self.fused.get(&placed.number).is_some_and(|fused| {
                fused.map_from_odom == placed.map_from_odom && fused.occupied.overlaps(&blocks)
            })
        };
        submaps_in_map.iter().filter(is_there).copied().collect()
    }

    /// Clears, here and in a submap that is in the map as it is, its evidence that makes these cells of the map occupied; gives
    /// whether there was any.
    ///
    /// # Errors
    /// When it is not in the map as it is; then nothing changes.
    pub fn clear(&mut self, submap: &mut Submap, cells: &[CellIndex]) -> Result<bool, NotFused> {
        let not_fused = NotFused(submap.number);
        let fused = self.fused.get_mut(&submap.number).ok_or(not_fused)?;
        let map = self.map.as_mut().filter(|_| fused.cleared == submap.cleared()).ok_or(not_fused)?;
        let map_from_submap = fused.map_from_odom * submap.odom_from_submap;
        let sources = map.occupied_sources(submap, map_from_submap, cells);
        map.clear(submap, map_from_submap, &sources)?;
        fused.cleared = submap.cleared();
        Ok(!sources.is_empty())
    }

    /// Does a step for which the submap is not needed; gives whether it was one.
    pub fn take_known(&mut self, step: Step) -> bool {
        let (Some(cell_size_m), Some(Fused { known: Some(known), .. })) =
            (self.cell_size_m, self.fused.get(&step.number()))
        else {
            return false;
        };
        let Step::Place(PlacedSubmap { number, map_from_odom }) = step else {
            self.remove(step.number());
            return true;
        };
        let footprint = known.footprint(map_from_odom, cell_size_m);
        if let Some(fused) = self.remove(number) {
            self.coverage.add(number, &footprint);
            self.fused.insert(number, Fused { map_from_odom, footprint, ..fused });
        }
        true
    }

    /// Does a step with its submap. Cells of it may have been cleared since it was last handed in.
    ///
    /// # Errors
    /// When its place is absurdly far from the others; it is then not in the map.
    pub fn take(&mut self, step: Step, mut submap: Submap) -> Result<(), TooFar> {
        let cleared = submap.cleared();
        let place = match step {
            Step::Place(placed) => Some(placed.map_from_odom),
            Step::Remove(_) => None,
        };
        if let Some(fused) = self.fused.get(&submap.number) {
            if place == Some(fused.map_from_odom) && fused.cleared == cleared {
                return Ok(());
            }
            self.withdraw(&mut submap);
        }
        if let Some(map_from_odom) = place {
            submap.set_cleared(&cleared);
            self.add(&submap, cleared, map_from_odom)?;
        }
        Ok(())
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

    /// Removes a covered submap for good, and gives the submap to be stored in its place: the same without evidence.
    pub fn retire(&mut self, mut submap: Submap) -> Submap {
        self.withdraw(&mut submap);
        self.retired.insert(submap.number);
        submap.tiles.clear();
        submap
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
            fused.corners.iter().map(moved).fold(0.0, f64::max) / fused.cell_size_m
        })
    }

    /// Submaps in the map that a solution has no place for.
    fn strays<'a>(&'a self, submaps_in_map: &'a [PlacedSubmap]) -> impl Iterator<Item = u32> + 'a {
        let placed: BTreeSet<u32> = submaps_in_map.iter().map(|placed| placed.number).collect();
        self.fused.keys().copied().filter(move |number| !placed.contains(number))
    }

    fn add(&mut self, submap: &Submap, cleared: ClearedCells, map_from_odom: Pose) -> Result<(), TooFar> {
        let (size_m, map_from_submap) =
            (*self.cell_size_m.get_or_insert(submap.cell_size_m), map_from_odom * submap.odom_from_submap);
        let known = (!self.sums).then(|| KnownCells::of(submap));
        let Added { known: footprint, occupied } = match &known {
            Some(known) => {
                Added { known: known.footprint(map_from_odom, size_m), occupied: Footprint::default() }
            }
            None => self.map.get_or_insert_with(|| FusedMap::new(size_m)).add(submap, map_from_submap)?,
        };
        self.coverage.add(submap.number, &footprint);
        let (corners, cell_size_m) = (corners(submap), submap.cell_size_m);
        let fused = Fused { map_from_odom, cleared, footprint, occupied, known, corners, cell_size_m };
        self.fused.insert(submap.number, fused);
        Ok(())
    }

    /// Takes a submap out as it came in. Should it not be the one that came in, the map begins anew: the next steps fill it.
    fn withdraw(&mut self, submap: &mut Submap) {
        let Some(fused) = self.remove(submap.number) else { return };
        let Some(map) = &mut self.map else { return };
        submap.set_cleared(&fused.cleared);
        if map.withdraw(submap, fused.map_from_odom * submap.odom_from_submap).is_err() {
            self.start_over();
        }
    }

    fn remove(&mut self, number: u32) -> Option<Fused> {
        let fused = self.fused.remove(&number)?;
        self.coverage.remove(number, &fused.footprint);
        Some(fused)
    }

    fn start_over(&mut self) {
        (self.map, self.cell_size_m, self.coverage) = (None, None, Coverage::default());
        self.fused.clear();
    }
}

/// Corners of the box around a submap's tiles, in odom.
fn corners(submap: &Submap) -> [Point; 4] {
    let side_m = submap.cell_size_m * TILE_SIDE as f64;
    let bounds = |pick: fn(&flockslam_evidence::TileKey) -> i32| {
        let keys = || submap.tiles.iter().map(|tile| f64::from(pick(&tile.key)));
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

    fn from_scratch(submaps: &[Submap], submaps_in_map: &[PlacedSubmap], without: &[u32]) -> FusedMap {
        let mut map = FusedMap::new(0.05);
        for placed in submaps_in_map.iter().filter(|placed| !without.contains(&placed.number)) {
            let submap = &submaps[placed.number as usize];
            map.add(submap, placed.map_from_odom * submap.odom_from_submap).unwrap();
        }
        map
    }

    fn follow(fusion: &mut Fusion, submaps: &[Submap], submaps_in_map: &[PlacedSubmap], closed: u32) {
        for step in fusion.steps(submaps_in_map, closed) {
            if fusion.take_known(step) {
                check_footprint(fusion, submaps, step);
                continue;
            }
            fusion.take(step, submaps[step.number() as usize].clone()).unwrap();
        }
    }

    /// What a submap that was not read again covers is what it covers when it is.
    fn check_footprint(fusion: &Fusion, submaps: &[Submap], step: Step) {
        if let Step::Place(PlacedSubmap { number, map_from_odom }) = step {
            let submap = &submaps[number as usize];
            let place = map_from_odom * submap.odom_from_submap;
            assert_eq!(fusion.fused[&number].footprint, Footprint::of(submap, place, submap.cell_size_m));
        }
    }

    fn finish(fusion: &mut Fusion, submaps: &[Submap], submaps_in_map: &[PlacedSubmap]) {
        for step in fusion.last_steps(submaps_in_map, submaps.len() as u32) {
            fusion.take(step, submaps[step.number() as usize].clone()).unwrap();
        }
    }

    fn placed(number: u32, x: f64, y: f64, turn: f64) -> PlacedSubmap {
        PlacedSubmap { number, map_from_odom: Pose::new(x, y, turn) }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn whatever_came_before_the_end_is_the_map_from_scratch(
            moves in proptest::collection::vec((0u32..6, -0.3..0.3f64, -0.1..0.1f64, any::<bool>()), 6..24),
            cleared in proptest::collection::vec((0usize..6, 0usize..24, 0usize..TILE_CELLS), 0..20),
            last in 0.0..0.1f64,
        ) {
            let mut submaps = store(6);
            let mut submaps_in_map: Vec<PlacedSubmap> = (0..6).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
            let mut fusion = Fusion::new(0);
            for (round, (number, shift, turn, detached)) in moves.iter().enumerate() {
                let moved = &mut submaps_in_map[*number as usize];
                moved.map_from_odom = Pose::new(*shift, 2.0 * turn, *turn) * moved.map_from_odom;
                for (submap, when, cell) in cleared.iter().filter(|(_, when, _)| *when == round) {
                    submaps[*submap].tiles[when % 2].clear(*cell);
                }
                let partly = submaps_in_map.iter().filter(|placed| !detached || placed.number != 2).copied();
                follow(&mut fusion, &submaps, &partly.collect::<Vec<_>>(), round as u32 + 1);
            }
            for at in &mut submaps_in_map[..if last < 0.05 { 1 } else { 6 }] {
                at.map_from_odom.x_m += last;
            }
            finish(&mut fusion, &submaps, &submaps_in_map);
            prop_assert!(fusion.map() == Some(&from_scratch(&submaps, &submaps_in_map, &[])));
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
                let emptied = fusion.retire(submaps[number as usize].clone());
                assert!(emptied.tiles.is_empty() && emptied.number == number);
                retired.push(number);
            }
        }
        assert_eq!(retired, [0, 1]);
        finish(&mut fusion, &submaps, &submaps_in_map);
        assert!(fusion.map() == Some(&from_scratch(&submaps, &submaps_in_map, &retired)));
        assert_eq!(fusion.retired().collect::<Vec<_>>(), retired);
    }

    #[test]
    fn a_submap_that_is_not_the_one_that_came_in_makes_the_map_anew() {
        let mut submaps = store(2);
        let submaps_in_map: Vec<_> = (0..2).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
        let mut fusion = Fusion::new(0);
        finish(&mut fusion, &submaps, &submaps_in_map);
        submaps[1].tiles[0].cells[700].free += 100;
        let moved = [submaps_in_map[0], placed(1, 1.0, 0.0, 0.0)];
        follow(&mut fusion, &submaps, &moved, 2);
        let anew = from_scratch(&submaps, &moved, &[0]);
        assert!(fusion.map() == Some(&anew), "the map holds nothing but the submap that was moved");
        follow(&mut fusion, &submaps, &moved, 2);
        assert!(fusion.map() == Some(&from_scratch(&submaps, &moved, &[])), "the next step fills it");
        finish(&mut fusion, &submaps, &moved);
        assert!(fusion.map() == Some(&from_scratch(&submaps, &moved, &[])));
    }

    #[test]
    fn cells_are_cleared_in_the_map_and_in_the_submap_as_if_it_had_been_added_so() {
        let mut submaps = store(2);
        submaps[1].tiles[0].clear(CellIndex::new(8, 8).offset());
        let submaps_in_map: Vec<_> = (0..2).map(|number| placed(number, 0.03, -0.02, 0.4)).collect();
        let mut fusion = Fusion::new(0);
        finish(&mut fusion, &submaps, &submaps_in_map);
        let map = fusion.map().unwrap();
        let all = map.tiles().flat_map(|(tile, _)| (0..TILE_CELLS).map(move |offset| tile.cell(offset)));
        let cells: Vec<_> = all.filter(|cell| map.cell(*cell).occupied > 0).step_by(7).collect();
        assert!(cells.len() > 20);
        assert_eq!(fusion.occupying(&submaps_in_map, &cells), submaps_in_map);
        for submap in &mut submaps {
            assert!(fusion.clear(submap, &cells).unwrap());
            assert!(!fusion.clear(submap, &cells).unwrap(), "nothing is left to clear");
        }
        let map = fusion.map().unwrap();
        assert!(cells.iter().all(|cell| map.cell(*cell).occupied == 0));
        assert!(map == &from_scratch(&submaps, &submaps_in_map, &[]));
    }

    #[test]
    fn while_the_robot_drives_no_evidence_is_held_and_the_area_is_known() {
        let submaps = store(3);
        let submaps_in_map: Vec<_> = (0..3).map(|number| placed(number, 0.0, 0.0, 0.0)).collect();
        let mut fusion = Fusion::new(0);
        (0..3).for_each(|_| follow(&mut fusion, &submaps, &submaps_in_map, 3));
        assert!(fusion.map().is_none());
        let area_m2 = fusion.area_m2();
        finish(&mut fusion, &submaps, &submaps_in_map);
        assert!(area_m2 > 20.0 && fusion.area_m2() == area_m2, "{area_m2}");
    }
}
