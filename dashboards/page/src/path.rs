//! The robot's path, thinned out to one point for each 0.1 m.

use flockslam_geometry::elementary::hypot;
use flockslam_messages::PoseEstimate;

/// A new point of the path is taken after this much travel, metres.
const STEP_M: f64 = 0.1;

/// A point of the robot's path, in the coordinates that never jump, with the submap that carries it when the solution moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Submap that a scan taken here enters.
    pub submap: u32,
    /// Metres along x of odom.
    pub x_m: f32,
    /// Metres along y of odom.
    pub y_m: f32,
    /// The pose's quality as number.
    pub quality: u32,
}

/// Bytes of a point as it is sent.
pub const POINT_BYTES: usize = 16;

impl PathPoint {
    /// As browsers are given it.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.submap.to_le_bytes());
        out.extend_from_slice(&self.x_m.to_le_bytes());
        out.extend_from_slice(&self.y_m.to_le_bytes());
        out.extend_from_slice(&self.quality.to_le_bytes());
    }
}

/// The way driven so far, thinned out.
#[derive(Debug, Default)]
pub struct Path {
    points: Vec<PathPoint>,
    /// Length of the way, metres.
    pub length_m: f64,
    last: Option<(f64, f64, u32)>,
}

impl Path {
    /// Takes the next pose in.
    pub fn push(&mut self, pose: &PoseEstimate) {
        let at = pose.odom_from_base;
        let (x_m, y_m) = (at.x_m, at.y_m);
        let along =
            self.last.map(|(x, y, trajectory)| (hypot(x - x_m, y - y_m), trajectory == pose.trajectory));
        let is_new = match (along, self.points.last()) {
            (Some((travel_m, same_trajectory)), Some(point)) => {
                travel_m >= STEP_M || !same_trajectory || point.submap != pose.submap
            }
            _ => true,
        };
        if is_new {
            self.length_m +=
                along.filter(|(_, same_trajectory)| *same_trajectory).map_or(0.0, |(travel_m, _)| travel_m);
            self.last = Some((x_m, y_m, pose.trajectory));
            let (x_m, y_m) = (x_m as f32, y_m as f32);
            self.points.push(PathPoint { submap: pose.submap, x_m, y_m, quality: pose.quality });
        }
    }

    /// All points.
    pub fn points(&self) -> &[PathPoint] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Pose;

    #[test]
    fn standing_adds_nothing_and_a_new_submap_begins_where_the_old_one_ends() {
        let mut path = Path::default();
        let pose = |x, submap| PoseEstimate {
            odom_from_base: Pose::new(x, 0.0, 0.0),
            submap,
            ..PoseEstimate::default()
        };
        for step in 0..100 {
            path.push(&pose(0.011 * f64::from(step), 0));
            path.push(&pose(0.011 * f64::from(step), 0));
        }
        // Points at 0, 0.11 … 0.99 m; the robot has come to 1.089 m.
        assert!((path.length_m - 0.99).abs() < 1e-9 && path.points().len() == 10, "{path:?}");
        path.push(&pose(0.011 * 99.0, 1));
        let first = path.points()[10];
        assert!(first.submap == 1 && (first.x_m - 1.089).abs() < 1e-6, "{first:?}");
        assert!((path.length_m - 1.089).abs() < 1e-9 && path.points().len() == 11, "{path:?}");
    }
}
