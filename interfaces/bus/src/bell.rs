use crate::BusError;
use crate::shared::Service;
use crossbeam::channel;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::port::notifier::NotifierNotifyError;
use iceoryx2::prelude::{EventId, FileDescriptorBased};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// What ended a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// Nobody has rung within the limit.
    TimedOut,
    /// There is something to look at.
    Rung,
    /// There will be, in a moment.
    Announced,
}

/// Event of a bell that rings for what will come; the default event is for what is there.
const ANNOUNCEMENT: usize = 1;

/// A stage's own bell: everything it could wait for rings it. Rings coalesce, so a woken stage drains all its inputs.
pub struct Listener(pub(crate) ListenerKind);

pub(crate) enum ListenerKind {
    Shared(Box<iceoryx2::port::listener::Listener<Service>>),
    Memory(channel::Receiver<()>),
}

impl Listener {
    /// Waits until somebody rings or `limit` has passed.
    ///
    /// # Errors
    /// When the bell itself is broken.
    pub fn wait(&self, limit: Duration) -> Result<Wake, BusError> {
        match &self.0 {
            ListenerKind::Shared(listener) => {
                sleep(listener.as_ref(), limit).map_err(|error| BusError::transfer("bell", error))?;
                let mut wake = Wake::TimedOut;
                let heard = listener.try_wait(|event| {
                    let announced = event.id.as_value() == ANNOUNCEMENT && wake != Wake::Rung;
                    wake = if announced { Wake::Announced } else { Wake::Rung };
                });
                match heard {
                    Ok(_) => Ok(wake),
                    Err(ListenerWaitError::InterruptSignal) => Ok(Wake::TimedOut),
                    Err(error) => Err(BusError::transfer("bell", error)),
                }
            }
            ListenerKind::Memory(receiver) => {
                Ok(if receiver.recv_timeout(limit).is_ok() { Wake::Rung } else { Wake::TimedOut })
            }
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
            RingerKind::Shared(notifier) => log_undelivered(notifier.notify()),
            RingerKind::Memory(bell) => bell.ring(),
        }
    }

    /// Rings for what will be there in a moment: who sleeps needs longer to wake up than to look.
    pub fn announce(&self) {
        match &self.0 {
            RingerKind::Shared(notifier) => {
                log_undelivered(notifier.notify_with_custom_event_id(EventId::new(ANNOUNCEMENT)));
            }
            RingerKind::Memory(bell) => bell.ring(),
        }
    }
}

/// A stopped stage leaves its bell full; it will find its inputs when it goes on.
fn log_undelivered(rung: Result<usize, NotifierNotifyError>) {
    if let Err(error) = rung {
        tracing::debug!(?error, "bell not delivered");
    }
}
