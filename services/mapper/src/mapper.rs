use crate::newcomers::Newcomers;
use crate::settings::Settings;
use crate::window::Window;
use flockslam_evidence::{CellIndex, SensorModel, Submap, Tile, TileKey, floor};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{ClearedCell, Deskew, PoseEstimate, ScanView};
use std::collections::VecDeque;

/// Turns scans with poses into evidence, tiles and submaps. A pure function of its calls.
#[derive(Debug)]
pub struct Mapper {
    settings: Settings,
    model: SensorModel,
    window: Window,
    /// The closed submaps of a bounded window: what leaves it must be known.
    closed: VecDeque<Submap>,
    left_cleared: Vec<Submap>,
    active: Option<ActiveSubmap>,
    number: u32,
    chain: u32,
    generation: u64,
    newcomers: Newcomers,
    /// Where the beams of the scan at hand end, in odom.
    ends: Vec<Point>,
    /// Those of them that are not known to be more than somebody who walks by.
    held_back: Vec<Point>,
}

#[derive(Debug)]
struct ActiveSubmap {
    odom_from_submap: Pose,
    first: u64,
    last: u64,
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
    /// The submaps that this scan closed: the one that it was the last of, and the one before when a new chain begins with it.
    pub closed: Vec<Submap>,
}

impl Mapper {
    /// An empty map.
    pub fn new(settings: Settings) -> Self {
        Self {
            model: settings.model(),
            window: Window::new(&settings),
            closed: VecDeque::new(),
            left_cleared: Vec::new(),
            active: None,
            number: 0,
            chain: 0,
            generation: 0,
            newcomers: Newcomers::default(),
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
        self.enter_chain(closed.chain);
        self.window.add_submap(&closed);
        self.remember(closed);
        self.window.end_scan();
        // What has left the window again is stored as it is.
        self.left_cleared.clear();
    }

    /// Inserts a scan at its pose, after taking out what `cleared` calls stale.
    pub fn insert(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        cleared: &[ClearedCell],
    ) -> Insertion<'_> {
        self.window.begin_scan();
        let mut closed = Vec::new();
        if pose.chain != self.chain {
            closed.extend(self.close_active());
            self.enter_chain(pose.chain);
        }
        for cell in cleared {
            self.clear(CellIndex::new(cell.x, cell.y));
        }
        let odom_from_base = pose.odom_from_base;
        let odom_from_laser = odom_from_base * scan.header().base_from_laser;
        self.take_ends(scan, pose);
        let hits = self.hold_back_newcomers(pose.times.sensor_ns);
        self.model.insert_hits(
            self.settings.cell_size_m,
            odom_from_laser.position(),
            &self.ends,
            hits,
            &mut self.window,
        );
        self.window.end_rays();
        let full = self.advance(scan.header().id.sequence, odom_from_base);
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

    /// Closed submaps that have left the window, or been in it when the map was closed, with cells cleared since they were
    /// closed: their stored form is to be replaced.
    pub fn take_cleared(&mut self) -> Vec<Submap> {
        std::mem::take(&mut self.left_cleared)
    }

    /// Closes the active submap, at the end of a log; `None` when it is empty.
    pub fn close(&mut self) -> Option<Submap> {
        let closed = self.close_active();
        self.left_cleared.extend(self.closed.iter().filter(|submap| submap.has_cleared()).cloned());
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
        let (sin, cos) = pose.odom_from_base.heading_rad.sin_cos();
        let Settings { range_min_m, range_max_m, skip_isolated, .. } = self.settings;
        self.ends.clear();
        for beam in 0..scan.len() {
            let Some(range) = scan.valid_range_m(beam) else { continue };
            let skipped = skip_isolated && scan.is_isolated(beam);
            if (range_min_m..=range_max_m).contains(&range) && !skipped {
                let end = deskew.end_in_base(scan, beam, range);
                self.ends.push(Point::new(
                    pose.odom_from_base.x_m + cos * end.x_m - sin * end.y_m,
                    pose.odom_from_base.y_m + sin * end.x_m + cos * end.y_m,
                ));
            }
        }
    }

    /// Moves the ends that need to be seen again behind the others; gives the number of the others. Where something has been
    /// seen often enough, the map forgets that nothing stood there.
    fn hold_back_newcomers(&mut self, stamp_ns: i64) -> usize {
        let views = self.settings.newcomer_views;
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
            let stays = self.newcomers.seen(cell, scan, stamp_ns) >= views;
            if stays {
                self.forget(cell);
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
    fn advance(&mut self, sequence: u64, pose: Pose) -> bool {
        let active = self.active.get_or_insert(ActiveSubmap {
            odom_from_submap: pose,
            first: sequence,
            last: sequence,
            insertions: 0,
            last_pose: pose,
            travel_m: 0.0,
        });
        active.last = sequence;
        active.insertions += 1;
        active.travel_m += active.last_pose.distance_m(pose);
        active.last_pose = pose;
        active.travel_m >= self.settings.submap_length_m
            || active.insertions >= self.settings.submap_insertions
    }

    fn close_active(&mut self) -> Option<Submap> {
        let active = self.active.take()?;
        let submap = Submap {
            number: self.number,
            chain: self.chain,
            insertions: active.insertions,
            first: active.first,
            last: active.last,
            odom_from_submap: active.odom_from_submap,
            cell_size_m: self.settings.cell_size_m,
            tiles: self.window.close_active(),
        };
        self.number += 1;
        if self.settings.window_m > 0.0 {
            self.remember(submap.clone());
        }
        Some(submap)
    }

    /// Empties the window when another chain begins: what came before lies nobody knows how to it.
    fn enter_chain(&mut self, chain: u32) {
        if chain == self.chain {
            return;
        }
        self.chain = chain;
        self.window.clear_all();
        self.left_cleared.extend(self.closed.drain(..).filter(Submap::has_cleared));
    }

    /// Keeps a closed submap while it is in a bounded window, and lets the oldest leave.
    fn remember(&mut self, submap: Submap) {
        let Some(size) = self.settings.window_submaps() else { return };
        self.closed.push_back(submap);
        while self.closed.len() > size {
            if let Some(oldest) = self.closed.pop_front() {
                self.window.withdraw_submap(&oldest);
                if oldest.has_cleared() {
                    self.left_cleared.push(oldest);
                }
            }
        }
    }

    /// Takes stale evidence out of a cell: the active submap loses what says "occupied", closed ones get it masked.
    fn clear(&mut self, cell: CellIndex) {
        self.window.clear(cell);
        self.mask(cell);
    }

    /// Takes all evidence out of a cell: something stands where nothing stood.
    fn forget(&mut self, cell: CellIndex) {
        self.window.forget(cell);
        self.mask(cell);
    }

    fn mask(&mut self, cell: CellIndex) {
        for submap in &mut self.closed {
            submap.clear(cell);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{Cell, FusedMap};
    use flockslam_messages::{PoseFlags, ScanBuffer};
    use proptest::prelude::*;

    fn scan(sequence: u64, ranges: &[f32]) -> ScanBuffer {
        let mut scan = ScanBuffer::from_ranges(ranges, -1.0, 0.02);
        (scan.header.id.sequence, scan.header.range_max_m) = (sequence, 20.0);
        scan
    }

    fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> PoseEstimate {
        let odom_from_base = Pose::new(x_m, y_m, heading_rad);
        PoseEstimate { odom_from_base, flags: PoseFlags::INSERT, ..PoseEstimate::default() }
    }

    fn drive(mapper: &mut Mapper, steps: std::ops::Range<u64>) -> Vec<Submap> {
        let ranges: Vec<f32> = (0..100).map(|i| 3.0 + (i as f32 * 0.7).sin()).collect();
        let step = |i: u64| {
            let at = pose(0.3 * i as f64, (i as f64).sin(), 0.1 * i as f64);
            mapper.insert(scan(i, &ranges).view().unwrap(), &at, &[]).closed
        };
        steps.flat_map(step).collect()
    }

    fn window_of(mapper: &Mapper) -> Vec<(TileKey, Tile)> {
        let mut tile = *Tile::unknown(0);
        let read = |key| {
            assert!(mapper.write_tile(key, &mut tile));
            (key, tile)
        };
        mapper.live_tiles().map(read).collect()
    }

    #[test]
    fn a_beam_leaves_free_space_a_hit_and_nothing_behind() {
        let settings = Settings { cell_size_m: 0.05, skip_isolated: false, ..Settings::default() };
        let mut mapper = Mapper::new(settings);
        let mut buffer = scan(5, &[2.02, 25.0, 0.2, f32::NAN]);
        buffer.header.angle_min_rad = 0.0;
        let insertion = mapper.insert(buffer.view().unwrap(), &pose(0.01, 0.02, 0.0), &[]);
        assert_eq!((insertion.generation, insertion.active_submap, insertion.closed.len()), (1, 0, 0));
        assert_eq!((insertion.changed, insertion.retired), (&[TileKey { x: 0, y: 0 }][..], &[][..]));
        let mut tile = Tile::unknown(0);
        assert!(mapper.write_tile(TileKey { x: 0, y: 0 }, &mut tile));
        let hit = tile.cells[40].unpack();
        assert_eq!(hit, Cell::from_weights(Settings::default().hit_nat, 0.0));
        assert_eq!(tile.cells[39].unpack(), Cell::from_weights(0.0, Settings::default().miss_nat));
        assert_eq!(tile.cells.iter().filter(|cell| !cell.is_unknown()).count(), 41);
        let score = (hit.masses().occupied * 65_535.0).round() as u16;
        assert_eq!(
            (tile.score[40], tile.score[39], tile.score_half[20], tile.score_quarter[10]),
            (score, 0, score, score)
        );
        assert!(!mapper.write_tile(TileKey { x: 9, y: 9 }, &mut tile));
    }

    #[test]
    fn every_scan_enters_exactly_one_submap_and_their_sum_is_the_window() {
        let mut mapper = Mapper::new(Settings { window_m: 0.0, ..Settings::default() });
        let mut submaps = drive(&mut mapper, 0..60);
        submaps.extend(mapper.close());
        assert!(submaps.len() > 3 && mapper.close().is_none());
        let mut next = 0;
        let mut sum = FusedMap::new(Settings::default().cell_size_m);
        for (number, submap) in submaps.iter().enumerate() {
            assert_eq!((submap.number as usize, submap.first), (number, next));
            assert_eq!(submap.last + 1 - submap.first, u64::from(submap.insertions));
            next = submap.last + 1;
            sum.add(submap, submap.odom_from_submap).unwrap();
        }
        assert_eq!(next, 60);
        for (key, tile) in window_of(&mapper) {
            for (offset, cell) in tile.cells.iter().enumerate() {
                assert_eq!(sum.cell(key.cell(offset)).pack(), *cell);
            }
        }
    }

    #[test]
    fn a_bounded_window_is_the_sum_of_its_submaps_and_retires_what_it_leaves() {
        let settings = Settings { window_m: 5.0, submap_length_m: 2.5, ..Settings::default() };
        let mut mapper = Mapper::new(settings.clone());
        let submaps = drive(&mut mapper, 0..80);
        let kept = mapper.closed.len();
        assert_eq!((kept, settings.window_submaps()), (2, Some(2)));
        let mut resumed = Mapper::new(settings);
        submaps.iter().for_each(|submap| resumed.resume(submap.clone(), submap.last + 1));
        drive(&mut resumed, submaps.last().unwrap().last + 1..80);
        assert_eq!(window_of(&resumed), window_of(&mapper));
        assert_eq!(
            (resumed.generation(), resumed.active_submap()),
            (mapper.generation(), mapper.active_submap())
        );
        assert!(window_of(&mapper).iter().all(|(key, _)| key.x > 0), "tiles behind have retired");
    }

    #[test]
    fn cleared_cells_lose_what_says_occupied_for_good() {
        let settings = Settings { window_m: 100.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings);
        drive(&mut mapper, 0..40);
        let stale = window_of(&mapper).into_iter().find_map(|(key, tile)| {
            tile.cells.iter().position(|cell| cell.occupied > 0).map(|offset| key.cell(offset))
        });
        let stale = stale.unwrap();
        let cleared = [ClearedCell { x: stale.x, y: stale.y }];
        let empty = scan(40, &[]);
        let insertion = mapper.insert(empty.view().unwrap(), &pose(12.0, 0.0, 0.0), &cleared);
        assert!(insertion.changed.contains(&stale.tile()));
        let after = window_of(&mapper).into_iter().find(|(key, _)| *key == stale.tile()).unwrap().1;
        assert_eq!((after.cells[stale.offset()].occupied, after.score[stale.offset()]), (0, 0));
        assert!(mapper.closed.iter().all(|submap| submap.cell(stale).is_unknown()));
        mapper.close();
        let cleared = mapper.take_cleared();
        assert!(!cleared.is_empty() && cleared.iter().all(Submap::has_cleared));
        assert!(mapper.take_cleared().is_empty());
    }

    #[test]
    fn a_new_chain_begins_with_an_empty_window_and_leaves_the_old_submaps_as_they_are() {
        let mut mapper = Mapper::new(Settings::default());
        let before = drive(&mut mapper, 0..40);
        let start = PoseEstimate { chain: 1, ..pose(3.0, 1.0, 0.5) };
        let insertion = mapper.insert(scan(40, &[3.0; 100]).view().unwrap(), &start, &[]);
        assert_eq!((insertion.closed.len(), insertion.closed[0].last), (1, 39));
        assert_eq!(insertion.closed[0].chain, 0);
        assert!(!insertion.retired.is_empty());
        assert!(insertion.changed.iter().all(|key| !insertion.retired.contains(key)));
        let closed = insertion.closed[0].clone();
        let mut alone = Mapper::new(Settings::default());
        alone.insert(scan(40, &[3.0; 100]).view().unwrap(), &start, &[]);
        assert_eq!(window_of(&mapper), window_of(&alone));
        let last = mapper.close().unwrap();
        assert_eq!((last.chain, last.number), (1, closed.number + 1));

        let mut resumed = Mapper::new(Settings::default());
        [before, vec![closed, last]].concat().into_iter().for_each(|submap| resumed.resume(submap, 41));
        assert_eq!(window_of(&resumed), window_of(&mapper));
    }

    #[test]
    fn an_absurd_pose_is_no_crash() {
        let mut mapper = Mapper::new(Settings::default());
        drive(&mut mapper, 0..2);
        let before = window_of(&mapper);
        mapper.insert(scan(2, &[3.0; 50]).view().unwrap(), &pose(1e12, -1e300, 0.0), &[]);
        assert_eq!(window_of(&mapper), before);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn scores_are_what_the_evidence_says(ranges in proptest::collection::vec(0.3f32..8.0, 1..60), turn in -3.0..3.0f64) {
            for settings in [Settings::default(), Settings::vinyslam()] {
                let mut mapper = Mapper::new(settings.clone());
                for i in 0..3 {
                    mapper.insert(scan(i, &ranges).view().unwrap(), &pose(0.0, 0.02 * i as f64, turn), &[]);
                }
                for (_, tile) in window_of(&mapper) {
                    for (cell, score) in tile.cells.iter().zip(tile.score) {
                        prop_assert_eq!(settings.read_out.score(cell.masses()), score);
                    }
                }
            }
        }
    }
}
