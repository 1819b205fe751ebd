//! Turns the evidence of a cell into one of 16 shades, with a table in place of exponentials.

use flockslam_evidence::{Masses, TILE_CELLS, WEIGHT_SCALE};

/// Shades of a cell on the page: 0 unknown, then from 1 (free) to this (occupied).
pub const DARKEST: u8 = 15;
/// Steps of a weight of evidence in the table, and their width in nat.
const STEPS: usize = 64;
const STEP_NAT: f64 = 0.125;

/// A picture of one tile: a shade for each cell, row by row.
pub type Shades = [u8; TILE_CELLS];

/// What cells look like: occupancy `p/(p+q)` of their evidence in a few shades, read from a table.
pub struct Shader(Box<[[u8; STEPS]; STEPS]>);

impl Default for Shader {
    fn default() -> Self {
        let mut table = Box::new([[0; STEPS]; STEPS]);
        for (occupied, row) in table.iter_mut().enumerate() {
            for (free, shade) in row.iter_mut().enumerate() {
                let masses = Masses::from_weights(occupied as f64 * STEP_NAT, free as f64 * STEP_NAT);
                let dark = |occupancy: f64| 1 + (occupancy * f64::from(DARKEST - 1)).round() as u8;
                *shade = masses.occupancy().map_or(0, dark);
            }
        }
        Self(table)
    }
}

impl Shader {
    /// The shade of a cell with these weights, in units of `1 / WEIGHT_SCALE` nat. Whatever is known at all is not unknown.
    #[inline]
    pub fn shade(&self, occupied: u32, free: u32) -> u8 {
        const UNITS: u32 = (STEP_NAT * WEIGHT_SCALE) as u32;
        const MOST: u32 = UNITS * (STEPS as u32 - 1);
        // Of much evidence only the difference counts.
        let excess = occupied.max(free).saturating_sub(MOST);
        let step = |weight: u32| weight.saturating_sub(excess).div_ceil(UNITS) as usize;
        self.0[step(occupied)][step(free)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::Cell;

    #[test]
    fn different_evidence_has_different_shades() {
        let shader = Shader::default();
        let shade = |occupied, free| {
            let cell = Cell::from_weights(occupied, free);
            shader.shade(cell.occupied, cell.free)
        };
        assert_eq!((shade(0.0, 0.0), shade(0.0, 0.001), shade(0.001, 0.0)), (0, 1, DARKEST));
        assert_eq!((shade(0.0, 900.0), shade(900.0, 0.0)), (1, DARKEST));
        assert!((7..=9).contains(&shade(2.0, 2.0)));
        assert!(shade(1.5, 0.3) > shade(1.5, 0.9));
        assert!(
            shade(60.0, 50.0) == DARKEST && shade(50.0, 60.0) == 1 && (7..=9).contains(&shade(99.0, 99.0))
        );
    }
}
