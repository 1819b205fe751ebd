//! Transport of messages: shared memory between processes, or its twin in memory between threads.
//!
//! Both carry rows of words, whatever the topic. iceoryx2 is generic over its payload and costs the compiler seconds for each
//! type, so there is one type for all topics, and what is compiled for it stays in this crate, behind these traits.

use crate::event::{Listener, Notifier};
use crate::room::WHOLE_MAX_BYTES;
use crate::shared_sample::SharedSample;
use crate::word_rows::Words;
use crate::{BusError, Limits};
use std::sync::Arc;

/// A topic as a transport sees it.
#[derive(Clone, Copy, Debug)]
pub struct TopicSpec {
    /// Name on the bus.
    pub name: &'static str,
    /// Name and version of its message.
    pub message: &'static str,
    /// Fingerprint of the message's layout.
    pub layout: u64,
    /// Words of a message; of the first ones where they may grow.
    pub words: usize,
    /// Whether messages have different lengths.
    pub grows: bool,
    /// Limits in this set.
    pub limits: Limits,
}

/// What iceoryx2 0.10 adds to each message, bytes.
const HEADER_BYTES: u64 = 48;
/// Sizes of objects are rounded up to pages, bytes.
const PAGE_BYTES: u64 = 4096;
/// What it keeps in front of the messages for each of them, bytes.
const INDEX_BYTES: u64 = 4;

impl TopicSpec {
    /// Messages that a publisher keeps memory for.
    fn messages(&self) -> u64 {
        let Limits { subscribers, buffer, borrowed, preallocated, .. } = self.limits;
        // One each is on loan, in the history, and being made.
        let worst = subscribers * (buffer + borrowed) + 3;
        preallocated.map_or(worst, |limit| limit.min(worst)) as u64
    }

    fn bytes(&self, messages: u64) -> u64 {
        let message = (self.words * size_of::<u64>()) as u64 + HEADER_BYTES;
        messages * message + self.messages() * INDEX_BYTES + PAGE_BYTES
    }

    /// What a publisher of the topic takes of shared memory when it is made, bytes.
    pub fn reserved_bytes(&self) -> u64 {
        let messages = self.limits.reserved.map_or(self.messages(), |few| (few as u64).min(self.messages()));
        self.bytes(messages)
    }

    /// Whether that is all that its messages will ever need.
    pub fn is_whole(&self) -> bool {
        !self.grows && self.bytes(self.messages()) <= WHOLE_MAX_BYTES
    }
}

/// A way to all topics and events of a set.
pub trait Transport {
    /// Opens a topic for sending.
    fn lender(&self, topic: &TopicSpec) -> Result<Box<dyn Lender>, BusError>;
    /// Opens a topic for receiving.
    fn source(&self, topic: &TopicSpec) -> Result<Box<dyn Source>, BusError>;
    /// An event to wait on.
    fn listener(&self, name: &str) -> Result<Listener, BusError>;
    /// An event to notify.
    fn notifier(&self, name: &str) -> Result<Notifier, BusError>;
    /// Frees what dead processes of the set hold: (cleaned, failed).
    fn clean_dead_nodes(&self) -> (u64, u64) {
        (0, 0)
    }
    /// The same for another thread, where that is possible: shared memory is joined by each process itself.
    fn for_another_thread(&self) -> Option<Box<dyn Transport + Send>> {
        None
    }
}

/// Sends messages of one topic.
pub trait Lender {
    /// Lends zeroed memory for so many words, lets `fill` write there, and sends it.
    fn send(&self, words: usize, fill: &mut dyn FnMut(&mut Words)) -> Result<(), BusError>;
    /// Connects to readers that came since the last message.
    fn refresh(&self) {}
}

/// Receives messages of one topic, oldest first.
pub trait Source {
    /// The next message, if one waits.
    fn receive(&self) -> Result<Option<Held>, BusError>;
}

/// A received message, read in place as long as this lives.
pub enum Held {
    /// In the publisher's memory.
    Shared(SharedSample),
    /// Shared between threads.
    Memory(Arc<Box<Words>>),
}

impl Held {
    /// What was sent.
    pub fn words(&self) -> &Words {
        match self {
            Self::Shared(sample) => sample.words(),
            Self::Memory(message) => message,
        }
    }
}
