//! A cell in three states: free, occupied, unknown.

use crate::Cell;

/// What is known of a cell.
#[repr(u8)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellState {
    /// Nothing.
    #[default]
    Unknown = 0,
    /// Nothing stands there.
    Free = 1,
    /// Something stands there.
    Occupied = 2,
}

impl CellState {
    /// Of a cell with this evidence: thresholds as in nav2, on p/(p+q).
    pub fn of(cell: &Cell) -> Self {
        let (occupied, free) = (u64::from(cell.occupied), u64::from(cell.free));
        // e^A - 1 grows faster than A: p/q is beyond A/B, seen from 1. Most cells need no exponential.
        match (occupied, free) {
            (0, 0) => Self::Unknown,
            _ if occupied > 2 * free => Self::Occupied,
            _ if free > 4 * occupied => Self::Free,
            _ => Self::by_masses(cell),
        }
    }

    fn by_masses(cell: &Cell) -> Self {
        match cell.masses().occupancy() {
            Some(occupancy) if occupancy > 0.65 => Self::Occupied,
            Some(occupancy) if occupancy < 0.25 => Self::Free,
            _ => Self::Unknown,
        }
    }

    /// The state of this number; every other number is unknown.
    pub fn of_bits(bits: u8) -> Self {
        match bits {
            1 => Self::Free,
            2 => Self::Occupied,
            _ => Self::Unknown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_state_is_that_of_the_masses(occupied in any::<u32>(), free in any::<u32>(), shift in 0..32) {
            for (occupied, free) in [(occupied >> shift, free >> shift), (occupied >> shift, 0), (0, free >> shift)] {
                let cell = Cell { occupied, free };
                prop_assert_eq!(CellState::of(&cell), CellState::by_masses(&cell), "{:?}", cell);
            }
        }
    }
}
