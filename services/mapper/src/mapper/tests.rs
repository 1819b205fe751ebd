//! Tests of the mapper: evidence, submaps, windows, trajectories, shares and unconfirmed objects.

use super::*;
use crate::settings::HIT_NAT;
use flockslam_evidence::Cell;
use flockslam_map_fusion::FusedMap;
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
    assert_eq!(hit, Cell::from_weights(HIT_NAT, 0.0));
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
    let mut known = 0;
    for (key, tile) in window_of(&mapper) {
        for (offset, cell) in tile.cells.iter().enumerate() {
            assert_eq!(sum.cell(key.cell(offset)).pack(), *cell);
            known += usize::from(!cell.is_unknown());
        }
    }
    let known_of = |cells: &[Cell]| cells.iter().filter(|cell| !cell.is_unknown()).count();
    assert_eq!(sum.tiles().map(|(_, cells)| known_of(&cells[..])).sum::<usize>(), known);
}

#[test]
fn a_bounded_window_is_the_sum_of_its_submaps_and_retires_what_it_leaves() {
    let settings = Settings { window_m: 10.0, ..Settings::default() };
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
    // A window of 0 has no bound.
    [100.0, 0.0].into_iter().for_each(clears_for_good);
}

fn clears_for_good(window_m: f64) {
    let settings = Settings { window_m, ..Settings::default() };
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
    assert!(mapper.closed.iter().all(|closed| closed.submap().cell(stale).is_unknown()));
    mapper.close();
    let cleared = mapper.take_cleared();
    assert!(!cleared.is_empty() && cleared.iter().all(Submap::has_cleared));
    assert!(mapper.take_cleared().is_empty());
}

#[test]
fn a_new_chain_begins_with_an_empty_window_and_leaves_the_old_submaps_as_they_are() {
    let mut mapper = Mapper::new(Settings::default());
    let before = drive(&mut mapper, 0..40);
    let start = PoseEstimate { trajectory: 1, ..pose(3.0, 1.0, 0.5) };
    let insertion = mapper.insert(scan(40, &[3.0; 100]).view().unwrap(), &start, &[]);
    assert_eq!((insertion.closed.len(), insertion.closed[0].last), (1, 39));
    assert_eq!(insertion.closed[0].trajectory, 0);
    assert!(!insertion.retired.is_empty());
    assert!(insertion.changed.iter().all(|key| !insertion.retired.contains(key)));
    let closed = insertion.closed[0].clone();
    let mut alone = Mapper::new(Settings::default());
    alone.insert(scan(40, &[3.0; 100]).view().unwrap(), &start, &[]);
    assert_eq!(window_of(&mapper), window_of(&alone));
    let last = mapper.close().unwrap();
    assert_eq!((last.trajectory, last.number), (1, closed.number + 1));

    let mut resumed = Mapper::new(Settings::default());
    [before, vec![closed, last]].concat().into_iter().for_each(|submap| resumed.resume(submap, 41));
    assert_eq!(window_of(&resumed), window_of(&mapper));
}

#[test]
fn shares_of_several_mappers_are_together_what_one_has() {
    let settings = Settings { window_m: 10.0, ..Settings::default() };
    let mut alone = Mapper::new(settings.clone());
    let whole = drive(&mut alone, 0..60);
    for parts in 2..4 {
        let share = |part| Mapper::of_share(settings.clone(), TileShare::new(part, parts));
        let mut shares: Vec<_> = (0..parts).map(share).collect();
        let closed: Vec<_> = shares.iter_mut().map(|mapper| drive(mapper, 0..60)).collect();
        let mut tiles: Vec<_> = shares.iter().flat_map(window_of).collect();
        tiles.sort_by_key(|(key, _)| *key);
        let mut expected = window_of(&alone);
        expected.sort_by_key(|(key, _)| *key);
        assert_eq!(tiles, expected);
        assert!(closed.iter().all(|submaps| *submaps == whole));
    }
}

#[test]
fn an_absurd_pose_leaves_the_map_as_it_is() {
    let mut mapper = Mapper::new(Settings::default());
    drive(&mut mapper, 0..2);
    let before = window_of(&mapper);
    mapper.insert(scan(2, &[3.0; 50]).view().unwrap(), &pose(1e12, -1e300, 0.0), &[]);
    assert_eq!(window_of(&mapper), before);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn scores_match_the_evidence(ranges in proptest::collection::vec(0.3f32..8.0, 1..60), turn in -3.0..3.0f64) {
        for settings in [Settings::default(), Settings::vinyslam()] {
            let mut mapper = Mapper::new(settings.clone());
            for i in 0..3 {
                mapper.insert(scan(i, &ranges).view().unwrap(), &pose(0.0, 0.02 * i as f64, turn), &[]);
            }
            for (_, tile) in window_of(&mapper) {
                for (cell, score) in tile.cells.iter().zip(tile.score) {
                    prop_assert_eq!(settings.read_out().score(cell.masses()), score);
                }
            }
        }
    }
}

/// Scans of a room while the robot creeps through its middle, a second apart: 4 m to the wall, something at 2 m on some beams of the second half.
fn room(mapper: &mut Mapper, scans: std::ops::Range<u64>, taken: impl Fn(u64, usize) -> bool) {
    for i in scans {
        let ranges: Vec<f32> = (0..100).map(|beam| if taken(i, beam) { 2.0 } else { 4.0 }).collect();
        let mut at = pose(0.004 * i as f64, 0.002 * i as f64, 0.0);
        at.times.sensor_ns = i as i64 * 1_000_000_000;
        mapper.insert(scan(i, &ranges).view().unwrap(), &at, &[]);
    }
}

/// Cells that are rather occupied than free, nearer than the wall.
fn standing(mapper: &Mapper) -> usize {
    let near = |cell: CellIndex| Point::new(f64::from(cell.x), f64::from(cell.y)).norm_m() * 0.045 < 3.5;
    window_of(mapper)
        .iter()
        .flat_map(|(key, tile)| {
            tile.score.iter().enumerate().map(|(offset, score)| (key.cell(offset), *score))
        })
        .filter(|(cell, score)| *score > u16::MAX / 2 && near(*cell))
        .count()
}

#[test]
fn a_pedestrian_leaves_no_trail_and_a_closed_door_is_mapped_at_the_third_view() {
    let mut mapper = Mapper::new(Settings::default());
    room(&mut mapper, 0..20, |_, _| false);
    // Five beams wide, five beams a second.
    room(&mut mapper, 20..40, |i, beam| beam / 5 == (i - 20) as usize);
    assert_eq!(standing(&mapper), 0);
    let door = |_: u64, beam: usize| (30..60).contains(&beam);
    room(&mut mapper, 40..42, door);
    assert_eq!(standing(&mapper), 0);
    room(&mut mapper, 42..43, door);
    assert!(standing(&mapper) > 10, "{}", standing(&mapper));
    let mut at_once = Mapper::new(Settings { confirming_scans: 1, ..Settings::default() });
    room(&mut at_once, 0..2, |_, _| false);
    room(&mut at_once, 2..4, |i, beam| beam / 5 == i as usize);
    assert!(standing(&at_once) > 0);
}

#[test]
fn what_is_seen_while_the_set_localizes_leaves_the_submaps_of_the_map_as_they_are() {
    let mut mapper = Mapper::new(Settings { window_m: 0.0, ..Settings::default() });
    let mut submaps = drive(&mut mapper, 0..40);
    let stale = window_of(&mapper).into_iter().find_map(|(key, tile)| {
        tile.cells.iter().position(|cell| cell.occupied > 0).map(|offset| key.cell(offset))
    });
    let cleared = [ClearedCell { x: stale.unwrap().x, y: stale.unwrap().y }];
    let ranges = [2.0; 100];
    for sequence in 40..60 {
        let mut at = pose(12.0, 0.0, 0.0);
        at.flags |= PoseFlags::LOCALIZING;
        let closed = mapper.insert(scan(sequence, &ranges).view().unwrap(), &at, &cleared).closed;
        assert_eq!(closed.len(), usize::from(sequence == 40 && submaps.last().unwrap().last < 39));
        submaps.extend(closed);
    }
    let of_map = submaps.len() as u32;
    assert_eq!(submaps.last().unwrap().last, 39, "the submap is cut where the set begins to localize");
    assert!(mapper.take_cleared().is_empty(), "nothing was cleared before");
    let closed = mapper.insert(scan(60, &ranges).view().unwrap(), &pose(12.0, 0.0, 0.0), &[]).closed;
    assert_eq!(closed.iter().map(|submap| (submap.first, submap.last)).collect::<Vec<_>>(), [(40, 59)]);
    mapper.close();
    assert!(mapper.take_cleared().iter().all(|submap| submap.number >= of_map));

    let mut successor = Mapper::new(Settings { window_m: 0.0, ..Settings::default() });
    submaps.iter().for_each(|submap| successor.resume(submap.clone(), submap.last));
    successor.has_localized(45);
    successor.insert(scan(61, &ranges).view().unwrap(), &pose(12.0, 0.0, 0.0), &cleared);
    successor.close();
    assert!(successor.take_cleared().iter().all(|submap| submap.number >= of_map));
}

#[test]
fn what_is_seen_while_the_set_localizes_is_dropped_by_way_and_by_age_and_leaves_no_evidence_on_disk() {
    let mut mapper = Mapper::new(Settings { window_m: 20.0, ..Settings::default() });
    let ranges: Vec<f32> = (0..100).map(|i| 3.0 + (i as f32 * 0.7).sin()).collect();
    let mut insert = |sequence: u64, x_m: f64, now_s: i64| {
        let mut at = pose(x_m, 0.0, 0.0);
        at.flags |= PoseFlags::LOCALIZING;
        at.times.sensor_ns = now_s * 1_000_000_000;
        let closed = mapper.insert(scan(sequence, &ranges).view().unwrap(), &at, &[]).closed.len();
        (closed, mapper.take_cleared(), mapper.live_tiles().count())
    };
    let (mut closed, mut left, mut most) = (0, Vec::new(), 0);
    for step in 0..400 {
        let (new, cleared, tiles) = insert(step, 0.3 * step as f64, step as i64 / 10);
        closed += new;
        left.extend(cleared);
        most = most.max(tiles);
    }
    let of_half = most;
    for step in 400..800 {
        left.extend(insert(step, 0.3 * step as f64, step as i64 / 10).1);
        most = most.max(insert(step + 1000, 0.3 * step as f64, step as i64 / 10).2);
    }
    assert!(closed > 20 && most <= of_half + 4, "{closed} submaps, {of_half} tiles, then {most}");
    assert!(left.len() > 20 && left.iter().all(|submap| submap.tiles.is_empty()));
    assert!(left.windows(2).all(|pair| pair[1].number == pair[0].number + 1), "each once, in order");
    // The robot has stood for an hour.
    let before = insert(2000, 240.0, 80);
    let after = insert(2001, 240.2, 3700);
    assert!(
        after.1.len() >= 2 && after.2 < before.2,
        "{} left, {} of {} tiles",
        after.1.len(),
        after.2,
        before.2
    );
    let newest = insert(2002, 240.4, 7300);
    assert!(newest.2 > 0, "what was seen last stays");
}
