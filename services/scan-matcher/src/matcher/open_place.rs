//! How a scan is fitted that the grid does not hold: by the surfaces around.

use super::fitted::Fitted;
use super::fitting::{Fitter, PRIOR_SIGMA};
use super::points::ScanPoints;
use crate::prediction::{Prediction, SLIP_COST, matrix};
use crate::settings::Strategy;
use flockslam_geometry::{Covariance, Point, Pose};
use flockslam_registration::{Fit, ScoreField, SurfaceFit};
use nalgebra::{Matrix3, Vector3};

/// A fit to the grid below this score, 0 … 1, is no proof of a place: beams that are far apart, or surfaces that do not repeat,
/// leave gaps between the cells. There the surfaces of the last scans hold the scan.
pub(super) const DENSE: f64 = 0.4;
/// Nor is one of fewer points than this, weighted by their scores, or, of a scan with few beams, than this share of them.
const HELD_POINTS: f64 = 50.0;
const HELD_SHARE: f64 = 0.22;

/// What the surfaces around say of a scan that the grid does not hold.
pub(super) enum Open {
    /// They hold it.
    Held(SurfaceFit),
    /// From where they hold it, it fits the grid: the fit, and that pose.
    Dense(Fit, Pose),
    /// They do not know it, as they know most scans.
    Unknown,
    /// They have shown too little yet, the place is not open, or the grid contradicts them. Whether they hold the scan near its prediction.
    New(bool),
}

impl<F: ScoreField> Fitter<'_, F> {
    /// The pose of a scan whose fit to the grid is poor, by the surfaces that the last scans have shown. From there the scan may fit
    /// the grid well.
    pub(super) fn in_the_open(&mut self, points: &ScanPoints, prediction: Prediction, poor: Fit) -> Open {
        if self.settings.strategy != Strategy::GaussNewton {
            return Open::New(false);
        }
        // Indoors the grid tells a jump of odometry from an unexpected turn; surfaces along a corridor do not.
        if !self.confidence.is_in_the_open() {
            return Open::New(false);
        }
        let held = self.surroundings.fit(self.scan, self.mask, &prediction);
        let dense = held.map(|held| (self.refine(points, held.pose, held.pose), held.pose));
        if let Some((dense, from)) = dense.filter(|(dense, _)| {
            is_held(dense, points.of_beams(self.scan.len())) && dense.score >= poor.score
        }) {
            return Open::Dense(dense, from);
        }
        match held {
            _ if !self.confidence.is_in_the_open() => Open::New(held.is_some()),
            Some(held) if self.is_contradicted(&points.ends, held.pose, dense, poor) => Open::New(true),
            Some(held) => Open::Held(held),
            None if self.surroundings.are_known() && self.scan.odometry().is_some() => Open::Unknown,
            None => Open::New(false),
        }
    }

    /// Whether the grid, which knows more of the past than the surfaces of the last scans, explains the scan so much better somewhere
    /// else that odometry would be rejected.
    fn is_contradicted(&self, ends: &[Point], pose: Pose, dense: Option<(Fit, Pose)>, poor: Fit) -> bool {
        let best = dense.map(|(fit, _)| fit).filter(|fit| fit.score > poor.score).unwrap_or(poor);
        self.gain_of_poor(&best, &Fit::at(self.field, ends, pose)) >= SLIP_COST
    }

    /// A scan at the pose that the surfaces around give.
    pub(super) fn held(&self, points: ScanPoints, prediction: Prediction, held: &SurfaceFit) -> Fitted {
        let of_scan = inverse(held.information, PRIOR_SIGMA);
        Fitted {
            prediction,
            fit: Fit::at(self.field, &points.ends, held.pose),
            points,
            twist: prediction.twist,
            covariance: fused_covariance(prediction.covariance, held.information),
            alone: Some((held.alone, of_scan)),
            is_rescued: false,
            is_fused: true,
            is_predicted: false,
            searched: None,
            alternative: None,
            is_open: true,
        }
    }

    /// The same with the scan at the predicted pose.
    pub(super) fn predicted(&self, fitted: Fitted, prediction: Prediction) -> Fitted {
        Fitted {
            fit: Fit::at(self.field, &fitted.points.ends, prediction.pose),
            covariance: prediction.covariance,
            twist: prediction.twist,
            prediction,
            is_rescued: false,
            is_predicted: true,
            ..fitted
        }
    }
}

/// The covariance of a pose that is predicted with a covariance, and held by surfaces with this information.
pub(super) fn fused_covariance(predicted: Covariance, information: Matrix3<f64>) -> Covariance {
    let prior = matrix(predicted).try_inverse().unwrap_or_else(Matrix3::zeros);
    inverse(prior + information, PRIOR_SIGMA)
}

/// The covariance of an information matrix; directions that it does not determine get these standard deviations.
fn inverse(information: Matrix3<f64>, (sigma_m, sigma_rad): (f64, f64)) -> Covariance {
    let [position, heading] = [sigma_m, sigma_rad].map(|sigma| sigma.powi(-2));
    let least = Matrix3::from_diagonal(&Vector3::new(position, position, heading));
    let Some(c) = (information + least).try_inverse() else {
        return Covariance::diagonal(sigma_m, sigma_rad);
    };
    Covariance { xx: c[(0, 0)], xy: c[(0, 1)], xt: c[(0, 2)], yy: c[(1, 1)], yt: c[(1, 2)], tt: c[(2, 2)] }
}

/// Whether the grid holds a scan of so many beams by many points.
pub(super) fn is_held(fit: &Fit, beams: usize) -> bool {
    fit.score >= DENSE && fit.score * fit.points as f64 >= HELD_POINTS.min(HELD_SHARE * beams as f64)
}

#[cfg(test)]
mod tests {
    use super::super::points::MoverMask;
    use super::super::tests::{FrontEnd, look, truth};
    use super::*;
    use crate::settings::Settings;
    use flockslam_registration::GridField;

    /// Whether the grid contradicts surfaces that have a robot turned by 0.12 rad, by a scan of which so many beams end where they would if it
    /// had not turned, and the others anywhere.
    fn contradicts(beams: usize) -> bool {
        let mut front_end = FrontEnd::new(Settings::default());
        for i in 0..60 {
            front_end.step(&look(i, truth(i), Some(truth(i))), true);
        }
        let mut scan = look(60, truth(60), Some(truth(60)));
        for (beam, range) in scan.numbers.iter_mut().enumerate().skip(beams) {
            *range = 0.5 + (beam * 7919 % 97) as f32 * 0.01;
        }
        let (view, mask) = (scan.view().unwrap(), MoverMask::default());
        let points = ScanPoints::default().thinned(view, Default::default(), &mask, 30.0, 150);
        let field = GridField::new(&front_end.grid, front_end.matcher.map.unknown_score);
        let fitter = front_end.matcher.fitter(view, &mask, &field);
        let straight = truth(0).to(truth(60));
        let turned = straight * Pose::new(0.0, 0.0, 0.12);
        fitter.is_contradicted(&points.ends, turned, None, Fit::at(&field, &points.ends, straight))
    }

    #[test]
    fn few_points_on_something_by_chance_do_not_contradict_the_surfaces_around() {
        assert_eq!([300, 60].map(contradicts), [true, false]);
    }
}
