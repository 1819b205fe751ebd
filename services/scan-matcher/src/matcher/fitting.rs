//! How a scan is fitted: strategy, velocity, and what the fit is worth.

use super::POINTS_MIN_FOR_SHARE;
use super::fitted::Fitted;
use super::matcher_state::Confidence;
use super::open_place::{Open, is_held};
use super::points::{MoverMask, ScanPoints};
use super::surroundings::Surroundings;
use crate::prediction::{Coasting, Prediction, SLIP_COST};
use crate::settings::{Settings, Strategy};
use flockslam_evidence::Level;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Covariance, Point, Pose};
use flockslam_messages::ScanView;
use flockslam_odometry_noise::OdometryNoise;
use flockslam_published_methods::{beam_weight, hill_climbing, monte_carlo};
use flockslam_registration::{
    Correlative, CorrelativeSearch, Expected, Fit, GaussNewton, MotionState, Ndt, ScoreField, ScoreRead,
    Sweep, TwistSigma, Window, degenerate_direction, inflated_along, inflated_everywhere,
};
use nalgebra::Vector2;

/// Window of `correlative` around a prediction: what odometry misses between two scans, metres and radians.
const NEAR_REACH: (f64, f64) = (0.25, 0.2);
/// Window around the prediction of a scan without odometry: a robot that speeds up or turns in between two scans, metres and radians.
const BLIND_REACH: (f64, f64) = (0.3, 0.35);
/// Window of the wide search after a bad fit, metres and radians; it grows up to three times while the robot is lost.
const RESCUE_REACH: (f64, f64) = (0.6, 0.35);
/// Poses of a wide search that are refined: in alike corners the best on the lattice is not always the best.
const RESCUE_CANDIDATES: usize = 3;
/// A pose of a wide search is kept when its score is better by this, 0 … 1: with less, noise would make the pose jump.
const RESCUE_GAIN: f64 = 0.05;
/// A direction is degenerate when the surfaces of the scan face it less than this (mean squared cosine, 0 … ½):
/// along bare corridors and walls odometry is followed. Noise alone makes about as much.
const DEGENERATE_BELOW: f64 = 0.005;
/// A wide search without a result is repeated only after this much motion, metres and radians.
const SEARCH_AGAIN: (f64, f64) = (0.1, 0.1);
/// Odometry is rejected when the velocity so far leads to a fit that scores better by this, 0 … 1.
const JUMPED: f64 = 0.05;
/// How far the velocity during a scan may be from that of odometry before it: a robot that speeds up by 1 m/s² and turns in
/// by 5 rad/s² within a tenth of a second.
const TWIST_SIGMA: TwistSigma = TwistSigma { x_m_s: 0.1, y_m_s: 0.05, turn_rad_s: 0.5 };
/// The same where odometry goes on as it did: an absolute part, and a share of the velocity, as far as the scale of odometry is not known.
const STEADY_SIGMA: TwistSigma = TwistSigma { x_m_s: 0.01, y_m_s: 0.01, turn_rad_s: 0.02 };
const STEADY_SHARE: f64 = 0.02;
/// Steps at most to pose and velocity together.
const SWEEP_STEPS: usize = 8;
/// Steps to pose and velocity that lose so much of the score, 0 … 1, are taken back.
const SCORE_LOSS_MAX: f64 = 0.05;
/// Position of a wall within its cell is known to this share of the cell (standard deviation). All points of a wall along the grid
/// share that error, so it does not shrink with their number.
const CELL_ERROR: f64 = 0.1;
/// Without odometry the variance of a fit is doubled in a direction that few surfaces face (mean squared cosine below this), as along a
/// corridor with some doors: errors of fits there are alike from scan to scan.
const FEW_FACE: f64 = 0.08;
/// Least share of surfaces (mean squared cosine) that is assumed to face a direction.
const HELD_MIN: f64 = 1e-5;
/// Mean squared residual of a good fit at least: with less, single points would decide.
const NOISE_MIN: f64 = 0.1;
/// What the best of the poses of a wide search gains by chance: some thousand independent ones are tried.
const SEARCH_COST: f64 = 8.0;
/// What a scan of a place that never looks the same gains by chance when it is fitted.
const CHANCE_GAIN: f64 = 2.0;
/// Standard deviation of the heading if the robot goes on as before, radians.
const COASTING_SIGMA_RAD: f64 = 0.1;
/// A fit that costs less than this by odometry is not compared with the predicted pose: two standard deviations.
const PLAUSIBLE_COST: f64 = 2.0;
/// Standard deviations of the prediction in directions that the scan does not determine.
pub(super) const PRIOR_SIGMA: (f64, f64) = (0.3, 0.15);

/// A pose that explains the last scans better than the one that odometry gives, as when wheels slip for some scans.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alternative {
    /// In odom.
    pub(super) pose: Pose,
    /// The motion before the wheels slipped: it is assumed to go on.
    motion: Coasting,
    /// Logarithm of the ratio of the likelihoods of these scans at both.
    pub(super) gain: f64,
}

/// Memory of the strategies that is used again for each scan.
#[derive(Debug, Default)]
pub(super) struct Solvers {
    search: CorrelativeSearch,
    correlative: Correlative,
    ndt: Ndt,
    weights: Vec<f64>,
}

/// The inputs of a fit.
pub(super) struct Fitter<'a, F> {
    pub(super) settings: &'a Settings,
    pub(super) confidence: &'a Confidence,
    /// The pose of the scan before, in odom.
    pub(super) before: Pose,
    /// The alternative of that pose.
    pub(super) alternative: Option<Alternative>,
    pub(super) field: &'a F,
    pub(super) scan: ScanView<'a>,
    pub(super) mask: &'a MoverMask,
    /// Errors of odometry and of fits.
    pub(super) noise: &'a OdometryNoise,
    pub(super) solvers: &'a mut Solvers,
    pub(super) surroundings: &'a mut Surroundings,
}

/// A pose found by the strategy, before the velocity during the scan is fitted.
struct Placed {
    fit: Fit,
    is_rescued: bool,
    is_predicted: bool,
    searched: Option<Pose>,
}

/// A scan whose motion is decided: by odometry, or by the velocity so far.
struct Settled {
    prediction: Prediction,
    points: ScanPoints,
    /// The fit near the prediction, if it was made.
    near: Option<Fit>,
    alternative: Option<Alternative>,
}

/// Where a better pose is looked for after a bad fit to the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Search {
    /// In a wide window.
    Wide,
    /// Nowhere: the surfaces around hold the scan where it is.
    None,
}

impl<F: ScoreField> Fitter<'_, F> {
    /// Fits the points of the scan, which begin straightened by the velocity of the prediction.
    pub(super) fn fit(mut self, points: ScanPoints, prediction: Prediction) -> Fitted {
        let first = self.descends().then(|| self.track(&points, &prediction, None));
        let Some(poor) = first.filter(|first| !is_held(first, points.of_beams(self.scan.len()))) else {
            return self.fit_to_grid(points, prediction, first, Search::Wide);
        };
        match self.in_the_open(&points, prediction, poor) {
            Open::Held(held) => self.held(points, prediction, &held),
            Open::Dense(fit, from) => {
                let prediction = Prediction { pose: from, steady: None, ..prediction };
                self.fit_to_grid(points, prediction, Some(fit), Search::None)
            }
            Open::New(is_held) => {
                let search = if is_held { Search::None } else { Search::Wide };
                self.fit_to_grid(points, prediction, first, search)
            }
            // Outdoors odometry goes on: of a front that comes into sight a good part fits somewhere in a wide window.
            Open::Unknown => {
                let fitted = self.fit_to_grid(points, prediction, first, Search::None);
                if is_held(&fitted.fit, fitted.points.of_beams(self.scan.len())) {
                    fitted
                } else {
                    self.predicted(fitted, prediction)
                }
            }
        }
    }

    /// Fits the points to the grid; `first` is the strategy's descent from the prediction.
    fn fit_to_grid(
        &mut self,
        points: ScanPoints,
        prediction: Prediction,
        first: Option<Fit>,
        search: Search,
    ) -> Fitted {
        let Settled { prediction, points, near, alternative } = self.settled(points, prediction, first);
        let (mut near_pose, mut near_covariance) = (prediction.pose, prediction.covariance);
        let (points, placed) = if self.descends() {
            let near = near.unwrap_or_else(|| self.track(&points, &prediction, None));
            (near_pose, near_covariance) = (near.pose, near.covariance(PRIOR_SIGMA.0, PRIOR_SIGMA.1));
            let placed = self.rescue(&points, &prediction, near, search);
            (points, placed)
        } else {
            self.sampled(points, prediction.pose)
        };
        let Placed { fit, is_rescued, is_predicted, searched } = placed;
        let covariance = fit.covariance(PRIOR_SIGMA.0, PRIOR_SIGMA.1);
        let fitted = Fitted {
            is_rescued,
            is_predicted,
            searched,
            alternative,
            ..Fitted::new(prediction, points, fit, covariance)
        };
        if is_predicted {
            let claimed = self.claimed(near_covariance, &fitted.points, near_pose);
            return Fitted { covariance: prediction.covariance, alone: Some((near_pose, claimed)), ..fitted };
        }
        self.with_velocity(fitted)
    }

    /// A fit of the pose alone with the velocity during the scan, weighed against odometry.
    pub(super) fn with_velocity(&self, fitted: Fitted) -> Fitted {
        let fits_velocity = self.descends() && self.settings.fits_velocity && self.scan.takes_time();
        let fitted = if fits_velocity { self.straightened(fitted) } else { fitted };
        self.weighed(fitted)
    }

    /// Decides between odometry and velocity where they contradict each other: the better fit wins, and is
    /// returned too.
    fn settled(&mut self, points: ScanPoints, prediction: Prediction, first: Option<Fit>) -> Settled {
        let Some(by_odometry) = first else {
            return Settled { prediction, points, near: None, alternative: None };
        };
        let Some(steady) = prediction.steady else {
            return self.slipped(points, prediction, by_odometry);
        };
        let points = points.straightened(steady.twist);
        let by_velocity = self.refine(&points, steady.pose, steady.pose);
        if by_velocity.score > by_odometry.score + JUMPED
            && self.gain(&by_velocity, &by_odometry) >= SLIP_COST
        {
            let prediction =
                Prediction { pose: steady.pose, twist: steady.twist, measured: None, ..prediction };
            let near = self.track(&points, &prediction, Some(by_velocity));
            return Settled { prediction, points, near: Some(near), alternative: None };
        }
        let points = points.straightened(prediction.twist);
        Settled { prediction, points, near: Some(by_odometry), alternative: None }
    }

    /// Whether the strategy goes down a slope, as opposed to trying poses.
    fn descends(&self) -> bool {
        !matches!(self.settings.strategy, Strategy::MonteCarlo | Strategy::HillClimbing)
    }

    /// Whether fits and odometry are weighed against each other. The published methods accept their fits.
    fn weighs_odometry(&self) -> bool {
        let is_ours = matches!(self.settings.strategy, Strategy::GaussNewton | Strategy::Correlative);
        is_ours && self.scan.odometry().is_some()
    }

    /// Fits pose and velocity of a scan that takes time together, starting at a fit of its pose alone. Where the map is thin the steps
    /// can go wrong: the fit of the pose alone stays if it explains the scan clearly better.
    fn straightened(&self, fitted: Fitted) -> Fitted {
        let Prediction { pose, twist, .. } = fitted.prediction;
        let predicted = MotionState { pose, twist };
        let sigma = self.twist_sigma(&fitted.prediction);
        let mut now = MotionState { pose: fitted.fit.pose, twist };
        let mut points = fitted.points;
        for _ in 0..SWEEP_STEPS {
            let next = sweep(&points).step(self.field, now, predicted, sigma);
            points = points.straightened(next.twist);
            let settled = next.is_near(now);
            now = next;
            if settled {
                break;
            }
        }
        let fit = Fit::at(self.field, &points.ends, now.pose);
        if fit.score < fitted.fit.score - SCORE_LOSS_MAX {
            return Fitted { points: points.straightened(twist), ..fitted };
        }
        let covariance = sweep(&points).covariance(self.field, now.pose, sigma, PRIOR_SIGMA);
        Fitted { points, fit, twist: now.twist, covariance, ..fitted }
    }

    /// How far the velocity during the scan may be from the predicted one: a robot whose odometry goes on as before keeps its velocity.
    /// Without odometry nothing says that it does.
    fn twist_sigma(&self, prediction: &Prediction) -> TwistSigma {
        if let Some(sigma) = prediction.measured {
            return sigma;
        }
        let Some(coasting) = prediction.coasting.filter(|_| self.scan.odometry().is_some()) else {
            return TWIST_SIGMA;
        };
        let (now, before) = (prediction.twist, coasting.twist);
        let (least, most) = (STEADY_SIGMA, TWIST_SIGMA);
        let by = |now: f64, before: f64, least: f64, most: f64| {
            (least + STEADY_SHARE * now.abs() + (now - before).abs()).min(most)
        };
        TwistSigma {
            x_m_s: by(now.x_m_s, before.x_m_s, least.x_m_s, most.x_m_s),
            y_m_s: by(now.y_m_s, before.y_m_s, least.y_m_s, most.y_m_s),
            turn_rad_s: by(now.turn_rad_s, before.turn_rad_s, least.turn_rad_s, most.turn_rad_s),
        }
    }

    /// The covariance of a fit: large where the scan determines little; there the fit is fused with the prediction.
    fn weighed(&self, fitted: Fitted) -> Fitted {
        let claimed = self.claimed(fitted.covariance, &fitted.points, fitted.fit.pose);
        let has_odometry = self.scan.odometry().is_some() && !fitted.prediction.is_coasting;
        let covariance = if has_odometry {
            self.noise.inflated(claimed)
        } else {
            inflated_without_odometry(claimed, &fitted.points.ends, fitted.fit.pose)
        };
        if fitted.is_rescued {
            return Fitted { covariance, ..fitted };
        }
        let alone = self.weighs_odometry().then_some((fitted.fit.pose, claimed));
        let fused = fitted.prediction.fused(fitted.fit.pose, covariance);
        let Some((pose, covariance)) = fused else { return Fitted { covariance, alone, ..fitted } };
        let fit = Fit::at(self.field, &fitted.points.ends, pose);
        Fitted { fit, covariance, alone, is_fused: true, ..fitted }
    }

    /// The covariance of a fit as its points claim it.
    fn claimed(&self, covariance: Covariance, points: &ScanPoints, pose: Pose) -> Covariance {
        let cell_m = self.field.reader(Level::Full).cell_size_m();
        let rough = inflated_everywhere(covariance, CELL_ERROR * cell_m);
        inflated(rough, &points.ends, pose)
    }

    /// The fit near the prediction; a scan without odometry is looked for before. `near` is the strategy's descent from there, when it
    /// was made already.
    fn track(&mut self, points: &ScanPoints, by_motion: &Prediction, near: Option<Fit>) -> Fit {
        let (ends, prediction) = (&points.ends, by_motion.pose);
        if self.settings.strategy == Strategy::Correlative {
            return self.solvers.correlative.fit(self.field, ends, window(prediction, NEAR_REACH));
        }
        let fit = near.unwrap_or_else(|| self.refine(points, prediction, prediction));
        if self.scan.odometry().is_some() {
            return fit;
        }
        let found =
            self.solvers.correlative.search(self.field, ends, window(prediction, BLIND_REACH), fit.pose);
        let other = found.map(|(_, start)| self.refine(points, start, start));
        let is_better =
            |other: &Fit| self.gain(other, &fit) > by_motion.cost(other.pose) - by_motion.cost(fit.pose);
        other.filter(is_better).unwrap_or(fit)
    }

    /// The strategy's own descent from `start`.
    pub(super) fn refine(&mut self, points: &ScanPoints, prediction: Pose, start: Pose) -> Fit {
        let ends = &points.ends;
        if self.settings.strategy == Strategy::Ndt {
            let expected = Expected { pose: prediction, from: Some(self.before.position()) };
            let pose = self.solvers.ndt.fit(&self.settings.ndt, self.field, ends, expected, start);
            return Fit::at(self.field, ends, pose.unwrap_or(start));
        }
        GaussNewton::default().fit(self.field, ends, prediction, start)
    }

    /// A wide search when the fit scores badly, which gives its best pose when that is better.
    fn rescue(&mut self, points: &ScanPoints, by_motion: &Prediction, near: Fit, search: Search) -> Placed {
        let Confidence { mean_score, lost, searched, .. } = *self.confidence;
        let prediction = by_motion.pose;
        let (fit, is_predicted) = self.plausible(points, by_motion, near);
        let is_poor = near.score < self.settings.rescue.below * mean_score;
        let proves_nothing = self.confidence.scatters() && self.scan.odometry().is_some();
        if search == Search::None || !is_poor || proves_nothing || points.len() < POINTS_MIN_FOR_SHARE {
            return Placed { fit, is_rescued: false, is_predicted, searched: None };
        }
        let near =
            |at: Pose| at.distance_m(prediction) < SEARCH_AGAIN.0 && at.turn_rad(prediction) < SEARCH_AGAIN.1;
        if lost == 0 && searched.is_some_and(near) {
            return Placed { fit, is_rescued: false, is_predicted, searched };
        }
        let wider = f64::from(1 + lost.min(2));
        let window = window(prediction, (wider * RESCUE_REACH.0, wider * RESCUE_REACH.1));
        let best = self.search(points, window, fit.pose);
        let better = best.filter(|best| {
            best.score > fit.score + RESCUE_GAIN && self.outweighs_widely(by_motion, best, &fit)
        });
        Placed {
            fit: better.unwrap_or(fit),
            is_rescued: better.is_some(),
            is_predicted: is_predicted && better.is_none(),
            searched: Some(prediction),
        }
    }

    /// The fit, or the scan at the predicted pose where the fit is too improbable by odometry for what it explains, and whether it
    /// is that.
    fn plausible(&self, points: &ScanPoints, by_motion: &Prediction, fit: Fit) -> (Fit, bool) {
        if !self.weighs_odometry() || by_motion.cost(fit.pose) < PLAUSIBLE_COST {
            return (fit, false);
        }
        let expected = Fit::at(self.field, &points.ends, by_motion.pose);
        if self.outweighs(by_motion, &fit, &expected) { (fit, false) } else { (expected, true) }
    }

    /// Whether wheels slip: a scan that fits badly where odometry says is tried where the robot would be if it had gone on as
    /// before. The evidence of several scans adds up in an [`Alternative`].
    fn slipped(&mut self, points: ScanPoints, prediction: Prediction, near: Fit) -> Settled {
        let is_poor = near.score < self.settings.rescue.below * self.confidence.mean_score;
        let asks = self.weighs_odometry() && self.confidence.has_started();
        let Some(coasting) = prediction.coasting.filter(|_| is_poor && asks) else {
            return Settled { prediction, points, near: Some(near), alternative: None };
        };
        let Alternative { pose, motion, gain } =
            self.alternative.unwrap_or(Alternative { pose: self.before, motion: coasting, gain: 0.0 });
        let start = pose * motion.pose;
        let points = points.straightened(motion.twist);
        let fit = self.refine(&points, start, start);
        let is_good = fit.score >= self.settings.rescue.below * self.confidence.mean_score;
        let gained = if is_good { self.gain(&fit, &near) } else { self.gain_of_poor(&fit, &near) };
        let gain = gain + gained - CHANCE_GAIN;
        if gain >= SLIP_COST {
            let covariance = Covariance::diagonal(coasting.sigma_m, COASTING_SIGMA_RAD);
            let prediction =
                Prediction { pose: start, twist: motion.twist, covariance, is_coasting: true, ..prediction };
            return Settled { prediction, points, near: Some(fit), alternative: None };
        }
        let points = points.straightened(prediction.twist);
        let alternative =
            Some(Alternative { pose: fit.pose, motion, gain }).filter(|alternative| alternative.gain > 0.0);
        Settled { prediction, points, near: Some(near), alternative }
    }

    /// Whether a pose explains the scan so much better than another that the odometry may have been wrong: the ratio of the
    /// likelihoods of the scan against that of the poses.
    fn outweighs(&self, by_motion: &Prediction, fit: &Fit, other: &Fit) -> bool {
        !self.weighs_odometry()
            || self.gain(fit, other) >= by_motion.cost(fit.pose) - by_motion.cost(other.pose)
    }

    /// The same of a pose that was the best of many.
    fn outweighs_widely(&self, by_motion: &Prediction, fit: &Fit, other: &Fit) -> bool {
        !self.weighs_odometry()
            || self.gain(fit, other) - SEARCH_COST >= by_motion.cost(fit.pose) - by_motion.cost(other.pose)
    }

    /// How much better a fit explains the scan than another, as the logarithm of the ratio of likelihoods.
    pub(super) fn gain(&self, fit: &Fit, other: &Fit) -> f64 {
        fit.gain_over(other, self.confidence.noise.max(NOISE_MIN)) / self.noise.excess()
    }

    /// The same of a fit that is poor itself. Where the scan fits nowhere, as behind a door, a few points that happen to lie on something are
    /// no evidence: they weigh by how far off its other points are.
    pub(super) fn gain_of_poor(&self, fit: &Fit, other: &Fit) -> f64 {
        fit.gain_over(other, self.confidence.noise.max(NOISE_MIN).max(fit.noise)) / self.noise.excess()
    }

    /// The best of the poses in a window, each refined, whose bound exceeds that of `alternative`.
    fn search(&mut self, points: &ScanPoints, window: Window, alternative: Pose) -> Option<Fit> {
        let mut search = std::mem::take(&mut self.solvers.search);
        let floor = (alternative, 0.5 * RESCUE_GAIN);
        let found = search.search(self.field, &points.ends, window, floor, RESCUE_CANDIDATES);
        let refined = found.iter().map(|(_, pose)| self.refine(points, *pose, *pose));
        let best = refined.max_by(|a, b| a.score.total_cmp(&b.score));
        self.solvers.search = search;
        best
    }

    /// vinySLAM's matchers; beams that end outside the map at the first pose are left out.
    fn sampled(&mut self, points: ScanPoints, prediction: Pose) -> (ScanPoints, Placed) {
        let field = self.field;
        let points = points.kept(|_, end| field.covers(prediction.apply(end)));
        let (ends, weights) = (&points.ends, &mut self.solvers.weights);
        weights.clear();
        weights.extend(ends.iter().map(|end| beam_weight(*end)));
        let (pose, _) = match self.settings.strategy {
            Strategy::MonteCarlo => {
                let seed = self.settings.seed ^ self.scan.header().id.sequence.rotate_left(20);
                monte_carlo(field, ends, weights, prediction, seed)
            }
            _ => hill_climbing(field, ends, weights, prediction),
        };
        let fit = Fit::at(field, ends, pose);
        let searched = self.confidence.searched;
        (points, Placed { fit, is_rescued: false, is_predicted: false, searched })
    }
}

fn sweep(points: &ScanPoints) -> Sweep<'_> {
    Sweep { points: &points.ends, times_s: &points.times_s }
}

fn window(center: Pose, (reach_m, reach_rad): (f64, f64)) -> Window {
    Window { center, reach_m, reach_rad }
}

/// A fit's covariance, inflated along the direction that the scan's surfaces leave open: single cells along a bare wall
/// have slopes, which hold nothing.
fn inflated(covariance: Covariance, points: &[Point], pose: Pose) -> Covariance {
    let Some((held, axis)) = open_direction(points, pose) else { return covariance };
    let across = variance_along(covariance, Vector2::new(-axis.y, axis.x));
    let seen = (held - DEGENERATE_BELOW).max(HELD_MIN);
    let missing = across * (1.0 - held) / seen - variance_along(covariance, axis);
    if missing > 0.0 { inflated_along(covariance, axis, missing.sqrt()) } else { covariance }
}

/// The covariance of a fit without odometry, inflated along a direction that few surfaces face.
fn inflated_without_odometry(covariance: Covariance, points: &[Point], pose: Pose) -> Covariance {
    let Some((_, axis)) = open_direction(points, pose).filter(|(held, _)| *held < FEW_FACE) else {
        return covariance;
    };
    inflated_along(covariance, axis, variance_along(covariance, axis).sqrt())
}

/// The direction that the scan's surfaces leave open, turned by the heading of the pose, and the share that faces it.
fn open_direction(points: &[Point], pose: Pose) -> Option<(f64, Vector2<f64>)> {
    let (held, axis) = degenerate_direction(points)?;
    let (sin, cos) = sin_cos(pose.heading_rad);
    Some((held, Vector2::new(cos * axis.x - sin * axis.y, sin * axis.x + cos * axis.y)))
}

/// Variance of a position along a direction, m².
fn variance_along(covariance: Covariance, axis: Vector2<f64>) -> f64 {
    let Covariance { xx, xy, yy, .. } = covariance;
    axis.x * axis.x * xx + 2.0 * axis.x * axis.y * xy + axis.y * axis.y * yy
}
