//! The protocol of meetings (Filatov 2021), for comparison with the solution of records: two robots match each other's current scan and exchange their
//! maps. Takes snapshots, gives one map in layers.

use flockslam_evidence::{Cell, CellIndex, Masses, PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey};
use flockslam_flock::{Flock, FlockGraph};
use flockslam_geometry::Pose;
use flockslam_map_fusion::FusedMap;
use flockslam_records::RobotId;
use flockslam_registration::cloud::{
    AlignSettings, Aligner, MomentGrid, PackedPoint, Placement, PooledField, Searcher, Window,
};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use std::sync::Arc;

/// Points of a scan that are searched for.
const SEARCH_POINTS: usize = 120;
/// A scan of fewer points is not looked for.
const POINTS_MIN: usize = 40;
/// Least score of a match, and least share of the points on lines of the map after refinement.
const MATCH_MIN: (f64, f64) = (0.6, 0.65);
/// A runner-up is at least this far away, and makes a match ambiguous when its score reaches this share of the best.
const APART: Window = Window { reach_m: 0.5, turn_rad: 0.175 };
const RUNNER_UP: f64 = 0.9;
/// Squares that a search evaluates before it gives up.
const SUMS_MAX: u64 = 3_000_000;
/// Farthest from the middle of a map that a scan is looked for, metres.
const REACH_MAX_M: f64 = 55.0;
/// Cells of the map that a match is refined with lie within this of it, metres.
const REFINED_WITHIN_M: f64 = 16.0;
/// Mass of "occupied" from which a cell is part of a wall.
const WALL_MIN: f64 = 0.5;
/// Matches in both directions agree when they differ by less, metres and radians.
const AGREEING: (f64, f64) = (0.3, 0.1);

/// How the cells of several robots' maps become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellFusion {
    /// Dempster's rule.
    #[default]
    Dempster,
    /// The cell of greatest occupancy.
    Maximum,
    /// The cell of least occupancy.
    Minimum,
    /// The mean of occupancies, as well known as the cells are on average.
    Mean,
}

/// What a robot hands over when it meets another.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The robot.
    pub robot: RobotId,
    /// Grows with the robot's map.
    pub version: u64,
    /// What it alone has seen, in its own frame (reference pose: identity).
    pub map: Arc<Submap>,
    /// Its current scan, in the robot's frame.
    pub scan: Vec<PackedPoint>,
    /// Where that was taken.
    pub map_from_base: Pose,
    /// The maps of others that it has.
    pub layers: BTreeMap<RobotId, Layer>,
}

/// The map of one robot, as another has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Version of the map.
    pub version: u64,
    /// Meetings that it went through.
    pub hops: u32,
    /// Who handed it over.
    pub via: RobotId,
    /// Takes its origin's frame to that of the robot that has it.
    pub own_from_origin: Pose,
    /// What its origin alone has seen, in its origin's frame.
    pub map: Arc<Submap>,
}

impl Layer {
    /// The newer map is better, then the one that came on the shorter way.
    fn rank(&self) -> (u64, Reverse<u32>, Reverse<&RobotId>) {
        (self.version, Reverse(self.hops), Reverse(&self.via))
    }
}

/// How meetings went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeetingCounts {
    /// Neither scan was found in the other's map, or in more than one place.
    pub unmatched: u64,
    /// Each scan was found in the other's map, but the two matches contradict each other.
    pub contradicting: u64,
    /// Maps were exchanged.
    pub merged: u64,
}

/// A robot by the protocol of meetings (Filatov 2021): when two robots meet, each matches the other's current scan in its own map, and its
/// own in the other's, takes over the other's map and fuses it with its own.
///
/// It keeps one layer for each origin, which a newer map of that robot replaces, and fuses them anew when the whole is wanted: so nothing is counted
/// twice for any sequence of meetings, and the order of meetings does not matter.
pub struct Meetings {
    own: Snapshot,
    counts: MeetingCounts,
}

impl Meetings {
    /// A robot without a meeting, or with its stored meetings.
    pub fn new(own: Snapshot) -> Self {
        Self { own, counts: MeetingCounts::default() }
    }

    /// What it hands over.
    pub fn snapshot(&self) -> &Snapshot {
        &self.own
    }

    /// How meetings went.
    pub fn counts(&self) -> MeetingCounts {
        self.counts
    }

    /// Takes over what its own front end has found since: a greater version, in the same frame.
    pub fn advance(&mut self, version: u64, map: Arc<Submap>, scan: Vec<PackedPoint>, map_from_base: Pose) {
        self.own = Snapshot { version, map, scan, map_from_base, ..self.own.clone() };
    }

    /// Meets another robot: gives its pose relative to this one, when the scans show it.
    pub fn meet(&mut self, other: &Snapshot) -> Option<Pose> {
        if other.robot == self.own.robot {
            return None;
        }
        let own_from_other = self.related(other)?;
        self.counts.merged += 1;
        let direct = Layer {
            version: other.version,
            hops: 1,
            via: other.robot.clone(),
            own_from_origin: own_from_other,
            map: Arc::clone(&other.map),
        };
        self.take(&other.robot, direct);
        for (origin, layer) in &other.layers {
            let passed_on = Layer {
                hops: layer.hops.saturating_add(1),
                via: other.robot.clone(),
                own_from_origin: own_from_other * layer.own_from_origin,
                ..layer.clone()
            };
            self.take(origin, passed_on);
        }
        Some(own_from_other)
    }

    fn take(&mut self, origin: &RobotId, layer: Layer) {
        let known = self.own.layers.get(origin);
        if *origin != self.own.robot && known.is_none_or(|known| layer.rank() > known.rank()) {
            self.own.layers.insert(origin.clone(), layer);
        }
    }

    /// Pose of the other robot relative to this one: by its scan in this map, by this scan in its map, or by both, which then must agree.
    fn related(&mut self, other: &Snapshot) -> Option<Pose> {
        let theirs = find(&self.own.map, &other.scan).map(|at| at * other.map_from_base.inverse());
        let ours = find(&other.map, &self.own.scan).map(|at| self.own.map_from_base * at.inverse());
        match (theirs, ours) {
            (Some(a), Some(b)) => {
                let here = a * other.map_from_base;
                let there = b * other.map_from_base;
                let agree = here.distance_m(there) <= AGREEING.0 && here.turn_rad(there) <= AGREEING.1;
                self.counts.contradicting += u64::from(!agree);
                agree.then_some(a)
            }
            (None, None) => {
                self.counts.unmatched += 1;
                None
            }
            (one, other) => one.or(other),
        }
    }

    /// Its own map and all layers in one, in its own frame.
    pub fn map(&self, fusion: CellFusion) -> FusedMap {
        let layers = self.own.layers.values().map(|layer| (&*layer.map, layer.own_from_origin));
        let all = [(&*self.own.map, Pose::IDENTITY)].into_iter().chain(layers);
        let size_m = self.own.map.cell_size_m;
        // Parts that are absurdly far away are left out.
        if fusion == CellFusion::Dempster {
            let mut map = FusedMap::new(size_m);
            all.for_each(|(layer, at)| drop(map.add(layer, at)));
            return map;
        }
        let placed: Vec<FusedMap> = all
            .map(|(layer, at)| {
                let mut map = FusedMap::new(size_m);
                drop(map.add(layer, at));
                map
            })
            .collect();
        let mut map = FusedMap::new(size_m);
        drop(map.add(&fused(&placed, fusion, size_m), Pose::IDENTITY));
        map
    }
}

/// Cell by cell one map of several in the same lattice.
fn fused(maps: &[FusedMap], fusion: CellFusion, cell_size_m: f64) -> Submap {
    let keys: BTreeSet<TileKey> = maps.iter().flat_map(|map| map.tiles().map(|(key, _)| key)).collect();
    let tile = |key: TileKey| {
        let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
        let tiles: Vec<_> = maps.iter().filter_map(|map| map.tile(key)).collect();
        for (offset, cell) in cells.iter_mut().enumerate() {
            let known = tiles.iter().map(|cells| cells[offset]);
            *cell = one(&known.filter(|cell| !cell.is_unknown()).collect::<Vec<_>>(), fusion).pack();
        }
        SubmapTile::new(key, cells)
    };
    of_tiles(cell_size_m, keys.into_iter().map(tile).collect())
}

/// One cell of those that know something.
fn one(cells: &[Cell], fusion: CellFusion) -> Cell {
    let occupancy = |cell: &Cell| cell.masses().occupancy().unwrap_or(0.5);
    let by = |a: &&Cell, b: &&Cell| occupancy(a).total_cmp(&occupancy(b));
    match fusion {
        CellFusion::Dempster => cells.iter().fold(Cell::UNKNOWN, |sum, cell| sum.combine(*cell)),
        CellFusion::Maximum => cells.iter().max_by(by).copied().unwrap_or_default(),
        CellFusion::Minimum => cells.iter().min_by(by).copied().unwrap_or_default(),
        CellFusion::Mean if cells.is_empty() => Cell::UNKNOWN,
        CellFusion::Mean => {
            let share = 1.0 / cells.len() as f64;
            let mean = cells.iter().map(occupancy).sum::<f64>() * share;
            let known = cells.iter().map(|cell| 1.0 - cell.masses().unknown).sum::<f64>() * share;
            Cell::from_masses(Masses::observation(mean, known))
        }
    }
}

fn of_tiles(cell_size_m: f64, tiles: Vec<SubmapTile>) -> Submap {
    Submap {
        number: 0,
        trajectory: 0,
        insertions: 0,
        first: 0,
        last: 0,
        odom_from_submap: Pose::IDENTITY,
        cell_size_m,
        tiles,
    }
}

/// A fused map in the form in which it is handed over.
fn handed_over(map: &FusedMap) -> Submap {
    let tile = |(key, cells): (TileKey, Box<[Cell; TILE_CELLS]>)| {
        SubmapTile::new(key, Box::new(cells.map(|cell| cell.pack())))
    };
    of_tiles(map.cell_size_m(), map.tiles().map(tile).collect())
}

/// The pose from which a scan was taken, somewhere in a map, at any heading; nothing when it fits nowhere or in several places.
fn find(map: &Submap, scan: &[PackedPoint]) -> Option<Pose> {
    if scan.len() < POINTS_MIN {
        return None;
    }
    let walls = walls(map);
    let (low, high) =
        walls.iter().fold(((f64::MAX, f64::MAX), (f64::MIN, f64::MIN)), |(low, high), &(x, y)| {
            ((low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y)))
        });
    let middle = (0.5 * (low.0 + high.0), 0.5 * (low.1 + high.1));
    let centred: Vec<(f64, f64)> = walls.iter().map(|&(x, y)| (x - middle.0, y - middle.1)).collect();
    let reach_m = (0.5 * (high.0 - low.0).max(high.1 - low.1)).min(REACH_MAX_M);
    if walls.len() < POINTS_MIN {
        return None;
    }
    let field = PooledField::new(&centred);
    let stride = scan.len().div_ceil(SEARCH_POINTS);
    let few: Vec<(f64, f64)> = scan.iter().step_by(stride).map(|p| (p.x_m(), p.y_m())).collect();
    let mut searcher = Searcher::bounded(SUMS_MAX);
    let window = Window { reach_m, turn_rad: PI };
    let found = searcher.best(&field, &few, Placement::IDENTITY, window, MATCH_MIN.0, None)?;
    let exclude = Some((found.placement, APART));
    let alternative =
        searcher.best(&field, &few, Placement::IDENTITY, window, RUNNER_UP * found.score, exclude);
    if alternative.is_some() || searcher.gave_up() {
        return None;
    }
    let at = refined(&centred, scan, found.placement)?;
    Some(Pose::new(at.x_m + middle.0, at.y_m + middle.1, at.heading_rad))
}

/// Centres of the cells that are part of walls.
fn walls(map: &Submap) -> Vec<(f64, f64)> {
    let centre = |cell: CellIndex| {
        ((f64::from(cell.x) + 0.5) * map.cell_size_m, (f64::from(cell.y) + 0.5) * map.cell_size_m)
    };
    let of_tile = |tile: &SubmapTile| -> Vec<(f64, f64)> {
        let walls = (0..TILE_CELLS).filter(|offset| tile.cell(*offset).masses().occupied >= WALL_MIN);
        walls.map(|offset| centre(tile.key.cell(offset))).collect()
    };
    map.tiles.iter().flat_map(of_tile).collect()
}

fn refined(walls: &[(f64, f64)], scan: &[PackedPoint], guess: Placement) -> Option<Placement> {
    let near = walls.iter().filter_map(|(x, y)| PackedPoint::from_metres(x - guess.x_m, y - guess.y_m));
    let near: Vec<PackedPoint> =
        near.filter(|p| p.squared_range_m2() <= REFINED_WITHIN_M * REFINED_WITHIN_M).collect();
    let mut grid = MomentGrid::default();
    grid.add(&Placement::new(guess.x_m, guess.y_m, 0.0), &near);
    let settings = AlignSettings { iterations: 12, gate_wide_m: 0.4, ..AlignSettings::default() };
    let found = Aligner::new(settings).align(&mut grid, scan, guess)?;
    (found.inliers >= MATCH_MIN.1 && found.placement.distance_m(&guess) <= 0.4).then_some(found.placement)
}

impl Snapshot {
    /// What a robot hands over that knows its own records only, at the end of its way; nothing when it has seen nothing. Its frame is that of its
    /// solution alone.
    pub fn of(flock: &Flock) -> Option<Self> {
        let solution = flock.solution(true);
        let map = flock.map(&solution).map?;
        let graph = FlockGraph::new(flock.collection());
        let nodes =
            solution.nodes.iter().find(|((robot, _), _)| robot == flock.robot()).map(|(_, nodes)| nodes)?;
        let last = nodes.iter().rposition(|node| node.part == solution.main_part)?;
        let scan = graph.points(last).to_vec();
        Some(Self {
            robot: flock.robot().clone(),
            version: nodes[last].sequence + 1,
            map: Arc::new(handed_over(&map)),
            scan,
            map_from_base: nodes[last].flock_from_base,
            layers: BTreeMap::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_records::RobotKey;
    use proptest::prelude::*;

    const SIZE_M: f64 = 0.05;

    /// Walls of an uneven hall as points, in the building's frame.
    fn hall() -> Vec<(f64, f64)> {
        let corners: [(f64, f64); 11] = [
            (0.0, 0.0),
            (9.0, 0.0),
            (9.0, 2.5),
            (7.6, 2.5),
            (7.6, 6.0),
            (4.0, 6.0),
            (4.0, 4.8),
            (2.2, 4.8),
            (2.2, 7.0),
            (0.0, 7.0),
            (0.0, 0.0),
        ];
        let mut points = Vec::new();
        for pair in corners.windows(2) {
            let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
            let count = ((bx - ax).abs().max((by - ay).abs()) / 0.04) as u32;
            let share = |k: u32| f64::from(k) / f64::from(count);
            points.extend((0..count).map(|k| (ax + (bx - ax) * share(k), ay + (by - ay) * share(k))));
        }
        points
    }

    /// A robot whose frame has this pose in the building, and which stands there.
    fn robot(name: &str, version: u64, building_from_map: Pose, building_from_base: Pose) -> Snapshot {
        let mut tiles: BTreeMap<TileKey, Box<[PackedCell; TILE_CELLS]>> = BTreeMap::new();
        let map_from_building = Placement::from(building_from_map).inverse();
        let wall = Cell::from_weights(2.0 + version as f64, 0.1).pack();
        for (x, y) in hall() {
            let (x, y) = map_from_building.apply(x, y);
            let cell = CellIndex::new((x / SIZE_M).floor() as i32, (y / SIZE_M).floor() as i32);
            let tile =
                tiles.entry(cell.tile()).or_insert_with(|| Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
            tile[cell.offset()] = wall;
        }
        let base_from_building = Placement::from(building_from_base).inverse();
        let seen = hall().into_iter().map(|(x, y)| base_from_building.apply(x, y));
        Snapshot {
            robot: RobotKey::of_replay(name).unwrap().id().clone(),
            version,
            map: Arc::new(of_tiles(
                SIZE_M,
                tiles.into_iter().map(|(key, cells)| SubmapTile::new(key, cells)).collect(),
            )),
            scan: seen.step_by(2).filter_map(|(x, y)| PackedPoint::from_metres(x, y)).collect(),
            map_from_base: building_from_map.inverse() * building_from_base,
            layers: BTreeMap::new(),
        }
    }

    fn robots() -> Vec<Snapshot> {
        vec![
            robot("a", 3, Pose::new(1.0, 2.0, 0.4), Pose::new(3.0, 2.0, 1.0)),
            robot("b", 5, Pose::new(-20.0, 7.0, 2.9), Pose::new(6.0, 3.0, -2.0)),
            robot("b", 6, Pose::new(-20.0, 7.0, 2.9), Pose::new(1.5, 5.0, 0.3)),
            robot("c", 2, Pose::new(4.0, -30.0, -1.2), Pose::new(5.0, 1.5, 3.0)),
        ]
    }

    fn cells(map: &FusedMap) -> Vec<(TileKey, Vec<Cell>)> {
        map.tiles().map(|(key, cells)| (key, cells.to_vec())).collect()
    }

    #[test]
    fn a_scan_gives_the_relative_pose_of_two_robots() {
        let robots = robots();
        let mut a = Meetings::new(robots[0].clone());
        let a_from_b = a.meet(&robots[1]).unwrap();
        let truth = Pose::new(1.0, 2.0, 0.4).inverse() * Pose::new(-20.0, 7.0, 2.9);
        let there = robots[1].map_from_base;
        assert!((a_from_b * there).distance_m(truth * there) < 0.05 && a_from_b.turn_rad(truth) < 0.02);
        assert_eq!(a.counts(), MeetingCounts { merged: 1, ..MeetingCounts::default() });
        let few =
            Snapshot { scan: Vec::new(), map: Arc::new(of_tiles(SIZE_M, Vec::new())), ..robots[3].clone() };
        assert_eq!(a.meet(&few), None);
        assert_eq!(a.counts().unmatched, 1);
    }

    #[test]
    fn what_one_has_received_is_passed_on_and_nothing_counts_twice() {
        let robots = robots();
        let mut b = Meetings::new(robots[1].clone());
        b.meet(&robots[3]).unwrap();
        let mut a = Meetings::new(robots[0].clone());
        a.meet(b.snapshot()).unwrap();
        assert_eq!(a.snapshot().layers.len(), 2);
        let once = a.map(CellFusion::Dempster);
        a.meet(b.snapshot()).unwrap();
        assert_eq!(cells(&a.map(CellFusion::Dempster)), cells(&once));
        // Directly is better than over another.
        a.meet(&robots[3]).unwrap();
        assert!(a.snapshot().layers.values().all(|layer| layer.hops == 1));
    }

    #[test]
    fn cells_are_fused_as_asked() {
        let (wall, free) = (Cell::from_weights(3.0, 0.5), Cell::from_weights(0.2, 2.0));
        let of = |fusion| one(&[wall, free], fusion);
        assert_eq!((of(CellFusion::Maximum), of(CellFusion::Minimum)), (wall, free));
        assert_eq!(of(CellFusion::Dempster), wall.combine(free));
        let occupancy = |cell: Cell| cell.masses().occupancy().unwrap();
        let mean = 0.5 * (occupancy(wall) + occupancy(free));
        assert!((occupancy(of(CellFusion::Mean)) - mean).abs() < 1e-3);
        assert_eq!(one(&[], CellFusion::Mean), Cell::UNKNOWN);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]
        #[test]
        fn order_and_repetition_of_meetings_do_not_matter(order in prop::collection::vec(1usize..4, 3..6)) {
            let robots = robots();
            let mut expected = Meetings::new(robots[0].clone());
            let mut met: Vec<usize> = order.clone();
            met.sort_unstable();
            met.dedup();
            for k in met {
                expected.meet(&robots[k]);
            }
            let mut a = Meetings::new(robots[0].clone());
            // The first b and c are always found.
            let origins = usize::from(order.contains(&1)) + usize::from(order.contains(&3));
            for k in order {
                a.meet(&robots[k]);
            }
            prop_assert!(a.snapshot().layers.len() >= origins);
            for fusion in [CellFusion::Dempster, CellFusion::Maximum, CellFusion::Minimum, CellFusion::Mean] {
                prop_assert_eq!(cells(&a.map(fusion)), cells(&expected.map(fusion)));
            }
        }
    }
}
