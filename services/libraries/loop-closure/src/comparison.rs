//! What a robot sees compared with the map around its pose: which of its points lie on known surfaces, and which in known free space.

use crate::finder::{LEAST_TRAVEL_M, QUERY_NODES, World, surroundings};
use crate::polar::Polar;
use crate::scans::ScanStore;
use crate::segment::{Segment, cloud, picked};
use flockslam_registration::cloud::{PackedPoint, Placement};

/// Points of a query that are compared, and least number of them that the map must know.
const POINTS: usize = 200;
const LOOKED_MIN: u32 = 50;
/// Share of them in free space of the map from which they contradict it, and share on its surfaces from which they confirm it.
const THROUGH_MIN: f64 = 0.5;
const ON_MIN: f64 = 0.6;
/// Segments that a query is compared with, how near they are, metres, and of how many of their nodes one is taken.
const SEGMENTS: usize = 4;
const NEAR_M: f64 = 12.0;
const NODES_STEP: usize = 3;
/// Largest share of the contradictions that may remain at the poses that the closures give.
const REMAINING_MAX: f64 = 0.25;

/// What older segments say of the points that a query sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Comparison {
    /// Points that they know.
    pub looked: u32,
    /// Points where they saw free space.
    pub through: u32,
    /// Points on their surfaces.
    pub on: u32,
}

impl Comparison {
    fn has(self, points: u32, share: f64) -> bool {
        self.looked >= LOOKED_MIN && f64::from(points) >= share * f64::from(self.looked)
    }

    /// Whether the map says that the query is not where it is taken to be.
    pub fn contradicts(self) -> bool {
        self.has(self.through, THROUGH_MIN)
    }

    /// Whether the map says that it is.
    pub fn confirms(self) -> bool {
        self.has(self.on, ON_MIN)
    }
}

impl std::iter::Sum for Comparison {
    fn sum<I: Iterator<Item = Self>>(comparisons: I) -> Self {
        comparisons.fold(Self::default(), |sum, more| Self {
            looked: sum.looked + more.looked,
            through: sum.through + more.through,
            on: sum.on + more.on,
        })
    }
}

/// Compares what node `query` and its neighbours see, if the node is at `at`, with the nearest segments that are old and end before
/// node `before`.
pub fn compared(world: &World<'_>, query: usize, at: &Placement, before: usize) -> Comparison {
    let polars: Vec<(Polar, Placement)> = nearest(world, query, at, before, NEAR_M, SEGMENTS)
        .into_iter()
        .flat_map(|number| world.segments[number].nodes.clone().step_by(NODES_STEP))
        .map(|i| (Polar::new(world.scans.points(world.nodes[i].scan)), world.poses[i]))
        .collect();
    if polars.is_empty() {
        return Comparison::default();
    }
    let points = cloud(world.nodes, world.scans, surroundings(world.nodes, query, QUERY_NODES), query);
    let judged = |(x, y): (f64, f64)| {
        let (x, y) = at.apply(x, y);
        let (mut shown, mut free) = (0u32, 0u32);
        for said in polars.iter().filter_map(|(polar, at)| polar.shows(at, x, y)) {
            *(if said { &mut shown } else { &mut free }) += 1;
        }
        Comparison {
            looked: u32::from(shown + free > 0),
            through: u32::from(free >= 2 && free > 4 * shown),
            on: u32::from(shown > free),
        }
    };
    picked(&points, POINTS).into_iter().map(judged).sum()
}

/// The old segments that end before node `before`, within `reach_m` of a pose, the nearest first, so many at most.
pub fn nearest(
    world: &World<'_>,
    query: usize,
    at: &Placement,
    before: usize,
    reach_m: f64,
    most: usize,
) -> Vec<usize> {
    let mut near: Vec<(f64, usize)> = old(world, query, before)
        .map(|number| {
            let nodes = world.segments[number].nodes.clone();
            (nodes.map(|i| world.poses[i].distance_m(at)).fold(f64::INFINITY, f64::min), number)
        })
        .filter(|(apart_m, _)| *apart_m <= reach_m)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(most);
    near.into_iter().map(|(_, number)| number).collect()
}

/// The segments that end before node `before` and are old for a query.
pub fn old(world: &World<'_>, query: usize, before: usize) -> impl Iterator<Item = usize> {
    let newest_m = world.nodes[query].travel_m - LEAST_TRAVEL_M;
    let is_old = move |segment: &Segment| {
        segment.nodes.end <= before && world.nodes[segment.nodes.end - 1].travel_m <= newest_m
    };
    (0..world.segments.len()).filter(move |number| is_old(&world.segments[*number]))
}

/// Whether the contradictions vanish where the closures put the queries.
pub fn is_resolved(now: Comparison, then: Comparison) -> bool {
    now.through > 0 && f64::from(then.through) <= REMAINING_MAX * f64::from(now.through)
}

/// Between which two of these successive scans, given with where the front end put them, the contradiction is greatest: the number of the
/// second of the two.
pub fn weakest(scans: &ScanStore, seen: &[(usize, Placement)]) -> usize {
    let contradicting = |number: usize| {
        let [(before, at), (behind, to)] = [seen[number - 1], seen[number]];
        let [before, behind] = [before, behind].map(|scan| scans.points(scan));
        let motion = at.to(to);
        free_at(before, behind, &motion) + free_at(behind, before, &motion.inverse())
    };
    let steps = (1..seen.len()).map(|number| (contradicting(number), number));
    steps.fold((0, seen.len() - 1), |most, step| if step.0 > most.0 { step } else { most }).1
}

/// Points of a scan taken at `at` that another, taken at the origin, looked through.
fn free_at(scan: &[PackedPoint], points: &[PackedPoint], at: &Placement) -> usize {
    let polar = Polar::new(scan);
    let is_free = |point: &&PackedPoint| {
        let (x_m, y_m) = at.apply(point.x_m(), point.y_m());
        polar.looked_through(&Placement::IDENTITY, x_m, y_m) == Some(true)
    };
    points.iter().filter(is_free).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::Node;
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;

    fn node(k: usize, at: Placement) -> Node {
        Node {
            scan: k,
            sequence: k as u64,
            odom: at,
            local_pose: at,
            start: at,
            travel_m: k as f64,
            drift_bound_m: k as f64,
            trajectory: 0,
            is_open: false,
            is_given: false,
        }
    }

    /// Ranges in a corridor of this width along x that ends 9 m ahead of the origin.
    fn scan(width_m: f64, x_m: f64) -> ScanBuffer {
        let range = |degrees: i32| {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            let ahead_m = if cos > 0.0 { (9.0 - x_m) / cos } else { 100.0 };
            ahead_m.min(0.5 * width_m / sin.abs()) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    #[test]
    fn what_is_seen_confirms_or_contradicts_the_map() {
        // The third visit is to a narrower corridor.
        let mut scans = ScanStore::default();
        let nodes: Vec<Node> = (0..90)
            .map(|k| {
                let (x_m, width_m) = (0.3 * (k % 15) as f64, if k < 60 { 4.0 } else { 2.0 });
                scans.keep(scan(width_m, x_m).view().unwrap(), Twist::default(), &[], false);
                node(k, Placement::new(x_m, 0.0, 0.0))
            })
            .collect();
        let poses: Vec<Placement> = nodes.iter().map(|node| node.local_pose).collect();
        let segments = [Segment::new(0..15)];
        let world = World { nodes: &nodes, scans: &scans, segments: &segments, poses: &poses };
        let seen = |query: usize, at: Placement| compared(&world, query, &at, 15);
        let [confirmed, contradicted] = [52, 82].map(|query| seen(query, poses[query]));
        assert!(confirmed.confirms() && !confirmed.contradicts(), "{confirmed:?}");
        assert!(contradicted.contradicts() && !contradicted.confirms(), "{contradicted:?}");
        assert_eq!(seen(82, Placement::new(60.0, 0.0, 0.0)), Comparison::default(), "far off the map");
        assert!(is_resolved(contradicted, confirmed) && !is_resolved(contradicted, contradicted));
        // Between nodes 59 and 60 the robot is carried there.
        let seen: Vec<_> = (46..74).map(|k| (k, poses[k])).collect();
        assert_eq!(weakest(&scans, &seen), 60 - 46);
    }
}
