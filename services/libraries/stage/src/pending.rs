//! Scans that wait for their join, in the order of their sequence.

use crate::StageError;
use flockslam_bus::{ScanSample, ScanSubscriber};
use std::collections::VecDeque;

/// Scans that are held in the publisher's memory until their join is complete, by sequence.
pub struct PendingScans {
    subscriber: ScanSubscriber,
    held: VecDeque<ScanSample>,
    limit: usize,
    next: u64,
}

impl PendingScans {
    /// Holds at most `limit` scans; those with a sequence below `next` are duplicates.
    pub fn new(subscriber: ScanSubscriber, limit: usize, next: u64) -> Self {
        assert!(limit > 0);
        Self { subscriber, held: VecDeque::with_capacity(limit + 1), limit, next }
    }

    /// Takes in what has arrived, up to the limit; true when there was anything.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<bool, StageError> {
        let mut any = false;
        loop {
            if self.held.len() >= self.limit {
                return Ok(any);
            }
            let Some(sample) = self.subscriber.receive()? else { return Ok(any) };
            any = true;
            self.hold(sample);
        }
    }

    fn hold(&mut self, sample: ScanSample) {
        let sequence = sample.header().id.sequence;
        if sequence < self.next {
            return;
        }
        // Nearly always the newest; a scan of the other topic may come a little late.
        let place = self.held.iter().rposition(|held| held.header().id.sequence <= sequence);
        match place {
            Some(place) if self.held[place].header().id.sequence == sequence => {}
            Some(place) => self.held.insert(place + 1, sample),
            None => self.held.push_front(sample),
        }
    }

    /// The oldest scan held.
    pub fn front(&self) -> Option<&ScanSample> {
        self.held.front()
    }

    /// Takes the oldest scan.
    pub fn pop(&mut self) -> Option<ScanSample> {
        let sample = self.held.pop_front()?;
        self.next = sample.header().id.sequence + 1;
        Some(sample)
    }

    /// Takes the scan of this sequence and releases all before it.
    pub fn take(&mut self, sequence: u64) -> Option<ScanSample> {
        self.release_before(sequence);
        let found = self.held.front().is_some_and(|held| held.header().id.sequence == sequence);
        self.next = self.next.max(sequence + 1);
        if found { self.held.pop_front() } else { None }
    }

    /// Releases all scans with a sequence below.
    pub fn release_before(&mut self, sequence: u64) {
        while self.held.front().is_some_and(|held| held.header().id.sequence < sequence) {
            self.held.pop_front();
        }
        self.next = self.next.max(sequence);
    }

    /// Scans held.
    pub fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }
}
