//! How a robot begins in a map that a caller of slam_toolbox's service has loaded. Pure.

use super::localisation_relay::USUAL_SIGMA;
use flockslam_ros::messages::InitialPose;

/// Values of `match_type`.
const UNSET: i8 = 0;
const START_AT_FIRST_NODE: i8 = 1;
const START_AT_GIVEN_POSE: i8 = 2;
const LOCALIZE_AT_POSE: i8 = 3;

/// Where the robot is taken to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapBeginning {
    /// Wherever it is found.
    Anywhere,
    /// Near a pose: x, y, heading and two standard deviations, metres and radians.
    Near([f64; 5]),
}

impl MapBeginning {
    /// Of the fields of a call, to a set that localizes or makes a map.
    ///
    /// # Errors
    /// When they have no meaning for it.
    pub fn of(match_type: i8, pose: InitialPose, localizes: bool) -> Result<Self, String> {
        let InitialPose { x, y, theta } = pose;
        let (sigma_m, sigma_rad) = USUAL_SIGMA;
        let is_finite = [x, y, theta].iter().all(|number| number.is_finite());
        match match_type {
            UNSET => Ok(Self::Anywhere),
            START_AT_GIVEN_POSE | LOCALIZE_AT_POSE if !is_finite => {
                Err("initial_pose has a number that is not finite".to_owned())
            }
            // A trajectory begins at the origin of its map.
            START_AT_FIRST_NODE if localizes => Ok(Self::Near([0.0, 0.0, 0.0, sigma_m, sigma_rad])),
            START_AT_GIVEN_POSE | LOCALIZE_AT_POSE if localizes => {
                Ok(Self::Near([x, y, theta, sigma_m, sigma_rad]))
            }
            START_AT_FIRST_NODE => Ok(Self::Anywhere),
            START_AT_GIVEN_POSE => {
                tracing::warn!(
                    "initial_pose has no effect while the map is being made: a closure finds where the robot is"
                );
                Ok(Self::Anywhere)
            }
            LOCALIZE_AT_POSE => {
                Err("match_type 3: this set makes a map: call flockslam/localize, or start it with --localize MAP".to_owned())
            }
            other => Err(format!("match_type {other} is none of 0 to 3")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_that_localizes_looks_near_the_pose_and_one_that_maps_finds_its_place_by_closures() {
        let pose = InitialPose { x: 1.0, y: 2.0, theta: 0.5 };
        let near = |x_m: f64, y_m: f64, heading_rad: f64| {
            Ok(MapBeginning::Near([x_m, y_m, heading_rad, USUAL_SIGMA.0, USUAL_SIGMA.1]))
        };
        let of = |match_type: i8, localizes: bool| MapBeginning::of(match_type, pose, localizes);
        assert_eq!(of(START_AT_FIRST_NODE, true), near(0.0, 0.0, 0.0));
        assert_eq!(of(START_AT_GIVEN_POSE, true), near(1.0, 2.0, 0.5));
        assert_eq!(of(LOCALIZE_AT_POSE, true), near(1.0, 2.0, 0.5));
        for match_type in [UNSET, START_AT_FIRST_NODE, START_AT_GIVEN_POSE] {
            assert_eq!(of(match_type, false), Ok(MapBeginning::Anywhere));
        }
        assert!(of(LOCALIZE_AT_POSE, false).unwrap_err().contains("--localize"));
        assert!(of(4, true).is_err() && of(-1, false).is_err());
        let nowhere = InitialPose { theta: f64::NAN, ..pose };
        assert!(MapBeginning::of(LOCALIZE_AT_POSE, nowhere, true).is_err());
    }
}
