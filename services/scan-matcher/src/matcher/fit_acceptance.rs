//! Whether a fit is accepted.

use super::{Fitted, MoverMask, ScanMatcher};
use crate::contradiction::{contradicted, unknown_share};
use crate::prediction::Prediction;
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::{Covariance, Pose, Twist};
use flockslam_messages::{Quality, ScanView};
use std::ops::Deref;

/// A fit below this share of the running mean is rejected. The share is low, so that fits in a changed place are accepted.
const LOST_BELOW: f64 = 0.25;
/// A fit farther than this from the prediction is rejected if it scores badly, metres and radians: wheels seldom slip
/// so far within one scan.
const JUMP: (f64, f64) = (0.3, 0.3);
/// A fit whose weakest direction is below this (per m² and point) slides along it.
const WEAK_DIRECTION: f64 = 1.0;
/// A fit below this share of the running mean, with at least this share of its points in free space, is in the wrong place.
const CONTRADICTED: (f64, f64) = (0.5, 0.1);
/// Places that wide searches found in so many scans before, one near the other, are where the robot is, when each scan fits at least
/// this share as well as usual. Corridors that look alike gave less, and single scans of the true place after a gap in the recording too.
const FOUND_TIMES: u32 = 3;
const FOUND_SHARE: f64 = 0.65;
/// The same where scans are missing before one of those without a match: the robot has gone on, and was probably not kidnapped.
const FOUND_SHARE_AFTER_GAP: f64 = 0.5;
/// A scan with this share of its points in unknown space shows a new place.
const NEW_PLACE: f64 = 0.7;

/// A scan is held firmly when it alone gives a pose near that of scan and odometry with at most these standard deviations, metres
/// and radians.
const FIRM: (f64, f64) = (0.05, 0.01);

/// The match result of a fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct MatchResult {
    /// Pose in odom: that of the fit, or the prediction where the fit is degenerate. It is not used when the quality is `Lost`.
    pub(super) pose: Pose,
    /// Velocity during the scan, in the robot's own frame.
    pub(super) twist: Twist,
    pub(super) covariance: Covariance,
    pub(super) quality: Quality,
}

impl ScanMatcher {
    /// A poor fit whose points end in free space is rejected: the robot is somewhere else. A poor fit whose points end
    /// in unknown space shows a new place, and odometry gives its pose.
    pub(super) fn assess<H: Deref<Target = Tile>>(
        &self,
        fitted: &Fitted,
        mask: &MoverMask,
        grid: &TileGrid<H>,
        was_kidnapped: bool,
    ) -> MatchResult {
        let Fitted { twist, covariance, .. } = *fitted;
        if fitted.is_open {
            return MatchResult { pose: fitted.fit.pose, twist, covariance, quality: open_quality(fitted) };
        }
        let as_fitted =
            MatchResult { pose: fitted.fit.pose, twist, covariance, quality: self.quality(fitted) };
        let is_poor = fitted.fit.score < self.least_score(fitted, CONTRADICTED.0);
        // Without a gap a robot was not driven where odometry rules it out, even if that place looks like the scan.
        let may_be_there = !was_kidnapped || self.confidence.lost_after_gap;
        if may_be_there && self.is_found_again(fitted) && !is_contradicted(fitted, mask, grid) {
            return MatchResult { quality: Quality::Degraded, ..as_fitted };
        }
        if was_kidnapped {
            return MatchResult { quality: Quality::Lost, ..as_fitted };
        }
        if self.settings.rescue.lost_scans_max == 0 || !is_poor {
            return as_fitted;
        }
        if is_contradicted(fitted, mask, grid) {
            return MatchResult { quality: Quality::Lost, ..as_fitted };
        }
        let Prediction { pose, twist, covariance, .. } = fitted.prediction;
        let is_new =
            as_fitted.quality == Quality::Lost && unknown_share(grid, &fitted.points.ends, pose) >= NEW_PLACE;
        if is_new { MatchResult { pose, twist, covariance, quality: Quality::Degraded } } else { as_fitted }
    }

    /// Whether a scan with a bad match shows a kidnapping. In the open, scores scatter too much, and without odometry
    /// it is not known where the robot may have driven.
    pub(super) fn is_kidnapped(&mut self, scan: ScanView<'_>, fitted: &Fitted) -> bool {
        let is_poor = fitted.fit.score < self.settings.rescue.below * self.confidence.mean_score;
        self.settings.rescue.lost_scans_max > 0
            && scan.odometry().is_some()
            && self.confidence.has_started()
            && !self.confidence.is_in_the_open()
            && !fitted.is_open
            && (is_poor || fitted.is_rescued)
            && self.kidnap.is_unexplained(fitted.prediction.pose, fitted.fit.pose)
    }

    /// Whether wide searches find one scan after the other along one way, though none of them well: the robot sees what the map
    /// hardly shows, as after a turn that no scan has seen.
    fn is_found_again(&self, fitted: &Fitted) -> bool {
        let share = if self.confidence.lost_after_gap { FOUND_SHARE_AFTER_GAP } else { FOUND_SHARE };
        fitted.is_rescued
            && fitted.fit.score >= share * self.confidence.mean_score
            && self.confidence.found_near(fitted.fit.pose) >= FOUND_TIMES
    }

    /// The score from which a fit is accepted: a share of the usual one. Where scores scatter a fit near the prediction may be
    /// worse; a place found by a wide search must be recognised.
    fn least_score(&self, fitted: &Fitted, share: f64) -> f64 {
        let least = share * self.confidence.mean_score;
        if fitted.is_rescued { least } else { least.min(self.confidence.unusual_score()) }
    }

    /// Match result by the score.
    fn quality(&self, fitted: &Fitted) -> Quality {
        let (fit, prediction) = (&fitted.fit, fitted.prediction.pose);
        let rescue = &self.settings.rescue;
        let share = fit.score / self.confidence.mean_score.max(f64::MIN_POSITIVE);
        let jumps = fit.pose.distance_m(prediction) > JUMP.0 || fit.pose.turn_rad(prediction) > JUMP.1;
        let least = self.least_score(fitted, if jumps { rescue.below } else { LOST_BELOW });
        let accepted = fit.score >= least;
        if !accepted && rescue.lost_scans_max > 0 {
            Quality::Lost
        } else if share < rescue.below
            || fit.weakest_direction() < WEAK_DIRECTION
            || fitted.is_fused
            || fitted.is_predicted
        {
            Quality::Degraded
        } else {
            Quality::Tracking
        }
    }
}

/// Match result of a pose among the surfaces around: by how firmly they hold the scan.
fn open_quality(fitted: &Fitted) -> Quality {
    let is_firm = fitted.alone.is_some_and(|(alone, covariance)| {
        covariance.position_std_m() <= FIRM.0
            && covariance.tt <= FIRM.1 * FIRM.1
            && alone.distance_m(fitted.fit.pose) <= FIRM.0
            && alone.turn_rad(fitted.fit.pose) <= FIRM.1
    });
    if is_firm { Quality::Tracking } else { Quality::Degraded }
}

/// Whether too many points of a poor fit end in space known to be free. Points that were set aside count as such.
fn is_contradicted<H: Deref<Target = Tile>>(fitted: &Fitted, mask: &MoverMask, grid: &TileGrid<H>) -> bool {
    // Where odometry has the robot, a good part of a scan may be new or have changed; anywhere else it must fit.
    let share_max = if fitted.is_rescued { CONTRADICTED.1 } else { CONTRADICTED.1.max(fitted.fit.score) };
    let (matched, aside) = (fitted.points.len() as f64, mask.aside as f64);
    let contradicting = matched * contradicted(grid, &fitted.points.ends, fitted.fit.pose) + aside;
    contradicting >= share_max * (matched + aside)
}
