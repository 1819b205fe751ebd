//! Masses of belief about a cell and the two rules that combine them.

use flockslam_geometry::elementary::exp;

/// Normalised Dempster–Shafer masses of a cell; they sum to one.
///
/// ```
/// use flockslam_evidence::Masses;
///
/// let (wall, maybe) = (Masses::observation(0.9, 0.5), Masses::observation(0.6, 0.2));
/// let mut total_conflicts = 0;
/// let joint = wall.combine(maybe, &mut total_conflicts);
/// assert!(joint.unknown < wall.unknown && total_conflicts == 0);
/// assert_eq!(Masses::UNKNOWN.pignistic(), 0.5);
/// assert!(Masses::new(0.6, 0.6, 0.1).is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Masses {
    /// Mass on {occupied}.
    pub occupied: f64,
    /// Mass on {free}.
    pub free: f64,
    /// Mass on {occupied, free}: ignorance.
    pub unknown: f64,
}

/// Masses of the unnormalised conjunctive rule (transferable belief model, Smets); they sum to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnnormalisedMasses {
    /// Mass on {occupied}.
    pub occupied: f64,
    /// Mass on {free}.
    pub free: f64,
    /// Mass on {occupied, free}: ignorance.
    pub unknown: f64,
    /// Mass on the empty set: conflict, v.
    pub conflict: f64,
}

/// Masses that came from outside and are not masses.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("masses {occupied}, {free}, {unknown} are not shares of one")]
pub struct NotMasses {
    /// The mass of "occupied".
    pub occupied: f64,
    /// The mass of "free".
    pub free: f64,
    /// The mass of "unknown".
    pub unknown: f64,
}

/// How far foreign masses may be from summing to one.
const SUM_TOLERANCE: f64 = 1e-6;

impl Masses {
    /// Complete ignorance: the neutral element of both rules.
    pub const UNKNOWN: Masses = Masses { occupied: 0.0, free: 0.0, unknown: 1.0 };

    /// Checks masses from outside and rescales them to sum to one exactly enough.
    ///
    /// # Errors
    /// When one is negative or not finite, or their sum is not one.
    pub fn new(occupied: f64, free: f64, unknown: f64) -> Result<Self, NotMasses> {
        let sum = occupied + free + unknown;
        let shares = occupied >= 0.0 && free >= 0.0 && unknown >= 0.0;
        if shares && (sum - 1.0).abs() <= SUM_TOLERANCE {
            return Ok(Self { occupied: occupied / sum, free: free / sum, unknown: unknown / sum });
        }
        Err(NotMasses { occupied, free, unknown })
    }

    /// An observation (vinySLAM): with quality `Q` (0 … 1) and the probability of "occupied",
    /// `p = prob·Q`, `q = (1-prob)·Q`, `u = 1-Q`.
    pub fn observation(probability: f64, quality: f64) -> Self {
        let (probability, quality) = (probability.clamp(0.0, 1.0), quality.clamp(0.0, 1.0));
        Self { occupied: probability * quality, free: (1.0 - probability) * quality, unknown: 1.0 - quality }
    }

    /// Masses of two weights of evidence in nat, both ≥ 0.
    pub fn from_weights(occupied_nat: f64, free_nat: f64) -> Self {
        // Scaled by the greater exponential, so that nothing overflows.
        let top = occupied_nat.max(free_nat);
        let (a, b, one) = (exp(occupied_nat - top), exp(free_nat - top), exp(-top));
        let total = a + b - one;
        Self {
            occupied: ((a - one) / total).max(0.0),
            free: ((b - one) / total).max(0.0),
            unknown: one / total,
        }
    }

    /// Dempster's rule. Total conflict (K = 1), which only masses without ignorance can reach, gives an unknown cell
    /// and is counted in `total_conflicts`.
    #[must_use]
    pub fn combine(self, other: Masses, total_conflicts: &mut u64) -> Masses {
        let joint = UnnormalisedMasses::from(self).combine(other.into());
        let agreed = joint.occupied + joint.free + joint.unknown;
        // Below this the quotients are rounding errors: sources that agree in nothing.
        if agreed < 1e-12 {
            *total_conflicts += 1;
            return Masses::UNKNOWN;
        }
        Masses {
            occupied: joint.occupied / agreed,
            free: joint.free / agreed,
            unknown: joint.unknown / agreed,
        }
    }

    /// Probability of "occupied" within the known mass, `p/(p+q)`; `None` for a cell without evidence.
    pub fn occupancy(self) -> Option<f64> {
        let known = self.occupied + self.free;
        (known > 0.0).then(|| (self.occupied / known).min(1.0))
    }

    /// Pignistic probability of "occupied": `p + u/2`.
    pub fn pignistic(self) -> f64 {
        (self.occupied + 0.5 * self.unknown).min(1.0)
    }

    /// vinySLAM's score of a cell: `1 - u/4 - (1 - u/2)(1 + q - p)/2`; 1 occupied, ½ unknown, 0 free.
    pub fn vinyslam_score(self) -> f64 {
        1.0 - 0.25 * self.unknown - (1.0 - 0.5 * self.unknown) * (1.0 + self.free - self.occupied) * 0.5
    }
}

impl UnnormalisedMasses {
    /// Masses from a cell's weights (nat) and `ln_unknown` = C, the sum of ln u over all observations:
    /// `u = e^C`, `p = e^C (e^A - 1)`, `q = e^C (e^B - 1)`, `v = 1 - e^C (e^A + e^B - 1)`.
    pub fn from_weights(occupied_nat: f64, free_nat: f64, ln_unknown: f64) -> Self {
        let unknown = exp(ln_unknown);
        let occupied = exp(occupied_nat + ln_unknown) - unknown;
        let free = exp(free_nat + ln_unknown) - unknown;
        Self { occupied, free, unknown, conflict: (1.0 - occupied - free - unknown).max(0.0) }
    }

    /// The conjunctive rule: `p' = p₁p₂ + p₁u₂ + u₁p₂`, `q'` alike, `u' = u₁u₂`, and what is left is conflict.
    #[must_use]
    pub fn combine(self, other: Self) -> Self {
        let share = |a: f64, b: f64| a * b + a * other.unknown + self.unknown * b;
        let occupied = share(self.occupied, other.occupied);
        let free = share(self.free, other.free);
        let unknown = self.unknown * other.unknown;
        Self { occupied, free, unknown, conflict: (1.0 - occupied - free - unknown).clamp(0.0, 1.0) }
    }

    /// Pignistic probability of "occupied", `(p + u/2)/(1 - v)`; ½ in total conflict.
    pub fn pignistic(self) -> f64 {
        let agreed = self.occupied + self.free + self.unknown;
        if agreed <= 0.0 { 0.5 } else { ((self.occupied + 0.5 * self.unknown) / agreed).clamp(0.0, 1.0) }
    }
}

impl From<Masses> for UnnormalisedMasses {
    fn from(masses: Masses) -> Self {
        let Masses { occupied, free, unknown } = masses;
        Self { occupied, free, unknown, conflict: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cell;
    use proptest::prelude::*;

    /// Dempster's rule as printed in textbooks, on floats.
    fn dempster(a: Masses, b: Masses) -> Masses {
        let conflict = a.occupied * b.free + a.free * b.occupied;
        let share = |p: f64, q: f64| (p * q + p * b.unknown + a.unknown * q) / (1.0 - conflict);
        Masses {
            occupied: share(a.occupied, b.occupied),
            free: share(a.free, b.free),
            unknown: a.unknown * b.unknown / (1.0 - conflict),
        }
    }

    fn close(a: Masses, b: Masses, tolerance: f64) -> bool {
        (a.occupied - b.occupied).abs() < tolerance
            && (a.free - b.free).abs() < tolerance
            && (a.unknown - b.unknown).abs() < tolerance
    }

    fn masses() -> impl Strategy<Value = Masses> {
        (0.0..1.0f64, 0.0..1.0f64)
            .prop_map(|(probability, quality)| Masses::observation(probability, quality))
    }

    proptest! {
        #[test]
        fn sums_of_weights_agree_with_dempsters_rule(
            observations in proptest::collection::vec((0.0..1.0f64, 0.0..0.6f64), 1..20)
        ) {
            let (mut cell, mut direct) = (Cell::UNKNOWN, Masses::UNKNOWN);
            let (mut ln_unknown, mut unnormalised) = (0.0, UnnormalisedMasses::from(Masses::UNKNOWN));
            for (probability, quality) in &observations {
                let observation = Masses::observation(*probability, *quality);
                cell = cell.combine(Cell::from_masses(observation));
                direct = dempster(direct, observation);
                ln_unknown += observation.unknown.ln();
                unnormalised = unnormalised.combine(observation.into());
            }
            // Both weights of each observation are rounded, by up to 2⁻¹³ nat.
            prop_assert!(close(cell.masses(), direct, 2.5e-4 * observations.len() as f64));
            let (a, b) = cell.weights_nat();
            let read = UnnormalisedMasses::from_weights(a, b, ln_unknown);
            prop_assert!((read.conflict - unnormalised.conflict).abs() < 2e-3 * observations.len() as f64);
            prop_assert!((unnormalised.pignistic() - direct.pignistic()).abs() < 1e-9);
        }

        #[test]
        fn the_float_rule_keeps_its_laws(a in masses(), b in masses(), c in masses()) {
            let mut conflicts = 0;
            let left = a.combine(b, &mut conflicts).combine(c, &mut conflicts);
            let right = a.combine(b.combine(c, &mut conflicts), &mut conflicts);
            prop_assert!(close(left, right, 1e-9) && conflicts == 0);
            prop_assert!(close(a.combine(b, &mut conflicts), dempster(a, b), 1e-12));
            prop_assert!(close(a.combine(b, &mut conflicts), b.combine(a, &mut conflicts), 1e-12));
            prop_assert!(close(a.combine(Masses::UNKNOWN, &mut conflicts), a, 1e-12));
            prop_assert!((left.occupied + left.free + left.unknown - 1.0).abs() < 1e-12);
        }

        #[test]
        fn foreign_numbers_become_masses_or_an_error(p in any::<f64>(), q in -0.5..1.5f64, u in -0.5..1.5f64) {
            match Masses::new(p, q, u) {
                Ok(m) => prop_assert!((m.occupied + m.free + m.unknown - 1.0).abs() < 1e-12),
                Err(_) => {
                    let sums_to_one = (p + q + u - 1.0).abs() <= 1e-6;
                    prop_assert!(p < 0.0 || q < 0.0 || u < 0.0 || !sums_to_one);
                }
            }
            // Shares of one, rounded by another program: a small deviation is corrected, a larger one is an error.
            let sum = q.abs() + u.abs() + 1.0;
            let (q, u, rest) = (q.abs() / sum, u.abs() / sum, 1.0 / sum);
            let m = Masses::new(q, u, rest + 5e-7).unwrap();
            prop_assert!((m.occupied + m.free + m.unknown - 1.0).abs() < 1e-12);
            let valid = Masses { occupied: q, free: u, unknown: rest };
            prop_assert!(close(m, valid, 1e-6), "{m:?} is not {valid:?}");
            prop_assert!(Masses::new(q, u, rest + 3e-6).is_err());
        }
    }

    #[test]
    fn total_conflict_is_an_unknown_cell_and_counted() {
        let (certain, never) = (Masses::new(1.0, 0.0, 0.0).unwrap(), Masses::new(0.0, 1.0, 0.0).unwrap());
        let mut conflicts = 0;
        assert_eq!(certain.combine(never, &mut conflicts), Masses::UNKNOWN);
        assert_eq!((conflicts, certain.combine(certain, &mut conflicts)), (1, certain));
        let joint = UnnormalisedMasses::from(certain).combine(never.into());
        assert_eq!((joint.conflict, joint.pignistic()), (1.0, 0.5));
        assert_eq!(Cell::from_masses(certain).occupied, u32::from(u16::MAX));
        assert!(Masses::new(f64::NAN, 0.0, 1.0).is_err());
    }

    #[test]
    fn read_outs_of_the_three_corners() {
        let (occupied, free) = (Masses::from_weights(700.0, 0.0), Masses::from_weights(0.0, 700.0));
        assert!((occupied.vinyslam_score() - 1.0).abs() < 1e-9 && free.vinyslam_score().abs() < 1e-9);
        assert_eq!(Masses::UNKNOWN.vinyslam_score(), 0.5);
        assert_eq!((occupied.occupancy(), occupied.pignistic()), (Some(1.0), 1.0));
        assert!(free.occupancy() == Some(0.0) && free.pignistic() < 1e-9);
        assert_eq!((Masses::UNKNOWN.occupancy(), Masses::UNKNOWN.pignistic()), (None, 0.5));
    }
}
