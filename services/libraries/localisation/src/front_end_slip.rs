//! A slip of the front end: its last motion is wrong by more than its drift, and a fit that is drawn to it stays beside the walls.

use crate::alignment::{Agreement, SeenPoint, Surroundings};
use flockslam_pose_graph::Symmetric;
use flockslam_registration::cloud::Placement;

/// How far the pose may be from the one that is expected: standard deviations, metres and radians.
const SIGMA: (f64, f64) = (0.15, 0.06);
/// Looked for where more than this share of the newest scan contradicts the map.
const CONTRADICTED: f64 = 0.1;
/// The pose must explain nearly all: least share explained, greatest contradicted, …
const RIGHT: (f64, f64) = (0.9, 0.06);
/// … and the difference of both must be so much greater than at the pose that is followed. The world that has changed is not explained anywhere.
const BETTER: f64 = 0.15;

/// The pose of the newest scan near the expected one, where that explains nearly all points and the pose `at` does not, and the information that
/// it is followed with. `unit`: information of a point, 1/m².
pub(crate) fn corrected(
    surroundings: &Surroundings,
    newest: &[SeenPoint],
    expected: Placement,
    at: Placement,
    unit: f64,
) -> Option<(Placement, Symmetric)> {
    let present = surroundings.agreement(newest, &at);
    if present.contradicted <= CONTRADICTED {
        return None;
    }
    let (position, heading) = (SIGMA.0.powi(-2), SIGMA.1.powi(-2));
    let prior = [position, 0.0, 0.0, position, 0.0, heading];
    let fit = surroundings.fit(newest, expected, &prior.map(|v| v / unit))?;
    let agreement = surroundings.agreement(newest, &fit.map_from_cloud);
    let merit = |agreement: &Agreement| agreement.explained - agreement.contradicted;
    let is_right = agreement.explained >= RIGHT.0 && agreement.contradicted <= RIGHT.1;
    let mut information = prior;
    information.iter_mut().zip(fit.information).for_each(|(sum, h)| *sum += unit * h);
    (is_right && merit(&agreement) >= merit(&present) + BETTER).then_some((fit.map_from_cloud, information))
}
