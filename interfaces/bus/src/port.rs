use crate::memory::MemoryTopic;
use crate::patience::Patience;
use crate::shared::Service;
use crate::wire::{Wire, unwrap_slice, unwrap_slice_mut};
use crate::{BusError, SliceTopic, Topic};
use crossbeam::channel::Receiver;
use iceoryx2::port::{publisher, subscriber, update_connections::UpdateConnections};
use std::ops::Deref;
use std::sync::Arc;

type SharedSlicePublisher<H> = publisher::Publisher<Service, [Wire<<H as SliceTopic>::Element>], Wire<H>>;
type SharedSliceSubscriber<H> = subscriber::Subscriber<Service, [Wire<<H as SliceTopic>::Element>], Wire<H>>;

/// Sends messages of one topic.
pub struct Publisher<T: Topic>(pub(crate) PublisherKind<T>);

pub(crate) enum PublisherKind<T: Topic> {
    Shared(Box<publisher::Publisher<Service, Wire<T>, ()>>),
    Memory(MemoryTopic<T>),
}

impl<T: Topic> Publisher<T> {
    /// Sends a copy of a small message.
    ///
    /// # Errors
    /// When no memory is free or a connection is broken.
    pub fn send(&self, message: &T) -> Result<(), BusError> {
        self.send_with(|slot| *slot = *message)
    }

    /// Lends zeroed memory that all readers will see, lets `fill` write the message there, and sends it.
    ///
    /// # Errors
    /// As [`Publisher::send`].
    pub fn send_with(&self, fill: impl FnOnce(&mut T)) -> Result<(), BusError> {
        match &self.0 {
            PublisherKind::Shared(publisher) => {
                let mut slot = publisher.loan_uninit().map_err(|e| BusError::transfer(T::NAME, e))?;
                let place = slot.payload_mut();
                // SAFETY: the loan is exclusive and as large as T; `Message` types are valid for all-zero bytes.
                let message = unsafe {
                    place.as_mut_ptr().write_bytes(0, 1);
                    &mut (*place.as_mut_ptr()).0
                };
                fill(message);
                // SAFETY: all bytes were written above.
                let slot = unsafe { slot.assume_init() };
                slot.send().map_err(|e| BusError::transfer(T::NAME, e))?;
            }
            PublisherKind::Memory(topic) => {
                let mut message = T::new_zeroed();
                fill(&mut message);
                topic.send(message);
            }
        }
        Ok(())
    }

    /// Connects to readers that came since the last message.
    pub fn refresh(&self) {
        if let PublisherKind::Shared(publisher) = &self.0 {
            let _ = publisher.update_connections();
        }
    }
}

/// Receives messages of one topic, oldest first.
pub struct Subscriber<T: Topic>(pub(crate) SubscriberKind<T>);

pub(crate) enum SubscriberKind<T: Topic> {
    Shared(Box<subscriber::Subscriber<Service, Wire<T>, ()>>, Patience),
    Memory(Receiver<Arc<T>>),
}

impl<T: Topic> Subscriber<T> {
    /// The next message, if one waits. It stays readable in the publisher's memory until the sample is dropped.
    ///
    /// # Errors
    /// When more samples are held than the topic allows, or a publisher that was killed while it was made is not cleaned up.
    pub fn receive(&self) -> Result<Option<Sample<T>>, BusError> {
        match &self.0 {
            SubscriberKind::Shared(subscriber, patience) => {
                let sample = patience.bear(T::NAME, subscriber.receive())?;
                Ok(sample.map(|sample| Sample(SampleKind::Shared(sample))))
            }
            SubscriberKind::Memory(receiver) => {
                Ok(receiver.try_recv().ok().map(|m| Sample(SampleKind::Memory(m))))
            }
        }
    }
}

/// A received message, read in place.
pub struct Sample<T: Topic>(SampleKind<T>);

enum SampleKind<T: Topic> {
    Shared(iceoryx2::sample::Sample<Service, Wire<T>, ()>),
    Memory(Arc<T>),
}

impl<T: Topic> Deref for Sample<T> {
    type Target = T;

    fn deref(&self) -> &T {
        match &self.0 {
            SampleKind::Shared(sample) => &sample.payload().0,
            SampleKind::Memory(message) => message,
        }
    }
}

/// Sends headers with slices.
pub struct SlicePublisher<H: SliceTopic>(pub(crate) SlicePublisherKind<H>);

pub(crate) enum SlicePublisherKind<H: SliceTopic> {
    Shared(Box<SharedSlicePublisher<H>>),
    Memory(MemoryTopic<(H, Vec<H::Element>)>),
}

impl<H: SliceTopic> SlicePublisher<H> {
    /// Lends zeroed memory for `length` elements, lets `fill` write them there, and sends them behind `header`.
    ///
    /// # Errors
    /// When no memory is free or a connection is broken.
    pub fn send_with(
        &self,
        header: &H,
        length: usize,
        fill: impl FnOnce(&mut [H::Element]),
    ) -> Result<(), BusError> {
        match &self.0 {
            SlicePublisherKind::Shared(publisher) => {
                let mut slot =
                    publisher.loan_slice_uninit(length).map_err(|e| BusError::transfer(H::NAME, e))?;
                *slot.user_header_mut() = Wire(*header);
                let place = slot.payload_mut();
                // SAFETY: the loan is exclusive; elements are valid for all-zero bytes and every byte is written here.
                let elements = unsafe {
                    place.as_mut_ptr().write_bytes(0, place.len());
                    core::slice::from_raw_parts_mut(
                        place.as_mut_ptr().cast::<Wire<H::Element>>(),
                        place.len(),
                    )
                };
                fill(unwrap_slice_mut(elements));
                // SAFETY: all bytes were written above.
                let slot = unsafe { slot.assume_init() };
                slot.send().map_err(|e| BusError::transfer(H::NAME, e))?;
            }
            SlicePublisherKind::Memory(topic) => {
                let mut elements = vec![zerocopy::FromZeros::new_zeroed(); length];
                fill(&mut elements);
                topic.send((*header, elements));
            }
        }
        Ok(())
    }

    /// Connects to readers that came since the last message.
    pub fn refresh(&self) {
        if let SlicePublisherKind::Shared(publisher) = &self.0 {
            let _ = publisher.update_connections();
        }
    }
}

/// Receives headers with slices, oldest first.
pub struct SliceSubscriber<H: SliceTopic>(pub(crate) SliceSubscriberKind<H>);

pub(crate) enum SliceSubscriberKind<H: SliceTopic> {
    Shared(Box<SharedSliceSubscriber<H>>, Patience),
    Memory(Receiver<Arc<(H, Vec<H::Element>)>>),
}

impl<H: SliceTopic> SliceSubscriber<H> {
    /// As [`Subscriber::receive`].
    ///
    /// # Errors
    /// As [`Subscriber::receive`].
    pub fn receive(&self) -> Result<Option<SliceSample<H>>, BusError> {
        match &self.0 {
            SliceSubscriberKind::Shared(subscriber, patience) => {
                let sample = patience.bear(H::NAME, subscriber.receive())?;
                Ok(sample.map(|sample| SliceSample(SliceSampleKind::Shared(sample))))
            }
            SliceSubscriberKind::Memory(receiver) => {
                Ok(receiver.try_recv().ok().map(|m| SliceSample(SliceSampleKind::Memory(m))))
            }
        }
    }
}

/// A received header with its slice, read in place.
pub struct SliceSample<H: SliceTopic>(SliceSampleKind<H>);

enum SliceSampleKind<H: SliceTopic> {
    Shared(iceoryx2::sample::Sample<Service, [Wire<H::Element>], Wire<H>>),
    Memory(Arc<(H, Vec<H::Element>)>),
}

impl<H: SliceTopic> SliceSample<H> {
    /// The header.
    pub fn header(&self) -> &H {
        match &self.0 {
            SliceSampleKind::Shared(sample) => &sample.user_header().0,
            SliceSampleKind::Memory(message) => &message.0,
        }
    }

    /// The elements.
    pub fn elements(&self) -> &[H::Element] {
        match &self.0 {
            SliceSampleKind::Shared(sample) => unwrap_slice(sample.payload()),
            SliceSampleKind::Memory(message) => &message.1,
        }
    }
}
