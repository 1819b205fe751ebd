//! A robot's own poses brought into the solution of the flock, between those of its nodes that are in it.

use super::PlacedNode;
use flockslam_geometry::Pose;
use flockslam_registration::cloud::Placement;

/// A scan's pose as a robot knows it for itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnPose {
    /// Sequence of the scan.
    pub sequence: u64,
    /// Its sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// The robot's pose in its own map.
    pub map_from_base: Pose,
}

/// A robot's own trajectory in the frame of the flock: moved with it from node to node, in proportion to the way between them.
///
/// `anchors` are the robot's nodes in its own map, by sequence; `placed` the same nodes in the solution of the flock. Gives the poses
/// of `scans`, which are in order; none when the flock has none of the robot's nodes.
pub fn in_flock_frame(scans: &[OwnPose], anchors: &[(u64, Pose)], placed: &[PlacedNode]) -> Vec<Pose> {
    let known: Vec<(u64, Placement)> = anchors
        .iter()
        .filter_map(|(sequence, own)| {
            let at = placed.binary_search_by_key(sequence, |node| node.sequence).ok()?;
            let flock = Placement::from(placed[at].flock_from_base);
            Some((*sequence, flock.compose(Placement::from(*own).inverse())))
        })
        .collect();
    if known.is_empty() {
        return Vec::new();
    }
    let mut poses = Vec::with_capacity(scans.len());
    for scan in scans {
        let own = Placement::from(scan.map_from_base);
        let next = known.partition_point(|(sequence, _)| *sequence <= scan.sequence);
        let pose = match (next.checked_sub(1).map(|before| known[before]), known.get(next)) {
            (Some((from, start)), Some((to, end))) => {
                let share = (scan.sequence - from) as f64 / (to - from) as f64;
                start.compose(own).interpolate(&end.compose(own), share)
            }
            (Some((_, only)), None) => only.compose(own),
            (None, Some((_, only))) => only.compose(own),
            (None, None) => own,
        };
        poses.push(pose.pose());
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trajectory_follows_its_nodes() {
        let scan = |sequence: u64, x: f64| OwnPose {
            sequence,
            stamp_ns: sequence as i64,
            map_from_base: Pose::new(x, 0.0, 0.0),
        };
        let node = |sequence: u64, x: f64, y: f64| PlacedNode {
            sequence,
            flock_from_base: Pose::new(x, y, 0.0),
            part: 0,
        };
        let scans: Vec<_> = (0..5).map(|k| scan(k, k as f64)).collect();
        let anchors = [(1, Pose::new(1.0, 0.0, 0.0)), (3, Pose::new(3.0, 0.0, 0.0))];
        let poses =
            in_flock_frame(&scans, &anchors, &[node(1, 11.0, 5.0), node(2, 0.0, 0.0), node(3, 13.0, 6.0)]);
        let expected = [(10.0, 5.0), (11.0, 5.0), (12.0, 5.5), (13.0, 6.0), (14.0, 6.0)];
        assert!(poses.iter().zip(expected).all(|(pose, (x, y))| (pose.x_m, pose.y_m) == (x, y)), "{poses:?}");
        assert!(in_flock_frame(&scans, &anchors, &[]).is_empty());
    }
}
