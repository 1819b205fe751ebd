//! The state that the matcher keeps from scan to scan: the map, and how well the robot is localised in it.

use super::{Fitted, Judgement, MEAN_RATE, POINTS_MIN_FOR_SHARE, SLIPPED, START_SCANS};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, Quality};

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
    pub(super) begins_elsewhere: bool,
    /// Pose in odom of the last scan that entered the map.
    pub(super) inserted: Option<Pose>,
}

/// How well the robot is localised, by the fits so far.
#[derive(Debug, Default)]
pub(super) struct Confidence {
    /// Running mean of the scores of accepted fits.
    pub(super) mean_score: f64,
    pub(super) last_score: f64,
    /// Accepted fits.
    pub(super) matched: u64,
    /// Scans in a row whose fit was rejected.
    pub(super) lost: u32,
    /// Whether the last fit was far from where odometry had it.
    pub(super) slips: bool,
    /// Centre of the last wide search; reset by a good fit.
    pub(super) searched: Option<Pose>,
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
            begins_elsewhere: false,
            inserted: None,
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

impl Confidence {
    /// Counts a fit and its judgement.
    pub(super) fn count(&mut self, fitted: &Fitted, judgement: &Judgement) {
        let Judgement { pose, quality, .. } = *judgement;
        let odometry = fitted.prediction.pose;
        self.slips = pose.distance_m(odometry) > SLIPPED.0 || pose.turn_rad(odometry) > SLIPPED.1;
        self.searched = fitted.searched;
        self.last_score = fitted.fit.score;
        if quality == Quality::Lost {
            self.lost += u32::from(fitted.points.len() >= POINTS_MIN_FOR_SHARE);
            return;
        }
        self.lost = 0;
        self.matched += 1;
        let rate = MEAN_RATE.max(1.0 / self.matched as f64);
        self.mean_score += rate * (fitted.fit.score - self.mean_score);
    }

    /// Whether enough fits were accepted to call the robot localised.
    pub(super) fn has_started(&self) -> bool {
        self.matched >= START_SCANS
    }

    /// Begins with an empty map: earlier fits do not count.
    pub(super) fn begin_anew(&mut self) {
        (self.matched, self.lost, self.mean_score, self.last_score) = (0, 0, 0.0, 0.0);
        self.searched = None;
    }
}
