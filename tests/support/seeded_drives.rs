//! Outcomes that depend on a seed: one drive with one seed, measured. `cargo bench -p flockslam --bench seeds` shows how they are spread
//! over many seeds; tests run some of them with limits from those.

use super::ndt_runs::ndt_settings;
use super::{MovingDrive, Outputs, RunningSet, building, moving_building};
use flockslam::evaluation::{Spread, evaluate_truth};
use flockslam_drives::experiments::flat_seeded;
use flockslam_drives::ndt_system::{MoveError, ndt_errors};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, Quality};
use flockslam_simulation::Settings;
use flockslam_stage::JournalReader;
use std::path::Path;
use std::time::Duration;

/// A motion over one second that is further off than this is wrong: metres and radians.
const WRONG: (f64, f64) = (0.15, 0.05);
/// Scans in a second.
const SECOND: usize = 10;
/// How long a robot drives through the yard, seconds.
const YARD_S: u32 = 520;

/// A drive through the yard, where most beams return nothing.
#[derive(Clone, Copy, Debug)]
pub struct YardDrive {
    /// Seconds (from each scan one) over which all poses were said to be tracked.
    pub claims: usize,
    /// Of those, seconds over which the motion was wrong.
    pub false_claims: usize,
    /// Share of the scans whose pose was said to be tracked.
    pub tracked: f64,
    /// Error of the final trajectory, root mean square, metres.
    pub ate_m: f64,
}

impl YardDrive {
    /// Drives with a seed.
    pub fn with_seed(seed: u64) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let mut args = building(YARD_S);
        args.extend(["--set".to_owned(), "simulation.world=yard".to_owned()]);
        args.extend(["--set".to_owned(), format!("simulation.seed={seed}")]);
        let (outputs, poses) = run_watched("yard", directory.path(), &args);
        let truth: Vec<Pose> =
            outputs.trajectory("truth.tum").iter().map(|point| point.map_from_base).collect();
        assert_eq!(poses.len(), truth.len(), "a pose for each scan");
        // Who predicts a pose claims no fit.
        let tracked = |pose: &PoseEstimate| pose.quality == Quality::Tracking as u32;
        let claims = (0..truth.len() - SECOND).filter(|from| {
            let second = &poses[*from..=from + SECOND];
            let matched = second[0].has(PoseFlags::MATCHED) && second[SECOND].has(PoseFlags::MATCHED);
            matched && second.iter().all(tracked)
        });
        let claims: Vec<usize> = claims.collect();
        let is_wrong = |from: usize| {
            let (second, moved) = (&poses[from..=from + SECOND], truth[from].to(truth[from + SECOND]));
            let estimated = second[0].odom_from_base.to(second[SECOND].odom_from_base);
            moved.distance_m(estimated) > WRONG.0 || moved.turn_rad(estimated) > WRONG.1
        };
        Self {
            false_claims: claims.iter().filter(|from| is_wrong(**from)).count(),
            claims: claims.len(),
            tracked: poses.iter().filter(|pose| tracked(pose)).count() as f64 / truth.len() as f64,
            ate_m: absolute_error_m(&outputs, "trajectory.tum").rmse,
        }
    }
}

/// One and a half kilometres over a campus, a scan of 180 beams a second: error of the final trajectory, root mean square, metres, and scans
/// that are not in the map.
pub fn campus_drive(seed: u64) -> (f64, u64) {
    let directory = tempfile::tempdir().unwrap();
    let mut args = building(5600);
    let keys = [
        "world=campus",
        "wheel_slips=0",
        "scan_rate_hz=1",
        "beams=180",
        "field_of_view_deg=180",
        "range_max_m=80",
    ];
    let seeds = [format!("seed={seed}"), format!("world_seed={seed}")];
    let keys = keys.into_iter().map(str::to_owned).chain(seeds);
    args.extend(keys.flat_map(|key| ["--set".to_owned(), format!("simulation.{key}")]));
    let outputs = super::run_well("campus", directory.path(), &args);
    (absolute_error_m(&outputs, "trajectory.tum").rmse, outputs.report.detached_scans)
}

/// Error of a trajectory against the truth.
pub fn absolute_error_m(outputs: &Outputs, name: &str) -> Spread {
    let report = evaluate_truth(&outputs.trajectory(name), &outputs.trajectory("truth.tum")).unwrap();
    report.absolute.translation_m.unwrap()
}

/// Runs a set and reads beside it, from the journal, every pose that it publishes.
pub fn run_watched(test: &str, out: &Path, args: &[String]) -> (Outputs, Vec<PoseEstimate>) {
    let set = RunningSet::start(test, out, args);
    let journal_dir = set.status_dir().with_file_name("spill").join("journal");
    let running = std::thread::spawn(|| set.finish());
    let (mut journal, mut poses) = (None, Vec::new());
    loop {
        // Asked before reading: what is written before the end is then read after it.
        let ended = running.is_finished();
        if journal.is_none() && journal_dir.join("scans.journal").metadata().is_ok_and(|file| file.len() > 0)
        {
            journal = Some(JournalReader::open(&journal_dir).unwrap());
        }
        while let Some(record) = journal.as_mut().and_then(|journal| journal.read_next().unwrap()) {
            poses.push(record.pose);
        }
        if ended {
            return (running.join().unwrap(), poses);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// ATE of a drive with a seed, metres, alone and among twenty people; in the office, or in a real building where its map is at hand.
pub fn alone_and_among_twenty_m(building: Option<&str>, seed: u64) -> Option<[f64; 2]> {
    let map = match building {
        Some(name) => Some(moving_building(name)?),
        None => None,
    };
    let drive = |walkers| {
        let settings = Settings { seed, walkers, ..Settings::default() };
        MovingDrive { map: map.clone(), settings }.run(&[]).error_m()
    };
    Some([drive(0), drive(20)])
}

/// The largest errors of the moves in the flat of the published NDT experiment, with noise from a seed.
pub fn flat_worst(bearing_sigma_rad: f64, seed: u64) -> MoveError {
    let moves = ndt_errors(&flat_seeded(bearing_sigma_rad, seed), &ndt_settings());
    moves.into_iter().fold(MoveError::default(), MoveError::max)
}
