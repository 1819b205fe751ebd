//! Where a cloud of points fits in the whole known map, at any heading: every place is looked at.

use crate::PlaceField;
use crate::place_field::REACH_M;
use flockslam_registration::cloud::Placement;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Step of headings, radians: half of it moves the farthest point by a cell.
const STEP_RAD: f64 = 0.025;
/// Points of a cloud that are looked at. Their values sum up in 16 bits.
const POINTS: usize = 96;
/// Places within this of a better one are the same, metres and radians.
const APART: (f64, f64) = (0.6, 0.25);
/// Places that a search gives at most.
const PLACES_MAX: usize = 48;
/// Cells with enough score that are remembered before those are dropped that no longer count.
const REMEMBERED: usize = 1 << 16;

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quest {
    /// Least score of a place, 0 … 1.
    pub score_min: f64,
    /// A place is given when it has at least this share of the best score.
    pub share_min: f64,
    /// Where the cloud's origin is looked for; everywhere when `None`.
    pub near: Option<Near>,
}

/// A part of the map and of all headings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Its middle.
    pub pose: Placement,
    /// Radius, metres.
    pub reach_m: f64,
    /// Half the range of headings, radians.
    pub turn_rad: f64,
}

/// A place where a cloud fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pose of the cloud's origin in the map, to about a cell.
    pub map_from_cloud: Placement,
    /// Mean over the points of what they are worth in the map, 0 … 1.
    pub score: f64,
}

/// What a search has found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Places {
    /// The best place and all that are nearly as good, the best first, none near a better one.
    pub found: Vec<Candidate>,
    /// No place that is not given scores more than this.
    pub others_max: f64,
}

/// A cell with its score at a heading.
#[derive(Clone, Copy)]
struct Scored {
    sum: u16,
    heading: u16,
    row: u32,
    column: u32,
}

/// Searches the map for clouds. Keeps its buffers.
#[derive(Default)]
pub struct PlaceSearch {
    sums: Vec<u16>,
    scored: Vec<Scored>,
}

impl PlaceSearch {
    /// Looks for `points` (metres, in the cloud's own frame): at each heading the values of all of them are summed up for each cell where
    /// the robot may stand (Olson 2009, without levels: a sum for many cells at once costs less than bounds for a few).
    pub fn find(&mut self, field: &PlaceField, points: &[(f64, f64)], quest: &Quest) -> Places {
        let near = points.iter().filter(|p| p.0 * p.0 + p.1 * p.1 <= REACH_M * REACH_M);
        let near: Vec<(f64, f64)> = near.copied().collect();
        let stride = near.len().div_ceil(POINTS).max(1);
        let few: Vec<(f64, f64)> = near.into_iter().step_by(stride).collect();
        if few.is_empty() {
            return Places { found: Vec::new(), others_max: 1.0 };
        }
        let full = 255.0 * few.len() as f64;
        let headings = headings(quest.near);
        let mut least = (quest.score_min * full).ceil().max(1.0) as u16;
        self.scored.clear();
        let mut steps = Vec::with_capacity(few.len());
        for (number, heading) in headings.iter().enumerate() {
            let turned = Placement::new(0.0, 0.0, *heading);
            steps.clear();
            steps.extend(few.iter().map(|&(x, y)| turned.rotate(x, y)).map(|(x, y)| field.steps(x, y)));
            let best = self.sum_up(field, &steps, number as u16, quest.near, least);
            least = least.max((quest.share_min * f64::from(best)).ceil() as u16);
            if self.scored.len() > REMEMBERED {
                self.scored.retain(|scored| scored.sum >= least);
            }
            if self.scored.len() > REMEMBERED {
                least = self.keep_half();
            }
        }
        self.scored.retain(|scored| scored.sum >= least);
        // The best first; a stable sort keeps the order of headings, rows and columns among equals.
        self.scored.sort_by_key(|scored| std::cmp::Reverse(scored.sum));
        self.places(field, &headings, full, least)
    }

    /// Sums up the values of points that are so many steps from the robot for each cell, remembers those with enough, and gives the best.
    fn sum_up(
        &mut self,
        field: &PlaceField,
        steps: &[(i32, i32)],
        heading: u16,
        near: Option<Near>,
        least: u16,
    ) -> u16 {
        let mut best = 0;
        for row in 0..field.height() {
            for columns in field.passable(row) {
                let Some(columns) = within(field, near, columns, row) else { continue };
                self.sums.clear();
                self.sums.resize(columns.len(), 0);
                for step in steps {
                    let values = field.beside(&columns, row, *step);
                    self.sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += u16::from(*value));
                }
                let most = self.sums.iter().copied().max().unwrap_or(0);
                best = best.max(most);
                if most < least {
                    continue;
                }
                let row = row as u32;
                let enough = self.sums.iter().enumerate().filter(|(_, sum)| **sum >= least);
                self.scored.extend(enough.map(|(i, sum)| Scored {
                    sum: *sum,
                    heading,
                    row,
                    column: (columns.start + i) as u32,
                }));
            }
        }
        best
    }

    /// Forgets the worse half of what is remembered; gives the least score of the rest.
    fn keep_half(&mut self) -> u16 {
        let half = REMEMBERED / 2;
        let (_, middle, _) = self.scored.select_nth_unstable_by_key(half, |s| std::cmp::Reverse(s.sum));
        let least = middle.sum.saturating_add(1);
        self.scored.retain(|scored| scored.sum >= least);
        // The order of what is left must not depend on how it was selected.
        self.scored.sort_by_key(|scored| (scored.heading, scored.row, scored.column));
        least
    }

    fn places(&self, field: &PlaceField, headings: &[f64], full: f64, least: u16) -> Places {
        let mut found: Vec<Candidate> = Vec::new();
        for scored in &self.scored {
            let (x_m, y_m) = field.middle(scored.column as usize, scored.row as usize);
            let map_from_cloud = Placement::new(x_m, y_m, headings[usize::from(scored.heading)]);
            if found.iter().any(|better| is_same(&better.map_from_cloud, &map_from_cloud)) {
                continue;
            }
            let score = f64::from(scored.sum) / full;
            if found.len() == PLACES_MAX {
                return Places { found, others_max: score };
            }
            found.push(Candidate { map_from_cloud, score });
        }
        Places { found, others_max: f64::from(least) / full }
    }
}

/// Headings that are looked at, in order.
fn headings(near: Option<Near>) -> Vec<f64> {
    let (middle, half) = near.map_or((0.0, PI), |near| (near.pose.heading_rad, near.turn_rad.min(PI)));
    let steps = (half / STEP_RAD).ceil().max(0.0) as i32;
    let step = if steps == 0 { 0.0 } else { half / f64::from(steps) };
    // A full turn ends where it began.
    let last = if 2.0 * half + 1e-9 >= TAU { steps - 1 } else { steps };
    (-steps..=last).map(|i| middle + f64::from(i) * step).collect()
}

/// The part of these columns of a row that is near.
fn within(
    field: &PlaceField,
    near: Option<Near>,
    columns: &Range<usize>,
    row: usize,
) -> Option<Range<usize>> {
    let Some(near) = near else { return Some(columns.clone()) };
    let (first_m, y_m) = field.middle(columns.start, row);
    let half = near.reach_m * near.reach_m - (y_m - near.pose.y_m) * (y_m - near.pose.y_m);
    if half < 0.0 {
        return None;
    }
    let cell = |x_m: f64| ((x_m - first_m) / field.cell_m()).clamp(-1.0, columns.len() as f64);
    let start = columns.start + cell(near.pose.x_m - half.sqrt()).ceil().max(0.0) as usize;
    let end = columns.start + (cell(near.pose.x_m + half.sqrt()).floor() + 1.0) as usize;
    let part = start..end.min(columns.end);
    (!part.is_empty()).then_some(part)
}

/// Whether two poses are the same place.
pub(crate) fn is_same(a: &Placement, b: &Placement) -> bool {
    a.distance_m(b) < APART.0 && a.turn_rad(b) < APART.1
}
