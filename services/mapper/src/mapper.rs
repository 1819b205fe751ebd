//! The logic of the stage: takes scans with poses and cleared cells, gives changed tiles and closed submaps.

use crate::closed_submap::ClosedSubmap;
use crate::settings::{SUBMAP_LENGTH_M, Settings};
use crate::tile_share::TileShare;
use crate::unconfirmed_objects::UnconfirmedObjects;
use crate::window::Window;
use flockslam_evidence::{CellIndex, Submap, Tile, TileKey, floor};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{ClearedCell, Deskew, PoseEstimate, PoseFlags, ScanView};
use flockslam_ray_insertion::SensorModel;
use std::collections::VecDeque;

/// Longer ranges are not inserted, metres: the gaps between beams are wider than most objects there.
const RANGE_MAX_M: f64 = 30.0;

/// While the set localizes, what was last seen longer ago than this is not matched to any more, nanoseconds: ten minutes. Who comes back later
/// finds furniture elsewhere; the known map says where the robot is. The newest submap stays, however old.
const LOCAL_AGE_NS: i64 = 600_000_000_000;

/// Turns scans with poses into evidence, tiles and submaps. A pure function of its calls.
///
/// ```
/// use flockslam_evidence::{Tile, TileKey};
/// use flockslam_geometry::Pose;
/// use flockslam_mapper::{Mapper, Settings};
/// use flockslam_messages::{PoseEstimate, ScanBuffer};
///
/// // One beam of 2.02 m along the x-axis ends in the cell from 2.00 to 2.05 m.
/// let settings = Settings { cell_size_m: 0.05, skip_isolated: false, ..Settings::default() };
/// let mut mapper = Mapper::new(settings);
/// let scan = ScanBuffer::from_ranges(&[2.02], 0.0, 0.0);
/// let pose = PoseEstimate { odom_from_base: Pose::new(0.01, 0.02, 0.0), ..PoseEstimate::default() };
/// let insertion = mapper.insert(scan.view()?, &pose, &[]);
/// assert_eq!((insertion.generation, insertion.changed), (1, &[TileKey { x: 0, y: 0 }][..]));
///
/// let mut tile = Tile::unknown(0);
/// assert!(mapper.write_tile(TileKey { x: 0, y: 0 }, &mut tile));
/// assert!(tile.cells[40].occupied > 0 && tile.cells[39].free > 0 && tile.cells[41].is_unknown());
/// assert!(tile.score[40] > u16::MAX / 2);
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Debug)]
pub struct Mapper {
    settings: Settings,
    model: SensorModel,
    window: Window,
    /// The closed submaps of a bounded window: needed to remove them later.
    closed: VecDeque<ClosedSubmap>,
    left_cleared: Vec<Submap>,
    /// Submaps below this number stay as they are stored: the set has localized in the map that they are of.
    fixed_below: u32,
    /// The set localizes: what it sees is no part of the map.
    localizes: bool,
    active: Option<ActiveSubmap>,
    number: u32,
    trajectory: u32,
    generation: u64,
    unconfirmed_objects: UnconfirmedObjects,
    /// End points of the beams of the present scan, in odom.
    ends: Vec<Point>,
    /// Those of them that may belong to a moving person.
    held_back: Vec<Point>,
}

#[derive(Debug)]
struct ActiveSubmap {
    odom_from_submap: Pose,
    first: u64,
    last: u64,
    last_ns: i64,
    insertions: u32,
    last_pose: Pose,
    travel_m: f64,
}

/// What an insertion changed.
#[derive(Debug)]
pub struct Insertion<'a> {
    /// Generation of the grid with this scan in it.
    pub generation: u64,
    /// Tiles that have new content, sorted; [`Mapper::write_tile`] gives it.
    pub changed: &'a [TileKey],
    /// Tiles that left the window.
    pub retired: &'a [TileKey],
    /// Submap that the next scan enters.
    pub active_submap: u32,
    /// The submaps that this scan closed: the one that it was the last of, and the one before when a new trajectory begins with it.
    pub closed: Vec<Submap>,
}

impl Mapper {
    /// An empty map.
    pub fn new(settings: Settings) -> Self {
        Self::of_share(settings, TileShare::ALL)
    }

    /// An empty map that publishes some tiles only. Of several mappers with the same inputs, each with its share, all tiles
    /// together are those of a single mapper. Each holds the whole map, because the cells at the border of a tile depend on both sides.
    pub fn of_share(settings: Settings, share: TileShare) -> Self {
        Self {
            model: settings.model(),
            window: Window::new(&settings, share),
            closed: VecDeque::new(),
            left_cleared: Vec::new(),
            fixed_below: 0,
            localizes: false,
            active: None,
            number: 0,
            trajectory: 0,
            generation: 0,
            unconfirmed_objects: UnconfirmedObjects::default(),
            ends: Vec::new(),
            held_back: Vec::new(),
            settings,
        }
    }

    /// Continues after a closed submap of the same run: called for each in order of their numbers, before the active one is
    /// replayed. `generation` is that of the grid with it.
    pub fn resume(&mut self, closed: Submap, generation: u64) {
        self.generation = generation;
        self.window.begin_scan();
        self.number = closed.number + 1;
        self.enter_trajectory(closed.trajectory);
        let closed = ClosedSubmap::new(&closed, i64::MAX);
        self.window.add_submap(&closed);
        self.keep_in_window(closed);
        self.window.end_scan();
        // A submap that has left the window again is stored as it is.
        self.left_cleared.clear();
    }

    /// Inserts a scan at its pose, after removing the stale cells `cleared`.
    pub fn insert(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        cleared: &[ClearedCell],
    ) -> Insertion<'_> {
        self.window.begin_scan();
        let mut closed = Vec::new();
        if pose.trajectory != self.trajectory {
            closed.extend(self.close_active());
            self.enter_trajectory(pose.trajectory);
        }
        if pose.has(PoseFlags::LOCALIZING) != self.localizes {
            closed.extend(self.change_mode());
        }
        self.drop_old(pose.times.sensor_ns);
        for cell in cleared {
            self.clear(CellIndex::new(cell.x, cell.y));
        }
        let odom_from_base = pose.odom_from_base;
        let odom_from_laser = odom_from_base * scan.header().base_from_laser;
        self.take_ends(scan, pose);
        let hits = self.hold_back_unconfirmed(pose.times.sensor_ns);
        self.model.insert_hits(
            self.settings.cell_size_m,
            odom_from_laser.position(),
            &self.ends,
            hits,
            &mut self.window,
        );
        self.window.end_rays();
        let full = self.advance(scan.header().id.sequence, pose.times.sensor_ns, odom_from_base);
        if full {
            closed.extend(self.close_active());
        }
        self.window.end_scan();
        self.generation += 1;
        Insertion {
            generation: self.generation,
            changed: self.window.changed(),
            retired: self.window.retired(),
            active_submap: self.number,
            closed,
        }
    }

    /// Cuts the active submap where the set begins to localize, or to map again: what it sees while it localizes stays in submaps of its
    /// own. Those of the map are stored as they are now, and not again.
    fn change_mode(&mut self) -> Option<Submap> {
        self.localizes = !self.localizes;
        let closed = self.close_active();
        if self.localizes {
            self.keep_cleared();
            self.fixed_below = self.number;
        }
        closed
    }

    /// The set has localized at the scan with this sequence: submaps up to the one that holds it stay as they are stored. For a mapper
    /// that continues.
    pub fn has_localized(&mut self, sequence: u64) {
        let before = self.closed.iter().rev().find(|submap| submap.first() <= sequence);
        self.fixed_below = self.fixed_below.max(before.map_or(0, |submap| submap.number() + 1));
    }

    /// Hands over those closed submaps in the window whose stored form is to be replaced.
    fn keep_cleared(&mut self) {
        let fixed_below = self.fixed_below;
        let is_new = |submap: &&ClosedSubmap| submap.has_cleared() && submap.number() >= fixed_below;
        self.left_cleared.extend(self.closed.iter().filter(is_new).map(ClosedSubmap::submap));
    }

    /// Closed submaps that have left the window, or been in it when the map was closed, with cells cleared since they were
    /// closed: their stored form is to be replaced.
    pub fn take_cleared(&mut self) -> Vec<Submap> {
        std::mem::take(&mut self.left_cleared)
    }

    /// Closes the active submap, at the end of a log; `None` when it is empty.
    pub fn close(&mut self) -> Option<Submap> {
        let closed = self.close_active();
        self.keep_cleared();
        closed
    }

    /// Fills `out` with a tile of the window: evidence and scores. False (and an untouched `out`) when there is none.
    pub fn write_tile(&self, key: TileKey, out: &mut Tile) -> bool {
        match self.window.published(key) {
            Some(tile) => {
                out.clone_from(tile);
                true
            }
            None => false,
        }
    }

    /// All tiles of the window, for a reader that starts late.
    pub fn live_tiles(&self) -> impl Iterator<Item = TileKey> {
        self.window.keys()
    }

    /// Generation of the grid: the number of scans inserted.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Submap that the next scan enters.
    pub fn active_submap(&self) -> u32 {
        self.number
    }

    fn take_ends(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) {
        let deskew = Deskew::new(scan, pose.twist);
        let (sin, cos) = sin_cos(pose.odom_from_base.heading_rad);
        let Settings { range_min_m, skip_isolated, .. } = self.settings;
        self.ends.clear();
        for beam in 0..scan.len() {
            let Some(range) = scan.valid_range_m(beam) else { continue };
            let skipped = skip_isolated && scan.is_isolated(beam);
            if (range_min_m..=RANGE_MAX_M).contains(&range) && !skipped {
                let end = deskew.end_in_base(scan, beam, range);
                self.ends.push(Point::new(
                    pose.odom_from_base.x_m + cos * end.x_m - sin * end.y_m,
                    pose.odom_from_base.y_m + sin * end.x_m + cos * end.y_m,
                ));
            }
        }
    }

    /// Moves the end points that must be confirmed behind the others; gives the number of the others. Where something has been
    /// seen often enough, the evidence for "free" is removed.
    fn hold_back_unconfirmed(&mut self, stamp_ns: i64) -> usize {
        let views = self.settings.confirming_scans;
        if views <= 1 {
            return self.ends.len();
        }
        let (mut ends, mut held_back) = (std::mem::take(&mut self.ends), std::mem::take(&mut self.held_back));
        let scan = self.generation as u32 + 1;
        ends.retain(|end| {
            let cell = self.cell_at(*end);
            if !self.window.is_clear(cell) {
                return true;
            }
            let stays = self.unconfirmed_objects.seen(cell, scan, stamp_ns) >= views;
            if stays {
                self.remove(cell);
            } else {
                held_back.push(*end);
            }
            stays
        });
        let hits = ends.len();
        ends.append(&mut held_back);
        (self.ends, self.held_back) = (ends, held_back);
        hits
    }

    fn cell_at(&self, point: Point) -> CellIndex {
        let index = |metres: f64| floor(metres / self.settings.cell_size_m);
        CellIndex::new(index(point.x_m), index(point.y_m))
    }

    /// Counts the scan into the active submap; true when it was its last.
    fn advance(&mut self, sequence: u64, stamp_ns: i64, pose: Pose) -> bool {
        let active = self.active.get_or_insert(ActiveSubmap {
            odom_from_submap: pose,
            first: sequence,
            last: sequence,
            last_ns: stamp_ns,
            insertions: 0,
            last_pose: pose,
            travel_m: 0.0,
        });
        (active.last, active.last_ns) = (sequence, stamp_ns);
        active.insertions += 1;
        active.travel_m += active.last_pose.distance_m(pose);
        active.last_pose = pose;
        active.travel_m >= SUBMAP_LENGTH_M || active.insertions >= self.settings.submap_insertions
    }

    fn close_active(&mut self) -> Option<Submap> {
        let active = self.active.take()?;
        let submap = Submap {
            number: self.number,
            trajectory: self.trajectory,
            insertions: active.insertions,
            first: active.first,
            last: active.last,
            odom_from_submap: active.odom_from_submap,
            cell_size_m: self.settings.cell_size_m,
            tiles: self.window.close_active(),
        };
        self.number += 1;
        self.keep_in_window(ClosedSubmap::new(&submap, active.last_ns));
        Some(submap)
    }

    /// Empties the window when another trajectory begins: its pose relative to the earlier ones is unknown.
    fn enter_trajectory(&mut self, trajectory: u32) {
        if trajectory == self.trajectory {
            return;
        }
        self.trajectory = trajectory;
        self.window.clear_all();
        self.keep_cleared();
        self.closed.clear();
    }

    /// Keeps a closed submap while it is in the window, and lets the oldest leave a bounded one.
    fn keep_in_window(&mut self, submap: ClosedSubmap) {
        self.closed.push_back(submap);
        let Some(size) = self.settings.window_submaps() else { return };
        while self.closed.len() > size {
            self.leave_oldest();
        }
    }

    /// Lets what is too old leave the window while the set localizes.
    fn drop_old(&mut self, now_ns: i64) {
        let is_old = |closed: &ClosedSubmap| now_ns.saturating_sub(closed.last_ns()) > LOCAL_AGE_NS;
        while self.localizes && self.closed.len() > 1 && self.closed.front().is_some_and(is_old) {
            self.leave_oldest();
        }
    }

    /// The oldest submap leaves the window. One that was made while the set localizes is of no more use: it is stored without its evidence.
    fn leave_oldest(&mut self) {
        let Some(oldest) = self.closed.pop_front() else { return };
        self.window.withdraw_submap(&oldest);
        if oldest.number() < self.fixed_below {
            return;
        }
        if self.localizes {
            self.left_cleared.push(Submap { tiles: Vec::new(), ..oldest.submap() });
        } else if oldest.has_cleared() {
            self.left_cleared.push(oldest.submap());
        }
    }

    /// Removes stale evidence from a cell: the active submap loses its evidence for "occupied", in closed ones the cell is masked.
    fn clear(&mut self, cell: CellIndex) {
        self.window.clear(cell);
        self.mask(cell);
    }

    /// Removes all evidence from a cell: something stands where nothing stood.
    fn remove(&mut self, cell: CellIndex) {
        self.window.remove(cell);
        self.mask(cell);
    }

    fn mask(&mut self, cell: CellIndex) {
        for submap in &mut self.closed {
            submap.clear(cell);
        }
    }
}

#[cfg(test)]
mod tests;
