//! iceoryx2 behind the ports: services with explicit limits, created by the host and opened by everybody else.

use crate::event::{Listener, Notifier};
use crate::half_made_guard::HalfMadeGuard;
use crate::room::{GivenPages, take_refused_bytes, with_first_bytes};
use crate::service::Service;
use crate::shared_event::{SharedListener, SharedNotifier};
use crate::shared_sample::SharedSample;
use crate::transport::{Held, Lender, Source, TopicSpec, Transport};
use crate::word_rows::Words;
use crate::{BusError, Capacity, Limits};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo, publisher, subscriber};
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use std::any::Any;
use std::cell::RefCell;

type Factory = publish_subscribe::PortFactory<Service, Words, ()>;

const LAYOUT_KEY: &str = "flockslam-layout";
const MESSAGE_KEY: &str = "flockslam-message";

/// A process' access to the shared memory of its set.
pub struct SharedBus {
    // Services are declared before their node, so that they are dropped first.
    services: Vec<Box<dyn Any>>,
    node: Node<Service>,
    capacity: Capacity,
}

impl SharedBus {
    /// Registers this process.
    pub fn new(name: &str, capacity: Capacity) -> Result<Self, BusError> {
        let setup = |reason: String| {
            let other = || BusError::Setup { place: "the node directory".to_owned(), reason };
            BusError::no_room("a node").unwrap_or_else(other)
        };
        take_refused_bytes();
        let name = NodeName::new(name).map_err(|e| setup(format!("{e:?}")))?;
        let node = NodeBuilder::new()
            .name(&name)
            // Own handlers decide what SIGTERM means; the default would swallow it.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|e| setup(format!("{e:?}")))?;
        Ok(Self { services: Vec::new(), node, capacity })
    }

    /// Creates the service of a topic, which lives as long as this.
    pub fn create(&mut self, topic: &TopicSpec) -> Result<(), BusError> {
        let limits = &topic.limits;
        assert_limits(limits);
        let builder = self.node.service_builder(&service_name(topic.name)?).publish_subscribe::<Words>();
        let created = builder
            .enable_safe_overflow(true)
            .history_size(0)
            .max_publishers(limits.publishers)
            .max_subscribers(limits.subscribers)
            .max_nodes(limits.publishers + limits.subscribers)
            .subscriber_max_buffer_size(limits.buffer)
            .subscriber_max_borrowed_samples(limits.borrowed)
            .create_with_attributes(&layout_attributes(topic)?);
        self.services.push(Box::new(created.map_err(|e| BusError::open(topic.name, e))?));
        Ok(())
    }

    /// Creates the event of this name.
    pub fn create_event(&mut self, name: &str) -> Result<(), BusError> {
        let replicas = self.capacity.replicas + 1;
        let created = self
            .node
            .service_builder(&service_name(&format!("event/{name}"))?)
            .event()
            .max_listeners(replicas)
            // Every stage, the supervisor and outside programs may notify.
            .max_notifiers(6 * replicas + 4)
            .max_nodes(7 * replicas + 4)
            .event_id_max_value(1)
            .create();
        self.services.push(Box::new(created.map_err(|e| BusError::open(name, e))?));
        Ok(())
    }

    fn open(&self, topic: &TopicSpec) -> Result<Factory, BusError> {
        self.node
            .service_builder(&service_name(topic.name)?)
            .publish_subscribe::<Words>()
            .open_with_attributes(&layout_requirement(topic)?)
            .map_err(|e| open_error(topic, e))
    }

    fn open_event(&self, name: &str) -> Result<event::PortFactory<Service>, BusError> {
        let service = service_name(&format!("event/{name}"))?;
        self.node.service_builder(&service).event().open().map_err(|e| BusError::open(name, e))
    }
}

impl Transport for SharedBus {
    fn lender(&self, topic: &TopicSpec) -> Result<Box<dyn Lender>, BusError> {
        let limit = topic.limits.preallocated.unwrap_or(usize::MAX);
        let growth = if topic.grows { AllocationStrategy::PowerOfTwo } else { AllocationStrategy::Static };
        let factory = self.open(topic)?;
        let builder = factory
            .publisher_builder()
            .max_loaned_samples(2)
            .initial_max_slice_len(topic.words)
            .allocation_strategy(growth)
            .set_degradation_handler(unconnected(topic.name))
            .override_sample_preallocation(move |worst| worst.min(limit));
        let created = with_first_bytes(topic.reserved_bytes(), || builder.create());
        let port = made(topic.name, created)?;
        let pages = (!topic.is_whole()).then(|| RefCell::new(GivenPages::default()));
        Ok(Box::new(SharedLender { topic: topic.name, port, pages }))
    }

    fn source(&self, topic: &TopicSpec) -> Result<Box<dyn Source>, BusError> {
        let factory = self.open(topic)?;
        let port = made(
            topic.name,
            factory.subscriber_builder().set_degradation_handler(unconnected(topic.name)).create(),
        )?;
        Ok(Box::new(SharedSource { topic: topic.name, port, guard: HalfMadeGuard::default() }))
    }

    fn listener(&self, name: &str) -> Result<Listener, BusError> {
        let port = made(name, self.open_event(name)?.listener_builder().create())?;
        Ok(Listener::new(Box::new(SharedListener(port))))
    }

    fn notifier(&self, name: &str) -> Result<Notifier, BusError> {
        let port = made(name, self.open_event(name)?.notifier_builder().create())?;
        Ok(Notifier::new(Box::new(SharedNotifier(port))))
    }

    fn clean_dead_nodes(&self) -> (u64, u64) {
        let state = self.node.try_cleanup_dead_nodes();
        (state.cleanups, state.failed_cleanups)
    }
}

struct SharedLender {
    topic: &'static str,
    port: publisher::Publisher<Service, Words, ()>,
    /// Pages that its messages have got; `None` when all of its memory was there when it was made.
    pages: Option<RefCell<GivenPages>>,
}

impl Lender for SharedLender {
    fn send(&self, words: usize, fill: &mut dyn FnMut(&mut Words)) -> Result<(), BusError> {
        let wrong = |error: &dyn std::fmt::Debug| BusError::transfer(self.topic, error);
        let mut slot = self.port.loan_slice_uninit(words).map_err(|e| wrong(&e))?;
        let is_given = |pages: &RefCell<GivenPages>| pages.borrow_mut().give(slot.payload_mut());
        if !self.pages.as_ref().is_none_or(is_given) {
            return Err(BusError::out_of_room(self.topic, (words * size_of::<u64>()) as u64));
        }
        slot.payload_mut().iter_mut().for_each(|word| {
            word.write(0);
        });
        // SAFETY: every word was written above.
        let mut slot = unsafe { slot.assume_init() };
        fill(slot.payload_mut());
        slot.send().map_err(|e| wrong(&e))?;
        Ok(())
    }

    fn refresh(&self) {
        let _ = self.port.update_connections();
    }
}

struct SharedSource {
    topic: &'static str,
    port: subscriber::Subscriber<Service, Words, ()>,
    guard: HalfMadeGuard,
}

impl Source for SharedSource {
    fn receive(&self) -> Result<Option<Held>, BusError> {
        let sample = self.guard.pass(self.topic, self.port.receive())?;
        Ok(sample.map(|sample| Held::Shared(SharedSample::new(sample))))
    }
}

/// Logs a connection that cannot be made or is broken: iceoryx2 goes on without it, and what passes there is lost. Mostly the other process has
/// ended at that moment, so it is no warning.
fn unconnected(topic: &'static str) -> impl Fn(DegradationCause, &DegradationInfo) -> DegradationAction {
    move |cause, ports| {
        let cause = match cause {
            DegradationCause::FailedToEstablishConnection => "it cannot be made",
            DegradationCause::ConnectionCorrupted => "it is broken",
        };
        let (from, to) = (ports.sender_port_id, ports.receiver_port_id);
        tracing::debug!(topic, from, to, cause, "a connection is missing");
        DegradationAction::Ignore
    }
}

/// A port that was made whole. Where memory is used up iceoryx2 makes ports that some of the others cannot reach.
fn made<P, E: std::fmt::Debug>(name: &str, created: Result<P, E>) -> Result<P, BusError> {
    match BusError::no_room(name) {
        Some(error) => Err(error),
        None => created.map_err(|e| BusError::open(name, e)),
    }
}

/// Asserts at start-up that no limit is nonsense.
fn assert_limits(limits: &Limits) {
    assert!(limits.publishers > 0 && limits.subscribers > 0 && limits.buffer > 0 && limits.borrowed > 0);
}

fn service_name(name: &str) -> Result<ServiceName, BusError> {
    ServiceName::new(&format!("flockslam/{name}")).map_err(|e| BusError::open(name, e))
}

/// What a process and the creator of a topic must agree on: name, version and layout of its message.
fn layout_pairs(topic: &TopicSpec) -> Result<[(AttributeKey, AttributeValue); 2], BusError> {
    let pair = |key: &str, value: &str| -> Result<(AttributeKey, AttributeValue), BusError> {
        let key = key.try_into().map_err(|e| BusError::open(topic.message, e))?;
        Ok((key, value.try_into().map_err(|e| BusError::open(topic.message, e))?))
    };
    Ok([pair(LAYOUT_KEY, &format!("{:016x}", topic.layout))?, pair(MESSAGE_KEY, topic.message)?])
}

fn layout_attributes(topic: &TopicSpec) -> Result<AttributeSpecifier, BusError> {
    let defined = layout_pairs(topic)?
        .iter()
        .try_fold(AttributeSpecifier::new(), |all, (key, value)| all.define(key, value));
    defined.map_err(|e| BusError::open(topic.message, e))
}

fn layout_requirement(topic: &TopicSpec) -> Result<AttributeVerifier, BusError> {
    let required = layout_pairs(topic)?
        .iter()
        .try_fold(AttributeVerifier::new(), |all, (key, value)| all.require(key, value));
    required.map_err(|e| BusError::open(topic.message, e))
}

fn open_error(topic: &TopicSpec, error: PublishSubscribeOpenError) -> BusError {
    match error {
        PublishSubscribeOpenError::IncompatibleAttributes | PublishSubscribeOpenError::IncompatibleTypes => {
            BusError::Disagree { topic: topic.name.to_owned(), message: topic.message, layout: topic.layout }
        }
        other => BusError::open(topic.name, other),
    }
}
