//! One run of a process set, from its start to its outputs.

use super::CommandError;
use super::accounting::{SharedMemoryPeak, sum_up};
use super::progress_bar::RunProgress;
use super::run_services::RunServices;
use super::{lidar_calibration, localisation_map};
use crate::arguments::RunArgs;
use crate::configuration::Configuration;
use crate::outputs::{
    CalibrationRow, CellState, LatencyMicroseconds, LoopClosures, MapHasher, OccupancyImage, PictureTracks,
    Report, StageReport, TrajectoryPoint, write_map, write_picture, write_report, write_trajectory,
};
use crate::state_directory::spill_directory;
use crate::store::{MapHead, SavedMap};
use crate::supervisor::{MetricsService, ProcessSet, SetEvent, SetFile, Supervision};
use flockslam_bus::RuntimeDir;
use flockslam_lidar_ingest::process::{LidarSpec, Source};
use flockslam_messages::Stage;
use flockslam_results::flock_files;
use flockslam_results::{self as results, StampedPose, StoredMap, Summary};
use flockslam_results::{FlockStatus, LocalisationSummary, Unattached};
use flockslam_scan_matcher::process::LOST;
use flockslam_stage::{MemoryUse, Mode, read_reports};
use flockslam_telemetry::LatencyHistogram;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Subdirectories of what is not in the map begin with this; the number of the trajectory, from 1, follows.
const DETACHED: &str = "trajectory-";
/// A shorter way may be noise of the poses, metres.
const STEP_MIN_M: f64 = 0.05;

/// What is to be run.
pub struct Run {
    /// Where scans come from.
    pub source: Source,
    /// A map to simulate in.
    pub world: Option<PathBuf>,
    /// Scans in the source, when that is known.
    pub scans: Option<u64>,
    /// A saved map to begin with.
    pub continues: Option<SavedMap>,
}

/// What a run gave.
pub struct Outcome {
    /// The report, as written.
    pub report: Report,
    /// The final trajectory.
    pub last: Vec<TrajectoryPoint>,
    /// The trajectory as it was published at the time.
    pub online: Vec<TrajectoryPoint>,
    /// The exact trajectory, when the source knows it.
    pub truth: Option<Vec<StampedPose>>,
}

/// Runs a process set over a source and writes all outputs.
///
/// # Errors
/// When the source, the configuration or the output directory is not usable, or the set fails. Outputs of an earlier run are
/// then left as they were.
pub fn run(args: &RunArgs, run: Run) -> Result<Outcome, CommandError> {
    flockslam_telemetry::init_tracing("supervisor");
    let given = &args.configuration;
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
    prepare_directory(&args.out)?;
    let known_map = args.localize.as_deref().map(localisation_map::read).transpose()?;
    // A recorded source has no pace of its own; sensors have.
    let paced = args.live && !matches!(run.source, Source::Pipe | Source::Scans(_) | Source::Lidars(_));
    let rate = args.rate.or_else(|| paced.then_some(1.0));
    let mode = if rate.is_some() || args.live { Mode::Live } else { Mode::Exact };
    let interrupts = count_interrupts()?;
    let name = args.robot.clone().unwrap_or_else(|| format!("run-{}", std::process::id()));
    let started = Instant::now();
    let spill_dir = spill_directory(configuration.set.spill_dir.as_deref(), None);
    let runtime = RuntimeDir::create_spilling(&name, spill_dir.as_deref()).map_err(CommandError::user)?;
    let mut options = configuration.stage_options(mode);
    if let Some(map) = &run.continues {
        let head = MapHead::of_this_build(&name, configuration.mapper.cell_size_m);
        options.first_sequence = map.restore(&runtime, &head).map_err(CommandError::user)?.next_sequence;
    }
    if let Some(map) = &known_map {
        localisation_map::put(map, &runtime)?;
        options.localizes = true;
    }
    let file = SetFile {
        version: crate::VERSION.to_owned(),
        options,
        source: run.source.clone(),
        rate,
        world: run.world,
        configuration: configuration.clone(),
    };
    flockslam_telemetry::log_into_set(runtime.path());
    let mut set = ProcessSet::start(runtime, file, Supervision::of_one_run())?;
    let _metrics = MetricsService::start(&set, args.metrics_port).map_err(CommandError::user)?;
    let mut services = if args.live { RunServices::start(&set)? } else { RunServices::default() };
    let mut shared_memory = SharedMemoryPeak::default();
    watch(&mut set, run.scans, &interrupts, &mut services, &mut shared_memory)?;
    drop(services);
    shared_memory.look(set.runtime());
    let own_memory = MemoryUse::of_this_process();
    set.stop();
    let shared_memory_bytes = shared_memory.bytes();
    let source = describe(&run.source);
    let finished = Finished { set: &set, started, shared_memory_bytes, own_memory, source, configuration };
    write_outputs(&args.out, &finished)
}

fn watch(
    set: &mut ProcessSet,
    scans: Option<u64>,
    interrupts: &AtomicUsize,
    services: &mut RunServices,
    shared_memory: &mut SharedMemoryPeak,
) -> Result<(), CommandError> {
    let progress = RunProgress::new(scans);
    let (mut done, mut advanced) = (0, Instant::now());
    loop {
        // A set that is idle is looked at less often.
        let limit_ms = if advanced.elapsed() < Duration::from_secs(1) { 20 } else { 200 };
        let event = set.watch(Duration::from_millis(limit_ms));
        services.look_after(set);
        shared_memory.look_sometimes(set.runtime());
        match event {
            Ok(SetEvent::Finished) => break,
            Ok(SetEvent::Progress(scans)) if scans > done => {
                (done, advanced) = (scans, Instant::now());
                progress.at(scans);
            }
            Ok(SetEvent::Progress(_) | SetEvent::Quiet) => {}
            Err(error) => {
                progress.finish();
                // Whoever stops the whole process group stops the stages too.
                let interrupted = interrupts.load(Ordering::Relaxed) > 0;
                return Err(if interrupted { CommandError::failed("interrupted") } else { error.into() });
            }
        }
        match interrupts.load(Ordering::Relaxed) {
            0 => {}
            // The first asks for what there is so far, the second for nothing.
            // Again and again, since a source that is restarted meanwhile has not received it.
            1 => set.end_stream()?,
            _ => {
                progress.finish();
                return Err(CommandError::failed("interrupted"));
            }
        }
    }
    progress.finish();
    Ok(())
}

/// Counts SIGINT and SIGTERM from now on.
pub(super) fn count_interrupts() -> Result<Arc<AtomicUsize>, CommandError> {
    let count = Arc::new(AtomicUsize::new(0));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        let counter = Arc::clone(&count);
        let action = move || {
            counter.fetch_add(1, Ordering::Relaxed);
        };
        // SAFETY: adding to an atomic is all that the handler does.
        unsafe { signal_hook::low_level::register(signal, action) }.map_err(CommandError::failed)?;
    }
    Ok(count)
}

/// Makes the directory, and finds out now, not after the run, whether it can be written.
pub(super) fn prepare_directory(directory: &Path) -> Result<(), CommandError> {
    let wrong = |error: std::io::Error| CommandError::user(format!("{}: {error}", directory.display()));
    std::fs::create_dir_all(directory).map_err(wrong)?;
    let probe = directory.join(format!(".flockslam-{}", std::process::id()));
    std::fs::write(&probe, b"").map_err(wrong)?;
    std::fs::remove_file(&probe).map_err(wrong)
}

fn describe(source: &Source) -> String {
    match source {
        Source::Log(path) => path.display().to_string(),
        Source::Pipe => "standard input".to_owned(),
        Source::Scans(None) => "local socket".to_owned(),
        Source::Scans(Some(path)) => path.display().to_string(),
        Source::Lidars(lidars) => lidars.iter().map(LidarSpec::to_string).collect::<Vec<_>>().join(", "),
        Source::Simulation => "simulated building".to_owned(),
        Source::Nothing => "nothing".to_owned(),
    }
}

/// A run whose results are stored.
pub(super) struct Finished<'a> {
    /// The set, its stages stopped.
    pub set: &'a ProcessSet,
    /// When the run began.
    pub started: Instant,
    /// Peak of its shared memory, bytes.
    pub shared_memory_bytes: u64,
    /// What the supervisor itself takes.
    pub own_memory: MemoryUse,
    /// Where scans came from, for people.
    pub source: String,
    /// What was in force.
    pub configuration: Configuration,
}

/// Writes what the set found out into a directory.
pub(super) fn write_outputs(out: &Path, run: &Finished<'_>) -> Result<Outcome, CommandError> {
    let directory = run.set.runtime().results();
    let read = |name| -> Result<Vec<TrajectoryPoint>, CommandError> {
        let rows = results::read_trajectory(&directory, name).map_err(CommandError::failed)?;
        Ok(rows.into_iter().map(point).collect())
    };
    let last = read(results::FINAL_TRAJECTORY)?;
    let online = read(results::ONLINE_TRAJECTORY)?;
    let summary = results::read_summary(&directory).map_err(CommandError::failed)?;
    let (map, map_hash) = read_map(&directory).map_err(CommandError::failed)?;
    let write = || {
        write_trajectory(&out.join("trajectory.tum"), &last)?;
        write_trajectory(&out.join("trajectory_online.tum"), &online)?;
        write_map(out, &map)?;
        write_picture(&out.join("map.png"), &map, PictureTracks { main: &last, other: &[] })
    };
    write().map_err(CommandError::failed)?;
    remove_detached(out);
    for part in &summary.detached {
        part.directory.iter().try_for_each(|name| write_detached(&directory, out, name))?;
    }
    let report = report(run, &summary, &map, &last, map_hash)?;
    write_report(&out.join("report.json"), &report).map_err(CommandError::failed)?;
    let truth = results::read_trajectory(&directory, results::TRUE_TRAJECTORY).ok();
    if !run.configuration.sync_manager.flock.name.is_empty() {
        flock_files::keep(&directory, out).map_err(CommandError::failed)?;
        if let Some(status) = FlockStatus::read(&run.set.runtime().status()) {
            status.write(out).map_err(CommandError::failed)?;
        }
    }
    Ok(Outcome { report, last, online, truth })
}

/// Removes what an earlier run left of trajectories that were not in its map.
fn remove_detached(out: &Path) {
    for entry in std::fs::read_dir(out).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let number = name.to_str().and_then(|name| name.strip_prefix(DETACHED));
        if number.is_some_and(|number| number.parse::<u32>().is_ok())
            && entry.path().join("map.yaml").exists()
        {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

/// Writes the map and the trajectory of what is not in the map into a subdirectory of the outputs.
fn write_detached(results_dir: &Path, out: &Path, name: &str) -> Result<(), CommandError> {
    let (from, to) = (results_dir.join(name), out.join(name));
    let rows = results::read_trajectory(&from, results::FINAL_TRAJECTORY).map_err(CommandError::failed)?;
    let (last, (map, _)) = (points(&rows), read_map(&from).map_err(CommandError::failed)?);
    prepare_directory(&to)?;
    let write = || {
        write_trajectory(&to.join("trajectory.tum"), &last)?;
        write_map(&to, &map)?;
        write_picture(&to.join("map.png"), &map, PictureTracks { main: &last, other: &[] })
    };
    write().map_err(CommandError::failed)
}

/// A stored trajectory as the outputs take it.
pub fn points(rows: &[StampedPose]) -> Vec<TrajectoryPoint> {
    rows.iter().copied().map(point).collect()
}

fn point(row: StampedPose) -> TrajectoryPoint {
    TrajectoryPoint { stamp_ns: row.stamp_ns, map_from_base: row.pose }
}

/// The stored map as navigation reads it, and its hash. The evidence takes more memory than the picture made of it, so it is read row by row.
fn read_map(directory: &Path) -> Result<(OccupancyImage, String), results::ResultsError> {
    let reader = results::MapReader::open(directory)?;
    let shape = reader.shape();
    let mut image = OccupancyImage::of_width(shape.width, shape.cell_size_m, shape.origin);
    let mut hasher = MapHasher::new(&shape);
    reader.for_each_row(|row| {
        hasher.push_row(row);
        image.push_row(row.iter().map(CellState::of));
    })?;
    Ok((image.or_one_cell(), hasher.finish()))
}

/// The map as navigation reads it.
pub(super) fn occupancy(map: &StoredMap) -> OccupancyImage {
    let mut image = OccupancyImage::of_width(map.width, map.cell_size_m, map.origin);
    map.for_each_row(|row| image.push_row(row.iter().map(CellState::of)));
    image.or_one_cell()
}

fn report(
    run: &Finished<'_>,
    summary: &Summary,
    map: &OccupancyImage,
    trajectory: &[TrajectoryPoint],
    map_hash: String,
) -> Result<Report, CommandError> {
    let status = run.set.runtime().status();
    let ingest = read_reports(&status, Stage::LidarIngest.name());
    let rejected = ingest.iter().flat_map(|report| &report.counters);
    let rejected = rejected.filter_map(|(name, n)| Some((name.strip_prefix("rejected/")?.to_owned(), *n)));
    let matcher = read_reports(&status, Stage::ScanMatcher.name());
    let mut scan_to_pose = LatencyHistogram::default();
    matcher.iter().for_each(|report| scan_to_pose.merge(report.since_capture()));
    // Scans that never reached the matcher have no pose: only its gaps tell of them.
    let lost = matcher.iter().filter_map(|report| report.dropped.get(LOST)).sum::<u64>();
    let mut dropped = summary.dropped.clone();
    if lost > 0 {
        dropped.insert(LOST.to_owned(), lost);
    }
    let scans = summary.scans + lost;
    let filter = read_reports(&status, Stage::CorrelationFilter.name());
    let mut kept_by_reason = BTreeMap::new();
    for (name, count) in filter.iter().flat_map(|report| &report.counters) {
        if let Some(reason) = name.strip_prefix("kept/") {
            *kept_by_reason.entry(reason.to_owned()).or_default() += count;
        }
    }
    let share = |count: u64| count as f64 / scans.max(1) as f64;
    let wall_s = run.started.elapsed().as_secs_f64();
    let mut report = Report {
        version: crate::VERSION.to_owned(),
        source: run.source.clone(),
        configuration: serde_json::to_value(&run.configuration).map_err(CommandError::failed)?,
        scans,
        kept: summary.scans - summary.dropped.values().sum::<u64>(),
        dropped_share: dropped.iter().map(|(reason, count)| (reason.clone(), share(*count))).collect(),
        dropped,
        kept_by_reason,
        overridden: summary.overridden,
        rejected: rejected.collect(),
        wall_s,
        scans_per_s: scans as f64 / wall_s,
        scan_to_pose_us: microseconds(&scan_to_pose),
        stages: run
            .set
            .stages()
            .map(|(stage, pids, restarts)| stage_report(&status, stage, &pids, restarts))
            .collect(),
        shared_memory_bytes: run.shared_memory_bytes,
        map_hash,
        submaps: summary.submaps,
        submaps_retired: summary.submaps_retired,
        submap_bytes: summary.submap_bytes,
        submap_bytes_per_m2: summary.submap_bytes as f64 / summary.submap_area_m2.max(1.0),
        trajectories: summary.trajectories,
        detached_scans: summary.detached_scans,
        detached: summary.detached.clone(),
        mode: if summary.localizes { "localize" } else { "map" }.to_owned(),
        scans_apart: summary.scans_apart,
        localisation: summary.localisation,
        loop_closures: LoopClosures {
            tried: summary.closures_tried,
            accepted: summary.closures_accepted,
            revoked: summary.closures_revoked,
        },
        map_area_m2: map.known_area_m2(),
        trajectory_length_m: way_m(trajectory),
        ..Report::default()
    };
    let (journal, first) = (run.set.runtime().journal(), run.set.first_sequence());
    report.calibration =
        lidar_calibration::of_journal(&journal, first, &run.configuration).map_err(CommandError::failed)?;
    let all = Stage::ALL.into_iter().flat_map(|stage| read_reports(&status, stage.name()));
    sum_up(&mut report, run.own_memory, all.map(|process| process.file_bytes).max().unwrap_or(0));
    Ok(report)
}

fn stage_report(status: &Path, stage: Stage, pids: &[u32], restarts: u64) -> (String, StageReport) {
    let reports = read_reports(status, stage.name());
    let mut latency = LatencyHistogram::default();
    reports.iter().for_each(|report| latency.merge(report.latency()));
    let report = StageReport {
        pids: pids.to_vec(),
        restarts,
        cpu_s: reports.iter().map(|report| report.cpu_s).sum(),
        peak_rss_bytes: reports.iter().map(|report| report.peak_rss_bytes).max().unwrap_or(0),
        peak_private_bytes: reports.iter().map(|report| report.peak_private_bytes).max().unwrap_or(0),
        latency_us: microseconds(&latency),
    };
    (stage.name().to_owned(), report)
}

fn microseconds(histogram: &LatencyHistogram) -> LatencyMicroseconds {
    let us = |ns: u64| ns as f64 * 1e-3;
    LatencyMicroseconds {
        p50: us(histogram.quantile_ns(0.5)),
        p99: us(histogram.quantile_ns(0.99)),
        max: us(histogram.max_ns()),
    }
}

/// Length of the way, metres, in steps that are no trembling of the poses: a robot that stands drives nowhere.
fn way_m(trajectory: &[TrajectoryPoint]) -> f64 {
    let (mut way_m, mut last) = (0.0, trajectory.first().map(|point| point.map_from_base));
    for pose in trajectory.iter().map(|point| point.map_from_base) {
        let step_m = last.map_or(0.0, |last| last.distance_m(pose));
        if step_m >= STEP_MIN_M {
            (way_m, last) = (way_m + step_m, Some(pose));
        }
    }
    way_m
}

/// What is not in the map, for people: a line, or nothing.
fn not_attached(report: &Report) -> String {
    if let Some(localisation) = report.localisation {
        return localized(&localisation);
    }
    if report.detached.is_empty() {
        return String::new();
    }
    let travel_m: f64 = report.detached.iter().map(|part| part.travel_m).sum();
    let since_s = report.detached.iter().map(|part| part.from_s).fold(f64::INFINITY, f64::min);
    let own: Vec<&str> = report.detached.iter().filter_map(|part| part.directory.as_deref()).collect();
    let own = if own.is_empty() { String::new() } else { format!(": they are in {}", own.join(", ")) };
    let unattached = Unattached { scans: report.detached_scans, travel_m, since_s };
    format!("{unattached}{own}\n")
}

/// How the robot was found in a known map, for people.
fn localized(found: &LocalisationSummary) -> String {
    let all = found.localized_scans + found.unlocalized_scans;
    match found.found_after_m {
        None => format!("NOT FOUND in the known map: {} searches of {all} scans\n", found.searches),
        Some(after_m) => format!(
            "found in the known map after {after_m:.1} m; {} of {all} scans localized, found {} times by {} searches\n",
            found.localized_scans, found.found, found.searches
        ),
    }
}

/// What a run gave, for people.
pub fn summary(out: &Path, report: &Report) -> String {
    let dropped: u64 = report.dropped.values().sum();
    let share = 100.0 * dropped as f64 / report.scans.max(1) as f64;
    let closures = report.loop_closures.accepted.saturating_sub(report.loop_closures.revoked);
    let rejected: BTreeMap<_, _> = report.rejected.iter().filter(|(_, count)| **count > 0).collect();
    let bad = if rejected.is_empty() { String::new() } else { format!("bad lines skipped: {rejected:?}\n") };
    format!(
        "{} scans in {:.1} s ({:.0} scans/s), {share:.0} % dropped by the filter\n\
         {:.0} m driven, {:.0} m² mapped, {} submaps, {closures} loop closures\n\
         {}{}{bad}map {}\n\
         wrote trajectory.tum, trajectory_online.tum, map.pgm, map.yaml, map.png, report.json to {}\n",
        report.scans,
        report.wall_s,
        report.scans_per_s,
        report.trajectory_length_m,
        report.map_area_m2,
        report.submaps,
        not_attached(report),
        report.calibration.iter().map(CalibrationRow::line).collect::<String>(),
        report.map_hash,
        out.display()
    )
}
