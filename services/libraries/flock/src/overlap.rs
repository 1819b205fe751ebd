//! How well the scans of two robots fit together at a given place: counts of points that the other robot saw too, and of points in its free space.

use super::FlockGraph;
use flockslam_loop_closure::polar::Polar;
use flockslam_registration::cloud::{PackedPoint, Placement};

/// Travel between the scans that are compared, metres.
const EVERY_M: f64 = 0.6;
/// Scans taken within this of each other have seen the same place, metres.
const NEAR_M: f64 = 4.0;
/// Each scan is compared with so many of the other robot's.
const REFERENCES: usize = 3;
/// Of each scan about so many points are tested.
const POINTS: usize = 120;

/// How well what two robots have seen fits together: points of either side that lie where the other saw something, and where it looked
/// through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Fit {
    /// Scans that were compared.
    pub scans: u32,
    /// Points that the other side has seen as well.
    pub seen: u32,
    /// Points in space that the other side saw free.
    pub denied: u32,
}

impl Fit {
    /// Both together.
    pub fn and(&self, other: &Self) -> Self {
        Self {
            scans: self.scans + other.scans,
            seen: self.seen + other.seen,
            denied: self.denied + other.denied,
        }
    }

    /// Share of the points denied, of those that are seen or denied; 1 when there are none.
    pub fn denied_share(&self) -> f64 {
        let compared = self.seen + self.denied;
        if compared == 0 { 1.0 } else { f64::from(self.denied) / f64::from(compared) }
    }
}

/// A scan in a common frame, and how far it saw.
struct View<'a> {
    at: Placement,
    points: &'a [PackedPoint],
    polar: Polar,
}

/// Scans of two robots around a place that both have visited by hypothesis, in a common frame.
pub(super) struct Overlap<'a> {
    first: Vec<View<'a>>,
    second: Vec<View<'a>>,
}

impl<'a> Overlap<'a> {
    /// The scans of nodes of both, as far apart as they need be, each with its pose.
    pub fn new(
        graph: &'a FlockGraph,
        first: impl Iterator<Item = (usize, Placement)>,
        second: impl Iterator<Item = (usize, Placement)>,
    ) -> Self {
        Self { first: views(graph, first), second: views(graph, second) }
    }

    /// How well both fit together when all of the second robot's is moved by this.
    pub fn fit(&self, moved: &Placement) -> Fit {
        let (first, second) = (placed(&self.first, Placement::IDENTITY), placed(&self.second, *moved));
        let mut sum = Fit::default();
        for (one, other) in [(&first, &second), (&second, &first)] {
            for (view, at) in one {
                let references = nearest(at, other);
                if !references.is_empty() {
                    sum.scans += 1;
                    compare(view, at, &references, &mut sum);
                }
            }
        }
        sum
    }
}

fn views<'a>(graph: &'a FlockGraph, nodes: impl Iterator<Item = (usize, Placement)>) -> Vec<View<'a>> {
    let mut next_m = f64::NEG_INFINITY;
    let mut views = Vec::new();
    for (node, at) in nodes {
        let node = &graph.nodes[node];
        if node.travel_m >= next_m {
            let points = graph.scans.points(node.scan);
            views.push(View { at, points, polar: Polar::new(points) });
            next_m = node.travel_m + EVERY_M;
        }
    }
    views
}

type Placed<'v, 'a> = (&'v View<'a>, Placement);

fn placed<'v, 'a>(views: &'v [View<'a>], moved: Placement) -> Vec<Placed<'v, 'a>> {
    views.iter().map(|view| (view, moved.compose(view.at))).collect()
}

/// The nearest views, if they are near at all.
fn nearest<'v, 'a>(at: &Placement, among: &[Placed<'v, 'a>]) -> Vec<Placed<'v, 'a>> {
    let apart_m = |(i, (_, other)): (usize, &Placed<'_, '_>)| (at.distance_m(other), i);
    let mut near: Vec<(f64, usize)> =
        among.iter().enumerate().map(apart_m).filter(|(apart_m, _)| *apart_m <= NEAR_M).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(REFERENCES);
    near.into_iter().map(|(_, i)| among[i]).collect()
}

/// Counts the points of a scan that is at `at`, by what the reference scans have seen there.
fn compare(view: &View<'_>, at: &Placement, references: &[Placed<'_, '_>], sum: &mut Fit) {
    let stride = view.points.len().div_ceil(POINTS).max(1);
    for point in view.points.iter().step_by(stride) {
        let (x, y) = at.apply(point.x_m(), point.y_m());
        let (mut seen, mut denied) = (false, false);
        for (reference, place) in references {
            match reference.polar.shows(place, x, y) {
                Some(true) => seen = true,
                Some(false) => denied = true,
                None => {}
            }
        }
        sum.denied += u32::from(denied);
        sum.seen += u32::from(seen && !denied);
    }
}
