use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Fixed-point units in one unit (nat) of weight of evidence: 2⁻¹² nat is the resolution of every cell.
pub const WEIGHT_SCALE: f64 = 4096.0;

/// Accumulated evidence of a cell: two weights in fixed point (units of `1 / WEIGHT_SCALE` nat).
///
/// With masses p (occupied), q (free), u (unknown) the weights are `A = ln((p+u)/u)` and `B = ln((q+u)/u)`
/// (Shafer 1976, weights of evidence). Dempster's rule is then their sum, so combining is exactly commutative and
/// associative, and evidence can be withdrawn again.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Cell {
    /// Weight for "occupied", A.
    pub occupied: u32,
    /// Weight for "free", B.
    pub free: u32,
}

/// A cell as it is published and stored: the weights capped at 16 nat, which keeps u ≥ u_min.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct PackedCell {
    /// Weight for "occupied", A.
    pub occupied: u16,
    /// Weight for "free", B.
    pub free: u16,
}

/// Normalised Dempster–Shafer masses of a cell; they sum to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Masses {
    /// Mass on {occupied}.
    pub occupied: f64,
    /// Mass on {free}.
    pub free: f64,
    /// Mass on {occupied, free}: ignorance.
    pub unknown: f64,
}
