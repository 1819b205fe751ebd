//! What the service manager (systemd) learns of the supervisor: ready, alive, stopping.

use sd_notify::{NotifyState, notify, watchdog_enabled};
use std::time::{Duration, Instant};

/// The service manager that started the supervisor, if one did. It is notified when the set is ready, regularly that the
/// supervisor is alive, and when the set is being stopped.
pub struct ServiceManager {
    /// Time between two signs of life, if the service manager expects them.
    period: Option<Duration>,
    last: Option<Instant>,
}

impl ServiceManager {
    /// The one that started this process, by its environment (`NOTIFY_SOCKET`, `WATCHDOG_USEC`).
    pub fn from_environment() -> Self {
        // Half of the time that is allowed, as sd_watchdog_enabled(3) recommends.
        Self { period: watchdog_enabled().map(|allowed| allowed / 2), last: None }
    }

    /// The set works.
    pub fn ready(&self) {
        send(NotifyState::Ready);
    }

    /// The set is being stopped.
    pub fn stopping(&self) {
        send(NotifyState::Stopping);
    }

    /// The supervisor is alive; cheap when called often.
    pub fn alive(&mut self) {
        let Some(period) = self.period else { return };
        if self.last.is_none_or(|last| last.elapsed() >= period) {
            self.last = Some(Instant::now());
            send(NotifyState::Watchdog);
        }
    }
}

/// Does nothing where there is no service manager. A service manager that is gone does not stop the set.
fn send(state: NotifyState<'_>) {
    if let Err(error) = notify(&[state]) {
        tracing::debug!(%error, "the service manager was not notified");
    }
}
