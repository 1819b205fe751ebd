//! The belief of a robot about its pose in the known map.

use crate::Agreement;
use flockslam_geometry::elementary::ln;
use flockslam_pose_graph::Symmetric;
use flockslam_registration::cloud::Placement;

/// Whether a robot knows where it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Knowledge {
    /// It fits nowhere well enough.
    #[default]
    Unknown = 0,
    /// It fits at several places nearly as well, or not all have been looked at, or one is still to be found again after some travel.
    Ambiguous = 1,
    /// It fits at one place, and nowhere else nearly as well.
    Localized = 2,
}

impl Knowledge {
    /// Its name, as it is published.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Ambiguous => "ambiguous",
            Self::Localized => "localized",
        }
    }
}

/// A place where the robot may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// Its pose in the map.
    pub map_from_base: Placement,
    /// Its weight in the belief, 0 … 1.
    pub weight: f64,
    /// How well what it has seen agrees with the map there.
    pub agreement: Agreement,
}

/// The belief of a robot about its pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Belief {
    /// Whether it knows.
    pub knowledge: Knowledge,
    /// Where it may be, the most likely first. What is missing of a sum of 1 are places that have not been looked at.
    pub hypotheses: Vec<Hypothesis>,
    /// Covariance of the most likely pose, in the map's axes, while it is followed; else nothing is known of it.
    pub covariance: Option<Symmetric>,
}

impl Belief {
    /// Entropy of the weights, nat; that of what has not been looked at counts as one place.
    pub fn entropy_nat(&self) -> f64 {
        let known: f64 = self.hypotheses.iter().map(|hypothesis| hypothesis.weight).sum();
        let weights = self.hypotheses.iter().map(|hypothesis| hypothesis.weight).chain([1.0 - known]);
        weights.filter(|weight| *weight > 0.0).map(|weight| -weight * ln(weight)).sum()
    }
}
