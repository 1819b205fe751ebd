//! A guess of where the robot is, from outside.

use crate::place_search::Near;
use flockslam_registration::cloud::Placement;

/// A guess of where the robot is, with its standard deviations: metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hint {
    /// The guess.
    pub map_from_base: Placement,
    /// Of the position.
    pub sigma_m: f64,
    /// Of the heading.
    pub sigma_rad: f64,
}

impl Hint {
    /// The pose near which the robot is searched.
    pub(crate) fn near(&self) -> Near {
        Near { pose: self.map_from_base, reach_m: 3.0 * self.sigma_m, turn_rad: 3.0 * self.sigma_rad }
    }
}
