//! Where a map shows scattered returns and no surface: beams have met the ground or grass there, now here, now there.

/// An occupied patch of at most this area is a scattered return, if it is one of many, m²: a cell or two.
const PATCH_MAX_M2: f64 = 0.01;
/// Patches are counted in squares of this side, metres …
const SQUARE_M: f64 = 2.0;
/// … and there are many in a square where the squares around it, it among them, have at least so many of them, …
const PATCHES_MIN: u32 = 12;
/// … and it has one itself, or this many of the squares around it do.
const NEIGHBOURS_MIN: u32 = 4;

/// What a cell of a grid is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mark {
    /// Nothing that matters here.
    Empty,
    /// Occupied; the patch that it belongs to was not looked at yet.
    Occupied,
    /// Of a surface.
    Surface,
    /// Of a small patch of occupied cells.
    Patch,
    /// In a square of many patches, and of no surface there.
    AmongMany,
}

impl Mark {
    /// Beams end there, or pass, at random.
    pub(crate) fn is_scattered(self) -> bool {
        matches!(self, Self::Patch | Self::AmongMany)
    }
}

/// Finds what is scattered among the occupied cells of a grid, which are given row by row.
pub(crate) fn scattered_returns(
    is_occupied: impl Iterator<Item = bool>,
    width: usize,
    cell_size_m: f64,
) -> Vec<Mark> {
    let width = width.max(1);
    let mark = |is_occupied| if is_occupied { Mark::Occupied } else { Mark::Empty };
    let mut marks: Vec<Mark> = is_occupied.map(mark).collect();
    let height = marks.len() / width;
    let patch_max = (PATCH_MAX_M2 / (cell_size_m * cell_size_m)).round().max(1.0) as usize;
    let side = (SQUARE_M / cell_size_m).round().max(1.0) as usize;
    let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
    let mut patches = vec![0u32; columns * rows];
    let mut patch = Vec::new();
    for first in 0..marks.len() {
        if marks[first] != Mark::Occupied {
            continue;
        }
        patch.clear();
        patch.push(first);
        marks[first] = Mark::Patch;
        let mut next = 0;
        while next < patch.len() {
            let (x, y) = (patch[next] % width, patch[next] / width);
            next += 1;
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    let cell = y * width + x;
                    if marks[cell] == Mark::Occupied {
                        marks[cell] = Mark::Patch;
                        patch.push(cell);
                    }
                }
            }
        }
        if patch.len() <= patch_max {
            patches[first / width / side * columns + first % width / side] += 1;
        } else {
            patch.iter().for_each(|cell| marks[*cell] = Mark::Surface);
        }
    }
    let has_many = |square: usize| {
        let (column, row) = (square % columns, square / columns);
        let around = (row.saturating_sub(1)..(row + 2).min(rows)).flat_map(|row| {
            (column.saturating_sub(1)..(column + 2).min(columns)).map(move |column| row * columns + column)
        });
        let (mut sum, mut squares) = (0, 0);
        for other in around {
            sum += patches[other];
            squares += u32::from(patches[other] > 0);
        }
        sum >= PATCHES_MIN && (patches[square] > 0 || squares >= NEIGHBOURS_MIN)
    };
    for (y, row) in marks.chunks_exact_mut(width).enumerate() {
        for (column, cells) in row.chunks_mut(side).enumerate() {
            if has_many(y / side * columns + column) {
                cells
                    .iter_mut()
                    .filter(|mark| **mark != Mark::Surface)
                    .for_each(|mark| *mark = Mark::AmongMany);
            }
        }
    }
    marks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_cells_all_over_a_lawn_are_scattered_and_a_wall_and_a_chair_are_not() {
        let (width, cell_m) = (200, 0.05);
        let mut is_occupied = vec![false; width * 200];
        // A lawn on the left with a wall through it, four legs of a chair on the right.
        (0..100).for_each(|i| is_occupied[(i * 7 % 200) * width + (i * 13 % 80)] = true);
        (0..200).for_each(|y| is_occupied[y * width + 40] = true);
        for (x, y) in [(150, 50), (158, 50), (150, 58), (158, 58)] {
            is_occupied[y * width + x] = true;
        }
        let marks = scattered_returns(is_occupied.into_iter(), width, cell_m);
        let at = |x: usize, y: usize| marks[y * width + x] == Mark::AmongMany;
        assert!((0..200).all(|y| !at(40, y)), "a wall");
        assert!(!at(150, 50) && !at(154, 54), "a chair");
        let lawn = (0..200).flat_map(|y| (0..40).map(move |x| (x, y))).filter(|(x, y)| at(*x, *y)).count();
        assert!(lawn > 7000, "{lawn} of 8000 cells of the lawn");
    }
}
