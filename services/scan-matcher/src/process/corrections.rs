//! Corrections of sync-manager, from their arrival until they take effect.

use flockslam_bus::Subscriber;
use flockslam_messages::Correction;
use flockslam_stage::{Mode, StageContext, StageError};
use std::collections::VecDeque;

/// In replay the correction after a scan takes effect so many scans later. Fewer are nearer to live operation, where it comes within
/// milliseconds; with one, matcher and sync-manager would take turns.
const TAKES_EFFECT_AFTER: u64 = 4;

/// Corrections in the order in which they came.
pub(super) struct Corrections {
    subscriber: Subscriber<Correction>,
    waiting: VecDeque<Correction>,
    /// The one that took effect last.
    pub last: Option<Correction>,
    /// The newest scan that sync-manager has concluded.
    concluded: Option<u64>,
    /// Replay: scans that have entered the map and whose corrections are not due yet, oldest first.
    accepted: VecDeque<u64>,
    /// Replay: the newest of them whose correction is due.
    due: Option<u64>,
    /// The newest scan in the map when this process went on with it.
    resumed: Option<u64>,
}

impl Corrections {
    /// Listens to the topic.
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        Ok(Self {
            subscriber: context.bus.subscriber()?,
            waiting: VecDeque::with_capacity(context.capacity.window),
            last: None,
            concluded: None,
            accepted: VecDeque::with_capacity(2 * TAKES_EFFECT_AFTER as usize),
            due: None,
            resumed: None,
        })
    }

    /// Takes in what has arrived.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(correction) = self.subscriber.receive()? {
            self.concluded = self.concluded.max(Some(correction.scan));
            self.waiting.push_back(*correction);
        }
        Ok(())
    }

    /// A scan has entered the map: sync-manager will publish what follows from it.
    pub fn accepted(&mut self, mode: Mode, sequence: u64) {
        if mode == Mode::Exact {
            self.accepted.push_back(sequence);
        }
    }

    /// The map is gone on with after this scan: what followed from it takes effect at once.
    pub fn resumed(&mut self, sequence: u64) {
        (self.due, self.resumed) = (Some(sequence), Some(sequence));
    }

    /// The next one that takes effect before the scan `next`: live any, in replay at a fixed place.
    pub fn next_due(&mut self, mode: Mode, next: Option<u64>) -> Option<Correction> {
        let is_due = |correction: &Correction| {
            mode == Mode::Live || Some(correction.scan) <= self.resumed || takes_effect(correction.scan, next)
        };
        self.waiting.front().filter(|correction| is_due(correction))?;
        self.last = self.waiting.pop_front();
        self.last
    }

    /// Whether all that take effect before the scan `next` have arrived; live none is waited for.
    pub fn are_ready(&mut self, mode: Mode, next: Option<u64>) -> bool {
        while self.accepted.front().is_some_and(|accepted| takes_effect(*accepted, next)) {
            self.due = self.accepted.pop_front();
        }
        mode == Mode::Live || self.concluded >= self.due
    }
}

fn takes_effect(scan: u64, next: Option<u64>) -> bool {
    next.is_some_and(|next| scan + TAKES_EFFECT_AFTER <= next)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_bus::{Bus, Publisher, RuntimeDir};
    use flockslam_messages::Stage;
    use flockslam_stage::{StageOptions, StopFlag};

    /// Corrections, and the other end of their topic.
    struct Topic {
        corrections: Corrections,
        publisher: Publisher<Correction>,
        mode: Mode,
        _runtime: RuntimeDir,
    }

    impl Topic {
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
            let joined = bus.memory_joiner().unwrap()();
            let stop = StopFlag::default();
            let context =
                StageContext::on_bus(Stage::ScanMatcher, 0, joined, &runtime, &options, stop).unwrap();
            let corrections = Corrections::open(&context).unwrap();
            Self { corrections, publisher: bus.publisher().unwrap(), mode, _runtime: runtime }
        }

        fn publish(&mut self, scan: u64) {
            self.publisher.send(&Correction { scan, ..Correction::default() }).unwrap();
            self.corrections.drain().unwrap();
        }

        /// Scans whose corrections take effect before the scan `next`.
        fn due_before(&mut self, next: u64) -> Vec<u64> {
            let mode = self.mode;
            std::iter::from_fn(|| self.corrections.next_due(mode, Some(next))).map(|due| due.scan).collect()
        }

        fn is_ready_for(&mut self, next: u64) -> bool {
            self.corrections.are_ready(self.mode, Some(next))
        }
    }

    #[test]
    fn in_replay_corrections_take_effect_at_fixed_scans_however_early_they_come() {
        let mut topic = Topic::new("cor-fix", Mode::Exact);
        topic.publish(0);
        topic.publish(3);
        topic.publish(9);
        assert!(topic.due_before(3).is_empty());
        assert_eq!(topic.due_before(4), [0]);
        assert!(topic.due_before(6).is_empty());
        assert_eq!(topic.due_before(7), [3]);
        assert_eq!(topic.corrections.last.map(|last| last.scan), Some(3));
        assert_eq!(topic.due_before(100), [9]);
    }

    #[test]
    fn in_replay_a_scan_waits_for_the_corrections_that_are_due() {
        let mut topic = Topic::new("cor-wait", Mode::Exact);
        topic.corrections.accepted(Mode::Exact, 0);
        topic.corrections.accepted(Mode::Exact, 2);
        assert!(topic.is_ready_for(3) && !topic.is_ready_for(4));
        topic.publish(0);
        assert!(topic.is_ready_for(5) && !topic.is_ready_for(6));
        topic.publish(2);
        assert!(topic.is_ready_for(6));
    }

    #[test]
    fn a_continued_map_waits_for_the_correction_after_its_last_scan() {
        let mut topic = Topic::new("cor-res", Mode::Exact);
        topic.corrections.resumed(20);
        topic.publish(10);
        assert!(!topic.is_ready_for(21), "the correction after its last scan is missing");
        topic.publish(20);
        assert!(topic.is_ready_for(21));
        assert_eq!(topic.due_before(21), [10, 20]);
    }

    #[test]
    fn live_corrections_take_effect_as_they_come_and_none_is_waited_for() {
        let mut topic = Topic::new("cor-live", Mode::Live);
        topic.corrections.accepted(Mode::Live, 0);
        assert!(topic.is_ready_for(50));
        topic.publish(49);
        assert_eq!(topic.due_before(50), [49]);
    }
}
