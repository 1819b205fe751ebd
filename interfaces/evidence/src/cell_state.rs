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
        // Most cells of a tile have none, and masses take two exponentials.
        if *cell == Cell::default() {
            return Self::Unknown;
        }
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
