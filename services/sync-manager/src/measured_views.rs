//! The views of a robot that localizes: where each was measured to be in the known map, and what was seen from there. Gives the poses that
//! agree best with all of that.

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
/// How often all views are matched to what they saw together. A third time changes nothing.
const REFINEMENTS: usize = 2;
/// The cloud without points among the clouds.
const NO_CLOUD: usize = 0;

/// A place in the map that was measured.
#[derive(Clone, Copy)]
struct View {
    record: usize,
    measured: Measurement,
    /// The robot was followed from the view before this one.
    follows: bool,
    cloud: usize,
    is_open: bool,
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

    /// Adds the view of a record, with the points seen from there, in the robot's frame. `follows`: the robot was followed from the view
    /// before; `is_open`: points do not hold its pose, as in the open.
    pub fn push(
        &mut self,
        record: usize,
        measured: Measurement,
        follows: bool,
        points: &[PackedPoint],
        is_open: bool,
    ) {
        let is_empty = points.is_empty();
        let cloud = if is_empty { NO_CLOUD } else { self.clouds.keep_points(points.iter().copied()) };
        self.views.push(View { record, measured, follows, cloud, is_open });
    }

    /// Drops all views up to a record, which becomes record 0 and has this pose.
    pub fn drop_until(&mut self, record: usize, map_from_base: Placement) {
        let last = self.views.iter().rfind(|view| view.record <= record).copied();
        // What goes on begins with where the first scan that is left was.
        let begin = last.map(|last| View {
            record,
            measured: Measurement { map_from_base, ..last.measured },
            follows: false,
            cloud: NO_CLOUD,
            is_open: false,
        });
        self.views.retain(|view| view.record > record);
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

    /// The poses of all views in the map, each behind its record: measurements and the front end's motions together, then matched
    /// to what all views saw together, as a map's own scans are.
    pub fn solved(&self, records: &[PoseRecord]) -> Vec<(usize, Placement)> {
        let measured = self.views.iter().map(|view| view.measured.map_from_base);
        let mut poses: Vec<Placement> = std::iter::once(Placement::IDENTITY).chain(measured).collect();
        let motions = self.motions(records, 1.0);
        let measurements = self.views.iter().enumerate().map(|(k, view)| Edge {
            from: 0,
            to: k + 1,
            motion: view.measured.map_from_base,
            information: view.measured.information,
        });
        let measurements: Vec<Edge> = measurements.collect();
        let edges: Vec<Edge> = motions.iter().chain(&measurements).copied().collect();
        let settings =
            RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 1.6, rounds: 25, warm_up: 6 };
        solve(poses.len(), &edges, motions.len(), &settings, &mut poses);
        self.refine(&self.motions(records, MATCHED_SHARE), &measurements, &mut poses);
        self.views.iter().map(|view| view.record).zip(poses.split_off(1)).collect()
    }

    /// The front end's motions between views, with this share of their information, as edges between nodes; node 0 is the map.
    fn motions(&self, records: &[PoseRecord], share: f64) -> Vec<Edge> {
        // Each view hangs loosely at where it was measured: what nothing else holds stays there.
        let loose = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0];
        let at = |(k, view): (usize, &View)| Edge {
            from: 0,
            to: k + 1,
            motion: view.measured.map_from_base,
            information: loose,
        };
        let mut edges: Vec<Edge> = self.views.iter().enumerate().map(at).collect();
        for (k, pair) in self.views.windows(2).enumerate().filter(|(_, pair)| pair[1].follows) {
            let (from, to) = (&records[pair[0].record], &records[pair[1].record]);
            let motion = from.odom.to(to.odom);
            edges.push(Edge {
                from: k + 1,
                to: k + 2,
                motion,
                information: drift(&motion).map(|v| share * v),
            });
        }
        edges
    }

    fn refine(&self, motions: &[Edge], measurements: &[Edge], poses: &mut [Placement]) {
        // The map is a node without points.
        let of_map = [(NO_CLOUD, false)].into_iter();
        let seen = of_map.chain(self.views.iter().map(|view| (view.cloud, view.is_open)));
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
            odometry: motions,
            constraints: measurements,
            in_map: &in_map,
        };
        let mut grid = MomentGrid::default();
        (0..REFINEMENTS).for_each(|_| refinement.run(&mut grid, poses));
    }
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

    /// Poses that follow from measurements in the map with an error of a few centimetres, and the records.
    fn solved(sees: bool) -> Vec<Placement> {
        let mut random = Random::new(1, "views");
        let (mut views, mut records) = (MeasuredViews::default(), Vec::new());
        for step in 0..60 {
            let mut off = |most: f64| random.between(-most, most);
            let at = way(step).compose(Placement::new(off(0.04), off(0.04), off(0.02)));
            let odom = way(step).compose(Placement::new(off(0.01), off(0.01), off(0.005))).pose();
            records.push(PoseRecord::new(&PoseEstimate { odom_from_base: odom, ..PoseEstimate::default() }));
            let information = [800.0, 0.0, 0.0, 800.0, 0.0, 3000.0];
            let points = if sees { walls(way(step)) } else { Vec::new() };
            views.push(step, Measurement { map_from_base: at, information }, step > 0, &points, false);
        }
        views.solved(&records).into_iter().map(|(_, pose)| pose).collect()
    }

    #[test]
    fn what_views_see_together_halves_the_errors_of_their_motions_and_leaves_them_in_the_map() {
        let error = |poses: &[Placement]| {
            let off = |k: usize| poses[k].to(poses[k + 1]).distance_m(&way(k).to(way(k + 1)));
            (0..59).map(off).sum::<f64>() / 59.0
        };
        let (measured, matched) = (solved(false), solved(true));
        let (before_m, after_m) = (error(&measured), error(&matched));
        assert!(after_m < 0.56 * before_m, "{before_m} m, matched {after_m} m");
        let off_m = matched.iter().enumerate().map(|(k, at)| at.distance_m(&way(k))).fold(0.0, f64::max);
        assert!(off_m < 0.022, "{off_m} m from the map's frame");
    }

    #[test]
    fn what_is_dropped_takes_its_points_along() {
        let mut views = MeasuredViews::default();
        let measured = Measurement { map_from_base: way(0), information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        (0..10).for_each(|record| views.push(record, measured, true, &walls(way(record)), false));
        views.drop_until(6, way(6));
        let records: Vec<usize> = views.views.iter().map(|view| view.record).collect();
        assert_eq!((records, views.clouds.len()), (vec![0, 1, 2, 3], 1 + 3));
        let begin = &views.views[0];
        assert!(begin.measured.map_from_base == way(6) && views.clouds.points(begin.cloud).is_empty());
        assert_eq!(views.clouds.points(views.views[3].cloud), walls(way(9)));
    }
}
