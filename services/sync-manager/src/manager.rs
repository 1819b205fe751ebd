//! The back end of one robot as a state machine: poses, scans and closed submaps in; corrections, and at the end the solution, out.

use crate::filled_trajectory::{Between, filled};
use crate::pose_record::PoseRecord;
use crate::settings::Settings;
use crate::solution::{FrozenScan, Solution};
use conclusion::Concluded;
use driven::Driven;
use flockslam_loop_closure::agreement::eligible;
use flockslam_loop_closure::closure::{CHI_SQUARED_MAX, Closure};
use flockslam_loop_closure::connectivity::{self, TrajectoryConnectivity};
use flockslam_loop_closure::finder::{ClosureFinder, LEAST_TRAVEL_M};
use flockslam_loop_closure::node::{NewNode, Node};
use flockslam_loop_closure::odometry_graph::OdometryGraph;
use flockslam_loop_closure::open_finder::OpenFinder;
use flockslam_loop_closure::place::Placer;
use flockslam_loop_closure::scans::ScanStore;
use flockslam_loop_closure::segment::Segment;
use flockslam_messages::{BeamRange, PoseEstimate, PoseFlags, ScanView};
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{RobustSettings, solve};
use flockslam_registration::cloud::Placement;
use freeze::FrozenSubmap;
use map_entries::Entries;
use mid_scan_poses::MidScan;
use placed_stretch::Stretch;
use std::collections::{BTreeMap, BTreeSet};
use unpublished::Unpublished;
use wall_headings::WallHeadings;

mod conclusion;
mod counts;
mod driven;
mod final_passes;
mod final_solution;
mod freeze;
mod imported;
mod live_queries;
mod loop_search;
mod map_entries;
mod mid_scan_poses;
mod placed_stretch;
mod unpublished;
mod wall_headings;

/// A scan this close to the last one kept is not kept, metres and radians.
const REST: (f64, f64) = (0.01, 0.005);
/// Scans of a lidar are at most so many apart among those of all.
const LIDARS_MAX: usize = 16;
/// A scan becomes a node of the graph after this much travel, metres …
const NODE_DISTANCE_M: f64 = 0.3;
/// … or this much turning, radians: with 0.35 the published poses of the public logs drift more, with 0.15 as much.
const NODE_TURN_RAD: f64 = 0.2;
/// Each scan is placed at the end against the nodes up to this many before and after it.
const FINAL_NODES: usize = 3;
/// Most branch-and-bound searches from one closed submap to the next.
const SEARCHES_PER_SUBMAP: usize = 60;

/// Work on solving the graph from one closed submap to the next, products of 3 × 3 blocks: a graph that takes more is solved less often,
/// with the same work for each metre.
const SOLVING_PER_SUBMAP: u64 = 1_000_000;

/// A scan whose points were kept.
#[derive(Clone, Copy, Debug)]
struct Kept {
    record: usize,
    scan: usize,
    /// The last node at or before it; of a scan before all nodes the first one.
    node: usize,
    is_node: bool,
    /// The front end has matched it.
    is_matched: bool,
    middle: MidScan,
}

/// The back end of one robot: poses and inserted scans in, a correction after each of them, the solution at the
/// end.
///
/// A pure function of its calls. Work per call is bounded by the settings; everything measured stays
/// revocable, since poses are solved anew from the measurements.
///
/// ```
/// use flockslam_geometry::Pose;
/// use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, SubmapClosed};
/// use flockslam_sync_manager::{Settings, SyncManager};
/// # // Ranges in a room of 6 m × 4 m, from this far ahead of its middle.
/// # fn scan(x_m: f64) -> ScanBuffer {
/// #     let range = |degrees: i32| {
/// #         let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
/// #         ((3.0 - x_m * cos.signum()) / cos.abs()).min(2.0 / sin.abs()) as f32
/// #     };
/// #     ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
/// # }
///
/// let mut manager = SyncManager::new(Settings::default());
/// let mut pose = PoseEstimate { flags: PoseFlags::MATCHED | PoseFlags::INSERT, ..PoseEstimate::default() };
/// for k in 0..20u8 {
///     pose.id.sequence = k.into();
///     pose.odom_from_base = Pose::new(0.1 * f64::from(k), 0.0, 0.0);
///     manager.pose(&pose);
///     manager.node(scan(pose.odom_from_base.x_m).view()?, &pose, &[]);
/// }
/// let solution = manager.submap_closed(&SubmapClosed { last: pose.id, ..SubmapClosed::default() });
/// // The front end was right: there is nothing to correct.
/// assert!(solution.map_from_odom.distance_m(Pose::IDENTITY) < 0.1);
/// let solution = manager.finish();
/// assert_eq!(solution.trajectory.len(), 20);
/// assert!(solution.trajectory[19].map_from_base.distance_m(pose.odom_from_base) < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct SyncManager {
    settings: Settings,
    records: Vec<PoseRecord>,
    driven: Driven,
    scans: ScanStore,
    kept: Vec<Kept>,
    odometry: OdometryGraph,
    segments: Vec<Segment>,
    finder: ClosureFinder,
    /// The search in the open.
    open_finder: OpenFinder,
    closures: Vec<Closure>,
    /// By closure: whether it is an inlier in the last solution.
    is_inlier: Vec<bool>,
    /// Poses of the nodes in the last solution; newer nodes follow the odometry.
    poses: Vec<Placement>,
    /// Travel at which the next search for loops is due, metres.
    next_search_m: f64,
    revision: u32,
    /// What was concluded last.
    concluded: Concluded,
    /// Segments before this one stay for good.
    next_frozen: usize,
    /// Scans that are frozen and wait to be taken.
    frozen: Vec<FrozenScan>,
    frozen_submaps: BTreeMap<u32, FrozenSubmap>,
    retired_submaps: BTreeSet<u32>,
    frozen_closures: u64,
    /// Scans in the store that nothing refers to any more.
    gone_scans: usize,
    /// First nodes of the trajectories, by sequence, whose constraint by odometry the solution switches off.
    ruled_out: BTreeSet<u64>,
    /// Closures were found that the solution does not know.
    unsolved: bool,
    /// What nodes see of walls.
    walls: WallHeadings,
    /// Stretches that the set has only localized in.
    entries: Entries,
    /// Findings that are not published to the flock yet, when there is one.
    unpublished: Option<Unpublished>,
    /// Credit of work for solving, and the work of the last solution.
    solving_credit: u64,
    solving_cost: u64,
}

impl SyncManager {
    /// A back end that has seen nothing yet.
    pub fn new(settings: Settings) -> Self {
        Self {
            odometry: OdometryGraph::default(),
            finder: ClosureFinder::default(),
            open_finder: OpenFinder::default(),
            next_search_m: LEAST_TRAVEL_M,
            settings,
            records: Vec::new(),
            driven: Driven::default(),
            scans: ScanStore::default(),
            kept: Vec::new(),
            segments: Vec::new(),
            closures: Vec::new(),
            is_inlier: Vec::new(),
            poses: Vec::new(),
            revision: 0,
            concluded: Concluded::default(),
            next_frozen: 0,
            frozen: Vec::new(),
            frozen_submaps: BTreeMap::new(),
            retired_submaps: BTreeSet::new(),
            frozen_closures: 0,
            gone_scans: 0,
            ruled_out: BTreeSet::new(),
            unsolved: false,
            entries: Entries::default(),
            walls: WallHeadings::default(),
            unpublished: None,
            solving_credit: SOLVING_PER_SUBMAP,
            solving_cost: 0,
        }
    }

    /// Takes the published pose of a scan. Every scan's, in order of arrival. Scans that the set localizes with are no part of the map.
    pub fn pose(&mut self, pose: &PoseEstimate) {
        if pose.has(PoseFlags::LOCALIZING) {
            return self.entries.localize(!pose.has(PoseFlags::UNPLACED));
        }
        self.revision = self.revision.max(pose.corrections);
        let mut record = PoseRecord::new(pose);
        record.trajectory = self.entries.number(record.trajectory);
        // Numbers of trajectories only rise. A restarted front end may publish an earlier one.
        record.trajectory = self.records.last().map_or(0, |last| last.trajectory).max(record.trajectory);
        if !record.is_given {
            self.driven.count(&record);
        }
        self.records.push(record);
    }

    /// Takes a scan whose pose has just been given. Inserted scans may become nodes of the graph. Any scan may be given that was matched, or
    /// dropped untried: it is then placed by its own points at the end. `moving` are its beams on what moves, in order: they
    /// are not matched.
    pub fn node(&mut self, scan: ScanView<'_>, pose: &PoseEstimate, moving: &[BeamRange]) {
        let Some(record) = self.records.iter().rposition(|r| r.id == pose.id) else { return };
        let PoseRecord { odom, trajectory, odometry, is_given, .. } = self.records[record];
        let is_node = pose.has(PoseFlags::INSERT) && (is_given || self.is_due(&odom, trajectory));
        let is_matched = pose.has(PoseFlags::MATCHED);
        let last_is_open = self.odometry.nodes().last().is_some_and(|last| last.is_open);
        // In the open scans stay at the end where the front end's path puts them.
        if !is_node && (self.rests(&odom, pose.id.lidar) || (!is_matched && last_is_open)) {
            return;
        }
        let is_open = pose.has(PoseFlags::OPEN);
        let middle = MidScan::of(scan, pose.twist);
        let scan = self.scans.keep(scan, pose.twist, moving, is_open);
        if is_node {
            let sequence = pose.id.sequence;
            let of_trajectory =
                self.records[..=record].iter().rev().take_while(|r| r.trajectory == trajectory);
            // Its first scan may not have arrived.
            let is_first = self.odometry.nodes().last().is_some_and(|last| last.trajectory != trajectory);
            let continues = is_first && of_trajectory.into_iter().any(|r| r.continues);
            let sigmas = (pose.covariance.position_std_m(), pose.covariance.tt.max(0.0).sqrt());
            let new =
                NewNode { sequence, scan, odom, trajectory, odometry, continues, is_open, is_given, sigmas };
            if self.odometry.nodes().is_empty() {
                // Nothing connects scans before the first node with it that are of another trajectory.
                self.kept.retain(|kept| self.records[kept.record].trajectory == trajectory);
            }
            self.odometry.extend(new, &self.scans);
            self.see_walls();
            self.enter(pose);
        }
        let node = self.odometry.nodes().len().saturating_sub(1);
        self.kept.push(Kept { record, scan, node, is_node, is_matched, middle });
    }

    /// Whether the robot is still where the last scan of this lidar was kept: nothing is stored while it stands.
    fn rests(&self, odom: &Placement, lidar: u32) -> bool {
        let kept = self.kept.iter().rev().take(LIDARS_MAX).map(|kept| &self.records[kept.record]);
        kept.filter(|record| record.id.lidar == lidar)
            .take(1)
            .any(|record| record.odom.distance_m(odom) < REST.0 && record.odom.turn_rad(odom) < REST.1)
    }

    /// Whether the robot has moved enough for a new node.
    fn is_due(&self, odom: &Placement, trajectory: u32) -> bool {
        self.odometry.nodes().last().is_none_or(|last| {
            last.trajectory != trajectory
                || last.odom.distance_m(odom) >= NODE_DISTANCE_M
                || last.odom.turn_rad(odom) >= NODE_TURN_RAD
        })
    }

    /// Notes submaps that have left the map for good: their poses are not published any more.
    pub fn submaps_retired(&mut self, numbers: &[u32]) {
        for number in numbers {
            self.frozen_submaps.remove(number);
            self.retired_submaps.insert(*number);
        }
    }

    /// The constraints by odometry or localisation between trajectories that no closure has ruled out.
    fn joints(&self, known: usize) -> impl Iterator<Item = Edge> {
        let nodes = self.odometry.nodes();
        let joints = self.odometry.joints(known).chain(self.entry_edges(known));
        joints.filter(|joint| !self.ruled_out.contains(&nodes[joint.to].sequence))
    }

    /// How inlier closures connect the trajectories of the first `known` nodes.
    fn connectivity(&self, known: usize) -> TrajectoryConnectivity {
        let inliers = self.closures.iter().zip(&self.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        let joints = self.joints(known).map(|joint| (joint.from, joint.to));
        TrajectoryConnectivity::new(
            &self.odometry.nodes()[..known],
            inliers.map(|(c, _)| (c.edge.from, c.edge.to)).chain(joints),
        )
    }

    fn close_loops(&mut self, known: usize, searches: usize, at_submap: bool) {
        self.follow_odometry(known);
        let from = self.segments.last().map_or(0, |s| s.nodes.end);
        for segment in Segment::cut(&self.odometry.nodes()[..known], from) {
            self.smooth(&segment);
            self.segments.push(segment);
        }
        if !self.settings.close_loops {
            return;
        }
        let before = self.closures.len();
        self.search_due(known, searches);
        self.unsolved |= self.closures.len() > before;
        let is_last = searches == usize::MAX;
        let is_due = is_last || at_submap || self.surprise(before);
        if (self.unsolved && is_due && self.solving_credit >= self.solving_cost) || is_last {
            let walls = if is_last { Vec::new() } else { self.wall_edges(known) };
            self.solve(known, &walls);
            self.solving_credit = self.solving_credit.saturating_sub(self.solving_cost);
            self.unsolved = false;
        }
    }

    /// Smooths the odometry of the last segment and of a new one that goes on from it. In the solution the nodes behind the last closure
    /// follow: to those before it the closure has given its place already.
    fn smooth(&mut self, segment: &Segment) {
        let Some(last) = self.segments.last() else { return };
        let nodes = self.odometry.nodes();
        let (start, trajectory) = (last.nodes.start, nodes[segment.nodes.start].trajectory);
        let is_matched = |node: &Node| node.trajectory == trajectory && !node.is_open && !node.is_given;
        if !nodes[start..segment.nodes.end].iter().all(is_matched) {
            return;
        }
        self.odometry.smooth([last, segment], &self.scans, self.finder.scratch());
        let inliers = self.closures.iter().zip(&self.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        let held = inliers.map(|(closure, _)| closure.edge.to).fold(start, usize::max);
        self.follow_behind(held);
    }

    /// Solves the graph of the first `known` nodes, from the odometry, with constraints by `walls`, and all eligible loops on trial again.
    fn solve(&mut self, known: usize, walls: &[Edge]) {
        self.solve_with(known, &eligible(&self.closures, &self.odometry.nodes()[..known]), walls);
    }

    /// Solves the graph of the first `known` nodes with these loops on trial.
    fn solve_with(&mut self, known: usize, eligible: &[bool], walls: &[Edge]) {
        let mut edges: Vec<Edge> = self.odometry.edges()[..known - 1].to_vec();
        edges.extend(self.odometry.given());
        edges.extend(walls);
        let fixed_count = edges.len();
        edges.extend(
            self.closures.iter().zip(eligible).filter(|(_, eligible)| **eligible).map(|(c, _)| c.edge),
        );
        let closures_end = edges.len();
        edges.extend(self.entry_edges(known));
        let entries_end = edges.len();
        edges.extend(self.odometry.joints(known));
        let settings =
            RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 1.6, rounds: 25, warm_up: 6 };
        let mut poses =
            connectivity::start(&self.odometry.nodes()[..known], &edges[fixed_count..entries_end]);
        let solved = solve(known, &edges, fixed_count, &settings, &mut poses);
        (self.poses, self.solving_cost) = (poses, solved.work);
        self.hold_given();
        self.count_walls();
        let nodes = self.odometry.nodes();
        let joints = edges[closures_end..].iter().zip(&solved.weights[closures_end..]);
        self.ruled_out =
            joints.filter(|(_, w)| **w <= 0.5).map(|(joint, _)| nodes[joint.to].sequence).collect();
        let mut inliers = solved.weights[fixed_count..closures_end].iter().map(|&w| w > 0.5);
        self.is_inlier = eligible.iter().map(|&eligible| eligible && inliers.next() == Some(true)).collect();
    }

    /// Concludes the run: the last loops, a dense pass over the whole solution, and every kept scan placed in
    /// it.
    pub fn finish(&mut self) -> Solution {
        let known = self.odometry.nodes().len();
        if known == 0 {
            return self.solution(&filled(&self.records, &[], Between::FrontEnd));
        }
        self.close_loops(known, usize::MAX, true);
        if self.settings.close_loops {
            self.attach();
            self.close_again_in_the_open();
        }
        self.collect_findings(known);
        self.refine();
        self.placed()
    }

    /// Every kept scan placed among the nodes at their present poses.
    fn placed(&mut self) -> Solution {
        if self.odometry.nodes().is_empty() {
            return self.solution(&filled(&self.records, &[], Between::FrontEnd));
        }
        let nodes = self.placed_nodes();
        let stretch = Stretch { first: (0, 0), records: &self.records, kept: &self.kept, nodes: &nodes };
        let placer = Placer {
            nodes: self.odometry.nodes(),
            scans: &self.scans,
            poses: &self.poses,
            reach: FINAL_NODES,
        };
        let pairs = stretch.placed(&placer, self.finder.scratch());
        self.solution(&filled(&self.records, &pairs, Between::Measured))
    }

    fn placed_nodes(&self) -> Vec<(usize, Placement)> {
        let solved = self.kept.iter().filter(|k| k.is_node && k.node < self.poses.len());
        solved.map(|k| (k.record, self.poses[k.node])).collect()
    }
}
