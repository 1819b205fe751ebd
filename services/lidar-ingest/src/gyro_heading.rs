//! How far a robot has turned, from the rates that an IMU measures.

use flockslam_sensor_stream::ImuReading;
use flockslam_transforms::{Isometry3, LookupError, StampedTransform, TimeWatch, TransformBuffer};
use nalgebra::{UnitQuaternion, Vector3};
use std::collections::VecDeque;

/// Between measurements that are further apart the turn is not known, nanoseconds.
const GAP_MAX_NS: i64 = 500_000_000;
/// Names of the two ends of the turn.
const ENDS: (&str, &str) = ("turned_from", "turned");

/// The integral of the rate about the robot's vertical axis, from an arbitrary origin.
#[derive(Debug, Default)]
pub struct GyroHeading {
    /// Not yet integrated: where the IMU sits is known later.
    waiting: VecDeque<ImuReading>,
    /// Stamp, rate and heading after the last measurement.
    last: Option<(i64, f64, f64)>,
    headings: TransformBuffer,
    time: TimeWatch,
}

impl GyroHeading {
    /// Takes a measurement.
    pub fn push(&mut self, reading: ImuReading) {
        self.waiting.push_back(reading);
    }

    /// Integrates what has come; `base_from_imu` gives the rotation of a frame of the IMU.
    pub fn integrate(&mut self, base_from_imu: impl Fn(&ImuReading) -> UnitQuaternion<f64>) {
        while let Some(reading) = self.waiting.pop_front() {
            let rate_rad_s = (base_from_imu(&reading) * reading.turn_rad_s).z;
            if self.time.goes_back(reading.stamp_ns) {
                (self.last, self.headings) = (None, TransformBuffer::default());
            }
            let heading_rad = match self.last {
                None => 0.0,
                // Of measurements that come out of order the later ones count.
                Some((stamp_ns, ..)) if reading.stamp_ns <= stamp_ns => continue,
                Some((stamp_ns, ..)) if reading.stamp_ns - stamp_ns > GAP_MAX_NS => {
                    self.headings = TransformBuffer::default();
                    0.0
                }
                Some((stamp_ns, before_rad_s, heading_rad)) => {
                    let step_s = (reading.stamp_ns - stamp_ns) as f64 * 1e-9;
                    heading_rad + 0.5 * (before_rad_s + rate_rad_s) * step_s
                }
            };
            self.last = Some((reading.stamp_ns, rate_rad_s, heading_rad));
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
            let turned = StampedTransform {
                stamp_ns: reading.stamp_ns,
                parent: ENDS.0.to_owned(),
                child: ENDS.1.to_owned(),
                parent_from_child: Isometry3::from_parts(Default::default(), rotation),
            };
            self.headings.insert(&turned, false);
        }
    }

    /// The heading at a time, radians within ±π.
    ///
    /// # Errors
    /// When nothing was measured near that time, or not yet.
    pub fn heading_rad(&self, at_ns: i64) -> Result<f64, LookupError> {
        let turned = self.headings.lookup(ENDS.0, ENDS.1, at_ns)?;
        Ok(turned.rotation.euler_angles().2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn reading(stamp_ms: i64, rate_rad_s: f64) -> ImuReading {
        // The IMU is mounted on its side: it measures about its y axis.
        let turn_rad_s = Vector3::new(0.0, rate_rad_s, 0.0);
        ImuReading { stamp_ns: stamp_ms * MS, frame: "imu".to_owned(), turn_rad_s }
    }

    fn heading() -> (GyroHeading, UnitQuaternion<f64>) {
        let on_its_side = UnitQuaternion::rotation_between(&Vector3::y(), &Vector3::z()).unwrap();
        (GyroHeading::default(), on_its_side)
    }

    #[test]
    fn rates_about_the_vertical_axis_add_up() {
        let (mut gyro, on_its_side) = heading();
        assert_eq!(gyro.heading_rad(0), Err(LookupError::Unlinked));
        // A rate that rises evenly to 1 rad/s within a second, in tenths; one measurement comes twice, one late.
        for tenth in [0, 1, 2, 3, 3, 2, 4, 5, 6, 7, 8, 9, 10] {
            gyro.push(reading(100 * tenth, 0.1 * tenth as f64));
        }
        gyro.integrate(|_| on_its_side);
        assert!((gyro.heading_rad(1000 * MS).unwrap() - 0.5).abs() < 1e-9);
        assert!((gyro.heading_rad(450 * MS).unwrap() - 0.1025).abs() < 1e-4);
        assert_eq!(gyro.heading_rad(1001 * MS), Err(LookupError::NotYet));
    }

    #[test]
    fn across_a_gap_the_turn_is_not_known() {
        let (mut gyro, on_its_side) = heading();
        for stamp_ms in [0, 100, 900, 1000] {
            gyro.push(reading(stamp_ms, 1.0));
        }
        gyro.integrate(|_| on_its_side);
        assert_eq!(gyro.heading_rad(100 * MS), Err(LookupError::Missing));
        assert!((gyro.heading_rad(1000 * MS).unwrap() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn after_time_has_gone_back_turns_are_measured_again() {
        let (mut gyro, on_its_side) = heading();
        for stamp_ms in [9000, 9100, 100, 200, 300] {
            gyro.push(reading(stamp_ms, 1.0));
        }
        gyro.integrate(|_| on_its_side);
        assert!((gyro.heading_rad(300 * MS).unwrap() - 0.1).abs() < 1e-9);
        assert_eq!(gyro.heading_rad(9000 * MS), Err(LookupError::NotYet));
    }
}
