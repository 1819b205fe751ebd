//! Moving bodies as shapes that viewers draw. Pure.

use flockslam_geometry::{Point, Pose};
use flockslam_messages::Track;
use flockslam_ros::messages::{Color, Header, Marker, MarkerArray, Pose as RosPose, Vector3};

/// How wide and how tall a body is drawn, metres.
const BODY_M: Vector3 = Vector3 { x: 0.5, y: 0.5, z: 1.7 };
/// Shaft and head of an arrow, metres.
const ARROW_M: Vector3 = Vector3 { x: 0.06, y: 0.16, z: 0.16 };
/// A body of which nothing comes for so long is taken away: one second.
const LIFETIME: (i32, u32) = (1, 0);
const YELLOW: Color = Color { r: 1.0, g: 0.82, b: 0.25, a: 0.7 };

/// A cylinder for each body, and an arrow from where it is to where it will be in a second, in the frame of the map.
pub fn track_markers(stamp_ns: i64, map_frame: &str, map_from_odom: Pose, tracks: &[Track]) -> MarkerArray {
    let header = Header::new(stamp_ns, map_frame);
    let markers = tracks.iter().flat_map(|track| {
        let place = |at: Point| map_from_odom * Pose::new(at.x_m, at.y_m, 0.0);
        let (now, next) = (place(track.position), place(track.predicted[0]));
        let marker = |ns: &str, shape: i32, scale: Vector3| Marker {
            header: header.clone(),
            ns: ns.to_owned(),
            // Numbers of bodies are counted up: those that are seen together differ in their last digits.
            id: (track.id % i32::MAX as u64) as i32,
            shape,
            scale,
            color: YELLOW,
            lifetime: LIFETIME,
            ..Marker::default()
        };
        let mut body = RosPose::planar(now.x_m, now.y_m, 0.0);
        body.position.z = BODY_M.z / 2.0;
        let ends = [now, next].map(|end| Vector3 { x: end.x_m, y: end.y_m, z: 0.0 });
        [
            Marker { pose: body, ..marker("bodies", Marker::CYLINDER, BODY_M) },
            Marker { points: ends.into(), ..marker("velocities", Marker::ARROW, ARROW_M) },
        ]
    });
    MarkerArray { markers: markers.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_is_where_it_is_and_its_arrow_ends_where_it_will_be() {
        let track = Track {
            id: 7,
            position: Point::new(1.0, 2.0),
            predicted: [Point::new(1.0, 3.5); 3],
            ..Track::default()
        };
        let map_from_odom = Pose::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let found = track_markers(5, "map", map_from_odom, &[track]).markers;
        assert_eq!((found.len(), found[0].id, found[1].id), (2, 7, 7));
        let near = |at: Vector3, x: f64, y: f64| (at.x - x).hypot(at.y - y) < 1e-9;
        assert!(near(found[0].pose.position, -2.0, 1.0) && near(found[1].points[0], -2.0, 1.0));
        assert!(near(found[1].points[1], -3.5, 1.0));
    }
}
