//! iceoryx2 behind the ports: services with explicit limits, created by the host and opened by everybody else.

use crate::bell::{BellRinger, Listener, ListenerKind, RingerKind};
use crate::patience::Patience;
use crate::port::{PublisherKind, SlicePublisherKind, SliceSubscriberKind, SubscriberKind};
use crate::wire::Wire;
use crate::{
    BusError, Capacity, Limits, Publisher, SlicePublisher, SliceSubscriber, SliceTopic, Subscriber, Topic,
};
use flockslam_messages::Message;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use std::any::Any;

/// The iceoryx2 service type of the whole product: shared memory between processes, single-threaded ports.
pub type Service = ipc::Service;

type PlainFactory<T> = publish_subscribe::PortFactory<Service, Wire<T>, ()>;
type SliceFactory<H> = publish_subscribe::PortFactory<Service, [Wire<<H as SliceTopic>::Element>], Wire<H>>;

const LAYOUT_KEY: &str = "flockslam-layout";

/// A process' access to the shared memory of its set.
pub struct SharedBus {
    node: Node<Service>,
    capacity: Capacity,
}

impl SharedBus {
    /// Registers this process.
    pub fn new(name: &str, capacity: Capacity) -> Result<Self, BusError> {
        let setup = |reason: String| BusError::Setup { place: "the node directory".to_owned(), reason };
        let name = NodeName::new(name).map_err(|e| setup(format!("{e:?}")))?;
        let node = NodeBuilder::new()
            .name(&name)
            // Own handlers decide what SIGTERM means; the default would swallow it.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|e| setup(format!("{e:?}")))?;
        Ok(Self { node, capacity })
    }

    /// Frees what dead processes of the set hold; returns how many were cleaned and how many could not be.
    pub fn clean_dead_nodes(&self) -> (u64, u64) {
        let state = self.node.try_cleanup_dead_nodes();
        (state.cleanups, state.failed_cleanups)
    }

    /// Creates the service of a topic; it lives as long as what is returned.
    pub fn create<T: Topic>(&self) -> Result<Box<dyn Any>, BusError> {
        let limits = T::limits(&self.capacity);
        let builder = self.node.service_builder(&service_name(T::NAME)?).publish_subscribe::<Wire<T>>();
        let created = builder
            .enable_safe_overflow(true)
            .history_size(0)
            .max_publishers(limits.publishers)
            .max_subscribers(limits.subscribers)
            .max_nodes(limits.publishers + limits.subscribers)
            .subscriber_max_buffer_size(limits.buffer)
            .subscriber_max_borrowed_samples(limits.borrowed)
            .create_with_attributes(&layout_attribute::<T>()?);
        Ok(Box::new(created.map_err(|e| BusError::open(T::NAME, e))?))
    }

    /// As [`SharedBus::create`], for headers with slices.
    pub fn create_slice<H: SliceTopic>(&self) -> Result<Box<dyn Any>, BusError> {
        let limits = H::limits(&self.capacity);
        let builder =
            self.node.service_builder(&service_name(H::NAME)?).publish_subscribe::<[Wire<H::Element>]>();
        let created = builder
            .user_header::<Wire<H>>()
            .enable_safe_overflow(true)
            .history_size(0)
            .max_publishers(limits.publishers)
            .max_subscribers(limits.subscribers)
            .max_nodes(limits.publishers + limits.subscribers)
            .subscriber_max_buffer_size(limits.buffer)
            .subscriber_max_borrowed_samples(limits.borrowed)
            .create_with_attributes(&layout_attribute::<H>()?);
        Ok(Box::new(created.map_err(|e| BusError::open(H::NAME, e))?))
    }

    /// Creates the bell of this name.
    pub fn create_bell(&self, name: &str) -> Result<Box<dyn Any>, BusError> {
        let replicas = self.capacity.replicas + 1;
        let created = self
            .node
            .service_builder(&service_name(&format!("bell/{name}"))?)
            .event()
            .max_listeners(replicas)
            // Every stage, the supervisor and outside programs may ring.
            .max_notifiers(6 * replicas + 4)
            .max_nodes(7 * replicas + 4)
            .event_id_max_value(1)
            .create();
        Ok(Box::new(created.map_err(|e| BusError::open(name, e))?))
    }

    fn open<T: Topic>(&self) -> Result<PlainFactory<T>, BusError> {
        self.node
            .service_builder(&service_name(T::NAME)?)
            .publish_subscribe::<Wire<T>>()
            .open_with_attributes(&layout_requirement::<T>()?)
            .map_err(|e| open_error::<T>(T::NAME, e))
    }

    fn open_slice<H: SliceTopic>(&self) -> Result<SliceFactory<H>, BusError> {
        self.node
            .service_builder(&service_name(H::NAME)?)
            .publish_subscribe::<[Wire<H::Element>]>()
            .user_header::<Wire<H>>()
            .open_with_attributes(&layout_requirement::<H>()?)
            .map_err(|e| open_error::<H>(H::NAME, e))
    }

    fn open_bell(&self, name: &str) -> Result<event::PortFactory<Service>, BusError> {
        let service = service_name(&format!("bell/{name}"))?;
        self.node.service_builder(&service).event().open().map_err(|e| BusError::open(name, e))
    }

    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, BusError> {
        let limit = T::limits(&self.capacity).preallocated.unwrap_or(usize::MAX);
        let factory = self.open::<T>()?;
        let port = factory
            .publisher_builder()
            .max_loaned_samples(2)
            .override_sample_preallocation(move |worst| worst.min(limit))
            .create()
            .map_err(|e| BusError::open(T::NAME, e))?;
        Ok(Publisher(PublisherKind::Shared(Box::new(port))))
    }

    pub fn subscriber<T: Topic>(&self) -> Result<Subscriber<T>, BusError> {
        let factory = self.open::<T>()?;
        let port = factory.subscriber_builder().create().map_err(|e| BusError::open(T::NAME, e))?;
        Ok(Subscriber(SubscriberKind::Shared(Box::new(port), Patience::default())))
    }

    pub fn slice_publisher<H: SliceTopic>(&self) -> Result<SlicePublisher<H>, BusError> {
        let limit = H::limits(&self.capacity).preallocated.unwrap_or(usize::MAX);
        let factory = self.open_slice::<H>()?;
        let port = factory
            .publisher_builder()
            .max_loaned_samples(2)
            .initial_max_slice_len(H::FIRST_LENGTH)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .override_sample_preallocation(move |worst| worst.min(limit))
            .create()
            .map_err(|e| BusError::open(H::NAME, e))?;
        Ok(SlicePublisher(SlicePublisherKind::Shared(Box::new(port))))
    }

    pub fn slice_subscriber<H: SliceTopic>(&self) -> Result<SliceSubscriber<H>, BusError> {
        let factory = self.open_slice::<H>()?;
        let port = factory.subscriber_builder().create().map_err(|e| BusError::open(H::NAME, e))?;
        Ok(SliceSubscriber(SliceSubscriberKind::Shared(Box::new(port), Patience::default())))
    }

    pub fn listener(&self, name: &str) -> Result<Listener, BusError> {
        let port = self.open_bell(name)?.listener_builder().create().map_err(|e| BusError::open(name, e))?;
        Ok(Listener(ListenerKind::Shared(Box::new(port))))
    }

    pub fn ringer(&self, name: &str) -> Result<BellRinger, BusError> {
        let port = self.open_bell(name)?.notifier_builder().create().map_err(|e| BusError::open(name, e))?;
        Ok(BellRinger(RingerKind::Shared(Box::new(port))))
    }

    /// The limits of a topic in this set.
    pub fn capacity(&self) -> &Capacity {
        &self.capacity
    }
}

/// Asserts at start-up that no limit is nonsense.
pub fn assert_limits(limits: &Limits) {
    assert!(limits.publishers > 0 && limits.subscribers > 0 && limits.buffer > 0 && limits.borrowed > 0);
}

fn service_name(name: &str) -> Result<ServiceName, BusError> {
    ServiceName::new(&format!("flockslam/{name}")).map_err(|e| BusError::open(name, e))
}

fn layout_pair<T: Message>() -> Result<
    (iceoryx2::service::attribute::AttributeKey, iceoryx2::service::attribute::AttributeValue),
    BusError,
> {
    let text = format!("{:016x}", T::HASH);
    let key = LAYOUT_KEY.try_into().map_err(|e| BusError::open(T::TYPE_NAME, e))?;
    let value = text.as_str().try_into().map_err(|e| BusError::open(T::TYPE_NAME, e))?;
    Ok((key, value))
}

fn layout_attribute<T: Message>() -> Result<AttributeSpecifier, BusError> {
    let (key, value) = layout_pair::<T>()?;
    AttributeSpecifier::new().define(&key, &value).map_err(|e| BusError::open(T::TYPE_NAME, e))
}

fn layout_requirement<T: Message>() -> Result<AttributeVerifier, BusError> {
    let (key, value) = layout_pair::<T>()?;
    AttributeVerifier::new().require(&key, &value).map_err(|e| BusError::open(T::TYPE_NAME, e))
}

fn open_error<T: Message>(topic: &str, error: PublishSubscribeOpenError) -> BusError {
    match error {
        PublishSubscribeOpenError::IncompatibleAttributes | PublishSubscribeOpenError::IncompatibleTypes => {
            BusError::Disagree { topic: topic.to_owned(), message: T::TYPE_NAME, layout: T::HASH }
        }
        other => BusError::open(topic, other),
    }
}
