//! The findings of a robot for its flock: its nodes with their odometry, and the loops among them. They are published once
//! and stay as they were published.

use super::SyncManager;
use flockslam_flock::{Findings, OwnLoop};
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::node::Node;
use flockslam_records::{Descriptor, RecordedNode, Stretch, rounded_point};
use flockslam_registration::cloud::{PackedPoint, Placement};

/// Most nodes of a stretch that is published at once.
const STRETCH_NODES: usize = 48;

/// Findings that wait to be published.
#[derive(Debug, Default)]
pub(super) struct Unpublished {
    /// Sequence and trajectory of the last node published.
    last: Option<(u64, u32)>,
    findings: Findings,
}

impl Unpublished {
    pub(super) fn found(&mut self, closures: &[Closure], nodes: &[Node]) {
        let named = |closure: &Closure| OwnLoop {
            from: nodes[closure.edge.from].sequence,
            to: nodes[closure.edge.to].sequence,
            closure: *closure,
        };
        self.findings.loops.extend(closures.iter().map(named));
    }
}

impl SyncManager {
    /// Collects findings for the flock from now on. To be called before the first pose.
    pub fn publish_to_flock(&mut self) {
        self.unpublished = Some(Unpublished::default());
    }

    /// Findings since the last call.
    pub fn take_unpublished(&mut self) -> Findings {
        self.unpublished
            .as_mut()
            .map_or_else(Findings::default, |unpublished| std::mem::take(&mut unpublished.findings))
    }

    /// Collects the nodes below `known` that have not been published.
    pub(super) fn collect_findings(&mut self, known: usize) {
        let Some(unpublished) = &mut self.unpublished else { return };
        let (nodes, edges) = (self.odometry.nodes(), self.odometry.edges());
        let first =
            nodes.partition_point(|node| unpublished.last.is_some_and(|(last, _)| node.sequence <= last));
        let submap_of = |node: usize| {
            // Nodes stand among the kept scans in their order, each before the scans that follow it; the first has some before it.
            let place = self.kept.partition_point(|kept| kept.node < node);
            let place = (place..self.kept.len()).find(|place| self.kept[*place].is_node);
            place.map_or(0, |place| self.records[self.kept[place].record].submap)
        };
        let recorded = |i: usize| {
            let node = &nodes[i];
            let before = i.checked_sub(1).map(|before| &nodes[before]);
            let edge = i.checked_sub(1).map(|before| &edges[before]);
            let drift_bound_m = before.map_or(0.0, |before| {
                node.drift_bound_m - before.drift_bound_m - node.local_pose.distance_m(&before.local_pose)
            });
            RecordedNode {
                sequence: node.sequence,
                submap: submap_of(i),
                odom_from_base: node.odom.pose(),
                motion: edge.map_or(Placement::IDENTITY, |edge| edge.motion).pose(),
                information: edge
                    .map_or([1.0, 0.0, 0.0, 1.0, 0.0, 1.0], |edge| edge.information.map(|v| v as f32)),
                drift_bound_m: drift_bound_m.max(0.0) as f32,
                points: self
                    .scans
                    .points(node.scan)
                    .iter()
                    .map(|p: &PackedPoint| rounded_point([p.x_mm, p.y_mm]))
                    .collect(),
            }
        };
        let mut start = first;
        while start < known {
            let trajectory = nodes[start].trajectory;
            let end = (start..known.min(start + STRETCH_NODES))
                .find(|i| nodes[*i].trajectory != trajectory)
                .unwrap_or(known.min(start + STRETCH_NODES));
            let seen = (start..end).flat_map(|i| self.scans.points(nodes[i].scan));
            let previous =
                unpublished.last.filter(|(_, last)| *last == trajectory).map(|(sequence, _)| sequence);
            unpublished.findings.stretches.push(Stretch {
                trajectory,
                previous,
                descriptor: Descriptor::of(seen.map(|p| (p.x_m(), p.y_m()))),
                nodes: (start..end).map(recorded).collect(),
            });
            unpublished.last = Some((nodes[end - 1].sequence, trajectory));
            start = end;
        }
    }
}
