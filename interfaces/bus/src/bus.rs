//! Access to all topics and events of a set. Its ports are typed; the transport below is not.

use crate::event::{Listener, Notifier};
use crate::memory_bus::MemoryBus;
use crate::shared_memory_bus::SharedBus;
use crate::transport::{TopicSpec, Transport};
use crate::word_rows::{words_of, words_of_slice};
use crate::{
    BusError, Capacity, LargeScanHeader, Publisher, RuntimeDir, ScanPublisher, ScanSubscriber,
    SlicePublisher, SliceSubscriber, SliceTopic, Subscriber, Topic,
};
use flockslam_messages::{
    Commit, Control, Correction, FlockFrame, FlockRobots, Layout, LocalisationOrder, MarksHeader,
    MovingBeamsHeader, PartInserted, PoseEstimate, Progress, ScanHeader, ScanTally, SectorHeader, Stage,
    StageInputs, SubmapClosed, TileMessage, TracksHeader, Verdict,
};

/// A process' (or thread's) way to all topics and events of its set.
pub struct Bus {
    transport: Box<dyn Transport>,
    capacity: Capacity,
}

/// The event of the supervisor, beside those of the stages.
pub const SUPERVISOR_EVENT: &str = "supervisor";

impl Bus {
    /// Creates all services of a set and holds them until it is dropped. Only the supervisor does this.
    ///
    /// # Errors
    /// When shared memory cannot be prepared.
    pub fn host(runtime: &RuntimeDir, capacity: Capacity) -> Result<Self, BusError> {
        assert!(capacity.window > 0 && capacity.replicas > 0 && capacity.live_tiles > 0);
        runtime.configure_shared_memory()?;
        let mut bus = SharedBus::new("supervisor", capacity)?;
        for topic in topics(&capacity) {
            bus.create(&topic)?;
        }
        bus.create_event(SUPERVISOR_EVENT)?;
        for stage in Stage::ALL {
            bus.create_event(stage.name())?;
        }
        Ok(Self { transport: Box::new(bus), capacity })
    }

    /// Joins a running set.
    ///
    /// # Errors
    /// When the set does not exist.
    pub fn join(runtime: &RuntimeDir, name: &str, capacity: Capacity) -> Result<Self, BusError> {
        runtime.configure_shared_memory()?;
        Ok(Self { transport: Box::new(SharedBus::new(name, capacity)?), capacity })
    }

    /// The in-memory twin: it carries messages between threads of this process, see [`Bus::memory_joiner`].
    pub fn in_memory() -> Self {
        Self { transport: Box::new(MemoryBus::default()), capacity: Capacity::default() }
    }

    /// Gives another thread access to the same in-memory set; `None` for shared memory, where each process joins by
    /// itself and ports stay within their thread.
    pub fn memory_joiner(&self) -> Option<impl FnOnce() -> Self + Send + 'static> {
        let (transport, capacity) = (self.transport.for_another_thread()?, self.capacity);
        Some(move || Self { transport, capacity })
    }

    /// Frees what dead processes of the set hold: (cleaned, failed).
    pub fn clean_dead_nodes(&self) -> (u64, u64) {
        self.transport.clean_dead_nodes()
    }

    /// Opens a topic for sending.
    ///
    /// # Errors
    /// When the topic does not exist, has too many publishers, or was made by another build.
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, BusError> {
        Ok(Publisher::new(self.transport.lender(&plain::<T>(&self.capacity))?))
    }

    /// Opens a topic for receiving.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, BusError> {
        Ok(Subscriber::new(self.transport.source(&plain::<T>(&self.capacity))?))
    }

    /// Opens a topic of headers with slices for sending.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn slice_publisher<H: SliceTopic>(&self) -> Result<SlicePublisher<H>, BusError> {
        Ok(SlicePublisher::new(self.transport.lender(&slice::<H>(&self.capacity))?))
    }

    /// Opens a topic of headers with slices for receiving.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn slice_subscriber<H: SliceTopic>(&self) -> Result<SliceSubscriber<H>, BusError> {
        Ok(SliceSubscriber::new(self.transport.source(&slice::<H>(&self.capacity))?))
    }

    /// Opens the topics of scans for sending.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn scan_publisher(&self) -> Result<ScanPublisher, BusError> {
        Ok(ScanPublisher { ordinary: self.slice_publisher()?, large: self.slice_publisher()? })
    }

    /// Opens the topics of scans for receiving.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn scan_subscriber(&self) -> Result<ScanSubscriber, BusError> {
        Ok(ScanSubscriber { ordinary: self.slice_subscriber()?, large: self.slice_subscriber()? })
    }

    /// The event of a stage or of the supervisor, to wait on.
    ///
    /// # Errors
    /// When it does not exist or has too many listeners.
    pub fn listener(&self, name: &str) -> Result<Listener, BusError> {
        self.transport.listener(name)
    }

    /// The event of a stage or of the supervisor, to notify.
    ///
    /// # Errors
    /// When it does not exist or has too many notifiers.
    pub fn notifier(&self, name: &str) -> Result<Notifier, BusError> {
        self.transport.notifier(name)
    }
}

/// All topics of a set.
pub(crate) fn topics(capacity: &Capacity) -> [TopicSpec; 20] {
    [
        plain::<Verdict>(capacity),
        plain::<ScanTally>(capacity),
        plain::<PoseEstimate>(capacity),
        plain::<Commit>(capacity),
        plain::<StageInputs>(capacity),
        plain::<PartInserted>(capacity),
        plain::<SubmapClosed>(capacity),
        plain::<Correction>(capacity),
        plain::<FlockFrame>(capacity),
        plain::<FlockRobots>(capacity),
        plain::<LocalisationOrder>(capacity),
        plain::<Control>(capacity),
        plain::<Progress>(capacity),
        plain::<TileMessage>(capacity),
        slice::<ScanHeader>(capacity),
        slice::<LargeScanHeader>(capacity),
        slice::<MarksHeader>(capacity),
        slice::<SectorHeader>(capacity),
        slice::<TracksHeader>(capacity),
        slice::<MovingBeamsHeader>(capacity),
    ]
}

fn plain<T: Topic>(capacity: &Capacity) -> TopicSpec {
    TopicSpec {
        name: T::NAME,
        message: T::TYPE_NAME,
        layout: T::HASH,
        words: words_of::<T>(),
        grows: false,
        limits: T::limits(capacity),
    }
}

fn slice<H: SliceTopic>(capacity: &Capacity) -> TopicSpec {
    TopicSpec {
        name: H::NAME,
        message: H::TYPE_NAME,
        // Either may change alone.
        layout: H::HASH ^ H::Element::HASH.rotate_left(1),
        words: words_of_slice::<H, H::Element>(H::FIRST_LENGTH),
        grows: true,
        limits: H::limits(capacity),
    }
}
