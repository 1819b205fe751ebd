//! What the robot has seen over its last metres, as one cloud by its odometry.

use crate::SeenPoint;
use flockslam_evidence::floor;
use flockslam_geometry::elementary::{atan2, hypot};
use flockslam_registration::cloud::{PackedPoint, Placement};
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// The mean of the points in each square of this side stands for them, metres.
const CELL_M: f64 = 0.1;
/// Views that are held at most: a robot that turns on the spot gets many without travel.
const VIEWS_MAX: usize = 400;
/// What is firm follows from what was seen over at least this much travel, metres.
const FIRM_M: f64 = 4.0;
/// … by at most so many views.
const PANORAMAS: usize = 24;
/// So many directions of a turn are distinguished.
const DIRECTIONS: usize = 360;
/// A beam that ends within this of a point ends there, metres.
const ENDS_M: f32 = 0.3;
/// A point counts as firm when so many views end there, and more than pass it.
const ENDS_MIN: u32 = 2;

/// A scan and where it was taken by the front end.
#[derive(Clone, Debug)]
struct View {
    odom_from_base: Placement,
    travel_m: f64,
    points: Vec<PackedPoint>,
    panorama: Panorama,
}

/// The last views of a robot.
#[derive(Clone, Debug, Default)]
pub struct RecentViews {
    views: VecDeque<View>,
}

impl RecentViews {
    /// Clears all.
    pub fn clear(&mut self) {
        self.views.clear();
    }

    /// Adds a view, and drops those more than `length_m` of travel before it.
    pub fn push(&mut self, odom_from_base: Placement, points: &[PackedPoint], length_m: f64) {
        let travel_m = self
            .views
            .back()
            .map_or(0.0, |last| last.travel_m + last.odom_from_base.distance_m(&odom_from_base));
        self.views.push_back(View {
            odom_from_base,
            travel_m,
            points: points.to_vec(),
            panorama: Panorama::of(points),
        });
        while self.views.len() > VIEWS_MAX
            || self.views.front().is_some_and(|first| travel_m - first.travel_m > length_m)
        {
            self.views.pop_front();
        }
    }

    /// Drops all but the newest view and those after which it came within less than so many metres of travel.
    pub fn keep(&mut self, length_m: f64) {
        let Some(newest) = self.views.back().map(|view| view.travel_m) else { return };
        let is_old = |view: &View| newest - view.travel_m >= length_m && newest > view.travel_m;
        while self.views.front().is_some_and(is_old) {
            self.views.pop_front();
        }
    }

    /// The length of the way in it, metres.
    pub fn travel_m(&self) -> f64 {
        match (self.views.front(), self.views.back()) {
            (Some(first), Some(last)) => last.travel_m - first.travel_m,
            _ => 0.0,
        }
    }

    /// The whole way until the newest view since all was cleared, metres.
    pub fn way_m(&self) -> f64 {
        self.views.back().map_or(0.0, |newest| newest.travel_m)
    }

    /// The points of the last `length_m` of travel in the frame of the newest view, at most about `most`, evenly over the surface.
    pub fn cloud(&self, length_m: f64, most: usize) -> Vec<SeenPoint> {
        evenly(cell_means(&self.points(length_m)), most)
    }

    /// The same of what stands there, and the share that it is: ground, grass and leaves give other returns each time, so that as many beams
    /// pass a place as end there.
    pub fn firm_cloud(&self, length_m: f64, most: usize) -> (Vec<SeenPoint>, f64) {
        let points = cell_means(&self.points(length_m));
        let Some(newest) = self.views.back() else { return (points, 1.0) };
        let seen: Vec<&View> = self.within(length_m.max(FIRM_M)).collect();
        let stride = seen.len().div_ceil(PANORAMAS).max(1);
        let seen = seen.into_iter().rev().step_by(stride);
        let seen: Vec<(Placement, &Panorama)> =
            seen.map(|view| (view.odom_from_base.to(newest.odom_from_base), &view.panorama)).collect();
        let is_firm = |point: &&SeenPoint| {
            let (mut ends, mut passes) = (0, 0);
            for (view_from_newest, panorama) in &seen {
                let (x_m, y_m) = view_from_newest.apply(point.x_m, point.y_m);
                match panorama.meets(x_m, y_m) {
                    Some(true) => ends += 1,
                    Some(false) => passes += 1,
                    None => {}
                }
            }
            ends >= ENDS_MIN && ends > passes
        };
        let firm: Vec<SeenPoint> = points.iter().filter(is_firm).copied().collect();
        let share = firm.len() as f64 / points.len().max(1) as f64;
        (evenly(firm, most), share)
    }

    fn within(&self, length_m: f64) -> impl Iterator<Item = &View> {
        let newest_m = self.way_m();
        self.views.iter().filter(move |view| newest_m - view.travel_m <= length_m)
    }

    fn points(&self, length_m: f64) -> Vec<SeenPoint> {
        let Some(newest) = self.views.back() else { return Vec::new() };
        let mut points = Vec::new();
        for view in self.within(length_m) {
            let at = newest.odom_from_base.to(view.odom_from_base);
            points.extend(view.points.iter().map(|point| {
                let (x_m, y_m) = at.apply(point.x_m(), point.y_m());
                SeenPoint { x_m, y_m, from_x_m: at.x_m, from_y_m: at.y_m }
            }));
        }
        points
    }
}

/// How far a view sees in each direction: least and greatest range of its points there, metres.
#[derive(Clone, Debug)]
struct Panorama(Vec<(f32, f32)>);

impl Panorama {
    fn of(points: &[PackedPoint]) -> Self {
        let mut ranges_m = vec![(f32::INFINITY, 0.0_f32); DIRECTIONS];
        for point in points {
            let (direction, range_m) = polar(point.x_m(), point.y_m());
            let (least, greatest) = &mut ranges_m[direction];
            *least = least.min(range_m);
            *greatest = greatest.max(range_m);
        }
        Self(ranges_m)
    }

    /// Whether beams end at a point of the view's frame or pass it; `None` where none gets there.
    fn meets(&self, x_m: f64, y_m: f64) -> Option<bool> {
        let (direction, range_m) = polar(x_m, y_m);
        let (least, greatest) = self.0[direction];
        (greatest >= range_m - ENDS_M).then_some(least <= range_m + ENDS_M)
    }
}

/// Direction as the number of a step of a turn, and distance.
fn polar(x_m: f64, y_m: f64) -> (usize, f32) {
    let step = floor(atan2(y_m, x_m) * (DIRECTIONS as f64 / TAU)) as isize;
    (step.rem_euclid(DIRECTIONS as isize) as usize, hypot(x_m, y_m) as f32)
}

/// At most about so many of the points, evenly.
fn evenly(points: Vec<SeenPoint>, most: usize) -> Vec<SeenPoint> {
    let stride = points.len().div_ceil(most).max(1);
    points.into_iter().step_by(stride).collect()
}

/// The mean of the points in each square, in order of squares; the last view of each gives the viewpoint.
fn cell_means(points: &[SeenPoint]) -> Vec<SeenPoint> {
    let key = |v: f64| floor(v * (1.0 / CELL_M));
    let mut cells: Vec<(i32, i32, usize)> =
        points.iter().enumerate().map(|(i, p)| (key(p.y_m), key(p.x_m), i)).collect();
    cells.sort_unstable();
    let mean = |group: &[(i32, i32, usize)]| {
        let share = 1.0 / group.len() as f64;
        let sum = group.iter().fold((0.0, 0.0), |s, g| (s.0 + points[g.2].x_m, s.1 + points[g.2].y_m));
        SeenPoint { x_m: sum.0 * share, y_m: sum.1 * share, ..points[group[group.len() - 1].2] }
    };
    cells.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that drives along a wall and sees ground before it, each time elsewhere.
    #[test]
    fn a_wall_is_firm_and_ground_that_beams_pass_is_not() {
        let mut recent = RecentViews::default();
        // A linear congruential generator (Knuth 1997, 3.2.1), 0 … 1.
        let mut number = 5_u32;
        let mut random = || {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(number) / f64::from(u32::MAX)
        };
        for step in 0..12 {
            let at = Placement::new(0.3 * f64::from(step), 0.0, 0.0);
            let points = (-60..60).map(|degree| {
                let (sin, cos) = flockslam_geometry::elementary::sin_cos(f64::from(degree).to_radians());
                let to_wall_m = 8.0 / cos;
                let (meets_ground, share) = (random() < 0.4, random());
                let range_m = if meets_ground { 1.0 + share * (to_wall_m - 2.0) } else { to_wall_m };
                // The wall is on the left.
                PackedPoint::from_metres(-range_m * sin, range_m * cos).unwrap()
            });
            recent.push(at, &points.collect::<Vec<_>>(), 8.0);
        }
        let is_wall = |point: &&SeenPoint| (point.y_m - 8.0).abs() < 0.1;
        let all = recent.cloud(8.0, 10_000);
        let (firm, share) = recent.firm_cloud(8.0, 10_000);
        let (walls, firm_walls) = (all.iter().filter(is_wall).count(), firm.iter().filter(is_wall).count());
        assert!(firm_walls * 10 >= walls * 9, "{firm_walls} of {walls} squares of the wall");
        let (ground, firm_ground) = (all.len() - walls, firm.len() - firm_walls);
        assert!(firm_ground * 5 <= ground, "{firm_ground} of {ground} squares of the ground");
        assert!((share - firm.len() as f64 / all.len() as f64).abs() < 1e-9);
    }
}
