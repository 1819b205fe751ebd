//! Events between processes: events of iceoryx2.

use crate::BusError;
use crate::event::{NotifyPort, WaitPort, Wake};
use crate::service::Service;
use iceoryx2::port::listener::{self, ListenerWaitError};
use iceoryx2::port::notifier::{self, NotifierNotifyError};
use iceoryx2::prelude::{EventId, FileDescriptorBased};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::os::fd::BorrowedFd;
use std::time::Duration;

/// Number of a notification of what will come; the default one is of what is there.
const ANNOUNCEMENT: usize = 1;

pub(crate) struct SharedListener(pub(crate) listener::Listener<Service>);

impl WaitPort for SharedListener {
    fn wait(&self, limit: Duration) -> Result<Wake, BusError> {
        sleep(&self.0, limit).map_err(|error| BusError::transfer("event", error))?;
        let mut wake = Wake::TimedOut;
        let waited = self.0.try_wait(|event| {
            let announced = event.id.as_value() == ANNOUNCEMENT && wake != Wake::Notified;
            wake = if announced { Wake::Announced } else { Wake::Notified };
        });
        match waited {
            Ok(_) => Ok(wake),
            Err(ListenerWaitError::InterruptSignal) => Ok(Wake::TimedOut),
            Err(error) => Err(BusError::transfer("event", error)),
        }
    }
}

/// Sleeps until the event was notified or `limit` has passed: the listener's own wait counts in ticks of the system, which are several
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

pub(crate) struct SharedNotifier(pub(crate) notifier::Notifier<Service>);

impl NotifyPort for SharedNotifier {
    fn notify(&self) {
        log_undelivered(self.0.notify());
    }

    fn announce(&self) {
        log_undelivered(self.0.notify_with_custom_event_id(EventId::new(ANNOUNCEMENT)));
    }
}

/// A stopped stage leaves its event full; it will find its inputs when it goes on.
fn log_undelivered(notified: Result<usize, NotifierNotifyError>) {
    if let Err(error) = notified {
        tracing::debug!(?error, "event not delivered");
    }
}
