//! What each process reports about itself: counters, latencies, memory; written while it runs and read at the end.

use crate::MemoryUse;
use flockslam_telemetry::LatencyHistogram;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What one process of a stage reported about itself.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct ProcessReport {
    /// Process id.
    pub pid: u32,
    /// Processor time used, seconds.
    pub cpu_s: f64,
    /// Greatest resident memory, bytes.
    pub peak_rss_bytes: u64,
    /// Greatest private memory, bytes: see [`MemoryUse`].
    pub peak_private_bytes: u64,
    /// Greatest size of mapped pages of the executable and its libraries, bytes.
    pub file_bytes: u64,
    /// Scans handled.
    pub handled: u64,
    /// Scans or messages dropped, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// Counters of the stage's own (rejected lines, rescue searches …).
    pub counters: BTreeMap<String, u64>,
    /// Address of the numbers of the last scan in this process, for tests of shared memory.
    #[cfg(debug_assertions)]
    pub scan_address: u64,
    /// Address of a tile in this process, for the same tests.
    #[cfg(debug_assertions)]
    pub tile_address: u64,
    #[serde(skip)]
    latency: LatencyHistogram,
    #[serde(skip)]
    since_capture: LatencyHistogram,
}

impl ProcessReport {
    /// Time in the stage's logic per scan.
    pub fn latency(&self) -> &LatencyHistogram {
        &self.latency
    }

    /// Time from the capture of a scan to the stage's output.
    pub fn since_capture(&self) -> &LatencyHistogram {
        &self.since_capture
    }
}

/// Keeps a stage's report and writes it about once a second, so that little is missing when the process is killed.
pub struct ReportWriter {
    path: PathBuf,
    written_ns: u64,
    /// Scans handled when it was written.
    written_handled: u64,
    memory: MemoryUse,
    /// The report so far.
    pub report: ProcessReport,
}

const PERIOD_NS: u64 = 1_000_000_000;

impl ReportWriter {
    /// The report of a stage's process of this name.
    pub fn new(status_dir: &Path, name: &str) -> Self {
        let pid = std::process::id();
        let report = ProcessReport {
            pid,
            cpu_s: 0.0,
            peak_rss_bytes: 0,
            peak_private_bytes: 0,
            file_bytes: 0,
            handled: 0,
            dropped: BTreeMap::new(),
            counters: BTreeMap::new(),
            #[cfg(debug_assertions)]
            scan_address: 0,
            #[cfg(debug_assertions)]
            tile_address: 0,
            latency: LatencyHistogram::default(),
            since_capture: LatencyHistogram::default(),
        };
        Self {
            path: status_dir.join(format!("{name}.{pid}.report")),
            written_ns: 0,
            written_handled: 0,
            memory: MemoryUse::default(),
            report,
        }
    }

    /// Records a handled scan.
    pub fn handled(&mut self, latency_ns: u64, since_capture_ns: u64) {
        self.report.handled += 1;
        self.report.latency.record(latency_ns);
        self.report.since_capture.record(since_capture_ns);
    }

    /// Counts a drop.
    pub fn dropped(&mut self, reason: &str) {
        match self.report.dropped.get_mut(reason) {
            Some(count) => *count += 1,
            None => drop(self.report.dropped.insert(reason.to_owned(), 1)),
        }
    }

    /// Sets a counter of the stage's own.
    pub fn count(&mut self, name: &str, value: u64) {
        self.report.counters.insert(name.to_owned(), value);
    }

    /// Writes the report when the last one is old enough. A moment without work is chosen for it (`idle`), unless there is none for
    /// seconds. An idle stage hardly ever writes.
    pub fn write_sometimes(&mut self, now_ns: u64, idle: bool) {
        let rests = self.report.handled == self.written_handled;
        let period_ns = match (idle, rests) {
            (true, true) => 20 * PERIOD_NS,
            (true, false) => PERIOD_NS,
            (false, _) => 5 * PERIOD_NS,
        };
        if now_ns.saturating_sub(self.written_ns) >= period_ns {
            self.written_ns = now_ns;
            self.written_handled = self.report.handled;
            self.write_with(MemoryUse::roughly_of_this_process());
        }
    }

    /// Writes the report, with the memory counted page by page. A failure is logged and has no other effect.
    pub fn write(&mut self) {
        self.write_with(MemoryUse::of_this_process());
    }

    fn write_with(&mut self, memory: MemoryUse) {
        self.memory = self.memory.max(memory);
        let report = &mut self.report;
        report.cpu_s = own_cpu_s();
        report.peak_rss_bytes = self.memory.peak_rss_bytes;
        report.peak_private_bytes = self.memory.private_bytes;
        report.file_bytes = self.memory.file_bytes;
        let written = serde_json::to_vec(&self.report).map_err(|e| e.to_string()).and_then(|json| {
            let parts: [&[u8]; 3] =
                [self.report.latency.as_bytes(), self.report.since_capture.as_bytes(), &json];
            let durability = flockslam_journal::Durability::Process;
            flockslam_journal::replace_file_by_parts(&self.path, &parts, durability)
                .map_err(|e| e.to_string())
        });
        if let Err(error) = written {
            tracing::warn!(%error, "no report");
        }
    }
}

/// All reports that processes of this stage left, oldest process first.
pub fn read_reports(status_dir: &Path, stage: &str) -> Vec<ProcessReport> {
    let Ok(entries) = fs::read_dir(status_dir) else { return Vec::new() };
    let mut files: Vec<_> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| is_report_of(path, stage))
        .collect();
    files.sort_by_key(|path| fs::metadata(path).and_then(|m| m.created()).ok());
    files.iter().filter_map(|path| decode(&fs::read(path).ok()?)).collect()
}

fn is_report_of(path: &Path, stage: &str) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    name.starts_with(&format!("{stage}-")) && name.ends_with(".report")
}

fn decode(bytes: &[u8]) -> Option<ProcessReport> {
    let size = LatencyHistogram::default().as_bytes().len();
    let (latency, rest) = bytes.split_at_checked(size)?;
    let (since_capture, json) = rest.split_at_checked(size)?;
    let mut report: ProcessReport = serde_json::from_slice(json).ok()?;
    report.latency = LatencyHistogram::from_bytes(latency)?;
    report.since_capture = LatencyHistogram::from_bytes(since_capture)?;
    Some(report)
}

/// Processor time of this process, seconds.
fn own_cpu_s() -> f64 {
    let cpu = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_round_trips_with_its_histograms() {
        let directory = tempfile::tempdir().unwrap();
        let mut writer = ReportWriter::new(directory.path(), "mapper-0");
        writer.handled(1_000, 50_000);
        writer.dropped("deadline");
        writer.dropped("deadline");
        writer.count("tiles", 7);
        writer.write();
        fs::write(directory.path().join("mapper-0.1.report"), b"torn").unwrap();
        let reports = read_reports(directory.path(), "mapper");
        assert_eq!(reports.len(), 1);
        assert_eq!(
            (reports[0].handled, reports[0].dropped["deadline"], reports[0].counters["tiles"]),
            (1, 2, 7)
        );
        assert!(reports[0].peak_rss_bytes >= reports[0].peak_private_bytes);
        assert!(reports[0].peak_private_bytes > 0 && reports[0].since_capture().max_ns() >= 49_000);
        assert!(read_reports(directory.path(), "scan-matcher").is_empty());
    }
}
