//! A cell: two integer weights of evidence (Shafer 1976). Dempster's rule is their sum, so combining is exact in any order
//! and can be undone.

use crate::Masses;
use flockslam_geometry::elementary::{exp_m1, ln};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Fixed-point units in one unit (nat) of weight of evidence: 2⁻¹² nat is the resolution of every cell.
pub const WEIGHT_SCALE: f64 = 4096.0;

/// Greatest weight that a [`PackedCell`] holds, in nat; it is what keeps u ≥ u_min.
pub const PACKED_WEIGHT_MAX_NAT: f64 = u16::MAX as f64 / WEIGHT_SCALE;

/// Accumulated evidence of a cell: two weights in fixed point (units of `1 / WEIGHT_SCALE` nat).
///
/// With masses p (occupied), q (free), u (unknown) the weights are `A = ln((p+u)/u)` and `B = ln((q+u)/u)`
/// (Shafer 1976, weights of evidence). Dempster's rule is then their sum, so combining is exactly commutative and
/// associative, and evidence can be withdrawn again.
///
/// ```
/// use flockslam_evidence::{Cell, Masses};
///
/// let hit = Cell::from_masses(Masses::observation(0.9, 0.5));
/// let miss = Cell::from_masses(Masses::observation(0.1, 0.2));
/// let both = hit.combine(miss);
/// assert_eq!(both, miss.combine(hit));
/// assert_eq!(both.withdraw(miss), Some(hit));
/// assert!(both.masses().pignistic() > 0.5 && both.conflict() > 0.0);
/// ```
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

impl Cell {
    /// No evidence at all: the neutral element.
    pub const UNKNOWN: Cell = Cell { occupied: 0, free: 0 };

    /// A cell from weights in nat; negative and NaN count as 0.
    pub fn from_weights(occupied_nat: f64, free_nat: f64) -> Self {
        // A float cast saturates and takes NaN to zero.
        let fixed = |nat: f64| (nat * WEIGHT_SCALE).round() as u32;
        Self { occupied: fixed(occupied_nat), free: fixed(free_nat) }
    }

    /// The weights of normalised masses; certainty (u = 0) is capped at [`PACKED_WEIGHT_MAX_NAT`].
    pub fn from_masses(masses: Masses) -> Self {
        let weight = |mass: f64| {
            if mass <= 0.0 {
                return 0.0;
            }
            ln((mass + masses.unknown) / masses.unknown).min(PACKED_WEIGHT_MAX_NAT)
        };
        Self::from_weights(weight(masses.occupied), weight(masses.free))
    }

    /// Dempster's rule: the sum of the weights. It saturates only after 10⁶ nat, which bounded submaps never reach.
    #[inline]
    #[must_use]
    pub fn combine(self, other: Cell) -> Cell {
        Cell {
            occupied: self.occupied.saturating_add(other.occupied),
            free: self.free.saturating_add(other.free),
        }
    }

    /// Takes evidence out again that was combined before; `None` when it cannot have been.
    #[inline]
    #[must_use]
    pub fn withdraw(self, other: Cell) -> Option<Cell> {
        Some(Cell {
            occupied: self.occupied.checked_sub(other.occupied)?,
            free: self.free.checked_sub(other.free)?,
        })
    }

    /// Whether the cell holds no evidence.
    #[inline]
    pub fn is_unknown(self) -> bool {
        self == Self::UNKNOWN
    }

    /// The published form.
    #[inline]
    pub fn pack(self) -> PackedCell {
        let cap = |weight: u32| u16::try_from(weight).unwrap_or(u16::MAX);
        PackedCell { occupied: cap(self.occupied), free: cap(self.free) }
    }

    /// Weights for "occupied" and "free" in nat.
    pub fn weights_nat(self) -> (f64, f64) {
        (f64::from(self.occupied) / WEIGHT_SCALE, f64::from(self.free) / WEIGHT_SCALE)
    }

    /// Normalised masses: `u = 1/(e^A + e^B - 1)`, `p = (e^A - 1) u`, `q = (e^B - 1) u`.
    pub fn masses(self) -> Masses {
        let (a, b) = self.weights_nat();
        Masses::from_weights(a, b)
    }

    /// Conflict between the evidence for "occupied" and for "free": `(1 - e^-A)(1 - e^-B)`, 0 … 1.
    pub fn conflict(self) -> f64 {
        let (a, b) = self.weights_nat();
        exp_m1(-a) * exp_m1(-b)
    }
}

impl PackedCell {
    /// No evidence.
    pub const UNKNOWN: PackedCell = PackedCell { occupied: 0, free: 0 };

    /// The form that can be summed.
    #[inline]
    pub fn unpack(self) -> Cell {
        Cell { occupied: u32::from(self.occupied), free: u32::from(self.free) }
    }

    /// Whether the cell holds no evidence.
    #[inline]
    pub fn is_unknown(self) -> bool {
        self == Self::UNKNOWN
    }

    /// Normalised masses, see [`Cell::masses`].
    pub fn masses(self) -> Masses {
        self.unpack().masses()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cell() -> impl Strategy<Value = Cell> {
        (0u32..1 << 20, 0u32..1 << 20).prop_map(|(occupied, free)| Cell { occupied, free })
    }

    proptest! {
        #[test]
        fn combining_is_commutative_associative_and_reversible(a in cell(), b in cell(), c in cell()) {
            prop_assert_eq!(a.combine(b), b.combine(a));
            prop_assert_eq!(a.combine(b).combine(c), a.combine(b.combine(c)));
            prop_assert_eq!(a.combine(b).withdraw(b), Some(a));
            prop_assert_eq!(a.combine(Cell::UNKNOWN), a);
        }

        #[test]
        fn masses_sum_to_one_whatever_the_weights(occupied in any::<u32>(), free in any::<u32>()) {
            let cell = Cell { occupied, free };
            let m = cell.masses();
            prop_assert!((m.occupied + m.free + m.unknown - 1.0).abs() < 1e-9);
            for share in [m.occupied, m.free, m.unknown, m.occupancy().unwrap_or(0.5), m.pignistic(), cell.conflict()] {
                prop_assert!((0.0..=1.0).contains(&share), "{} of {:?}", share, cell);
            }
        }

        #[test]
        fn masses_are_recovered_from_their_weights(a in 0.0..8.0f64, b in 0.0..8.0f64) {
            let cell = Cell::from_weights(a, b);
            let back = Cell::from_masses(cell.masses());
            prop_assert!(back.occupied.abs_diff(cell.occupied) <= 1 && back.free.abs_diff(cell.free) <= 1);
        }

        #[test]
        fn packing_keeps_what_fits_and_caps_the_rest(a in cell()) {
            let packed = a.pack().unpack();
            prop_assert_eq!(packed.occupied, a.occupied.min(u32::from(u16::MAX)));
            prop_assert_eq!(packed.free, a.free.min(u32::from(u16::MAX)));
        }
    }

    #[test]
    fn foreign_evidence_cannot_be_withdrawn() {
        assert_eq!(Cell { occupied: 3, free: 9 }.withdraw(Cell { occupied: 4, free: 0 }), None);
        assert_eq!(Cell { occupied: 3, free: 9 }.withdraw(Cell { occupied: 0, free: 10 }), None);
        assert_eq!(Cell::from_weights(f64::NAN, -1.0), Cell::UNKNOWN);
    }
}
