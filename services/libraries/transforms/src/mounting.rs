//! Where a lidar sits on a robot: its pose in space, reduced to the plane that scans are matched in.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::{acos, atan2};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// A lidar whose plane is tilted by more than this sees floor and ceiling: cosine of 30°.
const TILT_COS_MIN: f64 = 0.866;

/// How a lidar is mounted: a pose in the plane, and whether it hangs upside down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// `base_from_laser`, in the plane. Of a lidar that is upside down: of one that is not and whose angles are counted clockwise.
    pub base_from_laser: Pose,
    /// The lidar's own angles are counted clockwise as seen from above.
    pub upside_down: bool,
}

/// A lidar does not scan in the plane that the robot drives in.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the lidar is tilted by {tilt_deg:.0}°")]
pub struct MountingError {
    /// Between the lidar's axis and the vertical, degrees.
    pub tilt_deg: f64,
}

impl Mounting {
    /// From the pose of the lidar in the frame of the robot.
    ///
    /// # Errors
    /// When the lidar's plane is tilted by more than 30°.
    pub fn from_transform(base_from_laser: &Isometry3<f64>) -> Result<Self, MountingError> {
        let up = (base_from_laser.rotation * Vector3::z()).z;
        if up.abs() < TILT_COS_MIN {
            return Err(MountingError { tilt_deg: acos(up.clamp(-1.0, 1.0)).to_degrees() });
        }
        Ok(Self { base_from_laser: planar(base_from_laser), upside_down: up < 0.0 })
    }

    /// The pose of the lidar in the frame of the robot, in space.
    pub fn in_space(&self) -> Isometry3<f64> {
        let Pose { x_m, y_m, heading_rad } = self.base_from_laser;
        let roll_rad = if self.upside_down { PI } else { 0.0 };
        let rotation = UnitQuaternion::from_euler_angles(roll_rad, 0.0, heading_rad);
        Isometry3::from_parts(Translation3::new(x_m, y_m, 0.0), rotation)
    }
}

/// A pose in space seen from above: its position, and the direction of its x axis.
pub fn planar(pose: &Isometry3<f64>) -> Pose {
    let ahead = pose.rotation * Vector3::x();
    Pose::new(pose.translation.x, pose.translation.y, atan2(ahead.y, ahead.x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn pose(roll: f64, pitch: f64, yaw: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(0.3, -0.1, 0.7),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        )
    }

    #[test]
    fn a_beam_has_the_direction_of_the_transform() {
        for (roll, pitch, yaw) in [(0.0, 0.0, 0.5), (PI, 0.0, 0.5), (0.0, PI, -2.0), (PI, 0.0, PI)] {
            let transform = pose(roll, pitch, yaw);
            let mounting = Mounting::from_transform(&transform).unwrap();
            for angle in [-2.0, 0.0, 0.3, 1.5_f64] {
                let turned = if mounting.upside_down { -angle } else { angle };
                let direction = transform.rotation * Vector3::new(angle.cos(), angle.sin(), 0.0);
                let expected = direction.y.atan2(direction.x);
                let found = mounting.base_from_laser.heading_rad + turned;
                assert!(Pose::new(0.0, 0.0, found).turn_rad(Pose::new(0.0, 0.0, expected)) < 1e-9);
            }
            assert!(mounting.base_from_laser.distance_m(Pose::new(0.3, -0.1, 0.0)) < 1e-12);
            let again = Mounting::from_transform(&mounting.in_space()).unwrap();
            assert_eq!(again.upside_down, mounting.upside_down);
            assert!(again.base_from_laser.turn_rad(mounting.base_from_laser) < 1e-9);
        }
    }

    #[test]
    fn a_tilted_lidar_is_refused() {
        let error = Mounting::from_transform(&pose(0.0, FRAC_PI_2, 0.0)).unwrap_err();
        assert_eq!(error.to_string(), "the lidar is tilted by 90°");
    }
}
