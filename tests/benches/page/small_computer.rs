//! Section `small-computer`: what a Raspberry Pi 3B+ would reach, computed from a run on this machine and two factors.

use super::accuracy::plain;
use super::machine::copy_gb_per_s;
use super::{Bench, Table};

/// How much longer one core of the small computer is thought to take than one of a server: from, to.
const SLOWER: [f64; 2] = [5.0, 15.0];
/// Copying on it, GB/s.
const PI_COPY_GB_PER_S: f64 = 1.1;
/// Scans a second of a common lidar.
const LIDAR_HZ: f64 = 10.0;
/// What the published program reached there, scans a second.
const PUBLISHED_HZ: f64 = 24.0;

/// An estimate, not a measurement.
pub fn section(bench: &mut Bench) -> String {
    let subject = bench.main_subject();
    let run = match plain(bench, &subject) {
        Ok(run) => run,
        Err(reason) => return format!("Not estimated: {reason}."),
    };
    let (cpu_ms, copy) = (run.cpu_ms_per_scan(), copy_gb_per_s());
    let mut table = Table::new([
        "one core is slower by",
        "CPU per scan ms",
        "scans/s on one of its four cores",
        "share of one core at 10 scans/s",
    ]);
    for factor in SLOWER {
        let per_scan_ms = cpu_ms * factor;
        table.row([
            format!("{factor} ×"),
            format!("{per_scan_ms:.1}"),
            format!("{:.0}", 1e3 / per_scan_ms),
            format!("{:.1} %", per_scan_ms * LIDAR_HZ * 0.1),
        ]);
    }
    format!(
        "**An estimate: nothing here was run on a Raspberry Pi.** {}, filter off, takes {cpu_ms:.2} ms of processor time a scan on the machine above. A core of the 3B+ (Cortex-A53, 1.4 GHz) is \
         taken to be {} to {} times slower. Public figures for it (T. Kaiser, sbc-bench, six runs): 7-zip 3000 … 3700 MIPS on four cores, so about 0.85 kMIPS each, where a core of a current server has 4 … 5; \
         copying memory 1.04 … 1.23 GB/s, where this machine has {copy:.1}, a factor of {:.0}. An in-order core loses more on floating-point code than on 7-zip, hence the upper end. The published \
         program (vinySLAM) processes {PUBLISHED_HZ:.0} scans/s there. The stages share four cores, so the whole set can be faster than one core.\n\n{table}",
        subject.name,
        SLOWER[0],
        SLOWER[1],
        copy / PI_COPY_GB_PER_S,
    )
}
