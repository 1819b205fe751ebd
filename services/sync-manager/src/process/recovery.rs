//! What the journal has and this process has not received: the state of a predecessor, and poses that were missed.

use super::SyncProcess;
use flockslam_messages::ScanBuffer;
use flockslam_stage::{Mode, StageContext, StageError};
use flockslam_telemetry::failpoint;
use std::fs::File;

/// Time without a pose after which the journal is read, nanoseconds. A sensor sends ten scans in it.
const SILENCE_NS: u64 = 1_000_000_000;

/// More poses than this are in the journal and not received: they do not reach this process at all. When a matcher is killed between
/// writing and sending, it is one.
const MISSED_MAX: u64 = 20;

/// The time without a pose, live. In exact replay a scan waits as long as it must.
pub(super) struct Silence {
    mode: Mode,
    since_ns: Option<u64>,
}

impl Silence {
    pub(super) fn new(mode: Mode) -> Self {
        Self { mode, since_ns: None }
    }

    /// Whether no pose has been `received` for the limit. It begins anew then.
    fn is_long(&mut self, received: bool, now_ns: u64) -> bool {
        if self.mode == Mode::Exact {
            return false;
        }
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        let is_long = !received && now_ns.saturating_sub(since_ns) > SILENCE_NS;
        if received || is_long {
            self.since_ns = Some(now_ns);
        }
        is_long
    }
}

impl SyncProcess {
    /// Recovers the state of a predecessor: the journal has every pose and every accepted scan.
    pub(super) fn recover(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.catch_up(u64::MAX, context)?;
        self.go_on(context)?;
        self.join.finished(self.join.expected)
    }

    /// Takes in the poses and scans of the journal before this sequence.
    pub(super) fn catch_up(&mut self, before: u64, context: &mut StageContext) -> Result<(), StageError> {
        while let Some(record) = self.journal.read_before(before)? {
            context.alive();
            if record.pose.id.sequence < self.join.expected {
                continue;
            }
            self.conclude_stored(record.pose.submap, context)?;
            let scan = record.scan.as_ref().and_then(|scan| scan.view().ok());
            self.take_in(&record.pose, scan, &[], context)?;
            self.accepted(&record.pose, context)?;
            self.join.expected = record.pose.id.sequence + 1;
        }
        Ok(())
    }

    /// The scan with this pose from the journal, which has all that have entered the map. After a long search the poses that wait reach
    /// further back than the scans that wait.
    pub(super) fn stored_scan(&mut self, sequence: u64) -> Result<Option<ScanBuffer>, StageError> {
        while let Some(record) = self.journal.read_before(sequence + 1)? {
            if record.pose.id.sequence == sequence {
                return Ok(record.scan);
            }
        }
        Ok(None)
    }

    /// Takes in the rest of the journal. Gives the number of its poses.
    pub(super) fn read_on(&mut self, context: &mut StageContext) -> Result<u64, StageError> {
        let first = self.join.expected;
        self.catch_up(u64::MAX, context)?;
        self.join.finished(self.join.expected)?;
        Ok(self.join.expected - first)
    }

    /// Live: after a time without a pose takes in what the journal has. A process that poses do not reach ends: its successor opens
    /// its topics anew.
    pub(super) fn listen(&mut self, received: bool, context: &mut StageContext) -> Result<(), StageError> {
        if !self.silence.is_long(received, context.now_ns()) {
            return Ok(());
        }
        let missed = self.read_on(context)?;
        if missed > MISSED_MAX { Err(StageError::Unreached { missed }) } else { Ok(()) }
    }
}

/// A test may want that poses do not reach the first process of a set.
pub(super) fn is_deaf(context: &StageContext) -> bool {
    failpoint("deaf") && {
        let place = context.status_dir.join("deaf");
        let own = std::process::id().to_string();
        let _ = File::create_new(&place).and_then(|_| std::fs::write(&place, &own));
        std::fs::read_to_string(&place).is_ok_and(|first| first == own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_long_once_for_each_limit_that_passes_without_a_pose() {
        let mut live = Silence::new(Mode::Live);
        assert!(!live.is_long(false, 5));
        assert!(!live.is_long(true, SILENCE_NS));
        assert!(!live.is_long(false, 2 * SILENCE_NS));
        assert!(live.is_long(false, 2 * SILENCE_NS + 1));
        assert!(!live.is_long(false, 3 * SILENCE_NS));
        assert!(live.is_long(false, 4 * SILENCE_NS));
        let mut exact = Silence::new(Mode::Exact);
        assert!(!exact.is_long(false, 5) && !exact.is_long(false, 3 * SILENCE_NS));
    }
}
