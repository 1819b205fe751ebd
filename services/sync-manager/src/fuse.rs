use crate::PlacedSubmap;
use flockslam_evidence::{CellIndex, FusedMap, Submap};
use flockslam_geometry::Point;
use flockslam_stage::results::StoredMap;
use flockslam_stage::{StageError, SubmapStore};

/// The fused map of a layout: the sum over the stored submaps at their poses, on the rectangle that has evidence.
///
/// # Errors
/// When a submap cannot be read, or lies absurdly far from the others.
pub fn fuse(store: &SubmapStore, layout: &[PlacedSubmap]) -> Result<StoredMap, StageError> {
    let mut fused: Option<FusedMap> = None;
    // The last scans may carry the number of a submap that nothing was inserted in.
    for placed in layout.iter().filter(|placed| placed.number < store.count()) {
        let submap: Submap = store.load(placed.number)?;
        let map = fused.get_or_insert_with(|| FusedMap::new(submap.cell_size_m));
        let map_from_submap = placed.map_from_odom * submap.odom_from_submap;
        map.add(&submap, map_from_submap).map_err(|far| StageError::file("the fused map", far))?;
    }
    Ok(fused.map_or_else(empty, |map| crop(&map)))
}

fn empty() -> StoredMap {
    StoredMap { width: 0, height: 0, cell_size_m: 1.0, origin: Point::default(), cells: Vec::new() }
}

fn crop(map: &FusedMap) -> StoredMap {
    let Some((low, high)) = map.bounds() else { return empty() };
    let cell_size_m = map.cell_size_m();
    let (width, height) = ((high.x - low.x + 1) as usize, (high.y - low.y + 1) as usize);
    let rows = (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| CellIndex::new(x, y)));
    StoredMap {
        width,
        height,
        cell_size_m,
        origin: Point::new(f64::from(low.x) * cell_size_m, f64::from(low.y) * cell_size_m),
        cells: rows.map(|index| map.cell(index)).collect(),
    }
}
