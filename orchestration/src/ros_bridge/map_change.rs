//! What has changed between two states of a map of one size: one rectangle. Pure.

use super::map_picture::MapPicture;
use flockslam_ros::messages::{Header, OccupancyGridUpdate};

/// The smallest rectangle in which two maps differ; `None` when they do not, or when they differ in size or place.
pub fn map_change(
    before: &MapPicture,
    after: &MapPicture,
    stamp_ns: i64,
    frame: &str,
) -> Option<OccupancyGridUpdate> {
    if !before.has_same_metadata(after) {
        return None;
    }
    let width = after.width();
    let (old, new) = (before.values(), after.values());
    let differs = |index: &usize| old[*index] != new[*index];
    let changed = (0..new.len()).filter(differs);
    let [left, right, bottom, top] = changed.fold([usize::MAX, 0, usize::MAX, 0], |found, index| {
        let (column, row) = (index % width, index / width);
        [found[0].min(column), found[1].max(column), found[2].min(row), found[3].max(row)]
    });
    if left > right {
        return None;
    }
    let data = (bottom..=top).flat_map(|row| new[row * width + left..=row * width + right].iter().copied());
    Some(OccupancyGridUpdate {
        header: Header::new(stamp_ns, frame),
        x: left as i32,
        y: bottom as i32,
        width: (right - left + 1) as u32,
        height: (top - bottom + 1) as u32,
        data: data.collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::map_picture::MapPainter;
    use super::*;
    use flockslam_evidence::{Cell, PackedCell, TILE_CELLS, TileKey};
    use flockslam_geometry::Pose;
    use flockslam_messages::TileMessage;
    use zerocopy::FromZeros;

    #[test]
    fn a_change_applied_to_the_map_before_gives_the_map_after() {
        let mut painter = MapPainter::new(0.05, 0.05);
        let mut paint = |occupied: &[usize]| {
            let mut tile = Box::new(TileMessage::new_zeroed());
            (tile.key, tile.cell_size_m) = (TileKey { x: 0, y: 0 }, 0.05);
            tile.tile.cells = [PackedCell::UNKNOWN; TILE_CELLS];
            occupied.iter().for_each(|cell| tile.tile.cells[*cell] = Cell::from_weights(8.0, 0.0).pack());
            painter.take(&tile);
            painter.paint(None, Pose::IDENTITY).unwrap()
        };
        let (before, after) = (paint(&[0]), paint(&[0, 3 + 64 * 2, 7 + 64 * 5]));
        assert_eq!(map_change(&before, &before, 0, "map"), None);
        let change = map_change(&before, &after, 7, "map").unwrap();
        assert_eq!((change.width, change.height), (5, 4));
        let mut patched = before.values();
        for (index, value) in change.data.iter().enumerate() {
            let (column, row) = (index % change.width as usize, index / change.width as usize);
            patched[(change.y as usize + row) * before.width() + change.x as usize + column] = *value;
        }
        assert_eq!(patched, after.values());
    }
}
