//! Acknowledgements to the source, and the end of the stream.

use crate::{Clock, Mode, StageContext, StageError};
use flockslam_bus::{Notifier, Publisher, Subscriber};
use flockslam_messages::{Control, ControlKind, Progress, Stage};

/// Live: so long after the end of the stream missing scans count as lost.
const SILENCE_MAX_NS: u64 = 2_000_000_000;

/// Acknowledges finished scans to the source: the credit of exact replay. A few scans are acknowledged at once, so
/// that flow control costs little.
pub struct Acknowledger {
    publisher: Publisher<Progress>,
    /// The source, which waits for credit in exact replay only.
    source: Option<Notifier>,
    message: Progress,
    step: u64,
    sent: u64,
    notified: u64,
    /// Another process of the stage may acknowledge for this one.
    pub(crate) is_active: bool,
}

impl Acknowledger {
    /// Opens the topic to the source.
    ///
    /// # Errors
    /// When the topic does not exist.
    pub fn open(context: &StageContext, done: u64) -> Result<Self, StageError> {
        Ok(Self {
            publisher: context.bus.publisher()?,
            source: match context.mode {
                Mode::Exact => Some(context.bus.notifier(Stage::LidarIngest.name())?),
                Mode::Live => None,
            },
            message: Progress { stage: context.stage as u32, replica: context.replica, done },
            step: (context.capacity.window as u64 / 8).max(1),
            sent: done,
            notified: done,
            is_active: true,
        })
    }

    /// All scans with a sequence below `done` are finished here.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn finished(&mut self, done: u64) -> Result<(), StageError> {
        self.message.done = self.message.done.max(done);
        if self.message.done >= self.sent + self.step { self.send() } else { Ok(()) }
    }

    /// Sends the acknowledgement now, also for a source that has just started.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn send(&mut self) -> Result<(), StageError> {
        if !self.is_active {
            return Ok(());
        }
        self.sent = self.message.done;
        self.publisher.send(&self.message)?;
        // A repetition does not wake the source: an idle set shall sleep.
        if self.notified < self.sent {
            self.notified = self.sent;
            self.source.iter().for_each(Notifier::notify);
        }
        Ok(())
    }

    /// All scans with a sequence below this are finished.
    pub fn done(&self) -> u64 {
        self.message.done
    }
}

/// The state of the stream of scans, by the control topic.
pub struct StreamEnd {
    subscriber: Subscriber<Control>,
    /// Scans in the stream, once the source has ended.
    pub scans: Option<u64>,
    /// Submaps of the mapper, once it has closed the last one.
    pub submaps: Option<u64>,
    /// The end of the source is requested.
    pub end_wanted: bool,
    /// A reader has requested all live tiles since the last poll.
    pub tiles_wanted: bool,
    received_ns: Option<u64>,
    clock: Clock,
}

impl StreamEnd {
    /// Listens to the control topic.
    ///
    /// # Errors
    /// When the topic does not exist.
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        Ok(Self {
            subscriber: context.bus.subscriber()?,
            scans: None,
            submaps: None,
            end_wanted: false,
            tiles_wanted: false,
            received_ns: None,
            clock: context.clock.clone(),
        })
    }

    /// Reads what has arrived.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(control) = self.subscriber.receive()? {
            match control.kind {
                kind if kind == ControlKind::StreamEnd as u32 => {
                    self.scans = Some(control.value);
                    self.received_ns.get_or_insert_with(|| self.clock.now_ns());
                }
                kind if kind == ControlKind::MapClosed as u32 => self.submaps = Some(control.value),
                kind if kind == ControlKind::EndWanted as u32 => self.end_wanted = true,
                kind if kind == ControlKind::TilesWanted as u32 => self.tiles_wanted = true,
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether all scans of the stream have a sequence below `done`. Live, a scan that is still missing a while after the end
    /// was lost with a stage that died.
    pub fn reached(&self, done: u64, mode: Mode) -> bool {
        let late = |received_ns| {
            mode == Mode::Live && self.clock.now_ns().saturating_sub(received_ns) > SILENCE_MAX_NS
        };
        self.scans.is_some_and(|scans| done >= scans) || self.received_ns.is_some_and(late)
    }
}
