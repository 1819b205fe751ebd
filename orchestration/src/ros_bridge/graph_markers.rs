//! The graph as shapes that viewers draw: nodes and the way between them, closed loops, submaps. Pure.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::hypot;
use flockslam_messages::PoseEstimate;
use flockslam_page::Path;
use flockslam_results::LivePoses;
use flockslam_ros::messages::{Color, Header, Marker, MarkerArray, Pose as RosPose, Vector3};
use std::collections::BTreeMap;

/// A node is drawn after this much of the path, metres.
const NODE_STEP_M: f64 = 0.3;
/// Nodes that are drawn at most: of a longer way every second, third … one.
const NODES_MAX: usize = 5000;
const NODE_M: f64 = 0.08;
const LINE_M: f64 = 0.03;
const TEXT_M: f64 = 0.4;
const BLUE: Color = Color { r: 0.2, g: 0.5, b: 1.0, a: 1.0 };
const GREEN: Color = Color { r: 0.2, g: 0.8, b: 0.3, a: 1.0 };
const RED: Color = Color { r: 0.9, g: 0.2, b: 0.2, a: 1.0 };
const GREY: Color = Color { r: 0.6, g: 0.6, b: 0.6, a: 1.0 };

/// What a marker shows.
#[derive(Clone, Copy)]
enum Kind {
    Nodes,
    Way,
    Closures,
    Revoked,
    Submap,
}

/// The graph of a set, kept up with poses and solutions.
#[derive(Debug, Default)]
pub struct GraphMarkers {
    path: Path,
    map_from_odom: Pose,
    solution: LivePoses,
}

impl GraphMarkers {
    /// Takes the pose of the next scan.
    pub fn push(&mut self, pose: &PoseEstimate) {
        self.map_from_odom = pose.map_from_odom;
        self.path.push(pose);
    }

    /// Takes what was concluded.
    pub fn solve(&mut self, solution: LivePoses) {
        self.solution = solution;
    }

    /// The graph, with submaps where the solution has them: `origins` says where each is in odom.
    pub fn message(&self, stamp_ns: i64, map_frame: &str, origins: &[(u32, Pose)]) -> MarkerArray {
        let header = Header::new(stamp_ns, map_frame);
        let places: BTreeMap<u32, Pose> = self
            .solution
            .submaps
            .iter()
            .map(|row| {
                (row.number, Pose::new(row.map_from_odom[0], row.map_from_odom[1], row.map_from_odom[2]))
            })
            .collect();
        let place = |submap: u32| places.get(&submap).copied().unwrap_or(self.map_from_odom);
        let mut nodes: Vec<Vector3> = Vec::new();
        for point in self.path.points() {
            let at = place(point.submap) * Pose::new(f64::from(point.x_m), f64::from(point.y_m), 0.0);
            let is_far = |last: &Vector3| hypot(last.x - at.x_m, last.y - at.y_m) >= NODE_STEP_M;
            if nodes.last().is_none_or(is_far) {
                nodes.push(Vector3 { x: at.x_m, y: at.y_m, z: 0.0 });
            }
        }
        let every = nodes.len().div_ceil(NODES_MAX).max(1);
        let nodes: Vec<_> = nodes.into_iter().step_by(every).collect();
        let ends = |acts: bool| {
            let chosen = self.solution.closures.iter().filter(move |closure| (closure[4] == 1.0) == acts);
            chosen.flat_map(|[x0, y0, x1, y1, _]| [(*x0, *y0), (*x1, *y1)]).map(|(x, y)| Vector3 {
                x,
                y,
                z: 0.0,
            })
        };
        // What was there before may be longer than what is there now.
        let clear = Marker { header: header.clone(), action: Marker::DELETE_ALL, ..Marker::default() };
        let mut markers = vec![
            clear,
            Marker { points: nodes.clone(), ..shape(&header, Kind::Nodes, 0) },
            Marker { points: nodes, ..shape(&header, Kind::Way, 0) },
            Marker { points: ends(true).collect(), ..shape(&header, Kind::Closures, 0) },
            Marker { points: ends(false).collect(), ..shape(&header, Kind::Revoked, 0) },
        ];
        markers.extend(origins.iter().map(|(number, odom_from_submap)| {
            let at = place(*number) * *odom_from_submap;
            Marker {
                pose: RosPose::planar(at.x_m, at.y_m, at.heading_rad),
                text: number.to_string(),
                ..shape(&header, Kind::Submap, *number as i32)
            }
        }));
        MarkerArray { markers }
    }
}

fn shape(header: &Header, kind: Kind, id: i32) -> Marker {
    let (ns, shape, size_m, color) = match kind {
        Kind::Nodes => ("nodes", Marker::SPHERE_LIST, NODE_M, BLUE),
        Kind::Way => ("way", Marker::LINE_STRIP, LINE_M, GREY),
        Kind::Closures => ("closures", Marker::LINE_LIST, LINE_M, GREEN),
        Kind::Revoked => ("revoked", Marker::LINE_LIST, LINE_M, RED),
        Kind::Submap => ("submaps", Marker::TEXT, TEXT_M, GREEN),
    };
    let scale = Vector3 { x: size_m, y: size_m, z: size_m };
    Marker { header: header.clone(), ns: ns.to_owned(), id, shape, scale, color, ..Marker::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_results::SubmapRow;

    #[test]
    fn nodes_lie_where_the_solution_has_their_submaps() {
        let mut graph = GraphMarkers::default();
        for step in 0..21 {
            graph.push(&PoseEstimate {
                odom_from_base: Pose::new(0.1 * f64::from(step), 0.0, 0.0),
                map_from_odom: Pose::new(0.0, 2.0, 0.0),
                submap: u32::from(step >= 10),
                ..PoseEstimate::default()
            });
        }
        graph.solve(LivePoses {
            submaps: vec![SubmapRow { number: 0, map_from_odom: [0.0, 1.0, 0.0] }],
            closures: vec![[0.0, 0.0, 1.0, 1.0, 1.0], [2.0, 2.0, 3.0, 3.0, 0.0]],
            ..LivePoses::default()
        });
        let found = graph.message(1_000_000_000, "map", &[(0, Pose::new(0.5, 0.0, 0.0))]).markers;
        let names: Vec<_> = found.iter().map(|marker| (marker.ns.as_str(), marker.points.len())).collect();
        assert_eq!(names[0], ("", 0));
        assert_eq!(names[3..], [("closures", 2), ("revoked", 2), ("submaps", 0)]);
        let (nodes, way) = (&found[1], &found[2]);
        assert_eq!((nodes.ns.as_str(), &nodes.points), ("nodes", &way.points));
        // The second submap is not in the solution yet: it is where the newest correction has it.
        assert!(nodes.points.iter().all(|at| at.y == if at.x < 0.95 { 1.0 } else { 2.0 }), "{nodes:?}");
        assert!((6..=8).contains(&nodes.points.len()), "{nodes:?}");
        assert_eq!(
            (found[5].pose.position.x, found[5].pose.position.y, found[5].text.as_str()),
            (0.5, 1.0, "0")
        );
    }
}
