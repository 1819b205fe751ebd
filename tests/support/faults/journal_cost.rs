//! What the journal adds to the latency of a pose, measured in pairs of drives.

use crate::support::{Outputs, flockslam, live_building, robot};
use std::path::Path;

/// p50 and p99 from the capture of a scan to its pose, microseconds: of a drive with the journal, and of one without.
type Pair = [(f64, f64); 2];

/// What writing the journal costs a pose, by pairs of live drives at 40 Hz with and without it, one right after the other.
pub struct JournalCost {
    pairs: Vec<Pair>,
}

impl JournalCost {
    pub fn measure(pairs: usize) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let pair = |_| ["", "no-journal"].map(|failpoints| drive(directory.path(), failpoints));
        Self { pairs: (0..pairs).map(pair).collect() }
    }

    /// The medians over all drives of a kind.
    pub fn table(&self) -> String {
        let median = |pick: fn(&(f64, f64)) -> f64, kind: usize| {
            let mut all: Vec<f64> = self.pairs.iter().map(|pair| pick(&pair[kind])).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        let row = |name: &str, kind: usize| {
            let (p50, p99) = (median(|drive| drive.0, kind), median(|drive| drive.1, kind));
            format!("| {name} | {} | {p50:.0} | {p99:.0} |\n", self.pairs.len())
        };
        let head = "| live at 40 Hz | drives | scan to pose, median of p50, µs | median of p99, µs |\n|---|---|---|---|\n";
        head.to_owned() + &row("with the journal", 0) + &row("without", 1)
    }
}

fn drive(directory: &Path, failpoints: &str) -> (f64, f64) {
    let mut args = live_building(7, 1);
    args.extend(["--set".to_owned(), "simulation.scan_rate_hz=40".to_owned()]);
    let mut command = flockslam();
    command.args(args).args(["--robot", &robot("cost"), "--out"]).arg(directory);
    let output = command.env("FLOCKSLAM_FAILPOINTS", failpoints).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let latency = Outputs::read(directory).report.scan_to_pose_us;
    (latency.p50, latency.p99)
}
