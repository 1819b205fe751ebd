//! What becomes of the tracks of people in simulated drives, stage by stage in one process with the true poses.

use flockslam_dynamic_cleaner::DynamicCleaner;
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::{Covariance, Point, Pose, Twist};
use flockslam_lidar_ingest::Settings as IngestSettings;
use flockslam_lidar_ingest::process::RecordingReader;
use flockslam_mapper::Mapper;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, ScanView, Track};
use flockslam_simulation::{MoverTruth, Settings, Simulation, World};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A track belongs to a person this near, metres.
const NEAR_M: f64 = 0.5;
/// Velocities are evaluated after so many seconds of view.
const CONVERGED_S: f64 = 1.0;
/// A person out of sight for this time, seconds, counts as occluded; after the longer time a new track is no error.
const HIDDEN_S: (f64, f64) = (0.3, 1.0);

/// Of a lidar that stands still every so many scans enter the map.
const MAPPED_EVERY: u64 = 10;
/// Sightings in a second of a bag.
const SIGHTINGS_MIN: usize = 10;

/// Mapper and cleaner with the true poses.
struct Robot {
    mapper: Mapper,
    cleaner: DynamicCleaner,
    grid: TileGrid<Box<Tile>>,
    inserted: Option<Pose>,
}

impl Robot {
    fn new() -> Self {
        let settings = flockslam_mapper::Settings::default();
        Self {
            grid: TileGrid::new(settings.cell_size_m),
            mapper: Mapper::new(settings),
            cleaner: DynamicCleaner::new(flockslam_dynamic_cleaner::Settings::default()),
            inserted: None,
        }
    }

    fn step(&mut self, scan: ScanView<'_>, truth: Pose, twist: Twist) -> Vec<Track> {
        let pose = PoseEstimate {
            id: scan.header().id,
            times: scan.header().times,
            odom_from_base: truth,
            covariance: Covariance::diagonal(0.01, 0.003),
            twist,
            flags: PoseFlags::MATCHED,
            ..PoseEstimate::default()
        };
        let tracks = self.cleaner.watch(scan, &pose, &self.grid).to_vec();
        if self.inserted.is_none_or(|last| last.distance_m(truth) >= 0.2 || last.turn_rad(truth) >= 0.35) {
            self.inserted = Some(truth);
            let marks = self.cleaner.handle(scan, &pose, &self.grid);
            let insertion = self.mapper.insert(scan, &pose, marks.cleared);
            let (changed, retired) = (insertion.changed.to_vec(), insertion.retired.to_vec());
            retired.into_iter().for_each(|key| drop(self.grid.remove(key)));
            for key in changed {
                let mut tile = self.grid.remove(key).unwrap_or_else(|| Tile::unknown(0));
                self.mapper.write_tile(key, &mut tile);
                let _ = self.grid.set(key, tile);
            }
        }
        tracks
    }
}

impl Robot {
    /// Centres of the occupied cells of the grid.
    fn standing(&self) -> Vec<Point> {
        let cells = self.grid.tiles().flat_map(|(key, tile)| {
            let occupied = tile.score.iter().enumerate().filter(|(_, score)| **score > u16::MAX / 2);
            occupied.map(move |(offset, _)| key.cell(offset))
        });
        cells.map(|cell| self.grid.center(cell)).collect()
    }
}

/// What a lidar that stands still sees: who walks, and what stands, metres from it.
pub struct SeenFromAStand {
    /// Where each one was at every sighting, by name; those who were followed for a second at least.
    pub ways: BTreeMap<u64, Vec<Point>>,
    /// Points of what stands.
    pub standing: Vec<Point>,
}

/// Follows the people of a bag that was recorded from a stand.
pub fn followed_from_a_stand(bag: &Path) -> SeenFromAStand {
    let mut reader = RecordingReader::open(bag, &IngestSettings::default()).unwrap();
    let (mut robot, mut scan) = (Robot::new(), ScanBuffer::default());
    let mut ways: BTreeMap<u64, Vec<Point>> = BTreeMap::new();
    let mut number = 0;
    while reader.next_scan(&mut scan).unwrap() {
        scan.header.id.sequence = number;
        if number % MAPPED_EVERY == 0 {
            robot.inserted = None;
        }
        number += 1;
        let tracks = robot.step(scan.view().unwrap(), Pose::IDENTITY, Twist::default());
        for track in tracks.iter().filter(|track| track.unseen_s == 0.0) {
            ways.entry(track.id).or_default().push(track.position);
        }
    }
    ways.retain(|_, way| way.len() >= SIGHTINGS_MIN);
    SeenFromAStand { ways, standing: robot.standing() }
}

/// What became of the tracks of a drive.
#[derive(Debug, Default)]
pub struct TrackFigures {
    squared_m2: f64,
    /// Sightings of people.
    pub positions: usize,
    speed_errors_m_s: f64,
    speeds: usize,
    /// Tracks in sight that belong to no person (false positives).
    pub false_tracks: usize,
    /// How often a person was occluded for up to a second.
    pub hidden: usize,
    /// How often the name was the same afterwards.
    pub recognised: usize,
    /// By who it is: the name last given, and when.
    names: BTreeMap<u32, (u64, f64)>,
}

impl TrackFigures {
    /// Who is behind which track is settled as CLEAR MOT does (Bernardin and Stiefelhagen 2008, section 2.1.3): who was stays, as
    /// long as they are near; then the nearest pair first, everybody once.
    fn take(&mut self, now_s: f64, tracks: &[Track], movers: &[MoverTruth]) {
        let in_view: Vec<&Track> = tracks.iter().filter(|track| track.unseen_s == 0.0).collect();
        let pairs = in_view.iter().flat_map(|track| movers.iter().map(move |mover| (*track, mover)));
        let off_m = |pair: &(&Track, &MoverTruth)| pair.1.center.distance_m(pair.0.position);
        let mut pairs: Vec<_> = pairs.filter(|pair| off_m(pair) < NEAR_M).collect();
        let was = |pair: &(&Track, &MoverTruth)| {
            self.names.get(&pair.1.id).is_some_and(|(name, _)| *name == pair.0.id)
        };
        pairs.sort_by(|a, b| was(b).cmp(&was(a)).then(off_m(a).total_cmp(&off_m(b))));
        let (mut named, mut known) = (BTreeSet::new(), BTreeSet::new());
        for (track, mover) in pairs {
            if !named.contains(&track.id) && !known.contains(&mover.id) {
                named.insert(track.id);
                known.insert(mover.id);
                self.count(now_s, track, mover);
            }
        }
        self.false_tracks += in_view.len() - named.len();
    }

    fn count(&mut self, now_s: f64, track: &Track, mover: &MoverTruth) {
        self.squared_m2 += mover.center.distance_m(track.position).powi(2);
        self.positions += 1;
        if track.age_s > CONVERGED_S {
            let speeds = [mover.velocity_m_s.norm_m(), track.velocity_m_s.norm_m()];
            self.speed_errors_m_s += (speeds[0] - speeds[1]).abs();
            self.speeds += 1;
        }
        if let Some((name, last_s)) = self.names.insert(mover.id, (track.id, now_s)) {
            let gap_s = now_s - last_s;
            if (HIDDEN_S.0..=HIDDEN_S.1 + 0.05).contains(&gap_s) {
                self.hidden += 1;
                self.recognised += usize::from(name == track.id);
            }
        }
    }
}

/// A drive among six people.
fn drive(seed: u64) -> TrackFigures {
    let settings = Settings { seed, walkers: 6, duration_s: 150.0, ..Settings::default() };
    let mut simulation = Simulation::new(&settings, World::floor_plan()).unwrap();
    let (mut robot, mut figures, mut scan) = (Robot::new(), TrackFigures::default(), ScanBuffer::default());
    while let Some(truth) = simulation.next_scan(&mut scan) {
        let view = scan.view().unwrap();
        let tracks = robot.step(view, truth, simulation.twist());
        let movers: Vec<MoverTruth> = simulation.movers().collect();
        figures.take(scan.header.times.sensor_ns as f64 * 1e-9, &tracks, &movers);
    }
    figures
}

impl TrackFigures {
    /// Figures of drives with these seeds together.
    pub fn of_drives(seeds: impl IntoIterator<Item = u64>) -> Self {
        seeds.into_iter().map(drive).fold(Self::default(), |mut all, one| {
            all.squared_m2 += one.squared_m2;
            all.positions += one.positions;
            all.speed_errors_m_s += one.speed_errors_m_s;
            all.speeds += one.speeds;
            all.hidden += one.hidden;
            all.recognised += one.recognised;
            all.false_tracks += one.false_tracks;
            all
        })
    }

    /// Root mean square error of the middle of a body, metres.
    pub fn rmse_m(&self) -> f64 {
        (self.squared_m2 / self.positions.max(1) as f64).sqrt()
    }

    /// Mean error of the speed after a second of view, m/s.
    pub fn speed_error_m_s(&self) -> f64 {
        self.speed_errors_m_s / self.speeds.max(1) as f64
    }
}
