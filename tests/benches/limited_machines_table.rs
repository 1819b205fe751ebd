//! `cargo bench -p flockslam --bench limited_machines -- [SECONDS [PROCESSORS MIB]]`: what a live set needs and gives up on machines with less processor and
//! memory, by limits of control groups.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use support::limited_machine::{Machine, office_on};

const DURATION_S: u32 = 120;
const MACHINES: [(f64, u64); 7] =
    [(2.0, 512), (1.0, 512), (1.0, 256), (0.25, 256), (0.1, 256), (0.05, 256), (0.02, 256)];

fn main() {
    let numbers: Vec<f64> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let duration_s = numbers.first().map_or(DURATION_S, |seconds| *seconds as u32);
    let machines = match numbers[..] {
        [_, processors, memory_mib] => vec![(processors, memory_mib as u64)],
        _ => MACHINES.to_vec(),
    };
    println!(
        "| processors | memory, MiB | most in use, MiB | processor time, % of one | held up, s | scan to pose p50 / p99, ms | dropped | restarts |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (processors, memory_mib) in machines {
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
