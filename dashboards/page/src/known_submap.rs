//! The map that a set localizes in, as a submap among those of its own.

use flockslam_evidence::{Cell, CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey};
use flockslam_geometry::Pose;
use flockslam_results::{KNOWN_MAP, MapReader};
use std::collections::BTreeMap;
use std::path::Path;

/// Its number: no submap of a set has it.
pub const KNOWN: u32 = u32::MAX;

/// The known map in the results of a set, in the lattice of cells of this size; `None` when it does not localize.
pub fn known_submap(results: &Path, cell_size_m: f64) -> Option<Submap> {
    let reader = MapReader::open_file(results.join(KNOWN_MAP)).ok()?;
    let shape = reader.shape();
    let mut tiles: BTreeMap<TileKey, Box<[PackedCell; TILE_CELLS]>> = BTreeMap::new();
    // Each cell of the map goes where its middle is.
    let lattice = |origin_m: f64, cell: usize| {
        ((origin_m + (cell as f64 + 0.5) * shape.cell_size_m) / cell_size_m).floor() as i32
    };
    let mut row = 0;
    let read = reader.for_each_row(|cells| {
        let y = lattice(shape.origin.y_m, row);
        for (column, cell) in cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown()) {
            put(&mut tiles, lattice(shape.origin.x_m, column), y, *cell);
        }
        row += 1;
    });
    if let Err(error) = read {
        tracing::warn!(%error, "the known map is not in the picture");
        return None;
    }
    let tiles = tiles.into_iter().map(|(key, cells)| SubmapTile::new(key, cells)).collect();
    Some(Submap {
        number: KNOWN,
        insertions: 1,
        odom_from_submap: Pose::IDENTITY,
        cell_size_m,
        tiles,
        ..Submap::default()
    })
}

fn put(tiles: &mut BTreeMap<TileKey, Box<[PackedCell; TILE_CELLS]>>, x: i32, y: i32, cell: Cell) {
    let index = CellIndex::new(x, y);
    let cells = tiles.entry(index.tile()).or_insert_with(|| Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
    let offset = index.offset();
    // Of several in one what is occupied counts.
    if cell.occupied >= u32::from(cells[offset].occupied) {
        cells[offset] = cell.pack();
    }
}
