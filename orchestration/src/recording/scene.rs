//! Turns the tracks of moving bodies into a scene of a recording: one cylinder and one arrow for each track.

use super::RecordTopic;
use super::foxglove_messages::{Recorded, SpatialPose, Time, Vector3, recorded, time, wall};
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::atan2;
use flockslam_messages::{Times, Track};
use serde::Serialize;

/// How tall and how wide a body is drawn, metres.
const BODY_M: Vector3 = Vector3 { x: 0.5, y: 0.5, z: 1.7 };
/// Shaft and head of an arrow, metres.
const SHAFT_M: f64 = 0.06;
const HEAD_M: f64 = 0.16;
/// A body is taken off the scene when nothing more comes of it for so long, seconds.
const LIFETIME_S: u64 = 1;
const YELLOW: Color = Color { r: 1.0, g: 0.82, b: 0.25, a: 0.7 };

#[derive(Serialize)]
struct SceneUpdate {
    deletions: [(); 0],
    entities: Vec<Entity>,
}

#[derive(Serialize)]
struct Entity {
    timestamp: Time,
    frame_id: &'static str,
    id: String,
    lifetime: Time,
    frame_locked: bool,
    metadata: [Label; 3],
    arrows: [Arrow; 1],
    cubes: [(); 0],
    spheres: [(); 0],
    cylinders: [Cylinder; 1],
    lines: [(); 0],
    triangles: [(); 0],
    texts: [(); 0],
    models: [(); 0],
}

#[derive(Serialize)]
struct Label {
    key: &'static str,
    value: String,
}

#[derive(Clone, Copy, Serialize)]
struct Color {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

#[derive(Serialize)]
struct Arrow {
    pose: SpatialPose,
    shaft_length: f64,
    shaft_diameter: f64,
    head_length: f64,
    head_diameter: f64,
    color: Color,
}

#[derive(Serialize)]
struct Cylinder {
    pose: SpatialPose,
    size: Vector3,
    bottom_scale: f64,
    top_scale: f64,
    color: Color,
}

/// Who moves, in odom: a cylinder for each body, with an arrow to where it will be in a second.
pub fn tracks(times: &Times, tracks: &[Track]) -> Recorded {
    let utc_ns = wall(times.utc_ns);
    let entities = tracks.iter().map(|track| entity(utc_ns, track)).collect();
    recorded(RecordTopic::Tracks, utc_ns, &SceneUpdate { deletions: [], entities })
}

fn entity(utc_ns: u64, track: &Track) -> Entity {
    let velocity = track.velocity_m_s;
    let pose = Pose::new(track.position.x_m, track.position.y_m, atan2(velocity.y_m, velocity.x_m));
    let label = |key, value: f64| Label { key, value: format!("{value:.2}") };
    Entity {
        timestamp: time(utc_ns),
        frame_id: "odom",
        id: track.id.to_string(),
        lifetime: time(LIFETIME_S * 1_000_000_000),
        frame_locked: true,
        metadata: [
            label("age_s", track.age_s),
            label("unseen_s", track.unseen_s),
            label("position_std_m", track.position_variance.max(0.0).sqrt()),
        ],
        arrows: [Arrow {
            pose: pose.into(),
            shaft_length: (velocity.norm_m() - HEAD_M).max(0.0),
            shaft_diameter: SHAFT_M,
            head_length: HEAD_M,
            head_diameter: HEAD_M,
            color: YELLOW,
        }],
        cubes: [],
        spheres: [],
        cylinders: [Cylinder {
            pose: pose.into(),
            size: BODY_M,
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: YELLOW,
        }],
        lines: [],
        triangles: [],
        texts: [],
        models: [],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Point;
    use serde_json::Value;

    #[test]
    fn a_body_is_where_it_is_and_its_arrow_points_where_it_goes() {
        let track = Track {
            id: 7,
            position: Point::new(1.0, 2.0),
            velocity_m_s: Point::new(0.0, 1.5),
            position_variance: 0.01,
            ..Track::default()
        };
        let times = Times { utc_ns: 5_000_000_001, ..Times::default() };
        let scene: Value = serde_json::from_slice(&tracks(&times, &[track]).data).unwrap();
        let body = &scene["entities"][0];
        assert_eq!((body["id"].as_str(), body["timestamp"]["sec"].as_u64()), (Some("7"), Some(5)));
        assert_eq!(body["cylinders"][0]["pose"]["position"]["y"], 2.0);
        let z = body["arrows"][0]["pose"]["orientation"]["z"].as_f64().unwrap();
        assert!((z - std::f64::consts::FRAC_PI_4.sin()).abs() < 1e-12, "{z}");
        assert_eq!(body["metadata"][2]["value"], "0.10");
        let schema: Value = serde_json::from_str(&RecordTopic::Tracks.schema()).unwrap();
        let properties = schema["properties"]["entities"]["items"]["properties"].as_object().unwrap();
        let mut names =
            (body.as_object().unwrap().keys().collect::<Vec<_>>(), properties.keys().collect::<Vec<_>>());
        names.0.sort();
        names.1.sort();
        assert_eq!(names.0, names.1);
    }
}
