//! The back end of a robot that localizes: poses and scans in; a belief and corrections out. The map is known and stays as it is.

use crate::filled_trajectory::{Between, filled};
use crate::measured_views::MeasuredViews;
use crate::pose_record::PoseRecord;
use crate::solution::{ClosureCounts, DetachedPart, FrozenScan, MAP_ANCHOR, PlacedScan, Solution};
use flockslam_geometry::Pose;
use flockslam_localisation::{Belief, Hint, Knowledge, Localizer, Measurement, Surroundings};
use flockslam_loop_closure::scans::ScanStore;
use flockslam_messages::{
    BeamRange, Correction, LocalisationOrder, PoseEstimate, PoseFlags, ScanId, ScanView, SubmapClosed,
};
use flockslam_registration::cloud::{PackedPoint, Placement};
use flockslam_results::LocalisationSummary;

/// A scan is looked at after this much travel, metres, or turning, radians.
const VIEW_M: f64 = 0.05;
const VIEW_RAD: f64 = 0.05;
/// A scan is a view after this much of either: the final poses are matched at views.
const KEPT_M: f64 = 0.02;
const KEPT_RAD: f64 = 0.02;
/// Views, and poses, after which the older half of the drive gets its final poses.
const VIEWS_MAX: usize = 1200;
const RECORDS_MAX: usize = 40_000;
/// What a published pose in the map is worth as a measurement after a restart: standard deviations, metres and radians.
const PUBLISHED_SIGMA: (f64, f64) = (0.03, 0.01);

/// The back end of a robot that localizes in a known map. A pure function of its calls.
pub struct LocalizingManager {
    localizer: Localizer,
    records: Vec<PoseRecord>,
    views: MeasuredViews,
    /// The last scan that was looked at, and its trajectory.
    last_view: Option<(Placement, u32)>,
    /// The last scan that is a view, and its trajectory.
    last_kept: Option<(Placement, u32)>,
    revision: u32,
    submap: u32,
    /// The last correction that was given.
    corrected: Option<(Pose, bool)>,
    frozen: Vec<FrozenScan>,
    summary: LocalisationSummary,
    travel_m: f64,
    is_localized: bool,
    stamp_ns: i64,
    map_area_m2: f64,
}

impl LocalizingManager {
    /// A robot that may be anywhere in the map.
    pub fn new(surroundings: Surroundings) -> Self {
        Self {
            map_area_m2: surroundings.map().known_area_m2(),
            localizer: Localizer::new(surroundings),
            records: Vec::new(),
            views: MeasuredViews::default(),
            last_view: None,
            last_kept: None,
            revision: 0,
            submap: 0,
            corrected: None,
            frozen: Vec::new(),
            summary: LocalisationSummary::default(),
            travel_m: 0.0,
            is_localized: false,
            stamp_ns: 0,
        }
    }

    /// Area of the known map, m².
    pub fn map_area_m2(&self) -> f64 {
        self.map_area_m2
    }

    /// The belief, and the sensor stamp of the last scan that was looked at.
    pub fn belief(&self) -> (&Belief, i64) {
        (self.localizer.belief(), self.stamp_ns)
    }

    /// What localisation did so far.
    pub fn summary(&self) -> LocalisationSummary {
        LocalisationSummary { searches: self.localizer.searches(), ..self.summary }
    }

    /// Looks for the robot anew at the next scan.
    pub fn relocalize(&mut self, order: &LocalisationOrder) {
        let hint = Hint {
            map_from_base: order.map_from_base.into(),
            sigma_m: order.sigma_m,
            sigma_rad: order.sigma_rad,
        };
        self.localizer.relocalize((order.sigma_m > 0.0).then_some(hint));
        self.last_view = None;
    }

    /// Takes the published pose of a scan. Every scan's, in order of arrival.
    pub fn pose(&mut self, pose: &PoseEstimate) {
        self.revision = self.revision.max(pose.corrections);
        if let Some(last) = self.records.last() {
            let step_m = last.odom.distance_m(&pose.odom_from_base.into());
            self.travel_m += if last.trajectory == pose.trajectory { step_m } else { 0.0 };
        }
        let mut record = PoseRecord::new(pose);
        // Numbers of trajectories only rise. A restarted front end may publish an earlier one.
        record.trajectory = self.records.last().map_or(0, |last| last.trajectory).max(record.trajectory);
        self.records.push(record);
        let count = if self.is_localized {
            &mut self.summary.localized_scans
        } else {
            &mut self.summary.unlocalized_scans
        };
        // Scans that the map was made of are no matter of localisation.
        *count += u64::from(pose.has(PoseFlags::LOCALIZING));
        if self.records.len() > RECORDS_MAX {
            self.freeze();
        }
    }

    /// Takes a pose that a predecessor of this process has received. Where it was placed in the map, that is taken for a measurement: the
    /// scans are not looked at again.
    pub fn published(&mut self, pose: &PoseEstimate) {
        let is_placed = !pose.has(PoseFlags::UNPLACED);
        let begins = is_placed && !self.is_localized;
        self.is_localized = is_placed;
        self.pose(pose);
        if begins {
            self.summary.found += 1;
            self.summary.found_after_m.get_or_insert(self.travel_m);
        }
        if begins || !is_placed {
            self.last_view = None;
        }
        self.corrected = Some((pose.map_from_odom, is_placed));
        let Some(record) = self.records.len().checked_sub(1) else { return };
        let PoseRecord { odom, trajectory, .. } = self.records[record];
        let is_due = self.last_view.is_none_or(|(last, _)| last.distance_m(&odom) >= VIEW_M);
        // The pose of a scan that was not matched is a prediction.
        if !is_placed || !pose.has(PoseFlags::MATCHED) || !is_due {
            return;
        }
        let follows = self.last_view.is_some();
        let (position, heading) = (PUBLISHED_SIGMA.0.powi(-2), PUBLISHED_SIGMA.1.powi(-2));
        let measured = Measurement {
            map_from_base: pose.map_from_base().into(),
            information: [position, 0.0, 0.0, position, 0.0, heading],
        };
        self.views.push(record, Some(measured), follows, &[], false);
        self.last_view = Some((odom, trajectory));
        if self.views.len() > VIEWS_MAX {
            self.freeze();
        }
    }

    /// Goes on after the poses that a predecessor has received.
    pub fn resume(&mut self) {
        if let (true, Some((map_from_odom, _))) = (self.is_localized, self.corrected) {
            self.localizer.resume(map_from_odom.into());
        }
        // The next scan is looked at wherever it was taken.
        self.last_view = None;
    }

    /// Takes a scan whose pose has just been given. `moving` are its beams on what moves, in order: they are not matched.
    pub fn node(&mut self, scan: ScanView<'_>, pose: &PoseEstimate, moving: &[BeamRange]) {
        let Some(record) = self.records.iter().rposition(|r| r.id == pose.id) else { return };
        let PoseRecord { odom, trajectory, continues, .. } = self.records[record];
        let is_beyond = |last: Option<(Placement, u32)>, metres: f64, radians: f64| {
            last.is_none_or(|(last, of)| {
                of != trajectory || last.distance_m(&odom) >= metres || last.turn_rad(&odom) >= radians
            })
        };
        let is_looked_at = is_beyond(self.last_view, VIEW_M, VIEW_RAD);
        let is_kept = is_looked_at || is_beyond(self.last_kept, KEPT_M, KEPT_RAD);
        if !is_kept || !pose.has(PoseFlags::MATCHED) {
            return;
        }
        let breaks = self.last_kept.is_some_and(|(_, of)| of != trajectory) && !continues;
        self.last_kept = Some((odom, trajectory));
        let is_open = pose.has(PoseFlags::OPEN);
        let mut store = ScanStore::default();
        let number = store.keep(scan, pose.twist, moving, is_open);
        let points = store.points(number);
        let measured = if is_looked_at { self.look(record, points, breaks) } else { None };
        self.views.push(record, measured, !breaks, points, is_open);
        if self.views.len() > VIEWS_MAX {
            self.freeze();
        }
    }

    /// Looks for the robot where a record was taken, whose points these are; gives the place that is measured.
    fn look(&mut self, record: usize, points: &[PackedPoint], breaks: bool) -> Option<Measurement> {
        let PoseRecord { odom, trajectory, stamp_ns, .. } = self.records[record];
        if breaks {
            self.localizer.odometry_breaks();
        }
        self.last_view = Some((odom, trajectory));
        self.stamp_ns = stamp_ns;
        let was_localized = self.is_localized && !breaks;
        self.localizer.see(odom, points);
        self.is_localized = self.localizer.belief().knowledge == Knowledge::Localized;
        if self.is_localized && !was_localized {
            self.summary.found += 1;
            self.summary.found_after_m.get_or_insert(self.travel_m);
        }
        self.localizer.measured()
    }

    /// The correction of the front end, when it is another one than was given last; for a set that runs live.
    pub fn fresh_correction(&mut self, id: ScanId) -> Option<Correction> {
        let now = (self.map_from_odom(), self.is_localized);
        (self.corrected != Some(now)).then(|| self.correction(id))
    }

    /// The correction of the front end after a scan.
    pub fn scan_accepted(&mut self, id: ScanId) -> Correction {
        self.correction(id)
    }

    /// The correction of the front end after a closed submap of the mapper.
    pub fn submap_closed(&mut self, notice: &SubmapClosed) -> Correction {
        self.submap = notice.number;
        self.correction(notice.last)
    }

    fn map_from_odom(&self) -> Pose {
        let before = self.corrected.map_or(Pose::IDENTITY, |(pose, _)| pose);
        self.localizer.map_from_odom().map_or(before, Placement::pose)
    }

    fn correction(&mut self, id: ScanId) -> Correction {
        let now = (self.map_from_odom(), self.is_localized);
        self.revision += u32::from(self.corrected.replace(now) != Some(now));
        Correction {
            map_from_odom: now.0,
            scan: id.sequence,
            run: id.run,
            submap: self.submap,
            revision: self.revision,
            closures: u32::from(self.is_localized),
            trajectory: self.records.last().map_or(0, |last| last.trajectory),
            attached: u32::from(self.is_localized),
        }
    }

    /// Scans that have their final poses since the last call.
    pub fn take_frozen(&mut self) -> Vec<FrozenScan> {
        std::mem::take(&mut self.frozen)
    }

    /// Gives the older half of the drive its final poses, and drops it.
    fn freeze(&mut self) {
        let known = self.views.solved(&self.records);
        let end = known.get(known.len() / 2).map_or(0, |(record, _)| *record);
        // A robot that stands, or is not found, has few views.
        let end = if end == 0 { self.records.len() / 2 } else { end };
        let until = known.partition_point(|(record, _)| *record <= end);
        let filled = filled(&self.records[..=end], &known[..until], Between::FrontEnd);
        let frozen = |(record, pose): (&PoseRecord, &Placement)| FrozenScan {
            id: record.id,
            stamp_ns: record.stamp_ns,
            anchor: MAP_ANCHOR,
            anchor_from_base: pose.pose(),
        };
        self.frozen.extend(self.records[..end].iter().zip(&filled).map(frozen));
        // Of a trajectory that is not found yet there is no pose.
        let is_known =
            until > 0 && self.records[known[until - 1].0].trajectory == self.records[end].trajectory;
        self.views.drop_until(end, is_known.then(|| filled[end]));
        self.records.drain(..end);
    }

    /// Concludes the run: final poses of all scans that are not frozen. Trajectories that were never found in the map stay apart.
    pub fn finish(&mut self) -> Solution {
        let known = self.views.solved(&self.records);
        let poses = filled(&self.records, &known, Between::FrontEnd);
        let found: Vec<u32> = known.iter().map(|(record, _)| self.records[*record].trajectory).collect();
        let placed = |(record, pose): (&PoseRecord, &Placement)| PlacedScan {
            id: record.id,
            stamp_ns: record.stamp_ns,
            map_from_base: pose.pose(),
        };
        let apart: Vec<PlacedScan> = self
            .records
            .iter()
            .zip(&poses)
            .filter(|(record, _)| found.binary_search(&record.trajectory).is_err())
            .map(placed)
            .collect();
        let detached_scans = apart.len() as u64;
        let travel_m = apart.windows(2).map(|pair| pair[0].map_from_base.distance_m(pair[1].map_from_base));
        let detached = DetachedPart { travel_m: travel_m.sum(), scans: apart, ..DetachedPart::default() };
        Solution {
            trajectory: self.records.iter().zip(&poses).map(placed).collect(),
            anchors: Vec::new(),
            submaps: Vec::new(),
            closures: ClosureCounts {
                searches: self.localizer.searches(),
                accepted: self.summary.found,
                trajectories: self.records.last().map_or(0, |last| u64::from(last.trajectory) + 1),
                detached_scans,
                ..ClosureCounts::default()
            },
            detached: if detached_scans > 0 { vec![detached] } else { Vec::new() },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::CellState;
    use flockslam_geometry::Point;
    use flockslam_localisation::KnownMap;
    use flockslam_messages::ScanBuffer;

    /// A room of 6 × 4 m with a niche in a corner, in the map frame.
    fn room() -> KnownMap {
        let mut map = KnownMap::of_width(140, 0.05, Point::new(-0.5, -0.5));
        let is_free =
            |x: f64, y: f64| (0.0..6.0).contains(&x) && (0.0..4.0).contains(&y) && !(x > 4.5 && y > 3.2);
        for row in 0..100 {
            let state = |column: i64| {
                let (x, y) = (f64::from(column as i32) * 0.05 - 0.475, f64::from(row) * 0.05 - 0.475);
                let near = (-2..=2).flat_map(|i| (-2..=2).map(move |k| (f64::from(i), f64::from(k))));
                match is_free(x, y) {
                    true => CellState::Free,
                    false if near.into_iter().any(|(i, k)| is_free(x + 0.05 * i, y + 0.05 * k)) => {
                        CellState::Occupied
                    }
                    false => CellState::Unknown,
                }
            };
            map.push_row((0..140).map(state));
        }
        map.measured()
    }

    fn scan(map: &KnownMap, at: Placement) -> ScanBuffer {
        let range = |degrees: i32| {
            let angle = f64::from(degrees).to_radians();
            let (cos, sin) = (angle.cos(), angle.sin());
            let is_hit = |range_m: &f64| {
                let (x, y) = at.apply(range_m * cos, range_m * sin);
                map.at(x, y).state != CellState::Free
            };
            (0..1000).map(|step| f64::from(step) * 0.01).find(is_hit).unwrap_or(0.0) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    const MAP_FROM_ODOM: (f64, f64, f64) = (3.0, 1.0, 0.5);

    fn way(step: u64) -> Placement {
        Placement::new(1.0 + 0.02 * step as f64, 1.5, 0.3)
    }

    /// The pose of the front end at a step of the way.
    fn estimate(step: u64, placed: bool) -> PoseEstimate {
        let (x, y, heading) = MAP_FROM_ODOM;
        let map_from_odom = Placement::new(x, y, heading);
        let mut pose = PoseEstimate {
            flags: PoseFlags::MATCHED | if placed { 0 } else { PoseFlags::UNPLACED },
            odom_from_base: map_from_odom.to(way(step)).pose(),
            ..PoseEstimate::default()
        };
        pose.map_from_odom = if placed { map_from_odom.pose() } else { Pose::IDENTITY };
        pose.id.sequence = step;
        pose
    }

    #[test]
    fn the_final_poses_are_those_in_the_map() {
        let map = room();
        let mut manager = LocalizingManager::new(Surroundings::new(map.clone()));
        for step in 0..100 {
            let pose = estimate(step, false);
            manager.pose(&pose);
            manager.node(scan(&map, way(step)).view().unwrap(), &pose, &[]);
        }
        assert_eq!((manager.summary().found, manager.summary().searches), (1, 1));
        let correction = manager.fresh_correction(ScanId::default()).unwrap();
        assert_eq!((correction.attached, manager.fresh_correction(ScanId::default())), (1, None));
        let solution = manager.finish();
        assert_eq!((solution.trajectory.len(), solution.detached.len()), (100, 0));
        for (step, placed) in (0..).zip(&solution.trajectory) {
            let off_m = way(step).distance_m(&placed.map_from_base.into());
            assert!(off_m < 0.03, "{step}: {off_m} m");
        }
    }

    #[test]
    fn a_successor_goes_on_without_a_search() {
        let map = room();
        let mut manager = LocalizingManager::new(Surroundings::new(map.clone()));
        (0..60).for_each(|step| manager.published(&estimate(step, step >= 5)));
        manager.resume();
        for step in 60..100 {
            let pose = estimate(step, true);
            manager.pose(&pose);
            manager.node(scan(&map, way(step)).view().unwrap(), &pose, &[]);
        }
        assert_eq!(manager.belief().0.knowledge, Knowledge::Localized);
        assert_eq!(manager.summary().searches, 0);
        let solution = manager.finish();
        let farthest_m = (0..)
            .zip(&solution.trajectory)
            .map(|(step, placed)| way(step).distance_m(&placed.map_from_base.into()))
            .fold(0.0, f64::max);
        assert!(solution.trajectory.len() == 100 && farthest_m < 0.03, "{farthest_m} m");
    }

    #[test]
    fn what_is_kept_of_a_robot_that_stands_for_hours_is_bounded_and_no_pose_is_lost() {
        let map = room();
        let mut manager = LocalizingManager::new(Surroundings::new(map.clone()));
        let (scan, mut frozen) = (scan(&map, way(0)), Vec::new());
        for sequence in 0..100_000 {
            let mut pose = estimate(0, false);
            pose.id.sequence = sequence;
            manager.pose(&pose);
            if sequence < 3 {
                manager.node(scan.view().unwrap(), &pose, &[]);
            }
            assert!(manager.records.len() <= RECORDS_MAX + 1);
            frozen.extend(manager.take_frozen());
        }
        let solution = manager.finish();
        assert_eq!(frozen.len() + solution.trajectory.len(), 100_000);
        let at = |pose: Pose| way(0).distance_m(&pose.into());
        assert!(frozen.iter().all(|scan| at(scan.anchor_from_base) < 0.03));
        assert!(solution.trajectory.iter().all(|scan| at(scan.map_from_base) < 0.03));
    }
}
