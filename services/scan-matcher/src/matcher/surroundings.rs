//! The surfaces around the robot, to which scans are fitted where the grid does not hold them.

use super::points::{MoverMask, ScanPoints};
use super::slip_watch::SlipWatch;
use crate::prediction::{Prediction, SLIP_COST, matrix};
use flockslam_geometry::{Covariance, Pose, Twist, wrap_angle};
use flockslam_messages::ScanView;
use flockslam_registration::{SURFACE_RANGE_MAX_M, SurfaceFit, SurfaceMap, SurfacePrior};
use nalgebra::{Matrix3, Vector3};

/// Of scans with more beams than this only every n-th beam is used: surfaces are as wide as several beams are apart.
const BEAMS_MAX: usize = 400;
/// Odometry counts as an outlier when the scan alone gives a pose that costs more than this by it: three standard deviations.
const UNUSUAL_COST: f64 = 4.5;
/// Wheels are taken to slip only where fewer than the first share of the usual inliers are found by odometry, and at least the second
/// elsewhere: surfaces that move with the robot, as the ground does, hold a scan a little better in many places.
const POOR_SHARE: f64 = 0.6;
const GOOD_SHARE: f64 = 0.8;
/// Where a smaller share of the points usually lies on surfaces, as among plants, a slip has to show so large a share there, or many scans: a robot
/// that turned among them was taken for one that had gone straight on, by a fifth of its points (simulated campuses, usual share 0.3).
const REPEATING_MIN: f64 = 0.5;
/// Wheels that slip err this many times more than usual.
const SLIP_TIMES: f64 = 10.0;
/// A prediction is known no better than this, metres and radians.
const SIGMA_MIN: (f64, f64) = (1e-3, 3e-4);
/// A fit is accepted when at least this share of the points is on surfaces, and no fewer than so many standard deviations below
/// the usual share.
const INLIERS_MIN: f64 = 0.15;
const UNUSUAL: f64 = 3.0;
/// Scans that do not enter the map are added this far apart, metres.
const APART_M: f64 = 0.2;
/// Fits after which the usual share is known.
const START_FITS: u64 = 20;
/// Weight of the newest fit in the usual share of inliers.
const RATE: f64 = 0.02;
/// The same in the share of the last few scans.
const RECENT_RATE: f64 = 0.2;

/// The surfaces that the last scans have shown.
#[derive(Debug, Default)]
pub(super) struct Surroundings {
    map: SurfaceMap,
    points: ScanPoints,
    /// Running mean of the share of inliers and of its squared deviation, and the scans that they were taken over.
    usual: f64,
    /// The same mean over few scans.
    recent: f64,
    variance: f64,
    fits: u64,
    slip: SlipWatch,
    /// Where the last scan was added.
    added: Option<Pose>,
}

impl Surroundings {
    /// Clears all scans.
    pub(super) fn clear(&mut self) {
        self.map.clear();
        self.slip.clear();
        self.added = None;
        (self.usual, self.recent, self.variance, self.fits) = (0.0, 0.0, 0.0, 0);
    }

    /// Whether enough scans were fitted to say that another does not belong here.
    pub(super) fn are_known(&self) -> bool {
        self.fits >= START_FITS
    }

    /// Whether points lie on surfaces that were seen before, usually and of late, as far as is known.
    fn repeat(&self) -> bool {
        !self.are_known() || self.usual.min(self.recent) >= REPEATING_MIN
    }

    /// The prediction of a scan in the open, or where the robot is if its wheels have slipped, when that explains the last scans better.
    pub(super) fn watched(&mut self, scan: ScanView<'_>, prediction: Prediction) -> Prediction {
        let Some(step) = self.slip.step(scan) else { return prediction };
        self.take(scan, prediction.twist, &MoverMask::default());
        let share_min = if self.repeat() { 0.0 } else { REPEATING_MIN };
        let view_rad = (scan.angle_rad(scan.len().saturating_sub(1)) - scan.angle_rad(0)).abs();
        self.slip.decide(step, &self.points.ends, &self.map, prediction, share_min, view_rad)
    }

    /// Whether it is open how the robot moved.
    pub(super) fn are_undecided(&self) -> bool {
        self.slip.is_undecided()
    }

    /// The robot was here at a scan.
    pub(super) fn placed(&mut self, scan: ScanView<'_>, pose: Pose) {
        self.slip.placed(scan, pose);
    }

    /// Odometry is not checked for slip here.
    pub(super) fn unwatched(&mut self) {
        self.slip.clear();
    }

    /// A scan that does not enter the map was made at this pose: it is added if the robot has moved since the last one.
    pub(super) fn add_apart(&mut self, scan: ScanView<'_>, mask: &MoverMask, pose: Pose, twist: Twist) {
        if self.added.is_none_or(|added| added.distance_m(pose) >= APART_M) {
            self.add(scan, mask, pose, twist);
        }
    }

    /// A scan was made at this pose.
    pub(super) fn add(&mut self, scan: ScanView<'_>, mask: &MoverMask, pose: Pose, twist: Twist) {
        if self.slip.is_undecided() {
            return;
        }
        self.added = Some(pose);
        self.take(scan, twist, mask);
        if !self.map.is_empty() && self.points.len() > 0 {
            let inliers = self.map.inliers_at(&self.points.ends, pose);
            self.count(inliers);
        }
        self.map.add(pose, &self.points.ends);
    }

    /// The pose that explains a scan and its prediction best; `None` when too little of the scan is known.
    pub(super) fn fit(
        &mut self,
        scan: ScanView<'_>,
        mask: &MoverMask,
        prediction: &Prediction,
    ) -> Option<SurfaceFit> {
        if self.map.is_empty() {
            return None;
        }
        self.take(scan, prediction.twist, mask);
        let usual = prior(prediction.pose, prediction.step);
        let by_odometry = self.map.fit(&self.points.ends, &usual)?;
        let fit = self.slipped(&usual, by_odometry);
        let is_usual = !self.are_known() || fit.inliers >= self.usual - UNUSUAL * self.variance.sqrt();
        if fit.inliers < INLIERS_MIN || !is_usual {
            return None;
        }
        Some(fit)
    }

    fn count(&mut self, inliers: f64) {
        self.fits += 1;
        let (rate, off) = (RATE.max(1.0 / self.fits as f64), inliers - self.usual);
        self.usual += rate * off;
        self.recent += RECENT_RATE.max(1.0 / self.fits as f64) * (inliers - self.recent);
        self.variance += rate * (off * off - self.variance);
    }

    /// The fit by odometry, or a likelier one where wheels slip and turn the robot by more than they say.
    fn slipped(&self, usual: &SurfacePrior, by_odometry: SurfaceFit) -> SurfaceFit {
        let is_poor = by_odometry.inliers < POOR_SHARE * self.usual;
        if !is_poor || !self.repeat() || prior_cost(usual, by_odometry.alone) < UNUSUAL_COST {
            return by_odometry;
        }
        let mut weak = *usual;
        weak.information[(2, 2)] /= SLIP_TIMES * SLIP_TIMES;
        let slipped = self.map.fit(&self.points.ends, &weak).filter(|fit| {
            fit.inliers >= GOOD_SHARE * self.usual
                && fit.cost + fit.prior_cost + SLIP_COST < by_odometry.cost + by_odometry.prior_cost
        });
        slipped.unwrap_or(by_odometry)
    }

    fn take(&mut self, scan: ScanView<'_>, twist: Twist, mask: &MoverMask) {
        let points = std::mem::take(&mut self.points);
        self.points = points.thinned(scan, twist, mask, SURFACE_RANGE_MAX_M, BEAMS_MAX);
    }
}

/// How improbable a pose is by a prediction: half the squared Mahalanobis distance.
fn prior_cost(prior: &SurfacePrior, pose: Pose) -> f64 {
    let off = Vector3::new(
        pose.x_m - prior.pose.x_m,
        pose.y_m - prior.pose.y_m,
        wrap_angle(pose.heading_rad - prior.pose.heading_rad),
    );
    0.5 * off.dot(&(prior.information * off))
}

pub(super) fn prior(pose: Pose, covariance: Covariance) -> SurfacePrior {
    let least = Vector3::new(SIGMA_MIN.0.powi(2), SIGMA_MIN.0.powi(2), SIGMA_MIN.1.powi(2));
    let covariance = matrix(covariance) + Matrix3::from_diagonal(&least);
    SurfacePrior { pose, information: covariance.try_inverse().unwrap_or_else(Matrix3::zeros) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use flockslam_geometry::elementary::sin_cos;
    use flockslam_messages::{PoseEstimate, ScanBuffer};

    /// Walls of 20 m around, seen from here; odometry has the robot there.
    fn scan(sequence: u64, at: Pose, odometry: Pose) -> ScanBuffer {
        let range = |degree: u32| {
            let (sin, cos) = sin_cos(at.heading_rad + f64::from(degree).to_radians());
            let wall = |side: f64, part: f64| (10.0 * part.signum() - side) / part;
            wall(at.x_m, cos).min(wall(at.y_m, sin)) as f32
        };
        let mut scan =
            ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians());
        (scan.header.odometry, scan.header.has_odometry) = (odometry, 1);
        (scan.header.id.sequence, scan.header.times.sensor_ns) = (sequence, 1_000_000_000 * sequence as i64);
        scan
    }

    /// The turn that is predicted of a robot that drives straight on while its wheels show a turn of 0.4 rad, where these shares of the
    /// points lie on surfaces, usually and of late.
    fn predicted_turn_rad(usual: f64, recent: f64) -> f64 {
        let (mut surroundings, mut motion) = (Surroundings::default(), Motion::new());
        let at = |step: u64| Pose::new(0.3 * step as f64, 0.0, 0.02);
        for step in 0..=8 {
            let (seen, pose) = (scan(step, at(step), at(step)), at(0).to(at(step)));
            let view = seen.view().unwrap();
            surroundings.add(view, &MoverMask::default(), pose, Twist::default());
            motion.advance(view, &PoseEstimate { odom_from_base: pose, ..PoseEstimate::default() });
            surroundings.placed(view, pose);
        }
        (surroundings.usual, surroundings.recent, surroundings.fits) = (usual, recent, START_FITS);
        let slipped = scan(9, at(9), at(9) * Pose::new(0.0, 0.0, 0.4));
        let view = slipped.view().unwrap();
        let prediction = surroundings.watched(view, motion.predict(view));
        prediction.pose.turn_rad(at(0).to(at(9)))
    }

    #[test]
    fn slipping_wheels_are_found_out_where_the_scan_shows_them_among_plants_too() {
        let turns_rad =
            [(0.8, 0.8), (0.3, 0.8), (0.8, 0.3)].map(|(usual, recent)| predicted_turn_rad(usual, recent));
        assert!(turns_rad.iter().all(|turn_rad| *turn_rad < 0.05), "{turns_rad:?}");
    }
}
