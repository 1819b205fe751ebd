use super::Atlas;
use super::layout::Solved;
use crate::agreement::eligible;
use crate::chain::BROKEN_M;
use crate::closure::{
    ANYWHERE, Closure, ClosureFinder, QUERY_NODES, SIGHT_M, World, apart_m, graph_distances, window,
};
use crate::settings::Settings;
use flockslam_records::{Constraint, RobotId};
use flockslam_registration::cloud::Window;
use std::collections::{BTreeSet, VecDeque};

/// Of the queries, every so many are looked for anywhere.
const WIDE_EVERY: usize = 2;
/// Squares that a search anywhere looks at before it gives up.
const WIDE_SUMS_MAX: u64 = 500_000;
/// So many queries before and after one that was found somewhere are looked for next: agreement is among neighbours.
const NEIGHBOURS: usize = 3;

/// Looks for the places that a robot shares with others.
pub struct Search {
    finder: ClosureFinder,
    /// Pairs of query and segment that have been compared anywhere, or near where they are expected: (query, segment, anywhere).
    tried: BTreeSet<(u64, u64, bool)>,
}

impl Search {
    pub fn new(settings: &Settings) -> Self {
        Self { finder: ClosureFinder::thorough(&settings.closure, WIDE_SUMS_MAX), tried: BTreeSet::new() }
    }

    /// Searches so far.
    pub fn searches(&self) -> u64 {
        self.finder.counts().searches
    }

    /// Looks for the nodes of `own` in the segments of other robots, with at most about so many searches: first anywhere, until
    /// closures agree on how the robots lie to each other, then near where that says. Gives what was found, which is in the atlas
    /// as well.
    pub fn run(
        &mut self,
        atlas: &mut Atlas,
        own: &RobotId,
        settings: &Settings,
        searches_max: u64,
    ) -> Vec<Constraint> {
        let mut found = Vec::new();
        if atlas.is_empty() {
            return found;
        }
        let until = self.searches().saturating_add(searches_max);
        let queries = queries(atlas, own, settings.closure.every_m);
        let mut solved = atlas.solve(settings);
        let few: Vec<usize> = queries.iter().copied().step_by(WIDE_EVERY).collect();
        let mut order: VecDeque<usize> = spread(few.len()).collect();
        while let Some(place) = order.pop_front() {
            let query = few[place];
            if self.searches() >= until {
                break;
            }
            let candidates: Vec<usize> = self.strangers(atlas, &solved, query).collect();
            let candidates = self.untried(atlas, query, candidates, |_| ANYWHERE, true);
            if candidates.is_empty() {
                continue;
            }
            let before = found.len();
            self.search(atlas, &solved, query, &candidates, &mut found);
            if found.len() > before {
                let around = place.saturating_sub(NEIGHBOURS)..(place + NEIGHBOURS + 1).min(few.len());
                around.for_each(|near| order.push_front(near));
                if connects(atlas, &solved) {
                    solved = atlas.solve(settings);
                }
            }
        }
        for query in queries {
            if self.searches() >= until {
                break;
            }
            let distances_m = distances(atlas, &solved, query);
            let near = nearby(atlas, &solved, query, &distances_m, settings.closure.segments_per_query);
            let anchor = |number: usize| atlas.segments[number].anchor;
            let candidates = self.untried(atlas, query, near, |n| window(distances_m[anchor(n)]), false);
            self.search(atlas, &solved, query, &candidates, &mut found);
        }
        found
    }

    fn search(
        &mut self,
        atlas: &mut Atlas,
        solved: &Solved,
        query: usize,
        candidates: &[(usize, Window)],
        found: &mut Vec<Constraint>,
    ) {
        let world = World {
            nodes: &atlas.nodes,
            scans: &atlas.scans,
            segments: &atlas.segments,
            poses: &solved.poses,
        };
        let closures = self.finder.find_in(&world, query, QUERY_NODES, candidates);
        for closure in &closures {
            let constraint = constraint(atlas, closure);
            atlas.add_across(&constraint);
            found.push(constraint);
        }
    }

    /// Segments of other robots of which it is not known how they lie to the query.
    fn strangers<'a>(
        &self,
        atlas: &'a Atlas,
        solved: &'a Solved,
        query: usize,
    ) -> impl Iterator<Item = usize> + 'a {
        let part = solved.strands.part(atlas.nodes[query].strand);
        let owner = atlas.owner(query);
        let foreign = move |segment: &crate::segment::Segment| {
            let strand = atlas.nodes[segment.anchor].strand;
            atlas.owner(segment.anchor) != owner && solved.strands.part(strand) != part
        };
        (0..atlas.segments.len()).filter(move |number| foreign(&atlas.segments[*number]))
    }

    /// Those segments that this query has not been compared with, each with where to look; they count as tried from now on.
    fn untried(
        &mut self,
        atlas: &Atlas,
        query: usize,
        segments: Vec<usize>,
        window: impl Fn(usize) -> Window,
        anywhere: bool,
    ) -> Vec<(usize, Window)> {
        let name = |node: usize| atlas.nodes[node].sequence;
        segments
            .into_iter()
            .filter(|number| self.tried.insert((name(query), name(atlas.segments[*number].anchor), anywhere)))
            .map(|number| (number, window(number)))
            .collect()
    }
}

/// Nodes of a robot at which a search is due, `every_m` metres of its way apart, away from the ends of its strands.
fn queries(atlas: &Atlas, own: &RobotId, every_m: f64) -> Vec<usize> {
    let mut queries = Vec::new();
    for log in atlas.logs.iter().filter(|log| log.robot == *own) {
        let mut next_m = f64::NEG_INFINITY;
        for i in log.nodes.clone().skip(QUERY_NODES) {
            if atlas.nodes[i].travel_m >= next_m && i + QUERY_NODES < log.nodes.end {
                queries.push(i);
                next_m = atlas.nodes[i].travel_m + every_m;
            }
        }
    }
    queries
}

/// The places 0 … `count`, from all over first and then from between: what is far apart tells the most.
fn spread(count: usize) -> impl Iterator<Item = usize> {
    let stride = count.div_ceil(8).max(1);
    (0..stride).flat_map(move |offset| (offset..count).step_by(stride))
}

/// Whether closures that were found since the solution connect parts that it does not.
fn connects(atlas: &Atlas, solved: &Solved) -> bool {
    let eligible = eligible(&atlas.closures, &atlas.nodes);
    let part = |node: usize| solved.strands.part(atlas.nodes[node].strand);
    atlas
        .closures
        .iter()
        .zip(&eligible)
        .any(|(c, eligible)| *eligible && part(c.edge.from) != part(c.edge.to))
}

fn distances(atlas: &Atlas, solved: &Solved, query: usize) -> Vec<f64> {
    let acting = atlas.closures.iter().zip(&solved.in_force).filter(|(_, acts)| **acts);
    let loops: Vec<_> = acting.map(|(c, _)| (c.edge.from, c.edge.to)).collect();
    graph_distances(&atlas.nodes, &loops, query)
}

/// Segments of other robots that the query may see, nearest first.
fn nearby(atlas: &Atlas, solved: &Solved, query: usize, distances_m: &[f64], most: usize) -> Vec<usize> {
    let world =
        World { nodes: &atlas.nodes, scans: &atlas.scans, segments: &atlas.segments, poses: &solved.poses };
    let mut near = Vec::new();
    for (number, segment) in atlas.segments.iter().enumerate() {
        if atlas.owner(segment.anchor) == atlas.owner(query) || distances_m[segment.anchor] >= BROKEN_M {
            continue;
        }
        let apart_m = apart_m(&world, segment, query);
        if apart_m <= window(distances_m[segment.anchor]).reach_m + SIGHT_M {
            near.push((apart_m, number));
        }
    }
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.into_iter().take(most).map(|(_, number)| number).collect()
}

/// A closure as it is told.
fn constraint(atlas: &Atlas, closure: &Closure) -> Constraint {
    Constraint {
        from: atlas.name(closure.edge.from),
        to: atlas.name(closure.edge.to),
        motion: closure.edge.motion.pose(),
        information: closure.edge.information.map(|v| v as f32),
        reach_m: closure.reach_m as f32,
        shift_m: closure.shift_m as f32,
    }
}
