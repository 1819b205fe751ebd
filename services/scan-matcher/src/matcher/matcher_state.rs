//! The state that the matcher keeps from scan to scan: the map, and how well the robot is localised in it.

use super::ScanMatcher;
use super::fitting::Alternative;
use super::open_place::{DENSE, is_held};
use super::{Fitted, MEAN_RATE, MatchResult, POINTS_MIN_FOR_SHARE, SLIPPED, START_SCANS};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, Quality};

/// Weight of the newest fit in the mean of the residuals: what a scan sees changes within some metres.
const NOISE_RATE: f64 = 0.2;
/// Weight of the newest scan in the share of those that the grid does not hold, when the robot has moved by this much since the scan
/// before, metres or radians; with less it weighs less, as a robot that stands sees the same again.
const OPEN_RATE: f64 = 0.05;
const OPEN_STEP: (f64, f64) = (0.2, 0.25);
/// The share from which on a place is open: twelve scans in a row, more than prove that the robot is lost where scans usually fit.
const OPEN_FROM: f64 = 0.45;
/// The share from which on the back end leaves poses to surfaces: a corridor full of people is below.
const FAR_OPEN_FROM: f64 = 0.6;
/// Share at the start: nothing is known, and nothing can have moved the robot.
const OPEN_AT_START: f64 = 0.5;
/// Standard deviations below the mean from which on a score is unusual.
const UNUSUAL: f64 = 3.0;

/// A robot moves no farther from one scan to the next, metres and radians.
const FOUND_NEAR: (f64, f64) = (0.3, 0.35);

/// The map that scans are matched to and enter.
#[derive(Debug)]
pub(super) struct MapState {
    /// Generation of the grid.
    pub(super) generation: u64,
    pub(super) active_submap: u32,
    /// The last correction by sync-manager.
    pub(super) map_from_odom: Pose,
    pub(super) corrections: u32,
    /// Number of the trajectory.
    pub(super) trajectory: u32,
    /// No closure connects the trajectory with the map.
    pub(super) detached: bool,
    /// The grid belongs to a trajectory before this one: it is not matched.
    pub(super) begins_detached: bool,
    /// Pose in odom of the last scan that entered the map.
    pub(super) inserted: Option<Pose>,
    /// Score (0 … 1) where the grid has no tile.
    pub(super) unknown_score: f64,
}

/// How well the robot is localised, by the fits so far.
#[derive(Debug)]
pub(super) struct Confidence {
    /// Running mean of the scores of accepted fits.
    pub(super) mean_score: f64,
    /// Running mean of their squared deviation from it.
    pub(super) score_variance: f64,
    pub(super) last_score: f64,
    /// Mean squared residual of the last accepted fits.
    pub(super) noise: f64,
    /// Running share of scans that the grid does not hold.
    pub(super) open: f64,
    /// Accepted fits.
    pub(super) matched: u64,
    /// Scans in a row whose fit was rejected.
    pub(super) lost: u32,
    /// Whether the last fit was far from where odometry had it.
    pub(super) slips: bool,
    /// Centre of the last wide search; reset by a good fit.
    pub(super) searched: Option<Pose>,
    /// The alternative of the last pose.
    pub(super) alternative: Option<Alternative>,
    /// Where wide searches found the last scans of a robot that is lost, and in how many in a row.
    pub(super) found: Option<(Pose, u32)>,
    /// Scans were missing before one of those that fit nowhere.
    pub(super) lost_after_gap: bool,
}

impl ScanMatcher {
    /// With this score (0 … 1) where the grid has no tile, in place of 0: what the mapper gives an unknown cell.
    #[must_use]
    pub fn with_unknown_score(mut self, unknown_score: f64) -> Self {
        self.map.unknown_score = unknown_score;
        self
    }
}

impl MapState {
    /// An empty map at the origin of odom.
    pub(super) fn new() -> Self {
        Self {
            generation: 0,
            active_submap: 0,
            map_from_odom: Pose::IDENTITY,
            corrections: 0,
            trajectory: 0,
            detached: false,
            begins_detached: false,
            inserted: None,
            unknown_score: 0.0,
        }
    }

    /// The map as it was when this pose was published.
    pub(super) fn resume(&mut self, last: &PoseEstimate) {
        self.map_from_odom = last.map_from_odom;
        self.corrections = last.corrections;
        self.generation = last.generation;
        self.active_submap = last.submap;
        self.inserted = Some(last.odom_from_base);
        self.trajectory = last.trajectory;
    }
}

impl Default for Confidence {
    fn default() -> Self {
        Self {
            mean_score: 0.0,
            score_variance: 0.0,
            last_score: 0.0,
            noise: 0.0,
            open: OPEN_AT_START,
            matched: 0,
            lost: 0,
            slips: false,
            searched: None,
            alternative: None,
            found: None,
            lost_after_gap: false,
        }
    }
}

impl Confidence {
    /// Counts a fit and its match result; `before` is the pose of the scan before, `beams` how many the scan has.
    pub(super) fn count(&mut self, fitted: &Fitted, match_result: &MatchResult, before: Pose, beams: usize) {
        let MatchResult { pose, quality, .. } = *match_result;
        let odometry = fitted.prediction.pose;
        self.slips = pose.distance_m(odometry) > SLIPPED.0 || pose.turn_rad(odometry) > SLIPPED.1;
        self.searched = fitted.searched;
        self.alternative = fitted.alternative;
        let place = fitted.fit.pose;
        self.found =
            (quality == Quality::Lost && fitted.is_rescued).then(|| (place, 1 + self.found_near(place)));
        self.last_score = fitted.fit.score;
        self.count_open(is_held(&fitted.fit, fitted.points.of_beams(beams)), before, pose);
        if quality == Quality::Lost {
            self.lost_after_gap = fitted.prediction.after_gap || (self.lost > 0 && self.lost_after_gap);
            self.lost += u32::from(fitted.points.len() >= POINTS_MIN_FOR_SHARE);
            return;
        }
        // The noise of a predecessor's fits is not known.
        let is_first = self.matched == 0 || self.noise == 0.0;
        self.count_score(fitted.fit.score);
        let noise_rate = if is_first { 1.0 } else { NOISE_RATE.max(1.0 / self.matched as f64) };
        self.noise += noise_rate * (fitted.fit.noise - self.noise);
    }

    /// Counts a fit that a predecessor has published; `before` is the pose of the scan before.
    pub(super) fn restore(&mut self, published: &PoseEstimate, before: Pose) {
        let is_lost = published.quality == Quality::Lost as u32;
        if !is_lost && !published.has(PoseFlags::MATCHED) {
            return;
        }
        self.count_open(published.score >= DENSE, before, published.odom_from_base);
        self.last_score = published.score;
        if is_lost {
            self.lost += 1;
        } else {
            self.count_score(published.score);
        }
    }

    /// Counts whether the grid holds a scan here.
    fn count_open(&mut self, is_held: bool, before: Pose, pose: Pose) {
        let open = if is_held { 0.0 } else { 1.0 };
        let moved = (pose.distance_m(before) / OPEN_STEP.0).max(pose.turn_rad(before) / OPEN_STEP.1);
        self.open += OPEN_RATE * moved.min(1.0) * (open - self.open);
    }

    /// Counts the score of an accepted fit.
    fn count_score(&mut self, score: f64) {
        self.lost = 0;
        self.matched += 1;
        let rate = MEAN_RATE.max(1.0 / self.matched as f64);
        let off = score - self.mean_score;
        self.mean_score += rate * off;
        // The first fits are to a thin map.
        if self.has_started() {
            self.score_variance += rate * (off * off - self.score_variance);
        }
    }

    /// In how many scans in a row before this one wide searches led near here.
    pub(super) fn found_near(&self, place: Pose) -> u32 {
        let is_near = |at: Pose| at.distance_m(place) < FOUND_NEAR.0 && at.turn_rad(place) < FOUND_NEAR.1;
        self.found.map_or(0, |(at, times)| if is_near(at) { times } else { 0 })
    }

    /// The score below which a fit is unusual. Surroundings that look different in each scan, such as plants, give scores that
    /// scatter: there a low one proves nothing.
    pub(super) fn unusual_score(&self) -> f64 {
        self.mean_score - UNUSUAL * self.score_variance.sqrt()
    }

    /// Whether scores scatter so much that no score is unusual: between open places and a thing that the robot passes closely.
    pub(super) fn scatters(&self) -> bool {
        self.has_started() && self.unusual_score() <= 0.0
    }

    /// Whether the grid usually does not hold a scan here.
    pub(super) fn is_in_the_open(&self) -> bool {
        self.open > OPEN_FROM
    }

    /// Whether the grid holds hardly any scan here.
    pub(super) fn is_far_in_the_open(&self) -> bool {
        self.has_started() && self.open > FAR_OPEN_FROM
    }

    /// Whether enough fits were accepted to call the robot localised.
    pub(super) fn has_started(&self) -> bool {
        self.matched >= START_SCANS
    }

    /// Begins with an empty map: earlier fits do not count. Whether the place is open is known.
    pub(super) fn begin_anew(&mut self) {
        (self.matched, self.lost, self.mean_score, self.last_score) = (0, 0, 0.0, 0.0);
        self.score_variance = 0.0;
        self.searched = None;
        self.alternative = None;
        self.found = None;
    }
}
