//! A horizontal slice of a cloud of points, as a planar lidar would see it from the same place.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::{atan2, hypot};
use flockslam_messages::{ScanBuffer, ScanSections};
use flockslam_recordings::FramedCloud;
use flockslam_transforms::Isometry3;
use std::f64::consts::{PI, TAU};

/// Directions that a slice is divided into: half a degree each, which every 3-D lidar and depth camera in use fills.
const BEAMS: usize = 720;
/// So near to the height of the robot's frame a slice does not come, metres: there is the floor.
const FLOOR_M: f64 = 0.1;
/// Points beyond are not taken, metres.
const RANGE_MAX_M: f32 = 100.0;
/// Points nearer than this, metres, are the sensor's own housing.
const RANGE_MIN_M: f32 = 0.05;

/// Of each direction the nearest point within `heights_m`, metres from below to above the sensor. The scan is taken at
/// the sensor's place and looks where the robot does. A direction without a point has no return.
pub fn slice(cloud: &FramedCloud, base_from_sensor: &Isometry3<f64>, heights_m: [f64; 2]) -> ScanBuffer {
    let place = base_from_sensor.translation.vector;
    let [below_m, above_m] = heights_m;
    let floor_m = if place.z > FLOOR_M { FLOOR_M - place.z } else { f64::NEG_INFINITY };
    let heights_m = below_m.max(floor_m)..=above_m;
    let step_rad = TAU / BEAMS as f64;
    let middle_rad = |beam: usize| (beam as f64 + 0.5) * step_rad - PI;
    let mut numbers = vec![f32::INFINITY; BEAMS];
    numbers.extend((0..BEAMS).map(|beam| middle_rad(beam) as f32));
    for point in &cloud.points {
        let point = base_from_sensor.rotation * point.cast::<f64>();
        let range_m = hypot(point.x, point.y) as f32;
        if !heights_m.contains(&point.z) || range_m < RANGE_MIN_M {
            continue;
        }
        let angle_rad = atan2(point.y, point.x);
        let beam = (((angle_rad + PI) / step_rad) as usize).min(BEAMS - 1);
        if range_m < numbers[beam] {
            (numbers[beam], numbers[BEAMS + beam]) = (range_m, angle_rad as f32);
        }
    }
    let mut scan = ScanBuffer { numbers, ..ScanBuffer::default() };
    let header = &mut scan.header;
    header.times.sensor_ns = cloud.stamp_ns;
    header.base_from_laser = Pose::new(place.x, place.y, 0.0);
    (header.angle_min_rad, header.angle_increment_rad) = (middle_rad(0), step_rad);
    (header.range_min_m, header.range_max_m) = (RANGE_MIN_M, RANGE_MAX_M);
    (header.beam_count, header.sections) = (BEAMS as u32, ScanSections::ANGLES);
    scan
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Translation3, UnitQuaternion};

    #[test]
    fn a_slice_has_the_nearest_points_at_its_heights_whichever_way_the_sensor_looks() {
        // A depth camera half a metre up: z ahead, x to the right, y down.
        let optical = UnitQuaternion::from_euler_angles(-PI / 2.0, 0.0, -PI / 2.0);
        let base_from_sensor = Isometry3::from_parts(Translation3::new(0.2, 0.0, 0.5), optical);
        // Ahead at two distances; on the floor; above; half to the left.
        let points = [[0.0, 0.1, 2.0], [0.0, 0.0, 3.0], [0.0, 0.45, 1.0], [0.0, -0.5, 1.0], [-1.0, 0.0, 1.0]];
        let cloud = FramedCloud { points: points.map(Point3::from).to_vec(), ..FramedCloud::default() };
        let scan = slice(&cloud, &base_from_sensor, [-0.5, 0.3]);
        let view = scan.view().unwrap();
        assert_eq!((view.len(), scan.header.base_from_laser.x_m), (BEAMS, 0.2));
        let returns: Vec<(f64, f64)> = (0..view.len())
            .filter_map(|beam| view.valid_range_m(beam).map(|range_m| (view.angle_rad(beam), range_m)))
            .collect();
        let expected = [(0.0, 2.0), (PI / 4.0, 2f64.sqrt())];
        assert_eq!(returns.len(), 2, "{returns:?}");
        for (found, expected) in returns.iter().zip(expected) {
            assert!(
                (found.0 - expected.0).abs() < 1e-6 && (found.1 - expected.1).abs() < 1e-6,
                "{returns:?}"
            );
        }
    }
}
