//! Typed ports: publishers and subscribers of a topic, and the messages that they read in place.

use crate::transport::{Held, Lender, Source};
use crate::word_rows::{plain, plain_mut, slice, slice_mut, words_of, words_of_slice};
use crate::{BusError, SliceTopic, Topic};
use std::marker::PhantomData;
use std::ops::Deref;
use std::ptr::NonNull;

/// Sends messages of one topic.
pub struct Publisher<T: Topic>(Box<dyn Lender>, PhantomData<T>);

impl<T: Topic> Publisher<T> {
    pub(crate) fn new(lender: Box<dyn Lender>) -> Self {
        Self(lender, PhantomData)
    }

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
        let mut fill = Some(fill);
        self.0.send(words_of::<T>(), &mut |words| {
            let fill = fill.take().expect("a lender fills once");
            fill(plain_mut(words).expect("as many words as asked for"));
        })
    }

    /// Connects to readers that came since the last message.
    pub fn refresh(&self) {
        self.0.refresh();
    }
}

/// Receives messages of one topic, oldest first.
pub struct Subscriber<T: Topic>(Box<dyn Source>, PhantomData<T>);

impl<T: Topic> Subscriber<T> {
    pub(crate) fn new(source: Box<dyn Source>) -> Self {
        Self(source, PhantomData)
    }

    /// The next message, if one waits. It stays readable in the publisher's memory until the sample is dropped.
    ///
    /// # Errors
    /// When more samples are held than the topic allows, or a publisher that was killed while it was made is not cleaned up.
    pub fn receive(&self) -> Result<Option<Sample<T>>, BusError> {
        let Some(held) = self.0.receive()? else { return Ok(None) };
        match plain::<T>(held.words()).map(NonNull::from) {
            Some(message) => Ok(Some(Sample { message, _held: held })),
            None => Err(too_short(T::NAME)),
        }
    }
}

fn too_short(topic: &'static str) -> BusError {
    BusError::transfer(topic, "a message is shorter than it says")
}

/// A received message, read in place.
pub struct Sample<T: Topic> {
    /// In the memory that is held. Grids are read through this, cell by cell.
    message: NonNull<T>,
    _held: Held,
}

impl<T: Topic> Deref for Sample<T> {
    type Target = T;

    #[inline]
    fn deref(&self) -> &T {
        // SAFETY: it came from a reference into the memory that is held, which stays where it is when the sample moves, and is not
        // written as long as it is held.
        unsafe { self.message.as_ref() }
    }
}

/// Sends headers with slices.
pub struct SlicePublisher<H: SliceTopic>(Box<dyn Lender>, PhantomData<H>);

impl<H: SliceTopic> SlicePublisher<H> {
    pub(crate) fn new(lender: Box<dyn Lender>) -> Self {
        Self(lender, PhantomData)
    }

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
        let mut fill = Some(fill);
        self.0.send(words_of_slice::<H, H::Element>(length), &mut |words| {
            let fill = fill.take().expect("a lender fills once");
            fill(slice_mut(words, header, length).expect("as many words as asked for"));
        })
    }

    /// Connects to readers that came since the last message.
    pub fn refresh(&self) {
        self.0.refresh();
    }
}

/// Receives headers with slices, oldest first.
pub struct SliceSubscriber<H: SliceTopic>(Box<dyn Source>, PhantomData<H>);

impl<H: SliceTopic> SliceSubscriber<H> {
    pub(crate) fn new(source: Box<dyn Source>) -> Self {
        Self(source, PhantomData)
    }

    /// As [`Subscriber::receive`].
    ///
    /// # Errors
    /// As [`Subscriber::receive`].
    pub fn receive(&self) -> Result<Option<SliceSample<H>>, BusError> {
        let Some(held) = self.0.receive()? else { return Ok(None) };
        match slice::<H, H::Element>(held.words()) {
            Some(_) => Ok(Some(SliceSample(held, PhantomData))),
            None => Err(too_short(H::NAME)),
        }
    }
}

/// A received header with its slice, read in place.
pub struct SliceSample<H: SliceTopic>(Held, PhantomData<H>);

impl<H: SliceTopic> SliceSample<H> {
    fn parts(&self) -> (&H, &[H::Element]) {
        slice(self.0.words()).expect("looked at when it was received")
    }

    /// The header.
    pub fn header(&self) -> &H {
        self.parts().0
    }

    /// The elements.
    pub fn elements(&self) -> &[H::Element] {
        self.parts().1
    }
}
