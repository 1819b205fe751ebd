//! Joins the inputs that a stage needs for a scan, by the scan's identity.

use crate::inbox::{Inbox, Named};
use crate::{Acknowledger, Deadline, Mode, StageContext, StageError, StreamEnd};
use flockslam_bus::{ScanSubscriber, Subscriber, Topic};

/// Joins scans with one message each: the verdict or the pose.
///
/// A shell takes the oldest with [`Join::oldest`], waits with [`Join::wait`] for what else belongs to it, takes the scan out of
/// [`Join::scans`], and ends with [`Join::finished`], which releases both and gives the source its credit.
pub struct Join<M: Topic + Named> {
    /// Scans in the memory of their publisher.
    pub scans: Inbox<ScanSubscriber>,
    /// The message about each scan.
    pub messages: Inbox<Subscriber<M>>,
    /// The state of the stream.
    pub stream: StreamEnd,
    /// Sequence of the next scan, if none is missed.
    pub expected: u64,
    deadline: Deadline,
    acknowledger: Acknowledger,
    mode: Mode,
}

/// The state of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited<T> {
    /// It is there.
    For(T),
    /// Live: the deadline has passed.
    TooLong,
    /// It may still come.
    NotYet,
}

impl<M: Topic + Named> Join<M> {
    /// Opens the topics. `deadline_ns` limits each wait in live operation, nanoseconds.
    ///
    /// # Errors
    /// When a topic does not exist.
    pub fn open(context: &StageContext, deadline_ns: u64) -> Result<Self, StageError> {
        Ok(Self {
            scans: Inbox::new(context.bus.scan_subscriber()?, context.capacity.window),
            messages: Inbox::unlimited(context.bus.subscriber()?),
            stream: StreamEnd::open(context)?,
            expected: 0,
            deadline: Deadline::live(context.mode, deadline_ns),
            acknowledger: Acknowledger::open(context, 0)?,
            mode: context.mode,
        })
    }

    /// Takes in what has arrived.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<(), StageError> {
        self.scans.drain()?;
        self.messages.drain()
    }

    /// Reads what has arrived, and gives the oldest message. It stays until its scan is finished.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn oldest(&mut self) -> Result<Option<M>, StageError> {
        self.drain()?;
        Ok(self.messages.front().copied())
    }

    /// Live: whether messages about earlier scans were missed. The journal has them.
    pub fn has_missed(&self, sequence: u64) -> bool {
        self.mode == Mode::Live && sequence > self.expected
    }

    /// Waits for an input of the oldest scan. `found` is this input once it is there.
    pub fn wait<T>(&mut self, found: Option<T>, now_ns: u64) -> Waited<T> {
        let waited = match found {
            Some(found) => Waited::For(found),
            None if self.deadline.passes(now_ns) => Waited::TooLong,
            None => return Waited::NotYet,
        };
        self.deadline.end();
        waited
    }

    /// Whether a wait that began at `since_ns` has passed its deadline at `now_ns`.
    pub fn is_over(&self, since_ns: u64, now_ns: u64) -> bool {
        self.deadline.is_over(since_ns, now_ns)
    }

    /// All scans before this sequence are finished: releases them and their messages, and acknowledges them to the source.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn finished(&mut self, sequence: u64) -> Result<(), StageError> {
        self.release_before(sequence);
        self.expected = self.expected.max(sequence);
        self.acknowledger.finished(sequence)
    }

    /// Another process has finished all scans before this sequence.
    pub fn release_before(&mut self, sequence: u64) {
        self.scans.release_before(sequence);
        self.messages.release_before(sequence);
    }

    /// Sets whether this process acknowledges scans for its stage. It does unless another process does.
    pub fn set_acknowledges(&mut self, acknowledges: bool) {
        self.acknowledger.is_active = acknowledges;
    }

    /// Repeats the last acknowledgement, for a source that has just started.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn refresh(&mut self) -> Result<(), StageError> {
        self.acknowledger.send()
    }

    /// Reads the control topic; true when all scans of the stream are finished.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn has_ended(&mut self) -> Result<bool, StageError> {
        self.stream.drain()?;
        Ok(self.stream.reached(self.acknowledger.done(), self.mode))
    }

    /// Whether a wait has begun, so that a deadline may pass.
    pub fn waits(&self) -> bool {
        self.deadline.runs()
    }
}

#[cfg(test)]
mod tests;
