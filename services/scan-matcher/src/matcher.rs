//! The logic of the stage: takes a scan, its verdict and the grid, gives a pose with its covariance and quality.
//!
//! [`ScanMatcher::handle`] is the whole path of a scan. Its steps pass values on: [`Prediction`],
//! [`ScanPoints`], [`MoverMask`], [`Fitted`], [`MatchResult`].

use crate::motion::Motion;
use crate::prediction::Prediction;
use crate::settings::{Settings, Strategy};
use fit_acceptance::MatchResult;
use fitted::Fitted;
use fitting::{Fitter, Solvers};
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::Pose;
use flockslam_messages::{
    BeamRange, Commit, Correction, DropReason, FlockRobots, PoseEstimate, PoseFlags, Quality,
    STARTS_DETACHED, ScanView, Verdict,
};
use flockslam_registration::GridField;
use kidnap_detector::KidnapDetector;
use light_fit::{LIGHT_BEAMS, Light};
use matcher_state::{Confidence, MapState};
use open_place::fused_covariance;
use points::{MoverMask, ScanPoints};
use std::ops::Deref;
use surroundings::Surroundings;

/// A scan with fewer points than this is not matched.
const POINTS_MIN: usize = 5;
/// With fewer points than this places cannot be distinguished: no wide search, and no proof that the robot is lost.
const POINTS_MIN_FOR_SHARE: usize = 30;
/// Of scans with more beams than this only every n-th beam is matched: the cost of a fit is bounded.
const BEAMS_MAX: usize = 1000;
/// The first scans of a run are never dropped: before, the map is too thin for a meaningful running mean of the scores.
const START_SCANS: u64 = 10;
/// A drop is overruled when the standard deviation of the predicted position exceeds this, metres: a sixth of the reach of
/// the wide search, so that the robot is well within it.
const SIGMA_MAX_M: f64 = 0.1;
/// Weight of the newest score in the running mean: the mean adapts within some fifty scans, and no single bad score spoils it.
const MEAN_RATE: f64 = 0.02;
/// A fit that claims at most this standard deviation of the position, metres, shows the errors of odometry and of fits.
const CERTAIN_SIGMA_M: f64 = 0.1;
/// Surroundings whose scans fit better than this in the mean, 0 … 1, are recognised: a robot that is lost there was kidnapped.
const RECOGNISABLE: f64 = 0.4;
/// Odometry that misses a fit by more than this means that wheels slip: metres and radians.
const SLIPPED: (f64, f64) = (0.15, 0.08);

mod bodies;
mod fit_acceptance;
mod fitted;
mod fitting;
mod flock_robots;
mod kidnap_detector;
mod light_fit;
mod matcher_state;
mod movers;
mod open_place;
mod points;
mod slip_watch;
mod surroundings;

/// Fits scans to the grid. A pure function of its calls.
#[derive(Debug)]
pub struct ScanMatcher {
    settings: Settings,
    /// How the robot moves.
    motion: Motion,
    /// The map that it moves in.
    map: MapState,
    /// How well the robot is localised.
    confidence: Confidence,
    /// The surfaces that the last scans have shown.
    surroundings: Surroundings,
    /// Points of the last scans, for the detection of a kidnapping.
    kidnap: KidnapDetector,
    /// Published poses of other robots.
    flock_robots: FlockRobots,
    buffers: Buffers,
}

/// Buffers that are used again for each scan: taken at its first step and given back at its last. The mask of the last scan stays
/// readable.
#[derive(Debug, Default)]
struct Buffers {
    points: ScanPoints,
    mask: MoverMask,
    solvers: Solvers,
}

/// Whether a scan is matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// No: its pose is the predicted one.
    None,
    /// The filter has kept it.
    Kept,
    /// The filter has dropped it, but it is needed nevertheless.
    Overridden,
}

impl ScanMatcher {
    /// A matcher at the origin of its odom frame.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            motion: Motion::new(),
            map: MapState::new(),
            confidence: Confidence::default(),
            surroundings: Surroundings::default(),
            kidnap: KidnapDetector::default(),
            flock_robots: FlockRobots::default(),
            buffers: Buffers::default(),
        }
    }

    /// The pose of a scan against the grid as it was last committed.
    pub fn handle<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        verdict: &Verdict,
        grid: &TileGrid<H>,
    ) -> PoseEstimate {
        self.buffers.mask.clear();
        self.begin_where(scan);
        let prediction = self.predict(scan);
        let prediction = self.watched(scan, prediction);
        let need = self.need(scan, verdict, &prediction);
        let predicted = self.predicted(scan, verdict, &prediction, need);
        if need == Need::None {
            let predicted = self.lightly_fitted(scan, verdict, predicted, &prediction, grid);
            return self.followed(scan, predicted);
        }
        let points = self.points(scan, &prediction);
        if points.len() < POINTS_MIN && self.confidence.is_in_the_open() && !self.map.begins_detached {
            self.buffers.points = points;
            return self.among_few_things(scan, predicted, &prediction);
        }
        if points.len() < POINTS_MIN || grid.is_empty() || self.map.begins_detached {
            return self.unmatched(scan, predicted, points, grid.is_empty());
        }
        self.kidnap.sees(scan, &points);
        let (points, mask) = self.mask_movers(scan, points, &prediction, grid);
        let fitted = self.fit(scan, points, &mask, prediction, grid);
        let is_kidnapped = self.is_kidnapped(scan, &fitted);
        let match_result = self.assess(&fitted, &mask, grid, is_kidnapped);
        self.update(scan, predicted, fitted, mask, match_result)
    }

    /// The beams of the last scan that were not matched because they lie on moving bodies, in order.
    pub fn moving_beams(&self) -> &[BeamRange] {
        &self.buffers.mask.moving
    }

    /// A generation of the grid became valid.
    pub fn committed(&mut self, commit: &Commit) {
        self.map.generation = commit.generation;
        self.map.active_submap = commit.active_submap;
    }

    /// Poses of other robots have arrived.
    pub fn set_flock_robots(&mut self, robots: &FlockRobots) {
        self.flock_robots = *robots;
    }

    /// sync-manager has a new correction.
    pub fn corrected(&mut self, correction: &Correction) {
        self.map.map_from_odom = correction.map_from_odom;
        self.map.corrections = correction.revision;
        if correction.trajectory == self.map.trajectory {
            self.map.detached = correction.attached == 0;
        }
    }

    /// Takes in a pose that a predecessor has published, all in order, before [`Self::resume`]: without knowing how well scans usually fit
    /// here, no fit can be called poor.
    pub fn restore(&mut self, published: &PoseEstimate) {
        if published.trajectory != self.map.trajectory {
            self.confidence.begin_anew();
            self.map.trajectory = published.trajectory;
        }
        self.confidence.restore(published, self.motion.pose);
        self.motion.restore(published);
    }

    /// Continues, after a restart, from the last pose that was published.
    pub fn resume(&mut self, last: &PoseEstimate) {
        self.motion.resume(last);
        self.map.resume(last);
        if self.confidence.matched == 0 {
            (self.confidence.mean_score, self.confidence.last_score) = (last.score, last.score);
        }
    }

    /// Continues a saved map: the robot may be anywhere by now, so a new trajectory begins at its next scan, which a closure
    /// may attach.
    pub fn resume_detached(&mut self, last: &PoseEstimate) {
        self.resume(last);
        self.motion.resume_detached(last);
        self.map.trajectory = last.trajectory + 1;
        (self.map.detached, self.map.begins_detached, self.map.inserted) = (true, true, None);
        (self.confidence.mean_score, self.confidence.last_score) = (0.0, 0.0);
    }

    /// Where nothing connects a scan with the one before, a new trajectory begins, which a closure may attach.
    fn begin_where(&mut self, scan: ScanView<'_>) {
        if scan.header().starts_at_odometry != STARTS_DETACHED {
            return;
        }
        self.motion.break_off();
        self.confidence.begin_anew();
        self.surroundings.clear();
        self.kidnap.clear();
        self.map.trajectory += 1;
        (self.map.detached, self.map.begins_detached, self.map.inserted) = (true, true, None);
    }

    /// The pose of a scan by odometry alone, for when no grid can be matched.
    pub fn follow_odometry(&mut self, scan: ScanView<'_>) -> PoseEstimate {
        self.begin_where(scan);
        let header = scan.header();
        let verdict = Verdict { id: header.id, times: header.times, ..Verdict::default() };
        let prediction = self.predict(scan);
        let predicted = self.predicted(scan, &verdict, &prediction, Need::None);
        self.followed(scan, PoseEstimate { quality: Quality::Degraded as u32, ..predicted })
    }

    /// The predicted pose of the robot at this scan.
    fn predict(&self, scan: ScanView<'_>) -> Prediction {
        let prediction = self.motion.predict(scan);
        // Without a search odometry alone gives the start of the fit.
        let steady = prediction.steady.filter(|_| self.settings.rescue.below != 0.0);
        Prediction { steady, ..prediction }
    }

    /// The prediction, unless in the open the scans since say that wheels have slipped.
    fn watched(&mut self, scan: ScanView<'_>, prediction: Prediction) -> Prediction {
        if self.confidence.is_in_the_open() && self.settings.strategy == Strategy::GaussNewton {
            return self.surroundings.watched(scan, prediction);
        }
        self.surroundings.unwatched();
        prediction
    }

    fn need(&self, scan: ScanView<'_>, verdict: &Verdict, prediction: &Prediction) -> Need {
        let withheld = scan.header().withheld == 1;
        match (withheld, verdict.keep == 0) {
            (false, false) => Need::Kept,
            (false, true) if self.overrules(scan, prediction) => Need::Overridden,
            _ => Need::None,
        }
    }

    /// Whether a dropped scan is needed nevertheless.
    fn overrules(&self, scan: ScanView<'_>, prediction: &Prediction) -> bool {
        let Confidence { last_score, mean_score, slips, .. } = self.confidence;
        let variance = SIGMA_MAX_M * SIGMA_MAX_M;
        !self.confidence.has_started()
            || scan.odometry().is_none()
            || prediction.steady.is_some()
            || slips
            || self.surroundings.are_undecided()
            || last_score < self.settings.rescue.below * mean_score
            || prediction.covariance.xx.max(prediction.covariance.yy) > variance
    }

    /// The scan's pose as it is predicted.
    fn predicted(
        &self,
        scan: ScanView<'_>,
        verdict: &Verdict,
        prediction: &Prediction,
        need: Need,
    ) -> PoseEstimate {
        let header = scan.header();
        let has_odometry = if scan.odometry().is_some() { PoseFlags::HAS_ODOMETRY } else { 0 };
        let overridden = if need == Need::Overridden { PoseFlags::OVERRIDDEN } else { 0 };
        PoseEstimate {
            id: header.id,
            times: header.times,
            odom_from_base: prediction.pose,
            map_from_odom: self.map.map_from_odom,
            odometry: scan.odometry().unwrap_or(Pose::IDENTITY),
            covariance: prediction.covariance,
            twist: prediction.twist,
            generation: self.map.generation,
            submap: self.map.active_submap,
            corrections: self.map.corrections,
            flags: has_odometry | overridden,
            drop_reason: verdict.drop_reason(),
            trajectory: self.map.trajectory,
            ..PoseEstimate::default()
        }
    }

    /// The points of the scan, straightened by the predicted velocity. The grid has a wall that beams graze as single points, which pull a
    /// scan to where the robot stood when they entered; without odometry that adds up, and the robot seems to stand.
    fn points(&mut self, scan: ScanView<'_>, prediction: &Prediction) -> ScanPoints {
        let memory = std::mem::take(&mut self.buffers.points);
        let points = memory.retaken(scan, prediction.twist, &self.buffers.mask, &self.settings);
        if scan.odometry().is_some() { points } else { points.without_grazing() }
    }

    /// A scan that is needed but not matched, as it has too few points, or is the first one of a map or of a trajectory.
    fn unmatched(
        &mut self,
        scan: ScanView<'_>,
        predicted: PoseEstimate,
        points: ScanPoints,
        grid_is_empty: bool,
    ) -> PoseEstimate {
        // After a restart the grid may arrive late. A scan inserted without it would be placed by odometry alone.
        let grid_is_missing = grid_is_empty && self.map.generation > 0 && !self.map.begins_detached;
        let is_blind = points.len() < POINTS_MIN;
        self.buffers.points = points;
        if grid_is_missing {
            // Nothing has shown whether odometry is right: the next scan is predicted from where the robot was known to be.
            return PoseEstimate { quality: Quality::Degraded as u32, ..predicted };
        }
        if is_blind {
            return self.followed(scan, PoseEstimate { quality: Quality::Degraded as u32, ..predicted });
        }
        self.map.begins_detached = false;
        let quality = if self.map.detached { Quality::Degraded } else { Quality::Tracking } as u32;
        self.inserted(scan, PoseEstimate { quality, ..predicted })
    }

    /// A scan in the open that has too few points for a grid: a tree or two may hold it beside odometry. It does not enter the grid.
    fn among_few_things(
        &mut self,
        scan: ScanView<'_>,
        predicted: PoseEstimate,
        prediction: &Prediction,
    ) -> PoseEstimate {
        let quality = Quality::Degraded as u32;
        let mask = std::mem::take(&mut self.buffers.mask);
        let held = self.surroundings.fit(scan, &mask, prediction);
        let held = held.map_or((prediction.pose, prediction.covariance), |held| {
            (held.pose, fused_covariance(prediction.covariance, held.information))
        });
        let (odom_from_base, covariance) = held;
        self.surroundings.add_apart(scan, &mask, odom_from_base, predicted.twist);
        self.buffers.mask = mask;
        self.followed(scan, PoseEstimate { odom_from_base, covariance, quality, ..predicted })
    }

    /// The pose of a scan that the filter dropped, by few of its beams where the grid holds scans.
    fn lightly_fitted<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        verdict: &Verdict,
        predicted: PoseEstimate,
        prediction: &Prediction,
        grid: &TileGrid<H>,
    ) -> PoseEstimate {
        let is_ours = matches!(self.settings.strategy, Strategy::GaussNewton | Strategy::Correlative);
        // Without odometry a robot that creeps looks as if it stood.
        let stands = verdict.drop_reason() == DropReason::Unchanged as u32 && scan.odometry().is_some();
        let is_asked = verdict.keep == 0 && scan.header().withheld == 0 && !stands && is_ours;
        let is_held = self.confidence.has_started() && !self.confidence.is_in_the_open();
        if !is_asked || !is_held || grid.is_empty() || self.map.begins_detached {
            return predicted;
        }
        let memory = std::mem::take(&mut self.buffers.points);
        let mask = std::mem::take(&mut self.buffers.mask);
        let points = memory.thinned(scan, prediction.twist, &mask, self.settings.range_max_m, LIGHT_BEAMS);
        let field = GridField::new(grid, self.map.unknown_score);
        let (points, light) = self.fitter(scan, &mask, &field).lightly(points, *prediction);
        (self.buffers.points, self.buffers.mask) = (points, mask);
        light.map_or(predicted, |Light { pose, twist, covariance }| PoseEstimate {
            odom_from_base: pose,
            twist,
            covariance,
            ..predicted
        })
    }

    fn fit<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        points: ScanPoints,
        mask: &MoverMask,
        prediction: Prediction,
        grid: &TileGrid<H>,
    ) -> Fitted {
        let field = GridField::new(grid, self.map.unknown_score);
        self.fitter(scan, mask, &field).fit(points, prediction)
    }

    fn fitter<'a, F>(&'a mut self, scan: ScanView<'a>, mask: &'a MoverMask, field: &'a F) -> Fitter<'a, F> {
        Fitter {
            settings: &self.settings,
            confidence: &self.confidence,
            before: self.motion.pose,
            alternative: self.confidence.alternative,
            field,
            scan,
            mask,
            noise: self.motion.noise(),
            solvers: &mut self.buffers.solvers,
            surroundings: &mut self.surroundings,
        }
    }

    /// Updates the state for the next scan.
    fn update(
        &mut self,
        scan: ScanView<'_>,
        predicted: PoseEstimate,
        fitted: Fitted,
        mask: MoverMask,
        match_result: MatchResult,
    ) -> PoseEstimate {
        self.confidence.count(&fitted, &match_result, self.motion.pose, scan.len());
        if let Some((pose, claimed)) = fitted.alone.filter(|(_, c)| c.position_std_m() <= CERTAIN_SIGMA_M) {
            self.motion.learn(scan, pose, claimed);
        }
        if let Some((held, _)) = fitted.alone.filter(|_| fitted.is_open && scan.odometry().is_some()) {
            self.motion.learn_scale(fitted.prediction.pose, held);
        }
        let is_certain = fitted.covariance.position_std_m() <= CERTAIN_SIGMA_M && !fitted.is_rescued;
        if scan.odometry().is_none() && is_certain && match_result.quality == Quality::Tracking {
            self.motion.learn_velocity(fitted.prediction.pose, fitted.fit.pose);
        }
        let estimate = self.matched(predicted, &fitted, &match_result);
        if match_result.quality != Quality::Lost {
            self.kidnap.explains(estimate.odom_from_base);
        }
        (self.buffers.points, self.buffers.mask) = (fitted.points, mask);
        let stays_lost = self.confidence.lost > self.settings.rescue.lost_scans_max;
        let estimate = if stays_lost { self.begun_trajectory(estimate) } else { estimate };
        self.inserted(scan, estimate)
    }

    /// The predicted pose updated by a fit; a rejected fit gives only its score and velocity.
    fn matched(&self, predicted: PoseEstimate, fitted: &Fitted, match_result: &MatchResult) -> PoseEstimate {
        let MatchResult { pose, twist, covariance, quality } = *match_result;
        let guessed = self.map.detached && quality == Quality::Tracking;
        let published = if guessed { Quality::Degraded } else { quality } as u32;
        let estimate = PoseEstimate { score: fitted.fit.score, twist, quality: published, ..predicted };
        if quality == Quality::Lost {
            return estimate;
        }
        let rescued = if fitted.is_rescued { PoseFlags::RESCUED } else { 0 };
        let open = if fitted.is_open || self.confidence.is_far_in_the_open() { PoseFlags::OPEN } else { 0 };
        let flags = estimate.flags | PoseFlags::MATCHED | rescued | open;
        PoseEstimate { odom_from_base: pose, covariance, flags, ..estimate }
    }

    /// A robot that stays lost begins a new trajectory at its predicted pose. The map is left as it is, and a closure may
    /// connect the two.
    fn begun_trajectory(&mut self, estimate: PoseEstimate) -> PoseEstimate {
        // Where scans usually fit, one place after the other that does not means that odometry is wrong. In the open it means as well
        // that the robot has drifted, and what contradicts its scans is an old part of the map.
        let is_hard = self.confidence.mean_score < RECOGNISABLE || self.confidence.is_in_the_open();
        let continues = estimate.has(PoseFlags::HAS_ODOMETRY) && is_hard && !self.kidnap.is_likely();
        let flags = estimate.flags | if continues { PoseFlags::CONTINUES } else { 0 };
        self.confidence.begin_anew();
        self.surroundings.clear();
        self.kidnap.clear();
        self.map.trajectory += 1;
        (self.map.detached, self.map.inserted) = (true, None);
        let quality = Quality::Degraded as u32;
        PoseEstimate { trajectory: self.map.trajectory, quality, flags, ..estimate }
    }

    /// The robot has moved to here.
    fn followed(&mut self, scan: ScanView<'_>, estimate: PoseEstimate) -> PoseEstimate {
        self.motion.advance(scan, &estimate);
        self.surroundings.placed(scan, estimate.odom_from_base);
        estimate
    }

    /// The robot has moved to here, and its scan enters the map if it should.
    fn inserted(&mut self, scan: ScanView<'_>, estimate: PoseEstimate) -> PoseEstimate {
        let estimate = self.followed(scan, estimate);
        if !self.enters_map(&estimate) {
            return estimate;
        }
        self.map.inserted = Some(estimate.odom_from_base);
        self.surroundings.add(scan, &self.buffers.mask, estimate.odom_from_base, estimate.twist);
        PoseEstimate { flags: estimate.flags | PoseFlags::INSERT, ..estimate }
    }

    fn enters_map(&self, estimate: &PoseEstimate) -> bool {
        if estimate.quality == Quality::Lost as u32 {
            return false;
        }
        let Some(last) = self.map.inserted else { return true };
        let gate = &self.settings.gate;
        let pose = estimate.odom_from_base;
        last.distance_m(pose) >= gate.travel_m || last.turn_rad(pose) >= gate.turn_rad
    }
}

#[cfg(test)]
mod corridor;
#[cfg(test)]
mod restart;
#[cfg(test)]
mod tests;
