//! What a stage needs for a scan, brought together by the scan's identity.

use crate::inbox::{Inbox, Named};
use crate::{Acknowledger, Deadline, Mode, StageContext, StageError, StreamEnd};
use flockslam_bus::{ScanSubscriber, Subscriber, Topic};

/// Scans, and the message that says of each what is to be done with it: its verdict or its pose.
///
/// A shell takes the oldest with [`Join::oldest`], waits with [`Join::wait`] for what else belongs to it, takes the scan out of
/// [`Join::scans`], and ends with [`Join::finished`], which releases both and gives the source its credit.
pub struct Join<M: Topic + Named> {
    /// Scans in the memory of their publisher.
    pub scans: Inbox<ScanSubscriber>,
    /// What is said of each.
    pub messages: Inbox<Subscriber<M>>,
    /// What was said about the stream.
    pub stream: StreamEnd,
    /// Sequence of the scan that comes next when none is missed.
    pub expected: u64,
    deadline: Deadline,
    acknowledger: Acknowledger,
    mode: Mode,
}

/// What has become of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited<T> {
    /// It is there.
    For(T),
    /// Live: it is not waited for any more.
    TooLong,
    /// It may still come.
    NotYet,
}

impl<M: Topic + Named> Join<M> {
    /// Opens the topics; live, nothing is waited for longer than this, nanoseconds.
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

    /// Takes in what has arrived, and gives the oldest of what was said. It stays until its scan is finished.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn oldest(&mut self) -> Result<Option<M>, StageError> {
        self.drain()?;
        Ok(self.messages.front().copied())
    }

    /// Live: whether something was said about scans before this one that has not arrived. The journal has it.
    pub fn has_missed(&self, sequence: u64) -> bool {
        self.mode == Mode::Live && sequence > self.expected
    }

    /// Waits for what belongs to the oldest scan: `found` once it is there, `None` before.
    pub fn wait<T>(&mut self, found: Option<T>, now_ns: u64) -> Waited<T> {
        let waited = match found {
            Some(found) => Waited::For(found),
            None if self.deadline.passes(now_ns) => Waited::TooLong,
            None => return Waited::NotYet,
        };
        self.deadline.end();
        waited
    }

    /// As [`Join::wait`], for what is waited for since a moment that the shell knows: whether that takes too long.
    pub fn is_over(&self, since_ns: u64, now_ns: u64) -> bool {
        self.deadline.is_over(since_ns, now_ns)
    }

    /// All scans before this sequence are finished: releases what is held of them, and gives the source its credit.
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

    /// Whether this process speaks for the stage, as it does unless another one is said to: then it acknowledges nothing.
    pub fn speak(&mut self, speaks: bool) {
        self.acknowledger.speaks = speaks;
    }

    /// Repeats to a source that has just started how far the stage is.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn refresh(&mut self) -> Result<(), StageError> {
        self.acknowledger.send()
    }

    /// Takes in what was said about the stream; whether all of its scans are finished.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn has_ended(&mut self) -> Result<bool, StageError> {
        self.stream.drain()?;
        Ok(self.stream.reached(self.acknowledger.done(), self.mode))
    }

    /// Whether anything is waited for, so that a deadline may pass.
    pub fn waits(&self) -> bool {
        self.deadline.runs()
    }
}

#[cfg(test)]
mod tests;
