//! The views of a robot that localizes: where each was measured to be in the known map, if it was, and what was seen from there. Gives the
//! poses that agree best with all of that.

use crate::pose_record::PoseRecord;
use flockslam_geometry::elementary::hypot;
use flockslam_localisation::Measurement;
use flockslam_loop_closure::node::Node;
use flockslam_loop_closure::refine::Refinement;
use flockslam_loop_closure::scans::ScanStore;
use flockslam_pose_graph::{Edge, RobustSettings, Symmetric, solve};
use flockslam_registration::cloud::{MomentGrid, PackedPoint, Placement};

/// Errors of the front end's motion from view to view: for a metre of travel, metres and radians, and what is there without any.
const DRIFT: (f64, f64) = (0.015, 0.004);
const DRIFT_MIN: (f64, f64) = (0.002, 0.001);
/// What these motions are worth, as a share, beside matches to what all views saw: they come from the same scans, and must not count twice.
const MATCHED_SHARE: f64 = 0.005;
/// A measurement with a greater squared Mahalanobis error is an outlier.
const CHI_SQUARED_MAX: f64 = 25.0;
/// Where a robot is found again, what the front end says of the way from the last place in the map may be off by this, metres and radians,
/// and by this share of the way and this much for each metre. Beyond it one of the two is wrong, and the way does not hold them together.
const FOUND_OFF: (f64, f64) = (0.3, 0.1);
const FOUND_OFF_PER_M: (f64, f64) = (0.05, 0.01);
/// A view that hangs at where it begins, and is held by nothing else: what this is worth, 1/m² and 1/rad², where it was measured and where
/// it was not. A long way without measurements must not hang there.
const LOOSE: (f64, f64) = (1.0, 1e-4);
/// What the pose of a scan is worth when all before it is dropped: standard deviations, metres and radians.
const DROPPED_SIGMA: (f64, f64) = (0.03, 0.01);
/// How often all views are matched to what they saw together. A third time changes nothing.
const REFINEMENTS: usize = 2;
/// The cloud without points among the clouds.
const NO_CLOUD: usize = 0;

/// A scan with its points, and its place in the map where that was measured.
#[derive(Clone, Copy)]
struct View {
    record: usize,
    measured: Option<Measurement>,
    /// The front end's motion leads here from the view before.
    follows: bool,
    cloud: usize,
    is_open: bool,
}

/// A view that has a pose in the map.
struct PlacedView {
    view: View,
    /// Where it begins, before anything is solved.
    begin: Placement,
    /// The front end's motion from the view before, unless it holds nothing together.
    motion: Option<Placement>,
}

/// Views in the order of their scans.
pub(crate) struct MeasuredViews {
    views: Vec<View>,
    clouds: ScanStore,
}

impl Default for MeasuredViews {
    fn default() -> Self {
        let mut clouds = ScanStore::default();
        clouds.keep_points(std::iter::empty());
        Self { views: Vec::new(), clouds }
    }
}

impl MeasuredViews {
    /// Number of views.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Adds the view of a record, with the points seen from there, in the robot's frame, and where it was measured to be. `follows`: the front
    /// end's motion leads here from the view before; `is_open`: points do not hold its pose, as in the open.
    pub fn push(
        &mut self,
        record: usize,
        measured: Option<Measurement>,
        follows: bool,
        points: &[PackedPoint],
        is_open: bool,
    ) {
        let is_empty = points.is_empty();
        let cloud = if is_empty { NO_CLOUD } else { self.clouds.keep_points(points.iter().copied()) };
        self.views.push(View { record, measured, follows, cloud, is_open });
    }

    /// Drops all views up to a record, which becomes record 0, and whose pose is this where it has one in the map.
    pub fn drop_until(&mut self, record: usize, map_from_base: Option<Placement>) {
        self.views.retain(|view| view.record > record);
        // What goes on begins with where the first scan that is left was.
        let begin = map_from_base.map(|map_from_base| {
            let (position, heading) = (DROPPED_SIGMA.0.powi(-2), DROPPED_SIGMA.1.powi(-2));
            let information = [position, 0.0, 0.0, position, 0.0, heading];
            let measured = Some(Measurement { map_from_base, information });
            View { record, measured, follows: false, cloud: NO_CLOUD, is_open: false }
        });
        self.views.splice(..0, begin);
        let mut is_wanted = vec![false; self.clouds.len()];
        is_wanted[NO_CLOUD] = true;
        self.views.iter().for_each(|view| is_wanted[view.cloud] = true);
        let renamed = self.clouds.retain(&is_wanted);
        for view in &mut self.views {
            view.record -= record;
            view.cloud = renamed[view.cloud];
        }
    }

    /// The poses in the map of all views that measurements and the front end's motions give one, each behind its record: from those together,
    /// then matched to what all views saw together, as a map's own scans are.
    pub fn solved(&self, records: &[PoseRecord]) -> Vec<(usize, Placement)> {
        let placed = self.placed(records);
        let begin = placed.iter().map(|view| view.begin);
        let mut poses: Vec<Placement> = std::iter::once(Placement::IDENTITY).chain(begin).collect();
        let measured = |(k, view): (usize, &PlacedView)| {
            let Measurement { map_from_base, information } = view.view.measured?;
            Some(Edge { from: 0, to: k + 1, motion: map_from_base, information })
        };
        let measurements: Vec<Edge> = placed.iter().enumerate().filter_map(measured).collect();
        let motions = motions(&placed, 1.0);
        let edges: Vec<Edge> = motions.iter().chain(&measurements).copied().collect();
        let settings =
            RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 1.6, rounds: 25, warm_up: 6 };
        solve(poses.len(), &edges, motions.len(), &settings, &mut poses);
        self.refine(&placed, &measurements, &mut poses);
        placed.iter().map(|view| view.view.record).zip(poses.split_off(1)).collect()
    }

    /// The views that have a pose to begin with: where they were measured, or by the front end's motion from or to one that was.
    fn placed(&self, records: &[PoseRecord]) -> Vec<PlacedView> {
        let motion = |k: usize| {
            let [from, to] = [k - 1, k].map(|k| records[self.views[k].record].odom);
            from.to(to)
        };
        let mut placed: Vec<(Option<Placement>, Option<Placement>)> = Vec::with_capacity(self.views.len());
        let mut way_m = 0.0;
        for (k, view) in self.views.iter().enumerate() {
            let motion = (k > 0 && view.follows).then(|| motion(k));
            way_m += motion.map_or(0.0, |motion| hypot(motion.x_m, motion.y_m));
            let before = placed.last().and_then(|(begin, _)| *begin);
            let carried = before.zip(motion).map(|(before, motion)| before.compose(motion));
            let measured = view.measured.map(|measured| measured.map_from_base);
            let is_apart = carried.zip(measured).is_some_and(|(carried, measured)| {
                carried.distance_m(&measured) > FOUND_OFF.0 + FOUND_OFF_PER_M.0 * way_m
                    || carried.turn_rad(&measured) > FOUND_OFF.1 + FOUND_OFF_PER_M.1 * way_m
            });
            way_m = if measured.is_some() { 0.0 } else { way_m };
            placed.push((measured.or(carried), motion.filter(|_| !is_apart)));
        }
        for k in (1..placed.len()).rev() {
            let (Some(after), Some(motion)) = placed[k] else { continue };
            placed[k - 1].0.get_or_insert(after.compose(motion.inverse()));
        }
        let views = self.views.iter().zip(placed);
        views
            .filter_map(|(view, (begin, motion))| Some(PlacedView { view: *view, begin: begin?, motion }))
            .collect()
    }

    fn refine(&self, placed: &[PlacedView], measurements: &[Edge], poses: &mut [Placement]) {
        // The map is a node without points.
        let of_map = [(NO_CLOUD, false)].into_iter();
        let seen = of_map.chain(placed.iter().map(|view| (view.view.cloud, view.view.is_open)));
        let node = |(at, (scan, is_open)): (&Placement, (usize, bool))| Node {
            scan,
            sequence: 0,
            odom: *at,
            local_pose: *at,
            start: *at,
            travel_m: 0.0,
            drift_bound_m: 0.0,
            trajectory: 0,
            is_open,
            is_given: false,
        };
        let nodes: Vec<Node> = poses.iter().zip(seen).map(node).collect();
        let in_map: Vec<bool> = nodes.iter().map(|node| node.scan != NO_CLOUD).collect();
        let refinement = Refinement {
            nodes: &nodes,
            scans: &self.clouds,
            odometry: &motions(placed, MATCHED_SHARE),
            constraints: measurements,
            in_map: &in_map,
        };
        let mut grid = MomentGrid::default();
        (0..REFINEMENTS).for_each(|_| refinement.run(&mut grid, poses));
    }
}

/// The front end's motions to views, with this share of their information, as edges between nodes; node 0 is the map.
fn motions(placed: &[PlacedView], share: f64) -> Vec<Edge> {
    // What nothing else holds stays where it begins.
    let at = |(k, view): (usize, &PlacedView)| {
        let loose = if view.view.measured.is_some() { LOOSE.0 } else { LOOSE.1 };
        Edge { from: 0, to: k + 1, motion: view.begin, information: [loose, 0.0, 0.0, loose, 0.0, loose] }
    };
    let to = |(k, view): (usize, &PlacedView)| {
        let information = drift(&view.motion?).map(|v| share * v);
        // The view before it is placed, too.
        Some(Edge { from: k, to: k + 1, motion: view.motion?, information })
    };
    let views = || placed.iter().enumerate();
    views().map(at).chain(views().filter_map(to)).collect()
}

/// Information of a motion of the front end.
fn drift(motion: &Placement) -> Symmetric {
    let way_m = hypot(motion.x_m, motion.y_m);
    let variance = |least: f64, per_m: f64| least * least + per_m * per_m * way_m;
    let (position, heading) = (1.0 / variance(DRIFT_MIN.0, DRIFT.0), 1.0 / variance(DRIFT_MIN.1, DRIFT.1));
    [position, 0.0, 0.0, position, 0.0, heading]
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::PoseEstimate;
    use flockslam_random::Random;

    fn way(step: usize) -> Placement {
        Placement::new(-2.0 + 0.06 * step as f64, 0.4, 0.004 * step as f64)
    }

    /// The walls of a room of 6 × 4 m, as they are seen from a place.
    fn walls(at: Placement) -> Vec<PackedPoint> {
        let along = (0..=120).map(|i| f64::from(i) / 120.0).flat_map(|share| {
            let (x, y) = (6.0 * share - 3.0, 4.0 * share - 2.0);
            [(x, -2.0), (x, 2.0), (-3.0, y), (3.0, y)]
        });
        let seen = along.map(|(x, y)| at.inverse().apply(x, y));
        seen.filter_map(|(x, y)| PackedPoint::from_metres(x, y)).collect()
    }

    /// Poses from measurements of these steps in the map with an error of a few centimetres, and from the front end's motions.
    fn solved(is_measured: impl Fn(usize) -> bool, motion_sigma: f64, sees: bool) -> Vec<Placement> {
        let mut random = Random::new(1, "views");
        let (mut views, mut records) = (MeasuredViews::default(), Vec::new());
        for step in 0..60 {
            let mut off = |most: f64| random.between(-most, most);
            let at = way(step).compose(Placement::new(off(0.04), off(0.04), off(0.02)));
            let odom = Placement::new(off(motion_sigma), off(motion_sigma), off(0.5 * motion_sigma));
            let odom = way(step).compose(odom).pose();
            records.push(PoseRecord::new(&PoseEstimate { odom_from_base: odom, ..PoseEstimate::default() }));
            let information = [800.0, 0.0, 0.0, 800.0, 0.0, 3000.0];
            let points = if sees { walls(way(step)) } else { Vec::new() };
            let measured = is_measured(step).then_some(Measurement { map_from_base: at, information });
            views.push(step, measured, step > 0, &points, false);
        }
        views.solved(&records).into_iter().map(|(_, pose)| pose).collect()
    }

    #[test]
    fn what_views_see_together_halves_the_errors_of_their_motions_and_leaves_them_in_the_map() {
        let error = |poses: &[Placement]| {
            let off = |k: usize| poses[k].to(poses[k + 1]).distance_m(&way(k).to(way(k + 1)));
            (0..59).map(off).sum::<f64>() / 59.0
        };
        let (measured, matched) = (solved(|_| true, 0.01, false), solved(|_| true, 0.01, true));
        let (before_m, after_m) = (error(&measured), error(&matched));
        assert!(after_m < 0.56 * before_m, "{before_m} m, matched {after_m} m");
        let off_m = matched.iter().enumerate().map(|(k, at)| at.distance_m(&way(k))).fold(0.0, f64::max);
        assert!(off_m < 0.022, "{off_m} m from the map's frame");
    }

    #[test]
    fn views_that_were_not_measured_are_placed_by_what_they_saw() {
        let worst_m = |poses: &[Placement]| {
            let off = |(k, at): (usize, &Placement)| at.distance_m(&way(k));
            poses.iter().enumerate().map(off).fold(0.0, f64::max)
        };
        let is_measured = |step| (20..40).contains(&step);
        let (carried, matched) = (solved(is_measured, 0.03, false), solved(is_measured, 0.03, true));
        assert_eq!((carried.len(), matched.len()), (60, 60));
        let (carried_m, matched_m) = (worst_m(&carried), worst_m(&matched));
        assert!(matched_m < 0.6 * carried_m, "{carried_m} m, matched {matched_m} m");
    }

    #[test]
    fn a_way_that_contradicts_the_place_where_the_robot_is_found_again_bends_nothing() {
        let (mut views, mut records) = (MeasuredViews::default(), Vec::new());
        let kidnapped =
            |step: usize| Placement::new(if step < 20 { 0.0 } else { 5.0 }, 0.0, 0.0).compose(way(step));
        for step in 0..30 {
            let odom = way(step).pose();
            records.push(PoseRecord::new(&PoseEstimate { odom_from_base: odom, ..PoseEstimate::default() }));
            let information = [800.0, 0.0, 0.0, 800.0, 0.0, 3000.0];
            let is_lost = (10..20).contains(&step);
            let measured = (!is_lost).then(|| Measurement { map_from_base: kidnapped(step), information });
            views.push(step, measured, true, &[], false);
        }
        let solved = views.solved(&records);
        assert_eq!(solved.len(), 30);
        let off = |(step, at): &(usize, Placement)| at.distance_m(&kidnapped(*step));
        assert!(solved.iter().all(|view| off(view) < 1e-3), "{solved:?}");
    }

    #[test]
    fn views_that_nothing_ties_to_the_map_have_no_pose() {
        let (mut views, mut records) = (MeasuredViews::default(), Vec::new());
        let measured = Measurement { map_from_base: way(0), information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        for step in 0..20 {
            let odom = way(step).pose();
            records.push(PoseRecord::new(&PoseEstimate { odom_from_base: odom, ..PoseEstimate::default() }));
            views.push(step, (step == 12).then_some(measured), step != 5, &[], false);
        }
        let placed: Vec<usize> = views.solved(&records).into_iter().map(|(record, _)| record).collect();
        assert_eq!(placed, (5..20).collect::<Vec<_>>());
        views.drop_until(3, None);
        assert_eq!(views.len(), 16);
    }

    #[test]
    fn what_is_dropped_takes_its_points_along() {
        let mut views = MeasuredViews::default();
        let measured = Measurement { map_from_base: way(0), information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        (0..10).for_each(|record| views.push(record, Some(measured), true, &walls(way(record)), false));
        views.drop_until(6, Some(way(6)));
        let records: Vec<usize> = views.views.iter().map(|view| view.record).collect();
        assert_eq!((records, views.clouds.len()), (vec![0, 1, 2, 3], 1 + 3));
        let begin = &views.views[0];
        assert!(
            begin.measured.unwrap().map_from_base == way(6) && views.clouds.points(begin.cloud).is_empty()
        );
        assert_eq!(views.clouds.points(views.views[3].cloud), walls(way(9)));
    }
}
