//! `cargo bench -p flockslam --bench limited_machines -- [SECONDS]`: what a live set needs and gives up on machines with less processor and
//! memory, by limits of control groups.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use support::limited_machine::{Machine, office_on};

const DURATION_S: u32 = 120;
const MACHINES: [(f64, u64); 7] =
    [(2.0, 512), (1.0, 512), (1.0, 256), (0.25, 256), (0.1, 256), (0.05, 256), (1.0, 64)];

fn main() {
    let duration_s = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(DURATION_S);
    println!(
        "| processors | memory, MiB | most in use, MiB | processor time, % of one | held up, s | scan to pose p50 / p99, ms | dropped | restarts |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (processors, memory_mib) in MACHINES {
        let directory = tempfile::tempdir().unwrap();
        let machine = Machine { processors, memory_mib };
        let Some(limited) = office_on(&machine, duration_s, directory.path()) else { return };
        let report = &limited.outputs.report;
        let latency = &report.scan_to_pose_us;
        println!(
            "| {processors} | {memory_mib} | {:.0} | {:.1} | {:.1} | {:.2} / {:.2} | {:?} | {} |",
            limited.peak_mib.unwrap_or_default(),
            100.0 * report.cpu_s / report.wall_s,
            limited.held_up.unwrap_or_default().as_secs_f64(),
            latency.p50 * 1e-3,
            latency.p99 * 1e-3,
            report.dropped,
            report.stages.values().map(|stage| stage.restarts).sum::<u64>(),
        );
    }
}
