//! Descriptions of the surroundings of nodes by histograms of range, which do not depend on the heading: they order the pairs to be matched.

use super::FlockGraph;
use flockslam_loop_closure::finder::QUERY_NODES;
use flockslam_loop_closure::segment::CLOUD_RANGE_M;

/// Bins of a description, half a metre of range each.
const BINS: usize = 2 * CLOUD_RANGE_M as usize;
const BINS_PER_M: f64 = 2.0;
/// The sum of all bins.
const WHOLE: u64 = 1 << 16;

/// How far away things are as seen from each node, whatever the heading: a histogram of the ranges of its points and its neighbours'.
/// It orders the work of matching; agreement decides.
pub struct Similarity {
    shares: Vec<[u32; BINS]>,
}

impl Similarity {
    /// Describes all nodes of a graph.
    pub fn new(graph: &FlockGraph) -> Self {
        let seen: Vec<[u32; BINS]> = graph.nodes.iter().map(|node| counted(graph, node.scan)).collect();
        let around = |i: usize| {
            let trajectory = graph.nodes[i].trajectory;
            let near = i.saturating_sub(QUERY_NODES)..(i + QUERY_NODES + 1).min(seen.len());
            let mut sum = [0u64; BINS];
            for k in near.filter(|k| graph.nodes[*k].trajectory == trajectory) {
                sum.iter_mut().zip(seen[k]).for_each(|(sum, count)| *sum += u64::from(count));
            }
            let all = sum.iter().sum::<u64>().max(1);
            sum.map(|count| (count * WHOLE / all) as u32)
        };
        Self { shares: (0..seen.len()).map(around).collect() }
    }

    /// How different the surroundings of a node are from the most similar place in a segment: 0 for the same.
    pub fn distance(&self, node: usize, segment: &flockslam_loop_closure::segment::Segment) -> u32 {
        let apart = |other: usize| -> u32 {
            self.shares[node].iter().zip(&self.shares[other]).map(|(a, b)| a.abs_diff(*b)).sum()
        };
        segment.nodes.clone().map(apart).min().unwrap_or(u32::MAX)
    }
}

fn counted(graph: &FlockGraph, scan: usize) -> [u32; BINS] {
    let mut counts = [0; BINS];
    for point in graph.scans.points(scan) {
        let bin = (point.squared_range_m2().sqrt() * BINS_PER_M) as usize;
        if let Some(count) = counts.get_mut(bin) {
            *count += 1;
        }
    }
    counts
}
