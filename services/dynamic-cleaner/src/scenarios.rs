//! The cleaner in small worlds of straight walls, mapped and seen with simulated scans.

use crate::{DynamicCleaner, Sector, Settings};
use flockslam_evidence::{Cell, CellIndex, Tile, TileGrid, TileKey};
use flockslam_geometry::{Covariance, Point, Pose};
use flockslam_messages::{ClearedCell, PoseEstimate, PoseFlags, ScanBuffer};
use flockslam_ray_insertion::{ObservedCells, SensorModel};
use std::collections::{BTreeMap, BTreeSet};

type Wall = (f64, f64, f64, f64);

const CELL_M: f64 = 0.05;
/// A room of 10 m × 6 m with a corridor of 2 m × 12 m behind an opening.
const ROOM: [Wall; 8] = [
    (0.0, 0.0, 10.0, 0.0),
    (0.0, 6.0, 10.0, 6.0),
    (0.0, 0.0, 0.0, 6.0),
    (10.0, 0.0, 10.0, 2.0),
    (10.0, 4.0, 10.0, 6.0),
    (10.0, 2.0, 22.0, 2.0),
    (10.0, 4.0, 22.0, 4.0),
    (22.0, 2.0, 22.0, 4.0),
];

/// Evidence summed over scans; each scan counts once for a cell.
#[derive(Default)]
struct Map {
    sums: BTreeMap<CellIndex, Cell>,
    seen: BTreeSet<CellIndex>,
}

impl ObservedCells for Map {
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        if self.seen.insert(cell) {
            let sum = self.sums.entry(cell).or_default();
            *sum = sum.combine(evidence);
        }
    }
}

impl Map {
    fn insert(&mut self, scan: &ScanBuffer, pose: Pose) {
        let view = scan.view().unwrap();
        let end = |beam| {
            let range = view.valid_range_m(beam)?;
            let (sin, cos) = view.angle_rad(beam).sin_cos();
            Some(pose.apply(Point::new(range * cos, range * sin)))
        };
        let ends: Vec<Point> = (0..view.len()).filter_map(end).collect();
        self.seen.clear();
        let model = SensorModel::new(Cell::from_weights(2.2, 0.0), Cell::from_weights(0.0, 0.2));
        model.insert(CELL_M, pose.position(), &ends, self);
    }

    fn grid(&self) -> TileGrid<Box<Tile>> {
        let mut tiles: BTreeMap<TileKey, Box<Tile>> = BTreeMap::new();
        for (cell, sum) in &self.sums {
            let tile = tiles.entry(cell.tile()).or_insert_with(|| Tile::unknown(0));
            tile.cells[cell.offset()] = sum.pack();
            tile.set_score(cell.offset(), (sum.masses().occupied * f64::from(u16::MAX)) as u16);
        }
        let mut grid = TileGrid::new(CELL_M);
        for (key, tile) in tiles {
            grid.set(key, tile).unwrap();
        }
        grid
    }

    fn occupied(&self) -> BTreeSet<CellIndex> {
        self.sums.iter().filter(|(_, sum)| sum.masses().occupied > 0.5).map(|(cell, _)| *cell).collect()
    }
}

fn square(x: f64, y: f64, side: f64) -> [Wall; 4] {
    let h = 0.5 * side;
    [
        (x - h, y - h, x + h, y - h),
        (x - h, y + h, x + h, y + h),
        (x - h, y - h, x - h, y + h),
        (x + h, y - h, x + h, y + h),
    ]
}

fn cast(walls: &[Wall], from: Point, angle: f64) -> f64 {
    let (dy, dx) = angle.sin_cos();
    let hit = |(x0, y0, x1, y1): &Wall| {
        let (wx, wy) = (x1 - x0, y1 - y0);
        let det = wx * dy - wy * dx;
        let (ox, oy) = (x0 - from.x_m, y0 - from.y_m);
        let (range, share) = ((wx * oy - wy * ox) / det, (dx * oy - dy * ox) / det);
        (det.abs() > 1e-12 && range > 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
    };
    walls.iter().filter_map(hit).fold(f64::INFINITY, f64::min)
}

/// Half a circle (forward) or a whole one; noise of 1 cm from a fixed sequence.
fn scan(walls: &[Wall], pose: Pose, beams: u32, field_rad: f64, seed: u32) -> ScanBuffer {
    let step = field_rad / f64::from(beams);
    let mut state = seed.wrapping_mul(747_796_405).wrapping_add(1);
    let mut noise_m = || {
        let sum: u32 = (0..4)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                state >> 22
            })
            .sum();
        (f64::from(sum) / 1024.0 - 2.0) * 0.0173
    };
    let ranges: Vec<f32> = (0..beams)
        .map(|i| {
            let angle = pose.heading_rad - 0.5 * field_rad + (f64::from(i) + 0.5) * step;
            (cast(walls, pose.position(), angle) + noise_m()) as f32
        })
        .collect();
    let mut scan = ScanBuffer::from_ranges(&ranges, -0.5 * field_rad + 0.5 * step, step);
    scan.header.range_max_m = 80.0;
    scan
}

fn estimate(pose: Pose) -> PoseEstimate {
    let covariance = Covariance::diagonal(0.01, 0.003);
    PoseEstimate { odom_from_base: pose, covariance, flags: PoseFlags::MATCHED, ..PoseEstimate::default() }
}

/// Poses along the room and down the corridor, 0.2 m apart, looking ahead and then back.
fn tour() -> Vec<Pose> {
    let ahead = (0..90).map(|i| Pose::new(1.0 + 0.2 * f64::from(i), 3.1, 0.02 * f64::from(i % 7)));
    let back = (0..90).map(|i| Pose::new(18.8 - 0.2 * f64::from(i), 2.8, 3.1 - 0.02 * f64::from(i % 5)));
    ahead.chain(back).collect()
}

fn mapped(walls: &[Wall], poses: &[Pose], beams: u32, field_rad: f64) -> Map {
    let mut map = Map::default();
    for (i, pose) in (0..).zip(poses) {
        map.insert(&scan(walls, *pose, beams, field_rad, i), *pose);
    }
    map
}

fn index(cell: &ClearedCell) -> CellIndex {
    CellIndex::new(cell.x, cell.y)
}

/// Everything that the cleaner clears while it drives a tour through a world.
fn cleared_on(
    map: &Map,
    walls: &[Wall],
    poses: &[Pose],
    beams: u32,
    field_rad: f64,
    error: Pose,
) -> BTreeSet<CellIndex> {
    let (grid, mut cleaner, mut cleared) =
        (map.grid(), DynamicCleaner::new(Settings::default()), BTreeSet::new());
    for (i, pose) in (1000..).zip(poses) {
        let scan = scan(walls, *pose, beams, field_rad, i);
        let marks = cleaner.handle(scan.view().unwrap(), &estimate(*pose * error), &grid);
        assert_eq!(marks.header.cleared as usize, marks.cleared.len());
        cleared.extend(marks.cleared.iter().map(index));
    }
    cleared
}

/// Beams and field of view of the lidars that the scenarios are tried with: one per degree ahead, two per degree ahead,
/// one per degree all round.
const LIDARS: [(u32, f64); 3] =
    [(180, std::f64::consts::PI), (360, std::f64::consts::PI), (360, std::f64::consts::TAU)];

#[test]
fn an_unchanged_world_stays_whole_also_where_walls_are_seen_at_grazing_angles() {
    for (beams, field_rad) in LIDARS {
        let map = mapped(&ROOM, &tour(), beams, field_rad);
        let cleared = cleared_on(&map, &ROOM, &tour(), beams, field_rad, Pose::IDENTITY);
        assert!(cleared.is_empty(), "{beams} beams: {} of {} cells", cleared.len(), map.occupied().len());
    }
}

#[test]
fn a_small_error_of_the_pose_clears_less_than_two_cells_in_a_thousand() {
    for (beams, field_rad) in LIDARS {
        let map = mapped(&ROOM, &tour(), beams, field_rad);
        for error in [Pose::new(0.05, 0.0, 0.0), Pose::new(0.0, -0.05, 0.0), Pose::new(0.0, 0.0, 0.009)] {
            let cleared = cleared_on(&map, &ROOM, &tour(), beams, field_rad, error);
            let share = cleared.len() as f64 / map.occupied().len() as f64;
            assert!(share < 0.002, "{beams} beams, {error:?}: {share}");
        }
    }
}

#[test]
fn most_of_a_box_that_vanished_is_cleared_by_three_views_and_all_of_it_by_twelve() {
    let with_box: Vec<Wall> = ROOM.into_iter().chain(square(6.0, 3.2, 0.6)).collect();
    for (beams, field_rad) in LIDARS {
        let before = [Pose::new(3.0, 2.0, 0.0), Pose::new(3.2, 3.0, 0.1), Pose::new(3.4, 4.0, 0.2)];
        let map = mapped(&with_box, &before, beams, field_rad);
        let of_box = |cell: &CellIndex| {
            let center = Point::new((f64::from(cell.x) + 0.5) * CELL_M, (f64::from(cell.y) + 0.5) * CELL_M);
            center.distance_m(Point::new(6.0, 3.2)) < 0.6
        };
        let stale: BTreeSet<_> = map.occupied().into_iter().filter(of_box).collect();
        assert!(stale.len() > 8, "{}", stale.len());
        let after = [Pose::new(3.0, 2.5, 0.2), Pose::new(3.2, 2.6, 0.2), Pose::new(3.4, 2.7, 0.2)];
        let cleared = cleared_on(&map, &ROOM, &after, beams, field_rad, Pose::IDENTITY);
        assert!(cleared.is_subset(&stale), "{beams} beams");
        let share = cleared.len() as f64 / stale.len() as f64;
        assert!(share > 0.55, "{beams} beams: {share}");
        let more: Vec<Pose> = (0..12).map(|i| Pose::new(2.0 + 0.2 * f64::from(i), 2.4, 0.2)).collect();
        assert_eq!(cleared_on(&map, &ROOM, &more, beams, field_rad, Pose::IDENTITY), stale, "{beams} beams");
    }
}

/// Where segments close – near, at right angles – both methods find the same cells; elsewhere sectors leak.
#[test]
fn sectors_agree_with_beams_about_what_has_gone_near_the_robot() {
    let with_box: Vec<Wall> = ROOM.into_iter().chain(square(4.0, 3.0, 0.6)).collect();
    let before = [Pose::new(2.0, 2.0, 0.0), Pose::new(2.2, 3.0, 0.1), Pose::new(2.4, 4.0, 0.2)];
    let map = mapped(&with_box, &before, 1000, std::f64::consts::TAU);
    let after: Vec<Pose> = (0..12).map(|i| Pose::new(1.5 + 0.15 * f64::from(i), 2.6, 0.1)).collect();
    let clear = |settings: Settings| {
        let (grid, mut cleaner, mut cleared) = (map.grid(), DynamicCleaner::new(settings), BTreeSet::new());
        for (i, pose) in (1000..).zip(&after) {
            let scan = scan(&ROOM, *pose, 1000, std::f64::consts::TAU, i);
            let marks = cleaner.handle(scan.view().unwrap(), &estimate(*pose), &grid);
            cleared.extend(marks.cleared.iter().map(index));
        }
        cleared
    };
    let of_box = |cell: &CellIndex| {
        let center = Point::new((f64::from(cell.x) + 0.5) * CELL_M, (f64::from(cell.y) + 0.5) * CELL_M);
        center.distance_m(Point::new(4.0, 3.0)) < 0.6
    };
    let by_beams = clear(Settings::default());
    let by_sectors = clear(Settings { radius_m: 12.0, ..Settings::sectors() });
    let (beams, sectors): (BTreeSet<_>, BTreeSet<_>) = (
        by_beams.iter().copied().filter(of_box).collect(),
        by_sectors.iter().copied().filter(of_box).collect(),
    );
    assert!(beams.len() > 8 && beams == sectors, "{} {}", beams.len(), sectors.len());
    assert!(by_beams.iter().all(of_box), "beams leave the walls alone");
}

#[test]
fn several_processes_come_to_the_same_marks_as_one() {
    let with_box: Vec<Wall> = ROOM.into_iter().chain(square(6.0, 3.2, 0.6)).collect();
    let map = mapped(&with_box, &tour(), 360, std::f64::consts::TAU);
    let grid = map.grid();
    for parts in 2..4 {
        let new = || DynamicCleaner::new(Settings::default());
        let (mut alone, mut first, mut others) = (new(), new(), vec![new(); parts as usize]);
        let mut cleared = 0;
        for (i, pose) in (1000..).zip(tour()) {
            let scan = scan(&ROOM, pose, 360, std::f64::consts::TAU, i);
            let (view, pose) = (scan.view().unwrap(), estimate(pose));
            first.watch(view, &pose, &grid);
            first.begin(view, &pose);
            for part in (0..parts).rev() {
                let other = &mut others[part as usize];
                other.begin(view, &pose);
                other.look(view, &pose, &grid, Sector::new(part, parts));
                first.take(other.found());
            }
            let (together, expected) = (first.conclude(&pose), alone.handle(view, &pose, &grid));
            assert_eq!((together.header, together.cleared), (expected.header, expected.cleared));
            cleared += expected.cleared.len();
        }
        assert!(cleared > 0);
    }
}

#[test]
fn an_opened_door_is_cleared_and_its_frame_stays() {
    let closed: Vec<Wall> = ROOM.into_iter().chain([(10.0, 2.0, 10.0, 4.0)]).collect();
    let poses: Vec<Pose> = (0..20).map(|i| Pose::new(3.0 + 0.2 * f64::from(i), 3.0, 0.0)).collect();
    let map = mapped(&closed, &poses, 360, std::f64::consts::PI);
    let cleared = cleared_on(&map, &ROOM, &poses, 360, std::f64::consts::PI, Pose::IDENTITY);
    let door = |cell: &CellIndex| (198..=202).contains(&cell.x) && (40..80).contains(&cell.y);
    assert!(cleared.iter().all(door));
    let rows: BTreeSet<i32> = cleared.iter().map(|cell| cell.y).collect();
    assert!((45..75).all(|y| rows.contains(&y)), "{rows:?}");
}

#[test]
fn scans_that_contradict_much_of_the_grid_clear_less_than_a_twentieth_of_it() {
    let map = mapped(&ROOM, &tour(), 360, std::f64::consts::PI);
    let cleared = cleared_on(&map, &ROOM, &tour(), 360, std::f64::consts::PI, Pose::new(0.0, -0.6, 0.0));
    let share = cleared.len() as f64 / map.occupied().len() as f64;
    assert!(share < 0.05, "{share}");
}

#[test]
fn uncertain_poses_and_beams_without_return_clear_nothing() {
    let with_box: Vec<Wall> = ROOM.into_iter().chain(square(6.0, 3.2, 0.6)).collect();
    let poses: Vec<Pose> = (0..12).map(|i| Pose::new(2.0 + 0.2 * f64::from(i), 2.4, 0.2)).collect();
    let map = mapped(&with_box, &poses, 360, std::f64::consts::PI);
    let (grid, mut cleaner) = (map.grid(), DynamicCleaner::new(Settings::default()));
    for (i, pose) in (0..).zip(&poses) {
        let mut seen = scan(&ROOM, *pose, 360, std::f64::consts::PI, i);
        let unmatched = PoseEstimate { flags: 0, ..estimate(*pose) };
        let lost = PoseEstimate { quality: 2, ..estimate(*pose) };
        let senseless = PoseEstimate {
            covariance: Covariance { tt: f64::NAN, ..Covariance::default() },
            ..estimate(*pose)
        };
        for pose in [unmatched, lost, senseless] {
            assert!(cleaner.handle(seen.view().unwrap(), &pose, &grid).cleared.is_empty());
        }
        seen.numbers.fill(f32::INFINITY);
        assert!(cleaner.handle(seen.view().unwrap(), &estimate(*pose), &grid).cleared.is_empty());
    }
}

#[test]
fn a_person_who_walks_in_is_counted_and_a_standing_robot_clears_nothing() {
    let pose = Pose::new(3.0, 3.0, 0.0);
    let map = mapped(&ROOM, &tour(), 360, std::f64::consts::PI);
    let grid = map.grid();
    let with_person: Vec<Wall> = ROOM.into_iter().chain(square(5.0, 3.2, 0.4)).collect();
    let mut cleaner = DynamicCleaner::new(Settings::default());
    let alone = scan(&ROOM, pose, 360, std::f64::consts::PI, 1);
    assert_eq!(cleaner.handle(alone.view().unwrap(), &estimate(pose), &grid).header.moving_beams, 0);
    let visited = scan(&with_person, pose, 360, std::f64::consts::PI, 2);
    let moving = cleaner.handle(visited.view().unwrap(), &estimate(pose), &grid).header.moving_beams;
    assert!((15..40).contains(&moving), "{moving}");
    let mapped_before = mapped(&with_person, &[pose], 360, std::f64::consts::PI).grid();
    for seed in 0..50 {
        let scan = scan(&ROOM, pose, 360, std::f64::consts::PI, seed);
        assert!(cleaner.handle(scan.view().unwrap(), &estimate(pose), &mapped_before).cleared.is_empty());
    }
}

#[test]
fn a_scan_classifies_no_cell_twice_and_only_occupied_ones_in_range() {
    let map = mapped(&ROOM, &tour(), 360, std::f64::consts::PI);
    let (grid, pose) = (map.grid(), Pose::new(8.0, 3.0, 0.1));
    let scan = scan(&ROOM, pose, 360, std::f64::consts::PI, 1);
    let (settings, occupied) = (Settings::default(), map.occupied());
    let mut cleaner = DynamicCleaner::new(settings.clone());
    let mut before = None;
    for _ in 0..50 {
        assert!(cleaner.handle(scan.view().unwrap(), &estimate(pose), &grid).cleared.is_empty());
        let classified: BTreeSet<_> =
            cleaner.found().iter().map(|cell| CellIndex::new(cell.x, cell.y)).collect();
        assert_eq!(classified.len(), cleaner.found().len(), "a cell is classified once");
        assert!(classified.len() > 100 && classified.is_subset(&occupied), "{} cells", classified.len());
        let in_reach =
            |cell: &CellIndex| grid.center(*cell).distance_m(pose.position()) <= settings.radius_m + 1e-9;
        assert!(classified.iter().all(in_reach));
        // The work for a scan does not depend on those before it.
        assert!(before.replace(classified.clone()).is_none_or(|before| before == classified));
    }
}
