//! What a set used of memory and processor, each page and each second counted once.

use crate::outputs::{ProcessUse, Report};
use flockslam_bus::RuntimeDir;
use flockslam_stage::MemoryUse;
use std::time::{Duration, Instant};

/// How often the set's directory is looked through for the peak of shared memory.
const PERIOD: Duration = Duration::from_millis(2000);
/// `/proc` counts processor time in these parts of a second on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Follows the shared memory of a running set.
#[derive(Debug, Default)]
pub struct SharedMemoryPeak {
    bytes: u64,
    looked: Option<Instant>,
}

impl SharedMemoryPeak {
    /// Looks, when the last look is some time ago.
    pub fn look_sometimes(&mut self, runtime: &RuntimeDir) {
        if self.looked.is_none_or(|looked| looked.elapsed() >= PERIOD) {
            self.look(runtime);
        }
    }

    /// Looks now.
    pub fn look(&mut self, runtime: &RuntimeDir) {
        self.bytes = self.bytes.max(runtime.occupied_bytes());
        self.looked = Some(Instant::now());
    }

    /// The most that was seen.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

/// Adds the supervisor and the sums over the set to a report that has the stages and the shared memory. `before` is what the supervisor
/// had when the stages were stopped, `largest_file_bytes` the most that a stage had mapped of the executable and its libraries. All stages
/// must have ended: only then the kernel tells what they used.
pub fn sum_up(report: &mut Report, before: MemoryUse, largest_file_bytes: u64) {
    let own = MemoryUse::of_this_process();
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let (own_cpu_s, children_cpu_s) = cpu_times_s(&stat).unwrap_or_default();
    report.supervisor = ProcessUse {
        cpu_s: own_cpu_s,
        peak_rss_bytes: own.peak_rss_bytes,
        peak_private_bytes: before.private_bytes,
        outputs_private_bytes: own.private_bytes,
    };
    report.cpu_s = own_cpu_s + children_cpu_s;
    report.file_bytes = largest_file_bytes.max(own.file_bytes);
    let stages: u64 = report.stages.values().map(|stage| stage.peak_private_bytes).sum();
    let private = (stages + before.private_bytes).max(own.private_bytes);
    report.memory_bytes = private + report.shared_memory_bytes + report.file_bytes;
}

/// Processor time of this process and of all its children that have ended, seconds, from `/proc/self/stat`.
fn cpu_times_s(stat: &str) -> Option<(f64, f64)> {
    // The name of the program may contain anything; what follows its last bracket are numbers, from field 3 on.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut times = fields.split_ascii_whitespace().skip(14 - 3).map_while(|field| field.parse::<f64>().ok());
    let mut pair_s = || Some((times.next()? + times.next()?) / TICKS_PER_S);
    Some((pair_s()?, pair_s()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::StageReport;

    #[test]
    fn times_are_found_whatever_the_program_is_called() {
        let stat = "17 (a ) b) S 1 17 17 0 -1 4194304 163 9 0 0 150 25 300 45 20 0 1 0 77 0 0";
        assert_eq!(cpu_times_s(stat), Some((1.75, 3.45)));
        assert_eq!(cpu_times_s("17 (short) S 1"), None);
        assert!(cpu_times_s(&std::fs::read_to_string("/proc/self/stat").unwrap()).is_some());
    }

    #[test]
    fn nothing_is_counted_twice() {
        let stage = StageReport { peak_private_bytes: 5 << 20, ..StageReport::default() };
        let stages = ["mapper", "scan-matcher"].map(|name| (name.to_owned(), stage.clone())).into();
        let mut report = Report { stages, shared_memory_bytes: 7 << 20, ..Report::default() };
        let before = MemoryUse { private_bytes: 3 << 20, ..MemoryUse::default() };
        sum_up(&mut report, before, 1 << 40);
        let outputs = report.supervisor.outputs_private_bytes;
        assert!(outputs > 0);
        assert_eq!(report.memory_bytes, outputs.max(13 << 20) + (7 << 20) + (1 << 40));
    }
}
