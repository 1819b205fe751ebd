//! Messages that wait for their join, in the order of their scans.

use crate::StageError;
use flockslam_bus::{
    BusError, ScanSample, ScanSubscriber, SliceSample, SliceSubscriber, SliceTopic, Subscriber, Topic,
};
use flockslam_messages::{
    MarksHeader, MovingBeamsHeader, PoseEstimate, ScanId, ScanTally, SectorHeader, Verdict,
};
use std::collections::VecDeque;

/// A message about a scan.
pub trait Named {
    /// The scan.
    fn scan(&self) -> ScanId;
}

/// A source of messages about scans.
pub trait Port {
    /// The form in which a message is held until its join.
    type Message: Named;

    /// The next message, if one has arrived.
    ///
    /// # Errors
    /// When the bus fails.
    fn next(&self) -> Result<Option<Self::Message>, BusError>;
}

/// A slice topic whose messages are copied, because only few samples of it may be held at once.
pub struct Copies<H: SliceTopic>(pub SliceSubscriber<H>);

impl Port for ScanSubscriber {
    type Message = ScanSample;

    fn next(&self) -> Result<Option<ScanSample>, BusError> {
        self.receive()
    }
}

impl<T: Topic + Named> Port for Subscriber<T> {
    type Message = T;

    fn next(&self) -> Result<Option<T>, BusError> {
        Ok(self.receive()?.map(|sample| *sample))
    }
}

impl<H: SliceTopic + Named> Port for SliceSubscriber<H> {
    type Message = SliceSample<H>;

    fn next(&self) -> Result<Option<SliceSample<H>>, BusError> {
        self.receive()
    }
}

impl<H: SliceTopic + Named> Port for Copies<H> {
    type Message = (ScanId, Vec<H::Element>);

    fn next(&self) -> Result<Option<Self::Message>, BusError> {
        Ok(self.0.receive()?.map(|sample| (sample.scan(), sample.elements().to_vec())))
    }
}

impl Named for ScanSample {
    fn scan(&self) -> ScanId {
        self.header().id
    }
}

impl<H: SliceTopic + Named> Named for SliceSample<H> {
    fn scan(&self) -> ScanId {
        self.header().scan()
    }
}

impl<T> Named for (ScanId, T) {
    fn scan(&self) -> ScanId {
        self.0
    }
}

macro_rules! named {
    ($($message:ty),*) => {
        $(impl Named for $message {
            fn scan(&self) -> ScanId {
                self.id
            }
        })*
    };
}
named!(MarksHeader, MovingBeamsHeader, PoseEstimate, ScanTally, SectorHeader, Verdict);

/// Messages of one topic in the order of their scans, each once, held until they are taken.
pub struct Inbox<P: Port> {
    port: P,
    held: VecDeque<P::Message>,
    limit: usize,
    /// A message about an earlier scan is late or a repetition.
    next: u64,
}

impl<P: Port> Inbox<P> {
    /// Holds at most `limit` messages; more than that wait in the port.
    pub fn new(port: P, limit: usize) -> Self {
        assert!(limit > 0);
        Self { port, held: VecDeque::with_capacity(limit.min(FIRST_ROOM) + 1), limit, next: 0 }
    }

    /// As [`Inbox::new`], without a limit: small messages that are copied.
    pub fn unlimited(port: P) -> Self {
        Self::new(port, usize::MAX)
    }

    /// Takes in what has arrived, up to the limit.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while self.held.len() < self.limit {
            let Some(message) = self.port.next()? else { break };
            self.hold(message);
        }
        Ok(())
    }

    fn hold(&mut self, message: P::Message) {
        let sequence = message.scan().sequence;
        if sequence < self.next {
            return;
        }
        // A message is nearly always the newest; one of another publisher or topic may come a little late.
        match self.held.iter().rposition(|held| held.scan().sequence <= sequence) {
            Some(place) if self.held[place].scan().sequence == sequence => {}
            Some(place) => self.held.insert(place + 1, message),
            None => self.held.push_front(message),
        }
    }

    /// The oldest message.
    pub fn front(&self) -> Option<&P::Message> {
        self.held.front()
    }

    /// Takes the message about this scan, if it is there, and releases those about all scans before it.
    pub fn take(&mut self, sequence: u64) -> Option<P::Message> {
        self.release_before(sequence);
        if self.held.front()?.scan().sequence != sequence {
            return None;
        }
        self.next = sequence + 1;
        self.held.pop_front()
    }

    /// Releases messages about scans before this one; those that come later are refused.
    pub fn release_before(&mut self, sequence: u64) {
        while self.held.front().is_some_and(|held| held.scan().sequence < sequence) {
            self.held.pop_front();
        }
        self.next = self.next.max(sequence);
    }

    /// Messages held.
    pub fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }
}

/// Messages that a queue has room for before it grows.
const FIRST_ROOM: usize = 256;

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    /// Sequences that arrive one after the other.
    struct Arrivals(RefCell<VecDeque<u64>>);

    impl Port for Arrivals {
        type Message = (ScanId, u64);

        fn next(&self) -> Result<Option<Self::Message>, BusError> {
            let named = |sequence| (ScanId { sequence, ..ScanId::default() }, sequence);
            Ok(self.0.borrow_mut().pop_front().map(named))
        }
    }

    fn inbox(arrivals: &[u64], limit: usize) -> Inbox<Arrivals> {
        Inbox::new(Arrivals(RefCell::new(arrivals.iter().copied().collect())), limit)
    }

    #[test]
    fn messages_come_in_order_each_once_and_not_after_their_scan() {
        let mut inbox = inbox(&[2, 4, 3, 4, 2, 9], 100);
        inbox.drain().unwrap();
        assert_eq!(inbox.len(), 4);
        assert_eq!(inbox.front().unwrap().1, 2);
        assert_eq!(inbox.take(3).unwrap().1, 3);
        inbox.port.0.borrow_mut().extend([1, 3, 5]);
        inbox.drain().unwrap();
        assert_eq!((inbox.take(6), inbox.len()), (None, 1), "nothing is taken for another scan");
        inbox.release_before(10);
        assert!(inbox.is_empty());
    }

    #[test]
    fn what_is_over_the_limit_waits_in_the_port() {
        let mut inbox = inbox(&[0, 1, 2, 3], 2);
        inbox.drain().unwrap();
        assert_eq!((inbox.len(), inbox.port.0.borrow().len()), (2, 2));
        inbox.release_before(2);
        inbox.drain().unwrap();
        assert_eq!(inbox.front().unwrap().1, 2);
    }
}
