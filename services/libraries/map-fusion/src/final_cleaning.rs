//! Which cells of the finished map stand occupied although scans have looked through them since: what is known at the end, when
//! all scans have their final poses, and was not when they were taken.
//!
//! Scans are taken in from the last one back. The result of a scan for a cell counts only until a later one has seen it occupied, so the
//! first that does decides the cell, and no earlier scan is used for it.

use crate::FusedMap;
use crate::direction_set::DirectionSet;
use crate::rays::{BLOCK_SIDE, Rays};
use flockslam_evidence::{CellIndex, TILE_SIDE, TileKey, floor};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};
use flockslam_visibility::{Horizon, Margins, PassThrough, PolarRangeImage, Visibility};
use std::collections::BTreeMap;
use std::ops::Range;

/// Cells farther from the lidar are not classified, metres: beams are too far apart there.
const REACH_M: f64 = 12.0;
/// An object this near to a cell may be the one that was seen in it, cells.
const NEAR_CELLS: i32 = 2;
/// A beam passes a cell if it ends so far behind it, metres.
const PASSED_BEHIND_M: f64 = 0.3;
/// So many views through a cell, since it was last seen occupied, make it free …
pub const VIEWS: u8 = 3;
/// … or as many of beams through it alone, while none ends near, in so many scans that entered the map …
const SCANS: u8 = 2;
/// … or so many of them from anywhere, when something else stands near: then no wall gets a hole …
const PASSES: u8 = 2;
/// … each at least so long before the one after, nanoseconds.
pub const APART_NS: u64 = 300_000_000;
/// Scans that pass through more than this share of the classified cells have a wrong pose.
const CONTRADICTED_MAX: f64 = 0.2;
/// The share is that of every cell of so many.
const SAMPLED: usize = 4;
/// Blocks of cells along the side of a tile: those that a scan cannot see, nor cross, are passed over as wholes.
const BLOCKS_SIDE: usize = TILE_SIDE / BLOCK_SIDE as usize;
const BLOCKS: usize = BLOCKS_SIDE * BLOCKS_SIDE;
/// Final poses of scans are known this well among each other.
const MARGINS: Margins = Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.06, beside_rad: 0.005 };

/// The occupied cells of a map, and their judgements by one scan after the other, from the last one back.
///
/// Memory is bounded by the number of these cells; each scan costs as much as there are within its reach that are not settled.
#[derive(Debug)]
pub struct FinalCleaning {
    cell_size_m: f64,
    tiles: BTreeMap<TileKey, WatchedTile>,
    sight: PolarRangeImage,
    /// What the present scan cannot see.
    horizon: Horizon,
    /// Beams of the present scan, as far as they go where cells are not settled.
    rays: Rays,
    directions: DirectionSet,
    /// Blocks within its reach with cells that are not settled.
    open: Vec<(TileKey, usize)>,
    /// Its classification of these cells.
    sightings: Vec<Sighting>,
}

/// Classification of a cell by a scan.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    key: TileKey,
    place: usize,
    /// Whether a beam passes it; if so, whether all beams near do.
    passes: Option<bool>,
    /// A beam ends at it, and near it.
    is_met: bool,
    is_end_near: bool,
}

/// The occupied cells of a tile, block by block, and in each of these in the order of their offsets.
#[derive(Debug)]
struct WatchedTile {
    cells: Vec<Watched>,
    /// Where each block begins, and where the last one ends.
    starts: [u16; BLOCKS + 1],
    /// By block: so many of its cells are not settled.
    open: [u16; BLOCKS],
}

impl WatchedTile {
    fn new(cells: impl Iterator<Item = Watched>) -> Self {
        let mut cells: Vec<_> = cells.collect();
        cells.shrink_to_fit();
        cells.sort_by_key(|watched| (block(watched.offset), watched.offset));
        let before = |number: usize| cells.partition_point(|watched| block(watched.offset) < number) as u16;
        let starts: [u16; BLOCKS + 1] = std::array::from_fn(before);
        Self { starts, open: std::array::from_fn(|number| starts[number + 1] - starts[number]), cells }
    }

    /// The places of the cells of a block.
    fn of_block(&self, number: usize) -> Range<usize> {
        usize::from(self.starts[number])..usize::from(self.starts[number + 1])
    }
}

/// The number of the block that a cell of a tile is in.
fn block(offset: u16) -> usize {
    let side = BLOCK_SIDE as usize;
    usize::from(offset) / TILE_SIDE / side * BLOCKS_SIDE + usize::from(offset) % TILE_SIDE / side
}

/// An occupied cell, and how often it was looked through since it was last seen to stand.
#[derive(Clone, Copy, Debug)]
struct Watched {
    /// Its offset in its tile.
    offset: u16,
    /// By scans of which all beams near it passed too.
    views: u8,
    /// By any scans.
    passes: u8,
    /// By so many scans, however many views each of them counts as.
    scans: u8,
    /// Earlier scans add nothing to the views, and nothing to the passes.
    has_views: bool,
    has_passes: bool,
    /// When it was last counted.
    next_ns: i64,
}

impl Watched {
    fn new(offset: u16) -> Self {
        let (views, passes, scans, next_ns) = (0, 0, 0, i64::MIN);
        Self { offset, views, passes, scans, has_views: false, has_passes: false, next_ns }
    }

    fn is_free(&self) -> bool {
        self.views >= VIEWS || (self.passes >= VIEWS && self.scans >= SCANS)
    }

    /// Nothing that earlier scans say can change what becomes of it.
    fn is_decided(&self) -> bool {
        self.is_free() || (self.has_views && self.has_passes)
    }

    fn count(&mut self, now_ns: i64, is_clear: bool, views: u8) {
        if now_ns.abs_diff(self.next_ns) < APART_NS {
            return;
        }
        if !self.has_views {
            self.views = self.views.saturating_add(views * u8::from(is_clear));
        }
        if !self.has_passes {
            self.passes = self.passes.saturating_add(views);
            self.scans = self.scans.saturating_add(1);
        }
        self.next_ns = now_ns;
    }
}

impl FinalCleaning {
    /// Behind the last scan.
    pub fn new(map: &FusedMap) -> Self {
        let occupied = |cells: &[flockslam_evidence::Cell]| {
            let occupied = cells.iter().enumerate().filter(|(_, cell)| cell.occupied > cell.free);
            WatchedTile::new(occupied.map(|(offset, _)| Watched::new(offset as u16)))
        };
        let tiles = map.tiles().map(|(key, cells)| (key, occupied(&cells[..])));
        Self {
            cell_size_m: map.cell_size_m(),
            tiles: tiles.filter(|(_, tile)| !tile.cells.is_empty()).collect(),
            sight: PolarRangeImage::new(),
            horizon: Horizon::new(),
            rays: Rays::new(map.cell_size_m(), REACH_M, PASSED_BEHIND_M, NEAR_CELLS),
            directions: DirectionSet::new(),
            open: Vec::new(),
            sightings: Vec::new(),
        }
    }

    /// Takes in a scan at its final pose, which counts as so many views; each before those that were taken in.
    pub fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew, map_from_base: Pose, views: u8) {
        let map_from_laser = map_from_base * scan.header().base_from_laser;
        let at = map_from_laser.position();
        self.find_open(at);
        if self.open.is_empty() {
            return;
        }
        self.sight.look(scan, deskew);
        self.horizon.look(&self.sight, map_from_laser.heading_rad, self.cell_size_m);
        self.directions.clear();
        // A cell more than what is near an end, and half of one for its corners.
        let beside_m = f64::from(NEAR_CELLS + 2) * self.cell_size_m;
        for (key, number) in &self.open {
            let (low, high) = corners(*key, *number, self.cell_size_m, at);
            self.directions.add(low, high, beside_m);
        }
        self.rays.look(scan, deskew, map_from_base, at, &self.directions);
        self.classify_open_cells(map_from_laser);
        let counts = self.sightings.iter().any(|sighting| sighting.passes.is_some())
            && !self.is_contradicted(map_from_laser);
        let now_ns = scan.header().times.sensor_ns;
        for Sighting { key, place, passes, is_met, is_end_near } in self.sightings.drain(..) {
            let Some(tile) = self.tiles.get_mut(&key) else { continue };
            let watched = &mut tile.cells[place];
            if let Some(is_clear) = passes.filter(|_| counts) {
                watched.count(now_ns, is_clear, views);
            }
            watched.has_views |= is_met;
            watched.has_passes |= is_end_near;
            if watched.is_decided() {
                tile.open[block(watched.offset)] -= 1;
            }
        }
    }

    /// Finds the blocks within reach with cells that are not settled.
    fn find_open(&mut self, at: Point) {
        self.open.clear();
        for key in tiles_around(at, self.cell_size_m) {
            let Some(tile) = self.tiles.get(&key) else { continue };
            let open = (0..BLOCKS).filter(|number| tile.open[*number] > 0);
            self.open.extend(open.map(|number| (key, number)));
        }
    }

    /// Stores the classification of the undecided cells by the present scan.
    fn classify_open_cells(&mut self, map_from_laser: Pose) {
        let (at, size_m) = (map_from_laser.position(), self.cell_size_m);
        let view = PassThrough::new(&self.sight, map_from_laser, size_m, MARGINS).with_horizon(&self.horizon);
        for (key, number) in &self.open {
            let (low, high) = corners(*key, *number, size_m, at);
            let is_touched = self.rays.have_touched_block_of(key.cell(block_offset(*number)));
            if !is_touched && self.horizon.hides_all(low, high) {
                continue;
            }
            let tile = &self.tiles[key];
            for place in tile.of_block(*number).filter(|place| !tile.cells[*place].is_decided()) {
                let cell = key.cell(usize::from(tile.cells[place].offset));
                let center = center(cell, size_m);
                if center.distance_m(at) > REACH_M {
                    continue;
                }
                let (is_end_near, is_crossed) = self.rays.at(cell);
                let (passes, is_met) = match view.classify(center) {
                    Visibility::SeenThrough => (Some(true), false),
                    seen => (
                        (is_crossed && !is_end_near).then_some(false),
                        matches!(seen, Visibility::Supported | Visibility::Touched),
                    ),
                };
                if passes.is_some() || is_met || is_end_near {
                    self.sightings.push(Sighting { key: *key, place, passes, is_met, is_end_near });
                }
            }
        }
    }

    /// Whether the present scan passes through so much that its pose must be wrong.
    fn is_contradicted(&self, map_from_laser: Pose) -> bool {
        let (at, size_m) = (map_from_laser.position(), self.cell_size_m);
        let view = PassThrough::new(&self.sight, map_from_laser, size_m, MARGINS).with_horizon(&self.horizon);
        let (mut supported, mut seen_through) = (0, 0);
        for key in tiles_around(at, size_m) {
            let Some(tile) = self.tiles.get(&key) else { continue };
            for number in 0..BLOCKS {
                let places = tile.of_block(number);
                let (low, high) = corners(key, number, size_m, at);
                if places.is_empty() || self.horizon.hides_all(low, high) {
                    continue;
                }
                for place in places.filter(|place| place % SAMPLED == 0) {
                    let center = center(key.cell(usize::from(tile.cells[place].offset)), size_m);
                    if center.distance_m(at) > REACH_M {
                        continue;
                    }
                    match view.classify(center) {
                        Visibility::SeenThrough => seen_through += 1,
                        Visibility::Supported | Visibility::Touched => supported += 1,
                        Visibility::Passed | Visibility::Open => (),
                    }
                }
            }
        }
        f64::from(seen_through) > CONTRADICTED_MAX * f64::from(seen_through + supported)
    }

    /// The cells that are free, once all scans are taken in, in a fixed order: those that were seen through clearly, and those that were
    /// passed so often if something else stands near, so that no wall gets a hole.
    pub fn free(&self) -> Vec<CellIndex> {
        let is_free = |watched: &Watched, cell: CellIndex| {
            watched.is_free() || (watched.passes >= PASSES && self.something_stands_near(cell))
        };
        let free_of = |(key, tile): (&TileKey, &WatchedTile)| {
            let cells = tile.cells.iter().map(|watched| (watched, key.cell(usize::from(watched.offset))));
            cells.filter(|(watched, cell)| is_free(watched, *cell)).map(|(_, cell)| cell).collect::<Vec<_>>()
        };
        self.tiles.iter().flat_map(free_of).collect()
    }

    /// Whether another cell beside this one is not looked through.
    fn something_stands_near(&self, cell: CellIndex) -> bool {
        let around = -NEAR_CELLS..=NEAR_CELLS;
        around.clone().flat_map(|dy| around.clone().map(move |dx| (dx, dy))).any(|(dx, dy)| {
            let near = CellIndex::new(cell.x.saturating_add(dx), cell.y.saturating_add(dy));
            self.watched(near).is_some_and(|watched| watched.passes < PASSES)
        })
    }

    fn watched(&self, cell: CellIndex) -> Option<&Watched> {
        let tile = self.tiles.get(&cell.tile())?;
        let block = &tile.cells[tile.of_block(block(cell.offset() as u16))];
        let place = block.binary_search_by_key(&cell.offset(), |watched| usize::from(watched.offset));
        place.ok().map(|place| &block[place])
    }
}

/// The offset of the first cell of a block.
fn block_offset(number: usize) -> usize {
    (number / BLOCKS_SIDE * TILE_SIDE + number % BLOCKS_SIDE) * BLOCK_SIDE as usize
}

/// The tiles with cells within reach.
fn tiles_around(at: Point, cell_size_m: f64) -> impl Iterator<Item = TileKey> {
    let tile = move |metres: f64| floor(metres / (cell_size_m * TILE_SIDE as f64));
    let (left, right) = (tile(at.x_m - REACH_M), tile(at.x_m + REACH_M));
    let rows = tile(at.y_m - REACH_M)..=tile(at.y_m + REACH_M);
    rows.flat_map(move |y| (left..=right).map(move |x| TileKey { x, y }))
}

/// Corners of a block, as seen from `at`.
fn corners(key: TileKey, number: usize, cell_size_m: f64, at: Point) -> (Point, Point) {
    let first = key.cell(block_offset(number));
    let seen = |index: i32, at_m: f64| f64::from(index) * cell_size_m - at_m;
    let low = Point::new(seen(first.x, at.x_m), seen(first.y, at.y_m));
    let beyond = |index: i32| index.saturating_add(BLOCK_SIDE);
    (low, Point::new(seen(beyond(first.x), at.x_m), seen(beyond(first.y), at.y_m)))
}

fn center(cell: CellIndex, cell_size_m: f64) -> Point {
    let middle = |index: i32| (f64::from(index) + 0.5) * cell_size_m;
    Point::new(middle(cell.x), middle(cell.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, Submap, SubmapTile, TILE_CELLS};
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;

    const CELL_M: f64 = 0.05;
    /// The inner side of the walls around the room, cells from the middle.
    const WALL: i32 = 59;
    /// Its occupied cells: indices along x and y.
    const COLUMN: std::ops::Range<i32> = 24..28;

    fn is_column(cell: CellIndex) -> bool {
        COLUMN.contains(&cell.x) && COLUMN.contains(&cell.y)
    }

    /// A room of 6 × 6 m with a column in it.
    fn room() -> FusedMap {
        let tile = |(x, y): (i32, i32)| {
            let key = TileKey { x, y };
            let cell = |offset| {
                let cell = key.cell(offset);
                let far = [cell.x, cell.y].map(|index| index.max(-1 - index)).into_iter().max();
                match far.map_or(0, |far| far.cmp(&WALL) as i32) {
                    0 => PackedCell { occupied: 9000, free: 0 },
                    _ if is_column(cell) => PackedCell { occupied: 9000, free: 3000 },
                    -1 => PackedCell { occupied: 0, free: 5000 },
                    _ => PackedCell::UNKNOWN,
                }
            };
            SubmapTile::new(key, Box::new(std::array::from_fn::<_, TILE_CELLS, _>(cell)))
        };
        let submap = Submap {
            cell_size_m: CELL_M,
            tiles: [(-1, -1), (0, -1), (-1, 0), (0, 0)].map(tile).into_iter().collect(),
            ..Submap::default()
        };
        let mut map = FusedMap::new(CELL_M);
        map.add(&submap, Pose::IDENTITY).unwrap();
        map
    }

    /// Distance to the walls, and to the column if it is there, from `pose` in each of 360 directions.
    fn scan(number: i64, pose: Pose, column: bool) -> ScanBuffer {
        let solid = |x: f64, y: f64| {
            let index = |metres: f64| floor(metres / CELL_M);
            let cell = CellIndex::new(index(x), index(y));
            x.abs().max(y.abs()) >= f64::from(WALL) * CELL_M || (column && is_column(cell))
        };
        let range = |beam: i32| {
            let (sin, cos) = (pose.heading_rad + f64::from(beam).to_radians()).sin_cos();
            let ahead = |step: i32| 0.005 * f64::from(step);
            let hit =
                (0..2000).find(|step| solid(pose.x_m + ahead(*step) * cos, pose.y_m + ahead(*step) * sin));
            ahead(hit.unwrap()) as f32
        };
        let mut scan =
            ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians());
        scan.header.times.sensor_ns = number * 400_000_000;
        scan
    }

    fn pose(number: i64) -> Pose {
        Pose::new(0.1 * number as f64 - 0.6, -0.7, 0.3 * number as f64)
    }

    fn look(final_cleaning: &mut FinalCleaning, number: i64, column: bool, displaced: Pose) {
        let scan = scan(number, pose(number), column);
        let view = scan.view().unwrap();
        final_cleaning.look(view, &Deskew::new(view, Twist::default()), displaced * pose(number), 1);
    }

    #[test]
    fn what_scans_have_looked_through_since_is_free_and_the_walls_stand() {
        let map = room();
        let mut final_cleaning = FinalCleaning::new(&map);
        (6..8).rev().for_each(|number| look(&mut final_cleaning, number, false, Pose::IDENTITY));
        assert_eq!(final_cleaning.free(), [], "two views are too few");
        look(&mut final_cleaning, 5, false, Pose::IDENTITY);
        (0..5).rev().for_each(|number| look(&mut final_cleaning, number, true, Pose::IDENTITY));
        let column = COLUMN.flat_map(|y| COLUMN.map(move |x| CellIndex::new(x, y)));
        let mut free = final_cleaning.free();
        free.sort_by_key(|cell| (cell.y, cell.x));
        assert_eq!(free, column.collect::<Vec<_>>());
        // It is back at the end.
        let mut back = FinalCleaning::new(&map);
        (0..9).rev().for_each(|number| look(&mut back, number, number < 5 || number == 8, Pose::IDENTITY));
        assert!(back.free().len() < 12, "what is seen again stands: {:?}", back.free());
    }

    #[test]
    fn decided_cells_are_not_classified_again() {
        let mut final_cleaning = FinalCleaning::new(&room());
        let open = |cleaning: &FinalCleaning| -> u32 {
            cleaning.tiles.values().flat_map(|tile| tile.open).map(u32::from).sum()
        };
        let (all, undecided) = (open(&final_cleaning), |cleaning: &FinalCleaning| {
            let cells = cleaning.tiles.values().flat_map(|tile| &tile.cells);
            cells.filter(|watched| !watched.is_decided()).count() as u32
        });
        assert_eq!(all, undecided(&final_cleaning));
        (0..8).rev().for_each(|number| look(&mut final_cleaning, number, number < 5, Pose::IDENTITY));
        assert_eq!(open(&final_cleaning), undecided(&final_cleaning));
        assert!(open(&final_cleaning) < all / 20, "{} of {all}", open(&final_cleaning));
    }

    #[test]
    fn scans_in_the_wrong_place_and_scans_at_one_time_free_nothing() {
        let map = room();
        let mut displaced = FinalCleaning::new(&map);
        (0..9).rev().for_each(|number| look(&mut displaced, number, false, Pose::new(0.5, 0.5, 0.0)));
        assert_eq!(displaced.free(), []);
        let mut at_once = FinalCleaning::new(&map);
        (0..9).for_each(|_| look(&mut at_once, 4, false, Pose::IDENTITY));
        assert_eq!(at_once.free(), []);
    }
}
