//! Section `long-run`: a simulated drive of several hours, watched from outside for processor time and memory that grow.

use super::Table;
use super::runs::set;
use flockslam::outputs::Report;
use flockslam_messages::Stage;
use flockslam_stage::read_reports;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Length of the run, hours of simulated time.
const HOURS: u64 = 8;
/// Shorter drives whose ends are compared with its end, hours: after four the building is known, and its submaps have been replaced often.
const SHORTER_HOURS: [u64; 2] = [1, 4];
const SCANS_PER_HOUR: u64 = 36_000;
/// What the trajectories may keep of each scan.
const TRAJECTORY_BYTES: u64 = 32;

/// What the set had used when so many scans had been handled.
#[derive(Clone, Copy, Default)]
struct Sample {
    scans: u64,
    cpu_s: f64,
    private_bytes: u64,
    shared_bytes: u64,
}

/// Eight hours in the same building: is anything growing?
pub fn section() -> String {
    let introduction = format!(
        "{HOURS} hours of driving through the same building (`flockslam demo --set simulation.duration_s={}`, otherwise default settings), at full speed, watched from outside every half second; then shorter drives. Asked: flat beyond {TRAJECTORY_BYTES} B a scan for trajectories.\n\n",
        HOURS * 3600
    );
    match watch(HOURS).and_then(|samples| Ok((growth(&samples)?, samples))) {
        Ok((growth, samples)) => format!("{introduction}{}\n{growth}", table(&samples)),
        Err(reason) => format!("{introduction}Not measured: {reason}.\n"),
    }
}

/// By how much more memory each drive has taken than the next shorter one, each with its final work and its outputs; `long` is the longest.
fn growth(long: &[Sample]) -> Result<String, String> {
    let mut text = String::from("Private and shared memory together, with the outputs written:");
    let mut before: Option<Sample> = None;
    for hours in SHORTER_HOURS.into_iter().chain([HOURS]) {
        let samples = if hours == HOURS { long.to_vec() } else { watch(hours)? };
        let end = samples.last().copied().unwrap_or_default();
        let bytes = |sample: Sample| (sample.private_bytes + sample.shared_bytes) as f64;
        text += &format!(" {:.1} MB by a drive of {hours} h", bytes(end) * 1e-6);
        if let Some(before) = before {
            let scans = end.scans.saturating_sub(before.scans).max(1) as f64;
            text += &format!(" ({:.1} B for each further scan)", (bytes(end) - bytes(before)) / scans);
        }
        text += if hours == HOURS { ".\n" } else { "," };
        before = Some(end);
    }
    Ok(text)
}

/// What the set had used at the end of an hour. Reports of stages are up to a second apart: the last hour ends where the last of them does.
fn until(samples: &[Sample], hour: u64) -> Sample {
    samples.iter().rfind(|sample| sample.scans <= hour * SCANS_PER_HOUR).copied().unwrap_or_default()
}

/// What was seen of a drive of so many hours, to its end.
fn watch(hours: u64) -> Result<Vec<Sample>, String> {
    let out = tempfile::tempdir().map_err(|error| error.to_string())?;
    let robot = format!("long-{}", std::process::id());
    let mut command = Command::new(env!("CARGO_BIN_EXE_flockslam"));
    command.args(["demo", "--robot", &robot, "--out"]).arg(out.path());
    command.args(set(&[&format!("simulation.duration_s={}", hours * 3600)]));
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().map_err(|error| error.to_string())?;
    let directory = Path::new("/dev/shm").join(format!("flockslam-{robot}"));
    let mut samples: Vec<Sample> = Vec::new();
    loop {
        std::thread::sleep(Duration::from_millis(500));
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            if !status.success() {
                return Err(format!("it ended with {status}"));
            }
            let text = std::fs::read(out.path().join("report.json")).map_err(|error| error.to_string())?;
            let report: Report = serde_json::from_slice(&text).map_err(|error| error.to_string())?;
            let peaks_bytes = report.stages.values().map(|stage| stage.peak_private_bytes).sum();
            samples.last_mut().ok_or("nothing was seen of it")?.private_bytes = peaks_bytes;
            return Ok(samples);
        }
        // At the end its memory is given back, and outputs are written.
        let is_whole = |sample: &Sample| {
            samples.last().is_none_or(|before: &Sample| sample.shared_bytes >= before.shared_bytes / 2)
        };
        let sample = look(&directory).filter(is_whole);
        samples.extend(sample);
    }
}

/// What the stages last wrote about themselves, at most a second old each; `None` before all have and once the set is cleared
/// away. Scans are those that have got through: sync-manager sees each.
fn look(directory: &Path) -> Option<Sample> {
    let mut sample = Sample::default();
    for stage in Stage::ALL {
        let reports = read_reports(&directory.join("status"), stage.name());
        sample.cpu_s += reports.iter().map(|report| report.cpu_s).sum::<f64>();
        sample.private_bytes += reports.iter().map(|report| report.peak_private_bytes).max()?;
        if stage == Stage::SyncManager {
            sample.scans = reports.iter().map(|report| report.handled).sum();
        }
    }
    sample.shared_bytes = flockslam_bus::RuntimeDir::open(directory).ok()?.occupied_bytes();
    Some(sample)
}

fn table(samples: &[Sample]) -> Table {
    let mut table = Table::new([
        "hour",
        "CPU per scan ms",
        "private memory of the stages, peaks so far MB",
        "shared memory MB",
    ]);
    let mut before = Sample::default();
    for hour in 1..=HOURS {
        let end = until(samples, hour);
        let scans = end.scans.saturating_sub(before.scans);
        let cpu_ms = (end.cpu_s - before.cpu_s) * 1e3 / scans.max(1) as f64;
        let megabytes = |bytes: u64| format!("{:.1}", bytes as f64 * 1e-6);
        table.row([
            hour.to_string(),
            format!("{cpu_ms:.3}"),
            megabytes(end.private_bytes),
            megabytes(end.shared_bytes),
        ]);
        before = end;
    }
    table
}
