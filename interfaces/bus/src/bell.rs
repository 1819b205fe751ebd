use crate::BusError;
use crate::shared::Service;
use crossbeam::channel;
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
                let mut rang = false;
                let note = |_| rang = true;
                // The system counts in microseconds, and a limit of none would be no limit.
                let waited = if limit < Duration::from_micros(1) {
                    listener.try_wait(note)
                } else {
                    listener.timed_wait(note, limit)
                };
                match waited {
                    Ok(_) => Ok(rang),
                    // A signal (SIGSTOP and SIGCONT among them) only cuts the wait short.
                    Err(iceoryx2::port::listener::ListenerWaitError::InterruptSignal) => Ok(false),
                    Err(error) => Err(BusError::transfer("bell", error)),
                }
            }
            ListenerKind::Memory(receiver) => Ok(receiver.recv_timeout(limit).is_ok()),
        }
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
