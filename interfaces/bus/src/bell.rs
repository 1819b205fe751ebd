use crate::BusError;
use crate::shared::Service;
use crossbeam::channel;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::FileDescriptorBased;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// A stage's own bell: everything it could wait for rings it. Rings coalesce, so a woken stage drains all its inputs.
pub struct Listener(pub(crate) ListenerKind);

pub(crate) enum ListenerKind {
    Shared(Box<iceoryx2::port::listener::Listener<Service>>),
    Memory(channel::Receiver<()>),
}

impl Listener {
    /// Waits until somebody rings or `limit` has passed; true when it rang.
    ///
    /// # Errors
    /// When the bell itself is broken.
    pub fn wait(&self, limit: Duration) -> Result<bool, BusError> {
        match &self.0 {
            ListenerKind::Shared(listener) => {
                sleep(listener.as_ref(), limit).map_err(|error| BusError::transfer("bell", error))?;
                let mut rang = false;
                match listener.try_wait(|_| rang = true) {
                    Ok(_) => Ok(rang),
                    Err(ListenerWaitError::InterruptSignal) => Ok(false),
                    Err(error) => Err(BusError::transfer("bell", error)),
                }
            }
            ListenerKind::Memory(receiver) => Ok(receiver.recv_timeout(limit).is_ok()),
        }
    }
}

/// Sleeps until the bell has rung or `limit` has passed: the listener's own wait counts in ticks of the system, which are several
/// milliseconds, and takes twice as many system calls. A signal (SIGSTOP and SIGCONT among them) only cuts it short.
fn sleep(listener: &impl FileDescriptorBased, limit: Duration) -> Result<(), Errno> {
    let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
    // SAFETY: the descriptor is the listener's, which outlives this call, and nothing is done to it but waiting.
    let socket = unsafe { BorrowedFd::borrow_raw(listener.file_descriptor().native_handle()) };
    match poll(&mut [PollFd::new(&socket, PollFlags::IN)], Some(&limit)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error),
    }
}

/// Rings the bell of one stage (all of its replicas).
pub struct BellRinger(pub(crate) RingerKind);

pub(crate) enum RingerKind {
    Shared(Box<iceoryx2::port::notifier::Notifier<Service>>),
    Memory(crate::memory::MemoryBell),
}

impl BellRinger {
    /// Rings. A listener that is gone, or whose bell is still ringing, is no error.
    pub fn ring(&self) {
        match &self.0 {
            RingerKind::Shared(notifier) => {
                // A stopped stage leaves its bell full; it will find its inputs when it goes on.
                if let Err(error) = notifier.notify() {
                    tracing::debug!(?error, "bell not delivered");
                }
            }
            RingerKind::Memory(bell) => bell.ring(),
        }
    }
}
