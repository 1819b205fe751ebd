//! Processor time and private memory of the own process, as metrics.

use crate::names;
use crate::names::Metric;
use crate::registered::registered;
use prometheus::{Counter, IntGauge, Opts, Registry};
use std::fs;

/// Resources of the process: read only on request.
#[derive(Clone)]
pub(crate) struct ProcessUse {
    cpu: Counter,
    memory: IntGauge,
}

impl ProcessUse {
    pub(crate) fn new(registry: &Registry, opts: &impl Fn(Metric) -> Opts) -> Self {
        Self {
            cpu: registered(registry, Counter::with_opts(opts(names::CPU))),
            memory: registered(registry, IntGauge::with_opts(opts(names::PRIVATE_MEMORY))),
        }
    }

    pub(crate) fn look(&self) {
        self.cpu.inc_by((own_cpu_s() - self.cpu.get()).max(0.0));
        if let Some(bytes) = private_bytes(&fs::read_to_string("/proc/self/status").unwrap_or_default()) {
            self.memory.set(bytes);
        }
    }
}

fn own_cpu_s() -> f64 {
    let cpu = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    cpu.tv_sec as f64 + cpu.tv_nsec as f64 * 1e-9
}

/// Heap and stacks, by the kernel's count.
fn private_bytes(status: &str) -> Option<i64> {
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kilobytes: i64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_process_takes_is_seen() {
        assert_eq!(private_bytes("VmRSS:\t 9 kB\nRssAnon:\t   98 kB\n"), Some(98 << 10));
        let registry = Registry::new();
        let seen = ProcessUse::new(&registry, &|metric: Metric| Opts::new(metric.name, metric.help));
        seen.look();
        let before = seen.cpu.get();
        let sum: u64 = (0..std::hint::black_box(20_000_000_u64)).map(std::hint::black_box).sum();
        assert!(sum > 0 && seen.memory.get() > 0);
        seen.look();
        assert!(seen.cpu.get() > before);
    }
}
