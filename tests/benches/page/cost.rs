//! Section `cost`: scans a second, processor time, memory and latency of whole runs, in all and by stage.

use super::machine::copy_line;
use super::runs::{Measured, Subject, set};
use super::{Bench, Table, figure};
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, BufWriter, Write as _};
use std::path::Path;
use std::rc::Rc;

/// Runs of which the median counts.
const REPETITIONS: usize = 3;
/// What of a log is replayed live, seconds of its time, and how much faster than it was recorded.
const LIVE_S: f64 = 500.0;
const LIVE_RATE: f64 = 10.0;

/// Speed, processor time, memory and latency.
pub fn section(bench: &mut Bench) -> String {
    let mut text = format!(
        "Whole runs through six processes, loops closed, all outputs written; the median of {} runs by wall time. Beside them: {}. CPU is the processor time of the whole \
         set with its supervisor, from the start of each process to its end. Memory is the peak of the whole set with each page counted once: the private memory of \
         every process at its own peak while the stages run (heap, stacks, changed pages), shared memory and the set's files in `/dev/shm` at their peak, and once the executable with its \
         libraries. Asked on Intel: under 4 s on two cores, at most 0.4 ms of CPU a scan, memory under 100 MB.\n\n",
        repetitions(bench),
        copy_line()
    );
    let mut table = Table::new([
        "",
        "filter",
        "scans",
        "wall s",
        "scans/s",
        "CPU per scan ms",
        "dropped",
        "memory MB",
        "of it shared MB",
    ]);
    let mut closely = None;
    for subject in bench.subjects() {
        for (filter, options) in [("off", Vec::new()), ("on", set(&["correlation_filter.mode=correlation"]))]
        {
            match median_run(bench, &subject, &options) {
                Ok(run) => {
                    row(&mut table, &subject.name, filter, &run);
                    closely.get_or_insert((subject.name.clone(), run));
                }
                Err(reason) => table.row([&subject.name, filter, &format!("failed: {reason}")]),
            }
        }
    }
    let _ = writeln!(text, "{table}");
    if let Some((name, run)) = &closely {
        let _ = writeln!(
            text,
            "Stage by stage, {name}, filter off. Latency is the time in the stage's own logic for one scan:\n\n{}",
            stages(run)
        );
    }
    text + &live(bench)
}

fn repetitions(bench: &Bench) -> usize {
    if bench.plan.patient { REPETITIONS } else { 1 }
}

/// The run with the median wall time. The plain run is taken from the other sections when one is enough.
pub fn median_run(bench: &mut Bench, subject: &Subject, options: &[String]) -> Result<Rc<Measured>, String> {
    if repetitions(bench) == 1 {
        return bench.runs.of(subject, options);
    }
    let mut runs =
        (0..REPETITIONS).map(|_| bench.runs.again(subject, options)).collect::<Result<Vec<_>, _>>()?;
    runs.sort_by(|a, b| a.report.wall_s.total_cmp(&b.report.wall_s));
    Ok(runs.swap_remove(REPETITIONS / 2))
}

fn row(table: &mut Table, subject: &str, filter: &str, run: &Measured) {
    let report = &run.report;
    let dropped: u64 = report.dropped.values().sum();
    table.row([
        subject.to_owned(),
        filter.to_owned(),
        report.scans.to_string(),
        figure(report.wall_s, 2),
        figure(report.scans_per_s, 0),
        figure(run.cpu_ms_per_scan(), 3),
        format!("{:.0} %", 100.0 * dropped as f64 / report.scans.max(1) as f64),
        figure(megabytes(report.memory_bytes), 1),
        figure(megabytes(report.shared_memory_bytes), 1),
    ]);
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 * 1e-6
}

fn stages(run: &Measured) -> Table {
    let report = &run.report;
    let mut table =
        Table::new(["stage", "CPU per scan ms", "p50 µs", "p99 µs", "max µs", "private memory MB"]);
    let per_scan = |cpu_s: f64| figure(cpu_s * 1e3 / report.scans.max(1) as f64, 3);
    for (name, stage) in &report.stages {
        let latency = &stage.latency_us;
        table.row([
            name.clone(),
            per_scan(stage.cpu_s),
            figure(latency.p50, 1),
            figure(latency.p99, 1),
            figure(latency.max, 0),
            figure(megabytes(stage.peak_private_bytes), 1),
        ]);
    }
    let supervisor = &report.supervisor;
    let private = figure(megabytes(supervisor.peak_private_bytes), 1);
    table.row([
        "supervisor, and all outputs".to_owned(),
        per_scan(supervisor.cpu_s),
        "–".into(),
        "–".into(),
        "–".into(),
        private,
    ]);
    let none = || "–".to_owned();
    table.row([
        "shared memory".to_owned(),
        none(),
        none(),
        none(),
        none(),
        figure(megabytes(report.shared_memory_bytes), 1),
    ]);
    table.row([
        "executable and libraries".to_owned(),
        none(),
        none(),
        none(),
        none(),
        figure(megabytes(report.file_bytes), 1),
    ]);
    table.row([
        "**all**".to_owned(),
        per_scan(report.cpu_s),
        none(),
        none(),
        none(),
        figure(megabytes(report.memory_bytes), 1),
    ]);
    table
}

/// Latency from the reading of a scan to its published pose, at ten times the log's pace.
fn live(bench: &mut Bench) -> String {
    let subject = bench.main_subject();
    let rate = ["--rate".to_owned(), format!("{LIVE_RATE}")];
    let scratch = match tempfile::tempdir() {
        Ok(directory) => directory,
        Err(error) => return format!("Live latency could not be measured: {error}.\n"),
    };
    let seconds = if bench.plan.patient { LIVE_S } else { 0.2 * LIVE_S };
    let (shortened, what) = match &subject.log {
        Some((log, relations)) => {
            let part = scratch.path().join("part.clf");
            if let Err(error) = first_seconds(log, &part, seconds) {
                return format!("Live latency could not be measured: {error}.\n");
            }
            let what = format!("the first {seconds:.0} s of {}", subject.name);
            (Subject { log: Some((part, relations.clone())), ..subject }, what)
        }
        None => (subject.clone(), subject.name.clone()),
    };
    let run = match bench.runs.of(&shortened, &rate) {
        Ok(run) => run,
        Err(reason) => return format!("Live latency could not be measured: {reason}.\n"),
    };
    let (latency, report) = (run.report.scan_to_pose_us, &run.report);
    let mut table = Table::new(["scan → pose", "p50 µs", "p99 µs", "max µs"]);
    table.row([
        "measured".to_owned(),
        figure(latency.p50, 0),
        figure(latency.p99, 0),
        figure(latency.max, 0),
    ]);
    table.row(["asked", "< 200", "< 1000", ""]);
    format!(
        "Live, {what} at ten times its pace (`--rate {LIVE_RATE}`): from the moment when a scan has been read to its published pose, {} scans, {} of them dropped, \
         {} loop closures searched meanwhile. The source knows when the next scan is due and announces it 0.4 ms before, as a sensor's first bytes would:\n\n{table}",
        report.scans,
        report.dropped.values().sum::<u64>(),
        report.loop_closures.tried
    )
}

/// Copies the lines of a CARMEN log whose stamps lie in its first seconds.
fn first_seconds(log: &Path, part: &Path, seconds: f64) -> std::io::Result<()> {
    let input = BufReader::new(std::fs::File::open(log)?);
    let mut output = BufWriter::new(std::fs::File::create(part)?);
    let mut first_s = None;
    for line in input.split(b'\n') {
        let line = line?;
        let text = String::from_utf8_lossy(&line);
        let is_scan = text.starts_with("FLASER ") || text.starts_with("ROBOTLASER1 ");
        // The logger's stamp is the last field but for the host before it; both clocks run alike.
        let stamp_s = text.split_ascii_whitespace().rev().nth(2).and_then(|field| field.parse::<f64>().ok());
        if let (true, Some(stamp_s)) = (is_scan, stamp_s)
            && stamp_s > *first_s.get_or_insert(stamp_s) + seconds
        {
            break;
        }
        output.write_all(&line)?;
        output.write_all(b"\n")?;
    }
    output.flush()
}
