//! Tests of the join, over the in-memory bus and under a virtual clock.

use super::*;
use crate::{Clock, StageOptions, StopFlag};
use flockslam_bus::{Bus, Publisher, RuntimeDir, ScanPublisher};
use flockslam_messages::{Control, ControlKind, Progress, ScanBuffer, ScanId, Stage, Verdict};

const DEADLINE_NS: u64 = 20;

/// A join of scans and verdicts, and the other ends of its topics.
struct Bench {
    join: Join<Verdict>,
    context: StageContext,
    scans: ScanPublisher,
    verdicts: Publisher<Verdict>,
    control: Publisher<Control>,
    progress: Subscriber<Progress>,
    _runtime: RuntimeDir,
}

fn id(sequence: u64) -> ScanId {
    ScanId { sequence, ..ScanId::default() }
}

impl Bench {
    fn new(name: &str, mode: Mode) -> Self {
        let runtime = RuntimeDir::create(&format!("{name}-{}", std::process::id())).unwrap();
        let options = StageOptions {
            mode,
            window: 64,
            replicas: 1,
            live_tiles: 16,
            first_sequence: 0,
            localizes: false,
        };
        let bus = Bus::in_memory();
        let join = bus.memory_joiner().unwrap();
        let stop = StopFlag::default();
        let mut context =
            StageContext::on_bus(Stage::ScanMatcher, 0, join(), &runtime, &options, stop).unwrap();
        context.clock = Clock::virtual_at(1_000);
        Self {
            join: Join::open(&context, DEADLINE_NS).unwrap(),
            context,
            scans: bus.scan_publisher().unwrap(),
            verdicts: bus.publisher().unwrap(),
            control: bus.publisher().unwrap(),
            progress: bus.subscriber().unwrap(),
            _runtime: runtime,
        }
    }

    fn send_scan(&mut self, sequence: u64) {
        let mut scan = ScanBuffer::from_ranges(&[1.0, 2.0, 3.0], 0.0, 0.1);
        scan.header.id = id(sequence);
        self.scans.send(scan.view().unwrap()).unwrap();
    }

    fn send_verdict(&mut self, sequence: u64) {
        self.verdicts.send(&Verdict { id: id(sequence), ..Verdict::default() }).unwrap();
    }

    fn wait_for_verdict(&mut self, sequence: u64) -> Waited<Verdict> {
        self.join.drain().unwrap();
        let found = self.join.messages.take(sequence);
        self.join.wait(found, self.context.now_ns())
    }
}

#[test]
fn a_message_is_joined_whether_it_comes_before_or_after_its_scan() {
    let mut bench = Bench::new("join-order", Mode::Live);
    bench.send_verdict(0);
    bench.send_scan(0);
    bench.send_scan(1);
    assert_eq!(bench.wait_for_verdict(0), Waited::For(Verdict { id: id(0), ..Verdict::default() }));
    assert_eq!(bench.join.scans.take(0).unwrap().header().id.sequence, 0);
    assert_eq!(bench.wait_for_verdict(1), Waited::NotYet);
    assert!(bench.join.waits());
    bench.send_verdict(1);
    assert!(matches!(bench.wait_for_verdict(1), Waited::For(_)));
    assert!(!bench.join.waits());
}

#[test]
fn live_a_wait_ends_with_its_deadline_and_exact_replay_waits_on() {
    for (name, mode, last) in
        [("join-live", Mode::Live, Waited::TooLong), ("join-exact", Mode::Exact, Waited::NotYet)]
    {
        let mut bench = Bench::new(name, mode);
        bench.send_scan(0);
        assert_eq!(bench.wait_for_verdict(0), Waited::NotYet);
        bench.context.clock.advance(DEADLINE_NS);
        assert_eq!(bench.wait_for_verdict(0), Waited::NotYet, "{mode:?}");
        bench.context.clock.advance(1);
        assert_eq!(bench.wait_for_verdict(0), last, "{mode:?}");
    }
}

#[test]
fn what_is_finished_is_released_and_acknowledged_and_comes_too_late_afterwards() {
    let mut bench = Bench::new("join-finished", Mode::Exact);
    (0..16).for_each(|sequence| bench.send_scan(sequence));
    bench.send_verdict(3);
    bench.join.drain().unwrap();
    bench.join.finished(16).unwrap();
    assert!(bench.join.scans.is_empty() && bench.join.messages.is_empty());
    assert_eq!(bench.progress.receive().unwrap().map(|progress| progress.done), Some(16));
    bench.send_verdict(4);
    assert_eq!(bench.wait_for_verdict(4), Waited::NotYet, "its scan is finished");
    // A process that is not active acknowledges nothing.
    bench.join.set_acknowledges(false);
    bench.join.finished(32).unwrap();
    assert!(bench.progress.receive().unwrap().is_none());
}

#[test]
fn a_gap_in_the_sequence_is_noticed_live_only() {
    for (name, mode) in [("join-gap", Mode::Live), ("join-no-gap", Mode::Exact)] {
        let mut bench = Bench::new(name, mode);
        bench.join.finished(5).unwrap();
        assert!(!bench.join.has_missed(5));
        assert_eq!(bench.join.has_missed(7), mode == Mode::Live);
    }
}

#[test]
fn a_stream_has_ended_when_its_last_scan_is_finished_or_live_is_not_waited_for_any_more() {
    for (name, mode) in [("join-end", Mode::Live), ("join-end-exact", Mode::Exact)] {
        let mut bench = Bench::new(name, mode);
        let end = Control { kind: ControlKind::StreamEnd as u32, run: 1, value: 10 };
        bench.control.send(&end).unwrap();
        assert!(!bench.join.has_ended().unwrap());
        bench.context.clock.advance(3_000_000_000);
        assert_eq!(bench.join.has_ended().unwrap(), mode == Mode::Live, "scan 9 is lost");
        bench.join.finished(10).unwrap();
        assert!(bench.join.has_ended().unwrap());
    }
}
