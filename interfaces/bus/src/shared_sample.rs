//! A message in shared memory, held as long as it is read.

use crate::service::Service;
use crate::word_rows::Words;
use std::mem::ManuallyDrop;

/// A message in the publisher's memory. It is dropped by hand, so that iceoryx2's part of that is compiled here and not in each
/// crate that holds messages.
pub struct SharedSample(ManuallyDrop<iceoryx2::sample::Sample<Service, Words, ()>>);

impl SharedSample {
    /// Takes hold of a sample.
    pub fn new(sample: iceoryx2::sample::Sample<Service, Words, ()>) -> Self {
        Self(ManuallyDrop::new(sample))
    }

    /// What was sent.
    pub fn words(&self) -> &Words {
        self.0.payload()
    }
}

impl Drop for SharedSample {
    #[inline(never)]
    fn drop(&mut self) {
        // SAFETY: this is the only place that drops it, and nothing can use it afterwards.
        unsafe { ManuallyDrop::drop(&mut self.0) }
    }
}
