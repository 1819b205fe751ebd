//! Where a map shows scattered returns and no surface: beams have met the ground or grass there, now here, now there.

/// An occupied patch of at most this area is a scattered return, if it is one of many, m²: a cell or two.
const PATCH_MAX_M2: f64 = 0.01;
/// Patches are counted in squares of this side, metres …
const SQUARE_M: f64 = 2.0;
/// … and there are many in a square where the squares around it, it among them, have at least so many of them, …
const PATCHES_MIN: u32 = 12;
/// … and it has one itself, or this many of the squares around it do.
const NEIGHBOURS_MIN: u32 = 4;

/// What is scattered in a map: by cell, row by row.
pub(crate) struct Scattered {
    /// Small patches of occupied cells, single ones, too.
    pub(crate) is_patch: Vec<bool>,
    /// Cells in squares of many patches, and in no surface there.
    pub(crate) is_among_many: Vec<bool>,
}

/// Finds what is scattered among the occupied cells of a grid.
pub(crate) fn scattered_returns(is_occupied: &[bool], width: usize, cell_size_m: f64) -> Scattered {
    let height = is_occupied.len() / width.max(1);
    let patch_max = (PATCH_MAX_M2 / (cell_size_m * cell_size_m)).round().max(1.0) as usize;
    let side = (SQUARE_M / cell_size_m).round().max(1.0) as usize;
    let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
    let square = |cell: usize| cell / width / side * columns + cell % width / side;
    let mut patches = vec![0u32; columns * rows];
    // Occupied cells of surfaces, and of patches that have been counted.
    let (mut is_surface, mut is_seen) = (vec![false; is_occupied.len()], vec![false; is_occupied.len()]);
    let mut patch = Vec::new();
    for first in 0..is_occupied.len() {
        if !is_occupied[first] || is_seen[first] {
            continue;
        }
        patch.clear();
        patch.push(first);
        is_seen[first] = true;
        let mut next = 0;
        while next < patch.len() {
            let (x, y) = (patch[next] % width, patch[next] / width);
            next += 1;
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    let cell = y * width + x;
                    if is_occupied[cell] && !is_seen[cell] {
                        is_seen[cell] = true;
                        patch.push(cell);
                    }
                }
            }
        }
        if patch.len() <= patch_max {
            patches[square(first)] += 1;
        } else {
            patch.iter().for_each(|cell| is_surface[*cell] = true);
        }
    }
    let is_scattered = |square: usize| {
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
    let squares: Vec<bool> = (0..columns * rows).map(is_scattered).collect();
    let cells = 0..is_occupied.len();
    Scattered {
        is_patch: cells.clone().map(|cell| is_occupied[cell] && !is_surface[cell]).collect(),
        is_among_many: cells.map(|cell| squares[square(cell)] && !is_surface[cell]).collect(),
    }
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
        let scattered = scattered_returns(&is_occupied, width, cell_m).is_among_many;
        let at = |x: usize, y: usize| scattered[y * width + x];
        assert!((0..200).all(|y| !at(40, y)), "a wall");
        assert!(!at(150, 50) && !at(154, 54), "a chair");
        let lawn = (0..200).flat_map(|y| (0..40).map(move |x| (x, y))).filter(|(x, y)| at(*x, *y)).count();
        assert!(lawn > 7000, "{lawn} of 8000 cells of the lawn");
    }
}
