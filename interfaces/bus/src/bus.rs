use crate::bell::{BellRinger, Listener, ListenerKind, RingerKind};
use crate::memory::MemoryBus;
use crate::port::{PublisherKind, SlicePublisherKind, SliceSubscriberKind, SubscriberKind};
use crate::shared::{SharedBus, assert_limits};
use crate::{
    BusError, Capacity, LargeScanHeader, Publisher, RuntimeDir, ScanPublisher, ScanSubscriber,
    SlicePublisher, SliceSubscriber, SliceTopic, Subscriber, Topic,
};
use flockslam_messages::{
    Commit, Control, FlockFrame, FlockRobots, LayoutHeader, MarksHeader, MovingBeamsHeader, PartInserted,
    PoseEstimate, Progress, ScanHeader, ScanTally, SectorHeader, Stage, SubmapClosed, TileMessage,
    TracksHeader, Verdict,
};
use std::any::Any;

/// A process' (or thread's) way to all topics and bells of its set.
pub struct Bus(Kind);

enum Kind {
    Shared {
        // Services are declared before the bus that holds their node, so that they are dropped first.
        _services: Vec<Box<dyn Any>>,
        bus: SharedBus,
    },
    Memory(MemoryBus),
}

/// The bell of the supervisor, beside those of the stages.
pub const SUPERVISOR_BELL: &str = "supervisor";

impl Bus {
    /// Creates all services of a set and holds them until it is dropped. Only the supervisor does this.
    ///
    /// # Errors
    /// When shared memory cannot be prepared.
    pub fn host(runtime: &RuntimeDir, capacity: Capacity) -> Result<Self, BusError> {
        assert!(capacity.window > 0 && capacity.replicas > 0 && capacity.live_tiles > 0);
        runtime.configure_shared_memory()?;
        let bus = SharedBus::new("supervisor", capacity)?;
        let mut services = vec![
            create::<Verdict>(&bus)?,
            create::<ScanTally>(&bus)?,
            create::<PoseEstimate>(&bus)?,
            create::<Commit>(&bus)?,
            create::<PartInserted>(&bus)?,
            create::<SubmapClosed>(&bus)?,
            create::<LayoutHeader>(&bus)?,
            create::<FlockFrame>(&bus)?,
            create::<FlockRobots>(&bus)?,
            create::<Control>(&bus)?,
            create::<Progress>(&bus)?,
            create::<TileMessage>(&bus)?,
            bus.create_slice::<ScanHeader>()?,
            bus.create_slice::<LargeScanHeader>()?,
            bus.create_slice::<MarksHeader>()?,
            bus.create_slice::<SectorHeader>()?,
            bus.create_slice::<TracksHeader>()?,
            bus.create_slice::<MovingBeamsHeader>()?,
            bus.create_bell(SUPERVISOR_BELL)?,
        ];
        for stage in Stage::ALL {
            services.push(bus.create_bell(stage.name())?);
        }
        Ok(Self(Kind::Shared { _services: services, bus }))
    }

    /// Joins a running set.
    ///
    /// # Errors
    /// When the set does not exist.
    pub fn join(runtime: &RuntimeDir, name: &str, capacity: Capacity) -> Result<Self, BusError> {
        runtime.configure_shared_memory()?;
        Ok(Self(Kind::Shared { _services: Vec::new(), bus: SharedBus::new(name, capacity)? }))
    }

    /// The in-memory twin: it carries messages between threads of this process, see [`Bus::memory_joiner`].
    pub fn in_memory() -> Self {
        Self(Kind::Memory(MemoryBus::default()))
    }

    /// What another thread needs to join the same in-memory set; `None` for shared memory, where each process joins by
    /// itself and ports stay within their thread.
    pub fn memory_joiner(&self) -> Option<impl FnOnce() -> Self + Send + 'static> {
        match &self.0 {
            Kind::Memory(bus) => {
                let bus = bus.clone();
                Some(move || Self(Kind::Memory(bus)))
            }
            Kind::Shared { .. } => None,
        }
    }

    /// Frees what dead processes of the set hold: (cleaned, failed).
    pub fn clean_dead_nodes(&self) -> (u64, u64) {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.clean_dead_nodes(),
            Kind::Memory(_) => (0, 0),
        }
    }

    /// Opens a topic for sending.
    ///
    /// # Errors
    /// When the topic does not exist, has too many publishers, or was made by another build.
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.publisher(),
            Kind::Memory(bus) => Ok(Publisher(PublisherKind::Memory(bus.topic(T::NAME)))),
        }
    }

    /// Opens a topic for receiving.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.subscriber(),
            Kind::Memory(bus) => Ok(Subscriber(SubscriberKind::Memory(bus.topic(T::NAME).subscribe()))),
        }
    }

    /// Opens a topic of headers with slices for sending.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn slice_publisher<H: SliceTopic>(&self) -> Result<SlicePublisher<H>, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.slice_publisher(),
            Kind::Memory(bus) => Ok(SlicePublisher(SlicePublisherKind::Memory(bus.topic(H::NAME)))),
        }
    }

    /// Opens a topic of headers with slices for receiving.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn slice_subscriber<H: SliceTopic>(&self) -> Result<SliceSubscriber<H>, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.slice_subscriber(),
            Kind::Memory(bus) => {
                Ok(SliceSubscriber(SliceSubscriberKind::Memory(bus.topic(H::NAME).subscribe())))
            }
        }
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

    /// The bell of a stage or of the supervisor, to wait on.
    ///
    /// # Errors
    /// When it does not exist or has too many listeners.
    pub fn listener(&self, name: &str) -> Result<Listener, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.listener(name),
            Kind::Memory(bus) => Ok(Listener(ListenerKind::Memory(bus.bell(name).listen()))),
        }
    }

    /// The bell of a stage or of the supervisor, to ring.
    ///
    /// # Errors
    /// When it does not exist or has too many ringers.
    pub fn ringer(&self, name: &str) -> Result<BellRinger, BusError> {
        match &self.0 {
            Kind::Shared { bus, .. } => bus.ringer(name),
            Kind::Memory(bus) => Ok(BellRinger(RingerKind::Memory(bus.bell(name)))),
        }
    }
}

fn create<T: Topic>(bus: &SharedBus) -> Result<Box<dyn Any>, BusError> {
    assert_limits(&T::limits(bus.capacity()));
    bus.create::<T>()
}
