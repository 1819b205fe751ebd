//! What the robot has seen over its last metres, as one cloud by its odometry.

use crate::SeenPoint;
use flockslam_registration::cloud::{PackedPoint, Placement};
use std::collections::VecDeque;

/// The mean of the points in each square of this side stands for them, metres.
const CELL_M: f64 = 0.1;
/// Views that are held at most: a robot that turns on the spot gets many without travel.
const VIEWS_MAX: usize = 400;

/// A scan and where it was taken by the front end.
#[derive(Clone, Debug)]
struct View {
    odom_from_base: Placement,
    travel_m: f64,
    points: Vec<PackedPoint>,
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
        self.views.push_back(View { odom_from_base, travel_m, points: points.to_vec() });
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
        let Some(newest) = self.views.back() else { return Vec::new() };
        let mut points = Vec::new();
        for view in self.views.iter().filter(|view| newest.travel_m - view.travel_m <= length_m) {
            let at = newest.odom_from_base.to(view.odom_from_base);
            points.extend(view.points.iter().map(|point| {
                let (x_m, y_m) = at.apply(point.x_m(), point.y_m());
                SeenPoint { x_m, y_m, from_x_m: at.x_m, from_y_m: at.y_m }
            }));
        }
        let means = cell_means(&points);
        let stride = means.len().div_ceil(most).max(1);
        means.into_iter().step_by(stride).collect()
    }
}

/// The mean of the points in each square, in order of squares; the last view of each gives the viewpoint.
fn cell_means(points: &[SeenPoint]) -> Vec<SeenPoint> {
    let key = |v: f64| (v * (1.0 / CELL_M)).floor() as i32;
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
