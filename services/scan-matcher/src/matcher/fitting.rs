//! How a scan is fitted: strategy, velocity, and what the fit is worth.

use super::{Match, ScanMatcher, TELLING_POINTS};
use crate::motion::Prediction;
use crate::settings::Strategy;
use flockslam_evidence::Level;
use flockslam_geometry::{Covariance, Pose};
use flockslam_messages::{Quality, ScanView};
use flockslam_registration::{
    Expected, Fit, GaussNewton, Moving, ScoreField, ScoreRead, Sweep, TwistSigma, Window, beam_weight,
    hill_climbing, least_held, monte_carlo, roughened, widened,
};
use nalgebra::Vector2;

/// Window of `correlative` around a prediction: what wheels miss between two scans, metres and radians.
const NEAR_REACH: (f64, f64) = (0.25, 0.2);
/// Window around the prediction of a scan without odometry: a robot that speeds up or turns in between two scans, metres and radians.
const BLIND_REACH: (f64, f64) = (0.3, 0.35);
/// Window of the wide search after a bad fit, metres and radians; it grows up to three times while the robot is lost.
const RESCUE_REACH: (f64, f64) = (0.6, 0.35);
/// Poses of a wide search that are refined: in alike corners the best on the lattice is not always the best.
const RESCUE_CANDIDATES: usize = 3;
/// A pose of a wide search is kept when its score is better by this, 0 … 1: by less, noise would make a robot jump.
const RESCUE_GAIN: f64 = 0.05;
/// A direction that the surfaces of the scan face less than this (mean squared cosine, 0 … ½) is one that the scan tells nothing about:
/// along bare corridors and walls the wheels are followed. Noise alone makes about as much.
const DEGENERATE_BELOW: f64 = 0.005;
/// A wide search that found nothing is repeated only after this much motion, metres and radians.
const SEARCH_AGAIN: (f64, f64) = (0.1, 0.1);
/// Wheels are not believed when the velocity so far leads to a fit that scores better by this, 0 … 1.
const JUMPED: f64 = 0.05;
/// How far the velocity during a scan may be from that of the wheels before it: a robot that speeds up by 1 m/s² and turns in
/// by 5 rad/s² within a tenth of a second.
const TWIST_SIGMA: TwistSigma = TwistSigma { x_m_s: 0.1, y_m_s: 0.05, turn_rad_s: 0.5 };
/// Steps at most to pose and velocity together.
const SWEEP_STEPS: usize = 8;
/// Where in its cell a wall is, is known to this share of the cell (standard deviation). All points of a wall along the grid
/// share that error, so it does not shrink with their number.
const CELL_ERROR: f64 = 0.1;
/// Least share of surfaces (mean squared cosine) that a direction is taken to be held by.
const HELD_MIN: f64 = 1e-5;
/// Standard deviations assumed of the prediction where the scan determines nothing.
const PRIOR_SIGMA: (f64, f64) = (0.3, 0.15);

impl ScanMatcher {
    /// Decides between wheels and velocity where they contradict each other: whichever leads to the better fit, which is
    /// given along.
    pub(super) fn settled<F: ScoreField>(
        &mut self,
        field: &F,
        prediction: Prediction,
        scan: ScanView<'_>,
    ) -> (Prediction, Option<Fit>) {
        let Some(steady) = prediction.steady else { return (prediction, None) };
        let by_wheels = self.refine(field, prediction.pose, prediction.pose);
        self.take_points(scan, steady.twist);
        let by_velocity = self.refine(field, steady.pose, steady.pose);
        if by_velocity.score > by_wheels.score + JUMPED {
            let prediction = Prediction { pose: steady.pose, twist: steady.twist, ..prediction };
            return (prediction, Some(by_velocity));
        }
        self.take_points(scan, prediction.twist);
        (prediction, Some(by_wheels))
    }

    /// Matches the points that were taken; `fit` is that near the prediction, when it was made already.
    pub(super) fn match_scan<F: ScoreField>(
        &mut self,
        field: &F,
        prediction: &Prediction,
        fit: Option<Fit>,
        scan: ScanView<'_>,
    ) -> Match {
        let descends = !matches!(self.settings.strategy, Strategy::MonteCarlo | Strategy::HillClimbing);
        let (fit, rescued) = if descends {
            let fit = self.track(field, prediction.pose, fit, scan.odometry().is_some());
            self.rescue(field, prediction.pose, fit)
        } else {
            (self.sampled(field, prediction.pose, scan), false)
        };
        let fits_velocity = descends && self.settings.fits_velocity && scan.takes_time();
        let (mut fit, twist, mut covariance) = if fits_velocity {
            let (now, covariance) = self.straighten(field, prediction, fit, scan);
            (Fit::at(field, &self.points, now.pose), now.twist, covariance)
        } else {
            (fit, prediction.twist, fit.covariance(PRIOR_SIGMA.0, PRIOR_SIGMA.1))
        };
        covariance = roughened(covariance, CELL_ERROR * field.reader(Level::Full).cell_size_m());
        covariance = self.loosened(covariance, fit.pose);
        let fused = (!rescued).then(|| prediction.fused(fit.pose, covariance)).flatten();
        if let Some((pose, posterior)) = fused {
            (fit, covariance) = (Fit::at(field, &self.points, pose), posterior);
        }
        let quality = match self.judge(&fit, prediction.pose) {
            Quality::Tracking if fused.is_some() => Quality::Degraded,
            quality => quality,
        };
        Match { pose: fit.pose, twist, covariance, score: fit.score, quality, rescued }
    }

    /// Fits pose and velocity of a scan that takes time together, starting at a fit of its pose alone; leaves the points
    /// straightened by the velocity that was found.
    fn straighten<F: ScoreField>(
        &mut self,
        field: &F,
        prediction: &Prediction,
        fit: Fit,
        scan: ScanView<'_>,
    ) -> (Moving, Covariance) {
        let predicted = Moving { pose: prediction.pose, twist: prediction.twist };
        let mut now = Moving { pose: fit.pose, twist: prediction.twist };
        for _ in 0..SWEEP_STEPS {
            let sweep = Sweep { points: &self.points, times_s: &self.times_s };
            let next = sweep.step(field, now, predicted, TWIST_SIGMA);
            self.take_points(scan, next.twist);
            let settled = next.is_near(now);
            now = next;
            if settled {
                break;
            }
        }
        let sweep = Sweep { points: &self.points, times_s: &self.times_s };
        (now, sweep.covariance(field, now.pose, TWIST_SIGMA, PRIOR_SIGMA))
    }

    /// A fit's covariance, widened along the direction that the scan's surfaces leave open: single cells along a bare wall
    /// have slopes, which hold nothing.
    fn loosened(&self, covariance: Covariance, pose: Pose) -> Covariance {
        let Some((held, axis)) = least_held(&self.points) else { return covariance };
        let (sin, cos) = pose.heading_rad.sin_cos();
        let axis = Vector2::new(cos * axis.x - sin * axis.y, sin * axis.x + cos * axis.y);
        let along = |axis: Vector2<f64>| {
            let Covariance { xx, xy, yy, .. } = covariance;
            axis.x * axis.x * xx + 2.0 * axis.x * axis.y * xy + axis.y * axis.y * yy
        };
        let across = along(Vector2::new(-axis.y, axis.x));
        let seen = (held - DEGENERATE_BELOW).max(HELD_MIN);
        let missing = across * (1.0 - held) / seen - along(axis);
        if missing > 0.0 { widened(covariance, axis, missing.sqrt()) } else { covariance }
    }

    /// The fit near the prediction; a scan without odometry is looked for before.
    fn track<F: ScoreField>(
        &mut self,
        field: &F,
        prediction: Pose,
        fit: Option<Fit>,
        has_odometry: bool,
    ) -> Fit {
        if self.settings.strategy == Strategy::Correlative {
            return self.correlative.fit(field, &self.points, window(prediction, NEAR_REACH));
        }
        let fit = fit.unwrap_or_else(|| self.refine(field, prediction, prediction));
        if has_odometry {
            return fit;
        }
        let found = self.correlative.search(field, &self.points, window(prediction, BLIND_REACH));
        let other = found.map(|(_, start)| self.refine(field, start, start));
        other.filter(|other| other.score > fit.score).unwrap_or(fit)
    }

    /// The strategy's own descent from `start`.
    fn refine<F: ScoreField>(&mut self, field: &F, prediction: Pose, start: Pose) -> Fit {
        let points = &self.points;
        if self.settings.strategy == Strategy::Ndt {
            let expected = Expected { pose: prediction, from: Some(self.motion.pose.position()) };
            let pose = self.ndt.fit(&self.settings.ndt, field, points, expected, start);
            return Fit::at(field, points, pose.unwrap_or(start));
        }
        GaussNewton::default().fit(field, points, prediction, start)
    }

    /// A wide search when the fit scores badly; true beside its result when that is better.
    fn rescue<F: ScoreField>(&mut self, field: &F, prediction: Pose, fit: Fit) -> (Fit, bool) {
        if fit.score >= self.settings.rescue.below * self.mean_score || self.points.len() < TELLING_POINTS {
            self.searched = None;
            return (fit, false);
        }
        let near =
            |at: Pose| at.distance_m(prediction) < SEARCH_AGAIN.0 && at.turn_rad(prediction) < SEARCH_AGAIN.1;
        if self.lost == 0 && self.searched.is_some_and(near) {
            return (fit, false);
        }
        self.searched = Some(prediction);
        let wider = f64::from(1 + self.lost.min(2));
        let window = window(prediction, (wider * RESCUE_REACH.0, wider * RESCUE_REACH.1));
        let mut search = std::mem::take(&mut self.search);
        let found =
            search.search(field, &self.points, window, (fit.pose, 0.5 * RESCUE_GAIN), RESCUE_CANDIDATES);
        let refined = found.iter().map(|(_, pose)| self.refine(field, *pose, *pose));
        let best = refined.max_by(|a, b| a.score.total_cmp(&b.score));
        self.search = search;
        match best {
            Some(best) if best.score > fit.score + RESCUE_GAIN => (best, true),
            _ => (fit, false),
        }
    }

    /// vinySLAM's matchers; beams that end outside the map at the first pose are left out.
    fn sampled<F: ScoreField>(&mut self, field: &F, prediction: Pose, scan: ScanView<'_>) -> Fit {
        self.points.retain(|point| field.covers(prediction.apply(*point)));
        self.weights.clear();
        self.weights.extend(self.points.iter().map(|point| beam_weight(*point)));
        let (points, weights) = (&self.points, &self.weights);
        let (pose, _) = match self.settings.strategy {
            Strategy::MonteCarlo => {
                let seed = self.settings.seed ^ scan.header().id.sequence.rotate_left(20);
                monte_carlo(field, points, weights, prediction, seed)
            }
            _ => hill_climbing(field, points, weights, prediction),
        };
        Fit::at(field, points, pose)
    }
}

fn window(center: Pose, (reach_m, reach_rad): (f64, f64)) -> Window {
    Window { center, reach_m, reach_rad }
}
