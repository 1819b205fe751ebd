//! The profile `ndt` in one process.

use super::experiments::Experiment;
use flockslam_dynamic_cleaner::DynamicCleaner;
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::{Pose, wrap_angle};
use flockslam_mapper::Mapper;
use flockslam_messages::{Commit, ScanBuffer, Verdict};
use flockslam_scan_matcher::ScanMatcher;
use std::time::{Duration, Instant};

/// Settings of the three stages.
pub type NdtSettings =
    (flockslam_scan_matcher::Settings, flockslam_dynamic_cleaner::Settings, flockslam_mapper::Settings);

/// The profile's logic, stage by stage in one process.
pub struct NdtSystem {
    matcher: ScanMatcher,
    cleaner: DynamicCleaner,
    mapper: Mapper,
    grid: TileGrid<Box<Tile>>,
    /// Time in each of the three.
    times: [Duration; 3],
}

impl NdtSystem {
    /// The profile with nothing seen.
    pub fn new((matcher, cleaner, mapper): &NdtSettings) -> Self {
        Self {
            matcher: ScanMatcher::new(matcher.clone()),
            cleaner: DynamicCleaner::new(cleaner.clone()),
            grid: TileGrid::new(mapper.cell_size_m),
            mapper: Mapper::new(mapper.clone()),
            times: [Duration::ZERO; 3],
        }
    }

    /// Takes in a scan; gives its pose.
    pub fn step(&mut self, scan: &ScanBuffer) -> Pose {
        let (view, id) = (scan.view().unwrap(), scan.header.id);
        let starts = Instant::now();
        let pose = self.matcher.handle(view, &Verdict { id, keep: 1, ..Verdict::default() }, &self.grid);
        let matched = Instant::now();
        let marks = self.cleaner.handle(view, &pose, &self.grid);
        let cleaned = Instant::now();
        let insertion = self.mapper.insert(view, &pose, marks.cleared);
        let mapped = Instant::now();
        let generation = insertion.generation;
        let changed = insertion.changed.to_vec();
        for key in changed {
            let mut tile = self.grid.remove(key).unwrap_or_else(|| Tile::unknown(0));
            self.mapper.write_tile(key, &mut tile);
            self.grid.set(key, tile).unwrap();
        }
        self.matcher.committed(&Commit { id, generation, ..Commit::default() });
        let spent = [matched - starts, cleaned - matched, mapped - cleaned];
        self.times.iter_mut().zip(spent).for_each(|(time, spent)| *time += spent);
        pose.odom_from_base
    }
}

/// Milliseconds that the logic of the profile takes to match, clean and map a scan of an experiment; mean.
pub fn ndt_cost_ms(experiment: &Experiment, settings: &NdtSettings) -> [f64; 3] {
    let (mut times, rounds) = ([0.0; 3], 20);
    for _ in 0..rounds {
        let mut system = NdtSystem::new(settings);
        for scan in &experiment.scans {
            system.step(scan);
        }
        times.iter_mut().zip(system.times).for_each(|(sum, time)| *sum += time.as_secs_f64());
    }
    times.map(|seconds| 1e3 * seconds / f64::from(rounds) / experiment.scans.len() as f64)
}

/// How far off a move between two scans is.
#[derive(Clone, Copy, Debug, Default)]
pub struct MoveError {
    /// Its length, metres; the published table gives this and the turn.
    pub way_m: f64,
    /// Its turn, degrees.
    pub turn_deg: f64,
    /// Its end as the pose before sees it, metres: an error of that one's heading counts with the length of the move.
    pub end_m: f64,
}

impl MoveError {
    /// The worst of both, figure by figure.
    pub fn max(self, other: Self) -> Self {
        Self {
            way_m: self.way_m.max(other.way_m),
            turn_deg: self.turn_deg.max(other.turn_deg),
            end_m: self.end_m.max(other.end_m),
        }
    }
}

/// Each of the moves between scans as the profile finds it, against the true one.
pub fn ndt_errors(experiment: &Experiment, settings: &NdtSettings) -> Vec<MoveError> {
    let mut system = NdtSystem::new(settings);
    let poses: Vec<Pose> = experiment.scans.iter().map(|scan| system.step(scan)).collect();
    errors(&poses, &experiment.truth)
}

/// Each of the moves as it was found, against the true one.
pub fn errors(poses: &[Pose], truth: &[Pose]) -> Vec<MoveError> {
    let moves = |poses: &[Pose]| poses.windows(2).map(|pair| pair[0].to(pair[1])).collect::<Vec<_>>();
    let off = |(found, wanted): (Pose, Pose)| MoveError {
        way_m: (found.position().norm_m() - wanted.position().norm_m()).abs(),
        turn_deg: wrap_angle(found.heading_rad - wanted.heading_rad).abs().to_degrees(),
        end_m: found.distance_m(wanted),
    };
    moves(poses).into_iter().zip(moves(truth)).map(off).collect()
}
