//! The map as the graph gets it: closed submaps where the solution has them, and around them the grid that is being built. Pure.

use crate::outputs::{CellState, OccupancyImage};
use flockslam_evidence::{Cell, PackedCell, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_geometry::{Point, Pose};
use flockslam_map_fusion::FusedMap;
use flockslam_messages::TileMessage;
use flockslam_ros::messages::{Header, MapMetaData, OccupancyGrid, Pose as RosPose, Time};
use std::collections::BTreeMap;

/// Edges of the map move outwards in steps of this, metres: a map of another size makes nav2 clear its costmap.
const STEP_M: f64 = 6.4;
/// So much unknown lies around what is known, metres.
const MARGIN_M: f64 = 2.0;
/// Cells of a map at most: beyond, only the tiles around the robot are in it.
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
    cell_size_m: f64,
    bounds: Bounds,
    cells: Vec<CellState>,
}

/// Puts maps together, whose edges never move inwards.
#[derive(Debug)]
pub struct MapPainter {
    cell_size_m: f64,
    bounds: Option<Bounds>,
    /// The grid that is being built, in the frame of odometry.
    live: BTreeMap<TileKey, Box<[CellState; TILE_CELLS]>>,
}

impl MapPainter {
    /// Of maps with cells of this side, metres.
    pub fn new(cell_size_m: f64) -> Self {
        Self { cell_size_m, bounds: None, live: BTreeMap::new() }
    }

    /// Takes a tile of the grid that is being built, or that it has left the grid.
    pub fn take(&mut self, tile: &TileMessage) {
        if tile.retired == 1 {
            self.live.remove(&tile.key);
            return;
        }
        let states = self.live.entry(tile.key).or_insert_with(|| Box::new([CellState::Unknown; TILE_CELLS]));
        for (state, cell) in states.iter_mut().zip(&tile.tile.cells) {
            *state = live_state(*cell);
        }
    }

    /// Forgets everything: another map begins.
    pub fn clear(&mut self) {
        (self.bounds, self.live) = (None, BTreeMap::new());
    }

    /// The map now; `None` while nothing is known.
    pub fn paint(&mut self, fused: Option<&FusedMap>, map_from_odom: Pose) -> Option<MapPicture> {
        let mut known: BTreeMap<[i64; 2], CellState> = BTreeMap::new();
        // What the grid knows beyond the closed submaps comes first, so that these count where both know something.
        for (key, states) in &self.live {
            for (offset, state) in states.iter().enumerate().filter(|(_, state)| **state != CellState::Unknown) {
                let cell = self.moved(*key, offset, map_from_odom);
                let before = known.entry(cell).or_insert(*state);
                if *state == CellState::Occupied {
                    *before = *state;
                }
            }
        }
        let tiles: Vec<_> = fused.map(|map| map.tiles().collect()).unwrap_or_default();
        let mut extent = known.keys().fold(None, |extent, cell| Some(widened(extent, *cell)));
        for (key, cells) in &tiles {
            for (offset, _) in cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown()) {
                extent = Some(widened(extent, cell_of(*key, offset)));
            }
        }
        let bounds = self.grown(extent?);
        let mut picture = MapPicture {
            cell_size_m: self.cell_size_m,
            bounds,
            cells: vec![CellState::Unknown; bounds.width() * bounds.height()],
        };
        known.into_iter().for_each(|(cell, state)| picture.set(cell, state));
        for (key, cells) in &tiles {
            for (offset, cell) in cells.iter().enumerate() {
                let state = CellState::of(cell);
                if state != CellState::Unknown {
                    picture.set(cell_of(*key, offset), state);
                }
            }
        }
        Some(picture)
    }

    /// The cell of the map in which the middle of a cell of the grid lies.
    fn moved(&self, key: TileKey, offset: usize, map_from_odom: Pose) -> [i64; 2] {
        let middle = |index: i64| (index as f64 + 0.5) * self.cell_size_m;
        let [x, y] = cell_of(key, offset);
        let at = map_from_odom.apply(Point::new(middle(x), middle(y)));
        [at.x_m, at.y_m].map(|metres| (metres / self.cell_size_m).floor() as i64)
    }

    /// The bounds of the map when it has to show this much.
    fn grown(&mut self, known: Bounds) -> Bounds {
        let cells = |metres: f64| ((metres / self.cell_size_m).round() as i64).max(1);
        let (step, margin) = (cells(STEP_M), cells(MARGIN_M));
        let mut bounds = self.bounds.unwrap_or(Bounds {
            low: known.low.map(|low| (low - margin).div_euclid(step) * step),
            high: known.high.map(|high| -(-(high + margin)).div_euclid(step) * step),
        });
        for axis in 0..2 {
            while bounds.low[axis] > known.low[axis] - margin {
                bounds.low[axis] -= step;
            }
            while bounds.high[axis] < known.high[axis] + margin {
                bounds.high[axis] += step;
            }
            let beyond = bounds.high[axis] - bounds.low[axis] - SIDE_CELLS_MAX;
            if beyond > 0 {
                bounds.high[axis] -= beyond;
            }
        }
        *self.bounds.insert(bounds)
    }
}

impl MapPicture {
    fn set(&mut self, cell: [i64; 2], state: CellState) {
        let [x, y] = [0, 1].map(|axis| cell[axis] - self.bounds.low[axis]);
        let inside = (0..self.bounds.width() as i64).contains(&x) && (0..self.bounds.height() as i64).contains(&y);
        if inside {
            self.cells[y as usize * self.bounds.width() + x as usize] = state;
        }
    }

    fn origin(&self) -> Point {
        let [x_m, y_m] = self.bounds.low.map(|index| index as f64 * self.cell_size_m);
        Point::new(x_m, y_m)
    }

    /// As a message.
    pub fn message(&self, stamp_ns: i64, frame: &str) -> OccupancyGrid {
        let value = |state: &CellState| match state {
            CellState::Unknown => -1,
            CellState::Free => 0,
            CellState::Occupied => 100,
        };
        OccupancyGrid {
            header: Header::new(stamp_ns, frame),
            info: MapMetaData {
                map_load_time: Time::from_ns(stamp_ns),
                resolution: self.cell_size_m as f32,
                width: self.bounds.width() as u32,
                height: self.bounds.height() as u32,
                origin: RosPose::planar(self.origin().x_m, self.origin().y_m, 0.0),
            },
            data: self.cells.iter().map(value).collect(),
        }
    }

    /// As it is written into files.
    pub fn image(&self) -> OccupancyImage {
        let (width, height) = (self.bounds.width(), self.bounds.height());
        OccupancyImage::new(width, height, self.cell_size_m, self.origin(), self.cells.clone())
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

fn widened(bounds: Option<Bounds>, cell: [i64; 2]) -> Bounds {
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
        let mut painter = MapPainter::new(0.05);
        assert_eq!(painter.paint(None, Pose::IDENTITY), None);
        painter.take(&tile(0, 0, &[(0, occupied()), (1, free())]));
        let map = painter.paint(None, Pose::IDENTITY).unwrap().message(7_000_000_000, "map");
        assert_eq!((map.info.width, map.info.height, map.header.stamp.sec), (256, 256, 7));
        assert!((map.info.origin.position.x + 6.4).abs() < 1e-9);
        let at = |map: &OccupancyGrid, x: usize, y: usize| map.data[(y + 128) * map.info.width as usize + x + 128];
        assert_eq!([at(&map, 0, 0), at(&map, 1, 0), at(&map, 2, 0)], [100, 0, -1]);
        // Not even two metres beyond the edge.
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
    fn the_grid_lies_where_the_correction_has_it() {
        let mut painter = MapPainter::new(0.05);
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
    fn the_message_and_the_picture_are_the_same_map() {
        let mut painter = MapPainter::new(0.05);
        painter.take(&tile(0, 0, &[(0, occupied()), (70, free())]));
        let map = painter.paint(None, Pose::IDENTITY).unwrap();
        let (message, image) = (map.message(0, "map"), map.image());
        assert_eq!((image.width(), image.height()), (message.info.width as usize, message.info.height as usize));
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
