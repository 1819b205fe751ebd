//! Objects that stand free and are as narrow as a person – people, posts, legs of furniture – are left out of a fit, as
//! long as enough else is seen. A person who walks ahead of the robot into a new corridor, or stands still and goes on, would
//! hold the pose back, because nothing else there measures the distance driven.

use super::points::{MoverMask, ScanPoints, add_beams};
use flockslam_geometry::Point;
use std::ops::Range;

/// Points of neighbouring beams belong to one cluster when they are nearer to each other than this, metres, …
const JOIN_M: f64 = 0.08;
/// … and this share of their range. A person beside a wall is separated from it.
const JOIN_SHARE: f64 = 0.04;
/// A person is narrower than this, metres, …
const WIDTH_MAX_M: f64 = 0.6;
/// … shows at least so many points, …
const POINTS_MIN: usize = 3;
/// … can be distinguished from the end of a wall within this range, metres, …
const RANGE_MAX_M: f64 = 10.0;
/// … and what is seen on both sides is farther away by this, metres.
const BEFORE_M: f64 = 0.1;
/// Number of passes: a person half behind another one is found once the other is known.
const PASSES: usize = 2;
/// A scan with more than this share of its points on bodies is fitted as it is: there may be nothing but posts and trees.
const SHARE_MAX: f64 = 0.5;

/// Leaves out the points on bodies. Their beams do not count as moving: the map shows these bodies.
pub(super) fn without_bodies(points: ScanPoints, mut mask: MoverMask) -> (ScanPoints, MoverMask) {
    if points.len() == 0 {
        return (points, mask);
    }
    mask.unmark(points.len());
    let mut left_out = 0;
    find_pieces(&points.ends, &mut mask.pieces);
    for _ in 0..PASSES {
        left_out += mark_bodies(&points.ends, &mask.pieces, &mut mask.marks);
    }
    if left_out as f64 > SHARE_MAX * points.len() as f64 {
        return (points, mask);
    }
    for i in (0..points.len()).filter(|i| mask.marks[*i]) {
        add_beams(&mut mask.bodies, 0, points.beams[i], points.stride);
    }
    (points.without(&mask.marks), mask)
}

/// Finds the clusters of points, which are in the order of their beams: where each begins and ends.
fn find_pieces(points: &[Point], pieces: &mut Vec<Range<usize>>) {
    pieces.clear();
    let mut first = 0;
    let mut last_m = points.first().map_or(0.0, |point| point.norm_m());
    for end in 1..=points.len() {
        let is_next = points.get(end).is_some_and(|next| {
            let before_m = std::mem::replace(&mut last_m, next.norm_m());
            points[end - 1].distance_m(*next) < JOIN_M + JOIN_SHARE * before_m.min(last_m)
        });
        if !is_next {
            pieces.push(first..end);
            first = end;
        }
    }
}

/// Marks the points of those pieces that are bodies; gives how many were not marked yet.
fn mark_bodies(points: &[Point], pieces: &[Range<usize>], marked: &mut [bool]) -> usize {
    assert_eq!(points.len(), marked.len(), "a mark for each point");
    let mut count = 0;
    for piece in pieces {
        if !marked[piece.start] && is_body(points, marked, piece.start, piece.end) {
            marked[piece.clone()].fill(true);
            count += piece.len();
        }
    }
    count
}

fn is_body(points: &[Point], marked: &[bool], first: usize, end: usize) -> bool {
    let (right, left) = (points[first], points[end - 1]);
    if end - first < POINTS_MIN || right.distance_m(left) > WIDTH_MAX_M || right.norm_m() > RANGE_MAX_M {
        return false;
    }
    // Around the circle, past the bodies that are known already.
    let count = points.len();
    let before = (1..count).map(|step| (first + count - step) % count).find(|i| !marked[*i]);
    let after = (0..count).map(|step| (end + step) % count).find(|i| !marked[*i]);
    let is_behind = |other: Option<usize>, side: Point| {
        other.is_some_and(|other| points[other].norm_m() > side.norm_m() + BEFORE_M)
    };
    is_behind(before, right) && is_behind(after, left)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points a degree apart, where a wall is 4 m away and others are where `range_m` says.
    fn points(range_m: impl Fn(usize) -> Option<f64>) -> Vec<Point> {
        let end = |degree: usize| {
            let (sin, cos) = (degree as f64).to_radians().sin_cos();
            let range_m = range_m(degree).unwrap_or(4.0);
            Point::new(range_m * cos, range_m * sin)
        };
        (0..360).map(end).collect()
    }

    fn marked(points: &[Point]) -> Vec<usize> {
        let mut marked = vec![false; points.len()];
        let mut pieces = Vec::new();
        find_pieces(points, &mut pieces);
        let counts: usize = (0..PASSES).map(|_| mark_bodies(points, &pieces, &mut marked)).sum();
        assert_eq!(counts, marked.iter().filter(|marked| **marked).count());
        (0..points.len()).filter(|i| marked[*i]).collect()
    }

    #[test]
    fn a_person_before_a_wall_is_a_body() {
        let one = points(|degree| (100..110).contains(&degree).then_some(2.0));
        assert_eq!(marked(&one), (100..110).collect::<Vec<_>>());
    }

    #[test]
    fn a_partly_occluded_person_is_a_body() {
        let two = points(|degree| match degree {
            100..110 => Some(2.0),
            110..114 => Some(3.0),
            _ => None,
        });
        assert_eq!(marked(&two), (100..114).collect::<Vec<_>>());
    }

    #[test]
    fn a_piece_of_wall_between_two_people_is_none() {
        let between =
            points(|degree| [95..100, 105..110].iter().any(|at| at.contains(&degree)).then_some(1.0));
        assert_eq!(marked(&between), (95..100).chain(105..110).collect::<Vec<_>>());
    }

    #[test]
    fn what_is_wide_or_a_step_in_a_wall_is_none() {
        assert_eq!(marked(&points(|degree| (100..130).contains(&degree).then_some(2.0))), [0; 0]);
        assert_eq!(marked(&points(|degree| (degree < 180).then_some(3.0))), [0; 0]);
    }
}
