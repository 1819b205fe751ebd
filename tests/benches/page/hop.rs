//! Time from the publication of a scan to its arrival in another process, by number of beams.

use super::{SharedMemory, Table};
use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_messages::{ScanBuffer, Stage, Verdict};
use flockslam_telemetry::{LatencyHistogram, monotonic_ns};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const HOPS: u64 = 2000;
const BEAMS: [usize; 3] = [180, 1000, 8000];

/// The other process of the hop: answers each scan with the time that it took to get here.
pub fn echo(directory: &Path) {
    let runtime = RuntimeDir::open(directory).expect("the bench has made it");
    let bus = Bus::join(&runtime, "echo", Capacity::default()).expect("the bus is there");
    let scans = bus.scan_subscriber().expect("the topic is there");
    let answers = bus.publisher::<Verdict>().expect("the topic is there");
    let event = bus.listener(Stage::CorrelationFilter.name()).expect("the event is there");
    answers.send(&Verdict::default()).expect("the bench listens");
    loop {
        event.wait(Duration::from_secs(1)).expect("the event works");
        while let Some(sample) = scans.receive().expect("the topic works") {
            let coefficient = monotonic_ns().saturating_sub(sample.header().times.monotonic_ns) as f64;
            answers
                .send(&Verdict { id: sample.header().id, coefficient, ..Verdict::default() })
                .expect("it is received");
        }
    }
}

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// How long scans of several sizes take to another process that sleeps on its event.
pub fn table(shared: &SharedMemory) -> Table {
    let mut table = Table::new(["a scan of", "p50 µs", "p99 µs", "max µs"]);
    for beams in BEAMS {
        let histogram = hop(shared, beams);
        let us = |ns: u64| format!("{:.1}", ns as f64 * 1e-3);
        let (p50, p99) = (histogram.quantile_ns(0.5), histogram.quantile_ns(0.99));
        table.row([format!("{beams} beams"), us(p50), us(p99), us(histogram.max_ns())]);
    }
    table
}

fn hop(shared: &SharedMemory, beams: usize) -> LatencyHistogram {
    let bus = &shared.bus;
    let answers = bus.subscriber::<Verdict>().expect("the topic is there");
    let scans = bus.scan_publisher().expect("the topic is there");
    let event = bus.notifier(Stage::CorrelationFilter.name()).expect("the event is there");
    let this = std::env::current_exe().expect("a program knows itself");
    let mut command = Command::new(this);
    command.arg("--echo").arg(shared.runtime.path()).stdin(Stdio::null());
    let child = Killed(command.spawn().expect("it can start itself"));
    let mut scan = ScanBuffer::from_ranges(&vec![2.0; beams], 0.0, 0.01);
    let mut histogram = LatencyHistogram::default();
    let next = || loop {
        match answers.receive().expect("the topic works") {
            Some(answer) => return answer.coefficient,
            None => std::thread::sleep(Duration::from_micros(200)),
        }
    };
    next();
    for sequence in 0..HOPS {
        std::thread::sleep(Duration::from_micros(500));
        (scan.header.id.sequence, scan.header.times.monotonic_ns) = (sequence, monotonic_ns());
        scans.send(scan.view().expect("it is whole")).expect("memory is free");
        event.notify();
        histogram.record(next() as u64);
    }
    drop(child);
    bus.clean_dead_nodes();
    histogram
}
