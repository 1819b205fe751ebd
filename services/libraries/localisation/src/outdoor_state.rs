//! Whether a robot is outdoors: ground, grass and leaves give other returns each time, so that little of what it sees is firm.

use crate::SeenPoint;

/// A robot is outdoors when less than the first share of what it sees is firm, and no longer when more than the second is: what it sees along
/// a single house says little. Indoors it is .8 to .95, on a campus .3 to .6.
const FIRM: (f64, f64) = (0.6, 0.8);
/// The share is a mean over about this much travel, metres.
const MEAN_M: f64 = 8.0;
/// Fewer firm points say nothing.
const POINTS_MIN: usize = 40;
/// Where along a beam free space is sampled, one beam after the other.
const ALONG: [f64; 5] = [0.1, 0.7, 0.3, 0.85, 0.5];

/// What is known of it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outdoors {
    is_outdoors: bool,
    /// Share of what was seen of late that is firm; `None` as long as nothing is known.
    firm_share: Option<f64>,
}

impl Outdoors {
    /// Whether the robot is outdoors as far as is known.
    pub(crate) fn is_so(self) -> bool {
        self.is_outdoors
    }

    /// By all that was seen over some metres: how many points are firm, and which share of all they are.
    pub(crate) fn by_search(firm: usize, share: f64) -> Self {
        if firm < POINTS_MIN {
            return Self::default();
        }
        Self { is_outdoors: share < FIRM.0, firm_share: Some(share) }
    }

    /// After so much more travel, metres, with so many firm points now.
    #[must_use]
    pub(crate) fn after(self, way_m: f64, firm: usize, share: f64) -> Self {
        if firm < POINTS_MIN {
            return self;
        }
        let mean = self.firm_share.map_or(share, |mean| mean + (share - mean) * (way_m / MEAN_M).min(1.0));
        let limit = if self.is_outdoors { FIRM.1 } else { FIRM.0 };
        Self { is_outdoors: mean < limit, firm_share: Some(mean) }
    }
}

/// Samples of the space that the beams to these points have passed, in the frame of the points.
pub(crate) fn free_samples(points: &[SeenPoint]) -> Vec<(f64, f64)> {
    let sample = |(number, point): (usize, &SeenPoint)| {
        let along = ALONG[number % ALONG.len()];
        let between = |from: f64, to: f64| from + along * (to - from);
        (between(point.from_x_m, point.x_m), between(point.from_y_m, point.y_m))
    };
    points.iter().enumerate().map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_passes_a_house_is_still_outdoors() {
        let outdoors = Outdoors::by_search(200, 0.4);
        assert!(outdoors.is_so());
        let beside_a_house = (0..20).fold(outdoors, |outdoors, _| outdoors.after(0.3, 100, 0.9));
        assert!(beside_a_house.is_so());
        let inside = (0..60).fold(outdoors, |outdoors, _| outdoors.after(0.3, 100, 0.9));
        assert!(!inside.is_so());
        assert!(!inside.after(0.3, 100, 0.4).is_so(), "one view");
    }

    #[test]
    fn the_first_scan_does_not_say_that_a_robot_is_outdoors() {
        let first = Outdoors::by_search(0, 0.0);
        assert!(!first.is_so() && !first.after(0.1, 3, 0.1).is_so() && !first.after(0.1, 100, 0.9).is_so());
    }

    #[test]
    fn free_space_is_sampled_along_the_beams() {
        let point = SeenPoint { x_m: 11.0, y_m: 2.0, from_x_m: 1.0, from_y_m: 2.0 };
        assert_eq!(free_samples(&[point; 2]), [(2.0, 2.0), (8.0, 2.0)]);
    }
}
