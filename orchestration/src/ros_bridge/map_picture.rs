//! The map as the graph gets it: closed submaps where the solution has them, and around them the grid that is being built. Pure.

use crate::outputs::{CellState, OccupancyImage};
use flockslam_evidence::{Cell, PackedCell, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_map_fusion::FusedMap;
use flockslam_messages::TileMessage;
use flockslam_ros::messages::{Header, MapMetaData, OccupancyGrid, Pose as RosPose, Time};
use std::collections::BTreeMap;

/// Edges of the map move outwards in steps of this, metres: a map of another size makes nav2 clear its costmap.
const STEP_M: f64 = 6.4;
/// Margin of unknown cells around the map, metres.
const MARGIN_M: f64 = 2.0;
/// Cells along a side of a map at most; what is beyond is not in it.
const SIDE_CELLS_MAX: i64 = 16_384;

/// Cells from a lower left corner on, in the lattice of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bounds {
    low: [i64; 2],
    /// The first cell that is not inside.
    high: [i64; 2],
}

/// The map as a rectangle of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct MapPicture {
    resolution_m: f64,
    bounds: Bounds,
    cells: Vec<CellState>,
}

/// Puts maps together, whose edges never move inwards.
#[derive(Debug)]
pub struct MapPainter {
    /// Side of a cell of the map, metres.
    resolution_m: f64,
    /// Side of a cell of what it is made of, metres.
    cell_size_m: f64,
    bounds: Option<Bounds>,
    /// The grid that is being built, in the frame of odometry.
    live: BTreeMap<TileKey, LiveTile>,
}

#[derive(Debug)]
struct LiveTile {
    states: Box<[CellState; TILE_CELLS]>,
    known: KnownBox,
}

/// A pose whose turn is worked out once for many points.
#[derive(Clone, Copy, Debug)]
struct Placed {
    x_m: f64,
    y_m: f64,
    cos: f64,
    sin: f64,
}

impl From<Pose> for Placed {
    fn from(pose: Pose) -> Self {
        let (sin, cos) = sin_cos(pose.heading_rad);
        Self { x_m: pose.x_m, y_m: pose.y_m, cos, sin }
    }
}

/// First and last column, first and last row with a known cell; in a tile, or `None` in one without.
type KnownBox = Option<[usize; 4]>;

/// A tile of closed submaps.
type FusedTile = (TileKey, Box<[Cell; TILE_CELLS]>);

impl MapPainter {
    /// Of maps with cells of `resolution_m`, made of cells of `cell_size_m`.
    pub fn new(resolution_m: f64, cell_size_m: f64) -> Self {
        Self { resolution_m, cell_size_m, bounds: None, live: BTreeMap::new() }
    }

    /// Takes a tile of the grid that is being built, or that it has left the grid.
    pub fn take(&mut self, tile: &TileMessage) {
        if tile.retired == 1 {
            self.live.remove(&tile.key);
            return;
        }
        let fresh = || LiveTile { states: Box::new([CellState::Unknown; TILE_CELLS]), known: None };
        let live = self.live.entry(tile.key).or_insert_with(fresh);
        for (state, cell) in live.states.iter_mut().zip(&tile.tile.cells) {
            *state = live_state(*cell);
        }
        live.known = known_box(|offset| live.states[offset] != CellState::Unknown);
    }

    /// Clears everything: another map begins.
    pub fn clear(&mut self) {
        (self.bounds, self.live) = (None, BTreeMap::new());
    }

    /// The map now; `None` while nothing is known.
    pub fn paint(&mut self, fused: Option<&FusedMap>, map_from_odom: Pose) -> Option<MapPicture> {
        let (map_from_odom, map) = (Placed::from(map_from_odom), Placed::from(Pose::IDENTITY));
        let tiles: Vec<FusedTile> = fused.map(|map| map.tiles().collect()).unwrap_or_default();
        let live_boxes = self.live.iter().map(|(key, tile)| (*key, tile.known, map_from_odom));
        let fused_boxes = tiles.iter().map(|(key, cells)| {
            (*key, known_box(|offset| CellState::of(&cells[offset]) != CellState::Unknown), map)
        });
        let mut extent = None;
        for (key, known, pose) in live_boxes.chain(fused_boxes) {
            let Some([left, right, bottom, top]) = known else { continue };
            for (column, row) in [(left, bottom), (right, bottom), (left, top), (right, top)] {
                let cell = self.cell_at(key, row * TILE_SIDE + column, [0.5, 0.5], pose);
                extent = Some(extended(extent, cell));
            }
        }
        let bounds = self.grown(extent?);
        let mut picture = MapPicture::empty(self.resolution_m, bounds);
        // Closed submaps count where both know something: they lie where the solution has them.
        let mut closed = MapPicture::empty(self.resolution_m, bounds);
        let fine = (self.cell_size_m / self.resolution_m).ceil() as usize;
        for (key, cells) in &tiles {
            self.draw(&mut closed, *key, fine, map, |offset| CellState::of(&cells[offset]));
        }
        for (key, tile) in &self.live {
            // Turned cells would leave holes.
            self.draw(&mut picture, *key, 2 * fine, map_from_odom, |offset| tile.states[offset]);
        }
        for (cell, closed) in picture.cells.iter_mut().zip(closed.cells) {
            if closed != CellState::Unknown {
                *cell = closed;
            }
        }
        Some(picture)
    }

    /// Draws the known cells of a tile, each by so many points along each axis. What is occupied counts before what is free.
    fn draw(
        &self,
        picture: &mut MapPicture,
        key: TileKey,
        points: usize,
        pose: Placed,
        state_at: impl Fn(usize) -> CellState,
    ) {
        let middle = |index: usize| (index as f64 + 0.5) / points as f64;
        for offset in 0..TILE_CELLS {
            let state = state_at(offset);
            if state == CellState::Unknown {
                continue;
            }
            for point in 0..points * points {
                let within = [middle(point % points), middle(point / points)];
                picture.draw(self.cell_at(key, offset, within, pose), state);
            }
        }
    }

    /// The cell of the map in which a point of a cell is: `within` is its place in that cell, 0 … 1.
    fn cell_at(&self, key: TileKey, offset: usize, within: [f64; 2], pose: Placed) -> [i64; 2] {
        let [x, y] = cell_of(key, offset);
        let place = |index: i64, within: f64| (index as f64 + within) * self.cell_size_m;
        let (x_m, y_m) = (place(x, within[0]), place(y, within[1]));
        let at = [pose.x_m + pose.cos * x_m - pose.sin * y_m, pose.y_m + pose.sin * x_m + pose.cos * y_m];
        at.map(|metres| (metres / self.resolution_m).floor() as i64)
    }

    /// The bounds of the map when it has to show this much.
    fn grown(&mut self, known: Bounds) -> Bounds {
        let cells = |metres: f64| ((metres / self.resolution_m).round() as i64).max(1);
        let (step, margin) = (cells(STEP_M), cells(MARGIN_M));
        let down = |low: i64| (low - margin).div_euclid(step) * step;
        let up = |high: i64| -(-(high + margin)).div_euclid(step) * step;
        let fresh = Bounds { low: known.low.map(down), high: known.high.map(up) };
        let before = self.bounds.unwrap_or(fresh);
        let mut bounds = Bounds {
            low: [0, 1].map(|axis| before.low[axis].min(fresh.low[axis])),
            high: [0, 1].map(|axis| before.high[axis].max(fresh.high[axis])),
        };
        for axis in 0..2 {
            bounds.high[axis] = bounds.high[axis].min(bounds.low[axis] + SIDE_CELLS_MAX);
        }
        *self.bounds.insert(bounds)
    }
}

impl MapPicture {
    fn empty(resolution_m: f64, bounds: Bounds) -> Self {
        Self { resolution_m, bounds, cells: vec![CellState::Unknown; bounds.width() * bounds.height()] }
    }

    fn draw(&mut self, cell: [i64; 2], state: CellState) {
        let [x, y] = [0, 1].map(|axis| cell[axis] - self.bounds.low[axis]);
        let width = self.bounds.width() as i64;
        if (0..width).contains(&x) && (0..self.bounds.height() as i64).contains(&y) {
            let present = &mut self.cells[(y * width + x) as usize];
            if *present != CellState::Occupied {
                *present = state;
            }
        }
    }

    fn origin(&self) -> Point {
        let [x_m, y_m] = self.bounds.low.map(|index| index as f64 * self.resolution_m);
        Point::new(x_m, y_m)
    }

    /// Whether another map has the same size and place.
    pub fn has_same_metadata(&self, other: &Self) -> bool {
        (self.bounds, self.resolution_m) == (other.bounds, other.resolution_m)
    }

    /// Cells along x.
    pub fn width(&self) -> usize {
        self.bounds.width()
    }

    /// Cells row by row from below: −1 unknown, 0 free, 100 occupied.
    pub fn values(&self) -> Vec<i8> {
        let value = |state: &CellState| match state {
            CellState::Unknown => -1,
            CellState::Free => 0,
            CellState::Occupied => 100,
        };
        self.cells.iter().map(value).collect()
    }

    /// As a message.
    pub fn message(&self, stamp_ns: i64, frame: &str) -> OccupancyGrid {
        OccupancyGrid {
            header: Header::new(stamp_ns, frame),
            info: MapMetaData {
                map_load_time: Time::from_ns(stamp_ns),
                resolution: self.resolution_m as f32,
                width: self.bounds.width() as u32,
                height: self.bounds.height() as u32,
                origin: RosPose::planar(self.origin().x_m, self.origin().y_m, 0.0),
            },
            data: self.values(),
        }
    }

    /// As it is written into files.
    pub fn image(&self) -> OccupancyImage {
        let (width, height) = (self.bounds.width(), self.bounds.height());
        OccupancyImage::new(width, height, self.resolution_m, self.origin(), self.cells.clone())
    }
}

impl Bounds {
    fn width(&self) -> usize {
        (self.high[0] - self.low[0]) as usize
    }

    fn height(&self) -> usize {
        (self.high[1] - self.low[1]) as usize
    }
}

fn extended(bounds: Option<Bounds>, cell: [i64; 2]) -> Bounds {
    let bounds = bounds.unwrap_or(Bounds { low: cell, high: cell.map(|index| index + 1) });
    Bounds {
        low: [0, 1].map(|axis| bounds.low[axis].min(cell[axis])),
        high: [0, 1].map(|axis| bounds.high[axis].max(cell[axis] + 1)),
    }
}

fn cell_of(key: TileKey, offset: usize) -> [i64; 2] {
    let side = TILE_SIDE as i64;
    let (row, column) = ((offset / TILE_SIDE) as i64, (offset % TILE_SIDE) as i64);
    [i64::from(key.x) * side + column, i64::from(key.y) * side + row]
}

fn known_box(is_known: impl Fn(usize) -> bool) -> KnownBox {
    let mut found: KnownBox = None;
    for offset in (0..TILE_CELLS).filter(|offset| is_known(*offset)) {
        let (column, row) = (offset % TILE_SIDE, offset / TILE_SIDE);
        let [left, right, bottom, top] = found.unwrap_or([column, column, row, row]);
        found = Some([left.min(column), right.max(column), bottom.min(row), top.max(row)]);
    }
    found
}

fn live_state(cell: PackedCell) -> CellState {
    CellState::of(&Cell { occupied: u32::from(cell.occupied), free: u32::from(cell.free) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use zerocopy::FromZeros;

    fn tile(x: i32, y: i32, cells: &[(usize, PackedCell)]) -> Box<TileMessage> {
        let mut message = Box::new(TileMessage::new_zeroed());
        (message.key, message.cell_size_m) = (TileKey { x, y }, 0.05);
        message.tile.cells = [PackedCell::UNKNOWN; TILE_CELLS];
        for (offset, cell) in cells {
            message.tile.cells[*offset] = *cell;
        }
        message
    }

    fn occupied() -> PackedCell {
        Cell::from_weights(8.0, 0.0).pack()
    }

    fn free() -> PackedCell {
        Cell::from_weights(0.0, 8.0).pack()
    }

    #[test]
    fn a_map_has_margins_and_its_edges_move_outwards_in_steps() {
        let mut painter = MapPainter::new(0.05, 0.05);
        assert_eq!(painter.paint(None, Pose::IDENTITY), None);
        painter.take(&tile(0, 0, &[(0, occupied()), (1, free())]));
        let map = painter.paint(None, Pose::IDENTITY).unwrap().message(7_000_000_000, "map");
        assert_eq!((map.info.width, map.info.height, map.header.stamp.sec), (256, 256, 7));
        assert!((map.info.origin.position.x + 6.4).abs() < 1e-9);
        let at =
            |map: &OccupancyGrid, x: usize, y: usize| map.data[(y + 128) * map.info.width as usize + x + 128];
        assert_eq!([at(&map, 0, 0), at(&map, 1, 0), at(&map, 2, 0)], [100, 0, -1]);
        // Less than two metres remain to the edge.
        painter.take(&tile(1, 0, &[(30, free())]));
        let wider = painter.paint(None, Pose::IDENTITY).unwrap().message(0, "map");
        assert_eq!((wider.info.width, wider.info.height), (384, 256));
        let mut gone = tile(1, 0, &[]);
        gone.retired = 1;
        painter.take(&gone);
        assert_eq!(painter.paint(None, Pose::IDENTITY).unwrap().message(0, "map").info.width, 384);
        painter.clear();
        assert_eq!(painter.paint(None, Pose::IDENTITY), None);
    }

    #[test]
    fn the_grid_is_at_the_corrected_pose() {
        let mut painter = MapPainter::new(0.05, 0.05);
        painter.take(&tile(0, 0, &[(0, occupied())]));
        let moved = Pose::new(1.0, 0.0, std::f64::consts::FRAC_PI_2);
        let map = painter.paint(None, moved).unwrap();
        let message = map.message(0, "map");
        let found = message.data.iter().position(|value| *value == 100).unwrap();
        let [column, row] = [found % message.info.width as usize, found / message.info.width as usize];
        // The middle of the cell, 2.5 cm and 2.5 cm, is turned to 97.5 cm and 2.5 cm.
        assert_eq!([column as i64 + map.bounds.low[0], row as i64 + map.bounds.low[1]], [19, 0]);
    }

    #[test]
    fn cells_of_another_size_leave_no_holes_and_no_wall_out() {
        let all_free: Vec<_> = (0..TILE_CELLS).map(|offset| (offset, free())).collect();
        for column in 0..TILE_SIDE {
            let wall = (0..TILE_SIDE).map(|row| (row * TILE_SIDE + column, occupied()));
            let cells: Vec<_> = all_free.iter().copied().chain(wall).collect();
            for (resolution_m, heading_rad) in [(0.05, 0.0), (0.05, 0.7), (0.1, 0.3), (0.03, 0.7)] {
                let mut painter = MapPainter::new(resolution_m, 0.045);
                painter.take(&tile(0, 0, &cells));
                let map = painter.paint(None, Pose::new(0.0, 0.0, heading_rad)).unwrap();
                let at = |along_m: f64, across_m: f64| {
                    let (sin, cos) = heading_rad.sin_cos();
                    let place = [cos * along_m - sin * across_m, sin * along_m + cos * across_m];
                    let [x, y] =
                        [0, 1].map(|axis| (place[axis] / resolution_m).floor() as i64 - map.bounds.low[axis]);
                    map.cells[y as usize * map.bounds.width() + x as usize]
                };
                let inside =
                    (1..63).flat_map(|x| (1..63).map(move |y| (0.045 * f64::from(x), 0.045 * f64::from(y))));
                assert!(inside.clone().all(|(x_m, y_m)| at(x_m, y_m) != CellState::Unknown));
                let wall_m = 0.045 * (column as f64 + 0.5);
                assert!((1..63).all(|row| at(wall_m, 0.045 * f64::from(row)) == CellState::Occupied));
            }
        }
    }

    #[test]
    fn the_message_and_the_picture_are_the_same_map() {
        let mut painter = MapPainter::new(0.05, 0.05);
        painter.take(&tile(0, 0, &[(0, occupied()), (70, free())]));
        let map = painter.paint(None, Pose::IDENTITY).unwrap();
        let (message, image) = (map.message(0, "map"), map.image());
        assert_eq!(
            (image.width(), image.height()),
            (message.info.width as usize, message.info.height as usize)
        );
        let values = (0..image.height()).flat_map(|y| image.row(y).collect::<Vec<_>>());
        for (value, state) in message.data.iter().zip(values) {
            let expected = match value {
                100 => CellState::Occupied,
                0 => CellState::Free,
                _ => CellState::Unknown,
            };
            assert_eq!(state, expected);
        }
    }
}
