//! Compares a trajectory with the whole true trajectory. Gives absolute errors (ATE) and relative errors (RPE): Sturm et al. 2012,
//! section IV.

use super::spread::{SPREAD_COLUMNS, row};
use super::{EvaluationError, Spread};
use crate::outputs::TrajectoryPoint;
use flockslam_geometry::elementary::atan2;
use flockslam_geometry::{Point, Pose};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A true pose belongs to an estimated one when their stamps differ by at most this.
const TOLERANCE_NS: u64 = 10_000_000;
/// Relative errors are taken over this distance, metres, and this time.
const STEP_M: f64 = 1.0;
const STEP_NS: i64 = 1_000_000_000;

/// Errors of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TruthErrors {
    /// Poses, or pairs of them, that were compared.
    pub n: usize,
    /// Translational errors, metres; `None` (JSON null) when n is 0.
    pub translation_m: Option<Spread>,
    /// Rotational errors, degrees; `None` (JSON null) when n is 0.
    pub rotation_deg: Option<Spread>,
}

/// Errors of a trajectory against the truth (ATE and RPE: Sturm et al. 2012, section IV).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TruthReport {
    /// Estimated poses that have a true one.
    pub matched: usize,
    /// Estimated poses without a true one.
    pub without_truth: usize,
    /// True poses without an estimated one.
    pub missing: usize,
    /// `truth_from_estimate` that was applied before comparing absolute poses: metres, metres, degrees.
    pub alignment: [f64; 3],
    /// Absolute errors after the best rigid alignment of all positions.
    pub absolute: TruthErrors,
    /// Errors of the motion over each metre of the true way.
    pub per_metre: TruthErrors,
    /// Errors of the motion over each second.
    pub per_second: TruthErrors,
}

/// An estimated pose and the true one.
#[derive(Clone, Copy, Debug)]
struct Pair {
    stamp_ns: i64,
    estimate: Pose,
    truth: Pose,
}

/// Compares a trajectory with the true one. The order of `points` is taken as the order of motion; the truth may come in
/// any order.
///
/// # Errors
/// When fewer than two poses have a true one.
///
/// ```
/// use flockslam::evaluation::{EvaluationError, evaluate_truth, parse_tum};
///
/// let truth = parse_tum("truth.tum", b"0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n")?;
/// // The same way, 5 m to the left: a rigid motion is no error.
/// let points = parse_tum("found.tum", b"0 0 5 0 0 0 0 1\n1 1 5 0 0 0 0 1\n2 2 5 0 0 0 0 1\n")?;
/// let report = evaluate_truth(&points, &truth)?;
/// assert_eq!((report.matched, report.without_truth, report.missing), (3, 0, 0));
/// assert!(report.absolute.translation_m.is_some_and(|errors| errors.max < 1e-9));
/// assert!((report.alignment[1] + 5.0).abs() < 1e-9);
/// # Ok::<(), EvaluationError>(())
/// ```
pub fn evaluate_truth(
    points: &[TrajectoryPoint],
    truth: &[TrajectoryPoint],
) -> Result<TruthReport, EvaluationError> {
    let mut by_stamp = truth.to_vec();
    by_stamp.sort_by_key(|point| point.stamp_ns);
    let mut used = vec![false; by_stamp.len()];
    let mut pairs = Vec::with_capacity(points.len());
    for point in points {
        if let Some(index) = nearest(&by_stamp, point.stamp_ns) {
            used[index] = true;
            let (estimate, truth) = (point.map_from_base, by_stamp[index].map_from_base);
            pairs.push(Pair { stamp_ns: point.stamp_ns, estimate, truth });
        }
    }
    if pairs.len() < 2 {
        return Err(EvaluationError::NoCommonStamps(pairs.len()));
    }
    let truth_from_estimate = align(&pairs);
    Ok(TruthReport {
        matched: pairs.len(),
        without_truth: points.len() - pairs.len(),
        missing: used.iter().filter(|used| !**used).count(),
        alignment: [
            truth_from_estimate.x_m,
            truth_from_estimate.y_m,
            truth_from_estimate.heading_rad.to_degrees(),
        ],
        absolute: summarise(pairs.iter().map(|pair| pair.truth.to(truth_from_estimate * pair.estimate))),
        per_metre: relative(&pairs, &a_metre_later(&pairs)),
        per_second: relative(&pairs, &a_second_later(&pairs)),
    })
}

/// Index of the true pose with the nearest stamp, when it is near enough.
fn nearest(by_stamp: &[TrajectoryPoint], stamp_ns: i64) -> Option<usize> {
    let after = by_stamp.partition_point(|point| point.stamp_ns < stamp_ns);
    let distance_ns = |index: &usize| by_stamp[*index].stamp_ns.abs_diff(stamp_ns);
    let candidates = [after.checked_sub(1), (after < by_stamp.len()).then_some(after)];
    candidates
        .into_iter()
        .flatten()
        .min_by_key(distance_ns)
        .filter(|index| distance_ns(index) <= TOLERANCE_NS)
}

/// The rigid motion that brings the estimated positions nearest to the true ones in the sense of least squares (Horn 1987;
/// Umeyama 1991 without scale; in the plane the angle has a closed form).
fn align(pairs: &[Pair]) -> Pose {
    let centre = |position: fn(&Pair) -> Point| {
        let sum = pairs.iter().map(position).fold((0.0, 0.0), |sum, p| (sum.0 + p.x_m, sum.1 + p.y_m));
        Point::new(sum.0 / pairs.len() as f64, sum.1 / pairs.len() as f64)
    };
    let estimate = centre(|pair| pair.estimate.position());
    let truth = centre(|pair| pair.truth.position());
    let (mut sine, mut cosine) = (0.0, 0.0);
    for pair in pairs {
        let (ex, ey) = (pair.estimate.x_m - estimate.x_m, pair.estimate.y_m - estimate.y_m);
        let (tx, ty) = (pair.truth.x_m - truth.x_m, pair.truth.y_m - truth.y_m);
        sine += ex * ty - ey * tx;
        cosine += ex * tx + ey * ty;
    }
    let turn = Pose::new(0.0, 0.0, atan2(sine, cosine));
    let turned = turn.apply(estimate);
    Pose::new(truth.x_m - turned.x_m, truth.y_m - turned.y_m, turn.heading_rad)
}

/// For each pose the first one that is a metre further along the true way.
fn a_metre_later(pairs: &[Pair]) -> Vec<(usize, usize)> {
    let steps = pairs.windows(2).map(|pair| pair[0].truth.distance_m(pair[1].truth));
    let way_m: Vec<f64> = std::iter::once(0.0)
        .chain(steps.scan(0.0, |sum, step| {
            *sum += step;
            Some(*sum)
        }))
        .collect();
    let later = |from: usize| way_m.partition_point(|m| *m < way_m[from] + STEP_M);
    (0..pairs.len()).map(|from| (from, later(from))).filter(|(_, to)| *to < pairs.len()).collect()
}

/// For each pose the first later one whose stamp is a second higher.
fn a_second_later(pairs: &[Pair]) -> Vec<(usize, usize)> {
    // The highest stamp so far never runs backwards, unlike the stamps.
    let highest = pairs.iter().scan(i64::MIN, |highest, pair| {
        *highest = pair.stamp_ns.max(*highest);
        Some(*highest)
    });
    let highest: Vec<i64> = highest.collect();
    let later = |from: usize| {
        let wanted_ns = pairs[from].stamp_ns.saturating_add(STEP_NS);
        highest.partition_point(|stamp_ns| *stamp_ns < wanted_ns)
    };
    (0..pairs.len())
        .map(|from| (from, later(from)))
        .filter(|(from, to)| from < to && *to < pairs.len())
        .collect()
}

fn relative(pairs: &[Pair], steps: &[(usize, usize)]) -> TruthErrors {
    summarise(steps.iter().map(|(from, to)| {
        let (from, to) = (&pairs[*from], &pairs[*to]);
        from.truth.to(to.truth).to(from.estimate.to(to.estimate))
    }))
}

fn summarise(errors: impl Iterator<Item = Pose>) -> TruthErrors {
    let (translation_m, rotation_deg): (Vec<f64>, Vec<f64>) =
        errors.map(|error| (error.position().norm_m(), error.heading_rad.abs().to_degrees())).unzip();
    TruthErrors {
        n: translation_m.len(),
        translation_m: Spread::of(&translation_m),
        rotation_deg: Spread::of(&rotation_deg),
    }
}

impl fmt::Display for TruthReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x_m, y_m, turn_deg] = self.alignment;
        writeln!(
            f,
            "{} poses compared, {} without truth, {} true ones missing; aligned by {x_m:.3} m, {y_m:.3} m, {turn_deg:.2} deg",
            self.matched, self.without_truth, self.missing
        )?;
        let groups = [
            ("absolute (ATE)", &self.absolute),
            ("per metre (RPE)", &self.per_metre),
            ("per second (RPE)", &self.per_second),
        ];
        writeln!(f, "{:<18}{:>7}  {SPREAD_COLUMNS}", "translation [m]", "n")?;
        for (name, group) in groups {
            writeln!(f, "{name:<18}{:>7}  {}", group.n, row(group.translation_m, 4))?;
        }
        writeln!(f, "{:<18}{:>7}  {SPREAD_COLUMNS}", "rotation [deg]", "n")?;
        for (name, group) in groups {
            writeln!(f, "{name:<18}{:>7}  {}", group.n, row(group.rotation_deg, 3))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A circle of 5 m, driven at 0.5 m/s, ten poses a second.
    fn circle(count: usize) -> Vec<TrajectoryPoint> {
        let pose = |i: usize| i as f64 * 0.01;
        let at = |angle: f64| Pose::new(5.0 * angle.sin(), -5.0 * angle.cos(), angle);
        (0..count)
            .map(|i| TrajectoryPoint { stamp_ns: i as i64 * 100_000_000, map_from_base: at(pose(i)) })
            .collect()
    }

    fn moved(points: &[TrajectoryPoint], by: Pose) -> Vec<TrajectoryPoint> {
        points.iter().map(|p| TrajectoryPoint { map_from_base: by * p.map_from_base, ..*p }).collect()
    }

    #[test]
    fn a_constant_drift_shows_in_the_relative_errors() {
        let truth = circle(1000);
        let mut pose = Pose::IDENTITY;
        let mut drifting = vec![truth[0]];
        for pair in truth.windows(2) {
            // 2 % too far and 0.1° too much turn with every step of 5 cm.
            let step = pair[0].map_from_base.to(pair[1].map_from_base);
            pose = pose * Pose::new(step.x_m * 1.02, step.y_m, step.heading_rad + 0.1f64.to_radians());
            drifting.push(TrajectoryPoint {
                stamp_ns: pair[1].stamp_ns,
                map_from_base: truth[0].map_from_base * pose,
            });
        }
        let report = evaluate_truth(&drifting, &truth).unwrap();
        // One metre is 20 or 21 steps, one second 10.
        assert!((2.0 - 1e-6..2.1 + 1e-6).contains(&report.per_metre.rotation_deg.unwrap().mean), "{report}");
        assert!((report.per_second.rotation_deg.unwrap().mean - 1.0).abs() < 1e-6, "{report}");
        assert!((report.per_second.translation_m.unwrap().mean - 0.01).abs() < 0.002, "{report}");
        assert!(report.absolute.translation_m.unwrap().rmse > 0.05, "{report}");
    }

    #[test]
    fn poses_without_a_partner_are_counted() {
        let truth = circle(100);
        let report = evaluate_truth(&truth[10..], &truth[..90]).unwrap();
        assert_eq!((report.matched, report.without_truth, report.missing), (80, 10, 10));
        let later: Vec<_> =
            truth.iter().map(|p| TrajectoryPoint { stamp_ns: p.stamp_ns + 20_000_000, ..*p }).collect();
        assert_eq!(evaluate_truth(&later, &truth), Err(EvaluationError::NoCommonStamps(0)));
    }

    #[test]
    fn one_wrong_pose_is_the_maximum() {
        let truth = circle(500);
        let mut wrong = truth.clone();
        wrong[250].map_from_base = wrong[250].map_from_base * Pose::new(0.5, 0.0, 0.0);
        let report = evaluate_truth(&wrong, &truth).unwrap();
        assert!((report.absolute.translation_m.unwrap().max - 0.5).abs() < 0.01);
        assert!((report.absolute.translation_m.unwrap().rmse - 0.5 / 500f64.sqrt()).abs() < 1e-3);
    }

    proptest! {
        #[test]
        fn a_rigid_motion_is_no_error(x in -100.0..100.0f64, y in -100.0..100.0f64, heading in -3.0..3.0f64) {
            let truth = circle(200);
            let by = Pose::new(x, y, heading);
            let report = evaluate_truth(&moved(&truth, by), &truth).unwrap();
            prop_assert!(report.absolute.translation_m.unwrap().max < 1e-9 && report.absolute.rotation_deg.unwrap().max < 1e-9);
            for relative in [report.per_metre, report.per_second] {
                prop_assert!(relative.n > 0);
                prop_assert!(relative.translation_m.unwrap().max < 1e-9 && relative.rotation_deg.unwrap().max < 1e-9);
            }
            let found = Pose::new(report.alignment[0], report.alignment[1], report.alignment[2].to_radians());
            prop_assert!(found.distance_m(by.inverse()) < 1e-9 && found.turn_rad(by.inverse()) < 1e-9);
        }
    }
}
