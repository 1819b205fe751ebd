//! Where a cloud of points fits in the whole known map, at any heading: every place is looked at.

use crate::PlaceField;
use crate::place_field::{BLOCK, CELLS, Stretch, bit};
use flockslam_registration::cloud::Placement;
use std::cmp::Reverse;
use std::f64::consts::{PI, TAU};

/// Step of headings, radians: half of it moves the farthest point by a cell.
const STEP_RAD: f64 = 0.025;
/// Points of a cloud that are looked at. Their values sum up in 16 bits.
const POINTS: usize = 96;
/// Samples of free space that are looked at.
const FREE_SAMPLES: usize = 128;
/// Places within this of a better one are the same, metres and radians.
const APART: (f64, f64) = (0.6, 0.25);
/// Places that a search gives at most.
const PLACES_MAX: usize = 48;
/// Points are taken in steps of so many: a prime that is no divisor of their number.
const MIXING: usize = 101;
/// So many blocks, each the one with the greatest bound at its heading, are summed up before all others: a good place that is known makes
/// most other bounds too low.
const PROBES: usize = 12;
/// Cells with enough score that are kept before those are dropped that no longer count.
const SCORED_MAX: usize = 1 << 16;

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchRequest {
    /// Least score of a place, 0 … 1.
    pub score_min: f64,
    /// A place is given when it has at least this share of the best score.
    pub share_min: f64,
    /// Where the cloud's origin is looked for; everywhere when `None`.
    pub near: Option<Near>,
}

/// A part of the map and of all headings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Its middle.
    pub pose: Placement,
    /// Radius, metres.
    pub reach_m: f64,
    /// Half the range of headings, radians.
    pub turn_rad: f64,
}

/// A place where a cloud fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pose of the cloud's origin in the map, to about a cell.
    pub map_from_cloud: Placement,
    /// Mean over the points of what they are worth in the map, 0 … 1.
    pub score: f64,
}

/// What a search has found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Places {
    /// The best place and all that are nearly as good, the best first, none near a better one.
    pub found: Vec<Candidate>,
    /// No place that is not given scores more than this.
    pub others_max: f64,
    /// What the search took: blocks of cells that it summed up.
    pub blocks: u64,
}

/// A cell with its score at a heading.
#[derive(Clone, Copy)]
struct Scored {
    sum: u16,
    heading: u16,
    row: u32,
    column: u32,
}

/// Searches the map for clouds. Keeps its buffers.
#[derive(Default)]
pub struct PlaceSearch {
    scored: Vec<Scored>,
    offsets: Vec<(usize, usize)>,
    /// Blocks of cells that were summed up in this search.
    blocks: u64,
}

/// A cloud that is looked for.
struct SearchInput<'a> {
    field: &'a PlaceField,
    points: Vec<(f64, f64)>,
    /// Samples of free space.
    free: Vec<(f64, f64)>,
    headings: Vec<f64>,
    stretches: Vec<Stretch>,
    near: Option<Near>,
}

impl PlaceSearch {
    /// Looks for `points` (metres, in the cloud's own frame): at each heading the values of all of them are summed up for each cell where
    /// the robot may stand (Olson 2009). Blocks whose bound is too low are left out, and none that matters.
    pub fn find(&mut self, field: &PlaceField, points: &[(f64, f64)], request: &SearchRequest) -> Places {
        self.find_seen(field, points, &[], request)
    }

    /// The same where `free` was seen to be free, too: a place where something stands there is none. Only fields that are wide know of it.
    pub fn find_seen(
        &mut self,
        field: &PlaceField,
        points: &[(f64, f64)],
        free: &[(f64, f64)],
        request: &SearchRequest,
    ) -> Places {
        let reach_m = field.reach_m();
        let near = points.iter().filter(|p| p.0 * p.0 + p.1 * p.1 <= reach_m * reach_m);
        let near: Vec<(f64, f64)> = near.copied().collect();
        let stride = near.len().div_ceil(POINTS).max(1);
        let few: Vec<(f64, f64)> = near.into_iter().step_by(stride).collect();
        if few.is_empty() {
            return Places { others_max: 1.0, ..Places::default() };
        }
        // Neighbours in the cloud lie on one wall. In this order the first points already say much of the sum of all.
        let points: Vec<(f64, f64)> = (0..few.len()).map(|i| few[i * MIXING % few.len()]).collect();
        let near = free.iter().filter(|p| field.has_free() && p.0 * p.0 + p.1 * p.1 <= reach_m * reach_m);
        let near: Vec<(f64, f64)> = near.copied().collect();
        let stride = near.len().div_ceil(FREE_SAMPLES).max(1);
        let free: Vec<(f64, f64)> = near.into_iter().step_by(stride).collect();
        let full = 255.0 * (points.len() + free.len()) as f64;
        let (headings, stretches) = (headings(request.near), stretches(field, request.near));
        let input = SearchInput { field, points, free, headings, stretches, near: request.near };
        self.blocks = 0;
        let bounds = self.bound(&input);
        let enough = |best: u16| (request.share_min * f64::from(best)).ceil() as u16;
        let mut least =
            ((request.score_min * full).ceil().max(1.0) as u16).max(enough(self.probe(&input, &bounds)));
        self.scored.clear();
        for number in 0..input.headings.len() {
            let best = self.look(&input, &bounds, number, least);
            least = least.max(enough(best));
            if self.scored.len() > SCORED_MAX {
                self.scored.retain(|scored| scored.sum >= least);
            }
            if self.scored.len() > SCORED_MAX {
                least = self.keep_half();
            }
        }
        self.scored.retain(|scored| scored.sum >= least);
        // The best first, and in order of headings, rows and columns among equals.
        self.scored.sort_by_key(|scored| (Reverse(scored.sum), scored.heading, scored.row, scored.column));
        self.places(field, &input.headings, full, least)
    }

    /// Bounds of the mean value of a point in each block at each heading.
    fn bound(&mut self, input: &SearchInput<'_>) -> Vec<u8> {
        let points = (input.points.len() + input.free.len()) as u16;
        let mut bounds = Vec::with_capacity(input.headings.len() * input.blocks());
        for number in 0..input.headings.len() {
            self.turn(input, number);
            for stretch in &input.stretches {
                let sums = input.field.bounds(*stretch, &self.offsets);
                bounds.extend(sums[..stretch.count].iter().map(|sum| sum.div_ceil(points) as u8));
            }
        }
        bounds
    }

    /// The greatest sum in those blocks whose bounds are the greatest, each of another heading.
    fn probe(&mut self, input: &SearchInput<'_>, bounds: &[u8]) -> u16 {
        let top = |number: usize| {
            // The first of those with the greatest bound.
            let top = input.bounded(bounds, number).max_by_key(|(bound, block)| (*bound, Reverse(*block)));
            top.map(|top| (top, number))
        };
        let mut tops: Vec<_> = (0..input.headings.len()).filter_map(top).collect();
        tops.sort_by_key(|((bound, _), number)| (Reverse(*bound), *number));
        let mut best = 0;
        for ((bound, block), number) in tops.into_iter().take(PROBES) {
            self.turn(input, number);
            self.blocks += 1;
            let sums = input.sums(&self.offsets, block, bound, best).map(|(_, sum)| sum);
            best = sums.max().unwrap_or(best);
        }
        best
    }

    /// Turns the points by a heading.
    fn turn(&mut self, input: &SearchInput<'_>, number: usize) {
        let turned = Placement::new(0.0, 0.0, input.headings[number]);
        let offsets = input.points.iter().map(|&(x_m, y_m)| turned.rotate(x_m, y_m));
        self.offsets.clear();
        self.offsets.extend(offsets.map(|(x_m, y_m)| input.field.offsets(x_m, y_m)));
        let free = input.free.iter().map(|&(x_m, y_m)| turned.rotate(x_m, y_m));
        self.offsets.extend(free.filter_map(|(x_m, y_m)| input.field.free_offsets(x_m, y_m)));
    }

    /// Remembers all cells that sum up to enough at a heading, and gives the greatest sum.
    fn look(&mut self, input: &SearchInput<'_>, bounds: &[u8], number: usize, least: u16) -> u16 {
        self.turn(input, number);
        let mut best = 0;
        for (bound, block) in input.bounded(bounds, number).filter(|(bound, _)| *bound >= least) {
            self.blocks += 1;
            for (cell, sum) in input.sums(&self.offsets, block, bound, least) {
                best = best.max(sum);
                self.scored.push(Scored::new(sum, number, block, cell));
            }
        }
        best
    }

    /// Drops the worse half of what is kept; gives the least score of the rest.
    fn keep_half(&mut self) -> u16 {
        let half = SCORED_MAX / 2;
        let (_, middle, _) = self.scored.select_nth_unstable_by_key(half, |s| Reverse(s.sum));
        let least = middle.sum.saturating_add(1);
        self.scored.retain(|scored| scored.sum >= least);
        // The order of what is left must not depend on how it was selected.
        self.scored.sort_by_key(|scored| (scored.heading, scored.row, scored.column));
        least
    }

    fn places(&self, field: &PlaceField, headings: &[f64], full: f64, least: u16) -> Places {
        let mut found: Vec<Candidate> = Vec::new();
        for scored in &self.scored {
            let (x_m, y_m) = field.middle(scored.column as usize, scored.row as usize);
            let map_from_cloud = Placement::new(x_m, y_m, headings[usize::from(scored.heading)]);
            if found.iter().any(|better| is_same(&better.map_from_cloud, &map_from_cloud)) {
                continue;
            }
            let score = f64::from(scored.sum) / full;
            if found.len() == PLACES_MAX {
                return Places { found, others_max: score, blocks: self.blocks };
            }
            found.push(Candidate { map_from_cloud, score });
        }
        Places { found, others_max: f64::from(least) / full, blocks: self.blocks }
    }
}

/// Headings that are looked at, in order.
fn headings(near: Option<Near>) -> Vec<f64> {
    let (middle, half) = near.map_or((0.0, PI), |near| (near.pose.heading_rad, near.turn_rad.min(PI)));
    let steps = (half / STEP_RAD).ceil().max(0.0) as i32;
    let step = if steps == 0 { 0.0 } else { half / f64::from(steps) };
    // A full turn ends where it began.
    let last = if 2.0 * half + 1e-9 >= TAU { steps - 1 } else { steps };
    (-steps..=last).map(|i| middle + f64::from(i) * step).collect()
}

/// Blocks that are looked at.
fn stretches(field: &PlaceField, near: Option<Near>) -> Vec<Stretch> {
    let Some(Near { pose, reach_m, .. }) = near else { return field.stretches(0..usize::MAX, 0..usize::MAX) };
    let (first, last) = (
        field.block_at(pose.x_m - reach_m, pose.y_m - reach_m),
        field.block_at(pose.x_m + reach_m, pose.y_m + reach_m),
    );
    // Negative numbers become 0; the field ends by itself on the other side.
    let range = |first: f64, last: f64| first as usize..(last + 1.0) as usize;
    field.stretches(range(first.1, last.1), range(first.0, last.0))
}

impl Scored {
    fn new(sum: u16, heading: usize, block: (usize, usize), cell: usize) -> Self {
        let row = (block.0 * BLOCK + cell / BLOCK) as u32;
        let column = (block.1 * BLOCK + cell % BLOCK) as u32;
        Self { sum, heading: heading as u16, row, column }
    }
}

impl SearchInput<'_> {
    /// Number of blocks that are looked at.
    fn blocks(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.count).sum()
    }

    /// The blocks, row and column, each behind the bound of its sums at a heading.
    fn bounded(&self, bounds: &[u8], number: usize) -> impl Iterator<Item = (u16, (usize, usize))> {
        let blocks =
            self.stretches.iter().flat_map(|s| (s.column..s.column + s.count).map(|column| (s.row, column)));
        let points = (self.points.len() + self.free.len()) as u16;
        bounds[number * self.blocks()..].iter().map(move |bound| u16::from(*bound) * points).zip(blocks)
    }

    /// Cells of a block where the robot may stand and that sum up to enough, each with its sum.
    fn sums(
        &self,
        offsets: &[(usize, usize)],
        block: (usize, usize),
        bound: u16,
        least: u16,
    ) -> impl Iterator<Item = (usize, u16)> + use<> {
        let sums = self.field.sums(block, offsets, bound, least);
        let standing = if sums.is_some() { self.standing(block.0, block.1) } else { 0 };
        let is_enough = move |(cell, sum): &(usize, u16)| *sum >= least && standing >> cell & 1 == 1;
        sums.into_iter().flatten().enumerate().filter(is_enough)
    }

    /// Cells of a block where the robot may stand, and is looked for: a bit for each.
    fn standing(&self, row: usize, column: usize) -> u16 {
        let passable = self.field.passable(row, column);
        let Some(Near { pose, reach_m, .. }) = self.near else { return passable };
        let is_near = |i: &usize| {
            let (x_m, y_m) = self.field.middle(column * BLOCK + i % BLOCK, row * BLOCK + i / BLOCK);
            let (dx, dy) = (x_m - pose.x_m, y_m - pose.y_m);
            dx * dx + dy * dy <= reach_m * reach_m
        };
        let near = (0..CELLS).filter(is_near).fold(0, |bits, i| bits | bit(i % BLOCK, i / BLOCK));
        passable & near
    }
}

/// Whether two poses are the same place.
pub(crate) fn is_same(a: &Placement, b: &Placement) -> bool {
    a.distance_m(b) < APART.0 && a.turn_rad(b) < APART.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KnownMap;
    use flockslam_evidence::CellState;
    use flockslam_geometry::Point;
    use proptest::prelude::*;

    /// A map of rooms of all sizes, some of it unknown, from numbers.
    fn map(width: usize, height: usize, numbers: &[u8]) -> KnownMap {
        let mut map = KnownMap::of_width(width, 0.1, Point::new(-3.0, 2.0));
        let number = |i: usize| usize::from(numbers[i % numbers.len()]);
        for row in 0..height {
            let state = |column: usize| {
                let (i, k) = (column / (8 + number(row / 16) % 16), row / (8 + number(column / 16) % 16));
                match (number(7 * i + k), column % 16, row % 16) {
                    (0..20, _, _) => CellState::Unknown,
                    (20..120, 0, _) | (120..200, _, 0) => CellState::Occupied,
                    _ => CellState::Free,
                }
            };
            map.push_row((0..width).map(state));
        }
        map.measured()
    }

    /// The same without bounds: all cells are summed up at all headings.
    fn exhaustive(
        field: &PlaceField,
        points: &[(f64, f64)],
        free: &[(f64, f64)],
        request: &SearchRequest,
    ) -> Places {
        let headings = headings(request.near);
        let input = SearchInput {
            field,
            points: points.to_vec(),
            free: free.to_vec(),
            headings: headings.clone(),
            stretches: field.stretches(0..usize::MAX, 0..usize::MAX),
            near: request.near,
        };
        let mut search = PlaceSearch::default();
        let (mut all, mut best) = (Vec::new(), 0);
        for heading in 0..headings.len() {
            search.turn(&input, heading);
            for block in blocks(&input.stretches) {
                let bound = 255 * (points.len() + free.len()) as u16;
                for (cell, sum) in input.sums(&search.offsets, block, bound, 0) {
                    best = best.max(sum);
                    all.push(Scored::new(sum, heading, block, cell));
                }
            }
        }
        let full = 255.0 * (points.len() + free.len()) as f64;
        let least =
            (request.score_min * full).ceil().max(1.0).max((request.share_min * f64::from(best)).ceil())
                as u16;
        all.retain(|scored| scored.sum >= least);
        all.sort_by_key(|scored| (Reverse(scored.sum), scored.heading, scored.row, scored.column));
        search.scored = all;
        search.places(field, &headings, full, least)
    }

    fn blocks(stretches: &[Stretch]) -> impl Iterator<Item = (usize, usize)> {
        stretches.iter().flat_map(|s| (0..s.count).map(move |i| (s.row, s.column + i)))
    }

    /// Six of ten points are where the map is unknown at the true place; at another one fewer are at walls that the map lacks, but in free space.
    #[test]
    fn the_second_search_prefers_unknown_cells_to_free_ones() {
        let mut map = KnownMap::of_width(200, 0.1, Point::default());
        let is_within =
            |cell: usize, from_m: f64, to_m: f64| (from_m..to_m).contains(&(cell as f64 * 0.1 + 0.05));
        for row in 0..300 {
            let state = |column: usize| {
                let is_wall = (is_within(row, 7.0, 7.2) && is_within(column, 6.0, 14.0))
                    || (is_within(row, 22.0, 22.2) && is_within(column, 6.0, 14.0))
                    || (is_within(row, 18.0, 18.2) && is_within(column, 6.0, 9.0));
                let is_seen =
                    (is_within(row, 4.5, 7.0) || is_within(row, 17.0, 22.0)) && is_within(column, 3.0, 17.0);
                match (is_wall, is_seen) {
                    (true, _) => CellState::Occupied,
                    (false, true) => CellState::Free,
                    (false, false) => CellState::Unknown,
                }
            };
            map.push_row((0..200).map(state));
        }
        let map = map.measured();
        // A wall of 8 m on the left of the robot, and one of 12 m on its right.
        let left = (0..32).map(|k| (-3.9 + 0.25 * f64::from(k), 2.1));
        let points: Vec<(f64, f64)> =
            left.chain((0..48).map(|k| (-5.9 + 0.25 * f64::from(k), -2.0))).collect();
        let best_y_m = |unknown| {
            let request = SearchRequest { score_min: 0.3, share_min: 0.75, near: None };
            let places = PlaceSearch::default().find(&PlaceField::new(&map, unknown), &points, &request);
            places.found[0].map_from_cloud.y_m
        };
        let [first_m, second_m] = [crate::UNKNOWN, crate::MUCH_UNKNOWN].map(best_y_m);
        assert!((first_m - 20.0).abs() < 0.3 && (second_m - 5.0).abs() < 0.3, "{first_m} m, {second_m} m");
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, rng_seed: proptest::test_runner::RngSeed::Fixed(7), ..ProptestConfig::default() })]

        #[test]
        fn bounds_leave_out_nothing_that_is_found_without_them(
            size in (20usize..150, 20usize..90),
            numbers in prop::collection::vec(any::<u8>(), 8..64),
            points in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 4..40),
            free in prop::option::of(prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 1..20)),
            (score_min, share_min) in (0.0..0.5f64, 0.6..0.95f64),
            near in prop::option::of((-4.0..12.0f64, 0.0..10.0f64, -4.0..4.0f64, 0.3..6.0f64, 0.1..4.0f64)),
        ) {
            let map = map(size.0, size.1, &numbers);
            let (field, free) = match free {
                Some(free) => (PlaceField::wide(&map, crate::UNKNOWN), free),
                None => (PlaceField::new(&map, crate::UNKNOWN), Vec::new()),
            };
            let near = near.map(|(x, y, heading, reach_m, turn_rad)| Near {
                pose: Placement::new(x, y, heading),
                reach_m,
                turn_rad,
            });
            let request = SearchRequest { score_min, share_min, near };
            let found = PlaceSearch::default().find_seen(&field, &points, &free, &request);
            let all = exhaustive(&field, &points, &free, &request);
            prop_assert_eq!(&found, &Places { blocks: found.blocks, ..all });
        }
    }
}
