use crate::sight::{SECTORS, floor};
use flockslam_messages::ScanView;
use std::f64::consts::TAU;
use std::ops::Range;

/// Directions in the laser frame that are of interest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Directions {
    /// The middle of them, radians.
    pub middle_rad: f64,
    /// They reach so far to both sides of it, radians.
    pub half_rad: f64,
}

/// Runs of beams that the same directions come up in, at most; a scan of more turns is taken as a whole.
const RUNS: usize = 3;

impl Directions {
    /// The whole circle.
    pub const ALL: Self = Self { middle_rad: 0.0, half_rad: f64::INFINITY };

    pub(crate) fn is_all(self) -> bool {
        self.half_rad >= 0.5 * TAU
    }

    /// These, and those that lie so little beside them.
    pub(crate) fn and_beside(self, beside_rad: f64) -> Self {
        Self { half_rad: self.half_rad + beside_rad, ..self }
    }

    /// Whether something `half_rad` wide to both sides of a direction touches a sector that one of these lies in.
    pub(crate) fn has(self, angle_rad: f64, half_rad: f64) -> bool {
        let away = angle_rad - self.middle_rad;
        let away = (away - TAU * floor(away * (1.0 / TAU) + 0.5) as f64).abs();
        away <= self.half_rad + half_rad + 2.0 * TAU / SECTORS as f64
    }

    /// At least the beams of a scan with even angles that this holds for, in order.
    pub(crate) fn beams(self, scan: ScanView<'_>, half_rad: f64) -> impl Iterator<Item = usize> + use<> {
        let mut runs: [Range<usize>; RUNS] = std::array::from_fn(|_| 0..0);
        let beside_rad = self.half_rad + half_rad + 2.0 * TAU / SECTORS as f64;
        let (first_rad, step_rad) = (scan.angle_rad(0), scan.header().angle_increment_rad);
        let last_rad = scan.angle_rad(scan.len() - 1);
        let span_rad = (last_rad - first_rad).abs();
        if beside_rad >= 0.5 * TAU || !(step_rad != 0.0 && span_rad < (RUNS - 1) as f64 * TAU) {
            runs[0] = 0..scan.len();
        } else {
            // The middle of them, turn by turn, from where they first reach into the scan.
            let first_turn = 1 + floor((first_rad.min(last_rad) - self.middle_rad - beside_rad) / TAU);
            for (run, turn) in runs.iter_mut().zip(first_turn..) {
                let middle_rad = self.middle_rad + TAU * turn as f64;
                let beam = |angle_rad: f64| (angle_rad - first_rad) / step_rad;
                let (a, b) = (beam(middle_rad - beside_rad), beam(middle_rad + beside_rad));
                // A beam more to both sides: what is cut off by rounding.
                let at = |beam: i64| (beam.max(0) as usize).min(scan.len());
                *run = at(floor(a.min(b)).saturating_sub(1))..at(floor(a.max(b)).saturating_add(3));
            }
            runs.sort_unstable_by_key(|run| run.start);
        }
        runs.into_iter().flatten()
    }
}
