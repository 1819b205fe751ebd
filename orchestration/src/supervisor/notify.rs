//! The protocol of systemd's service notification, as far as the supervisor needs it: ready, alive, stopping.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// The service manager (systemd) that watches over the supervisor, when there is one: it is told when the set is ready and, again
/// and again, that the supervisor is alive.
pub struct ServiceManager {
    socket: Option<(UnixDatagram, SocketAddr)>,
    period: Option<Duration>,
    last: Option<Instant>,
}

impl ServiceManager {
    /// The one that started this process, by its environment (`NOTIFY_SOCKET`, `WATCHDOG_USEC`).
    pub fn from_environment() -> Self {
        let period = std::env::var("WATCHDOG_USEC").ok().and_then(|usec| usec.parse().ok());
        Self::at(std::env::var("NOTIFY_SOCKET").ok().as_deref(), period.map(Duration::from_micros))
    }

    /// The one that listens at `address` (a path, or `@` and an abstract name) and expects a word within each `watchdog`.
    fn at(address: Option<&str>, watchdog: Option<Duration>) -> Self {
        let address = address.and_then(|address| match address.strip_prefix('@') {
            Some(name) => SocketAddr::from_abstract_name(name).ok(),
            None => SocketAddr::from_pathname(address).ok(),
        });
        let socket = address.and_then(|address| Some((UnixDatagram::unbound().ok()?, address)));
        // Twice within the time that is allowed, as its manual asks for.
        Self { socket, period: watchdog.map(|watchdog| watchdog / 2), last: None }
    }

    /// The set works.
    pub fn ready(&self) {
        self.tell("READY=1");
    }

    /// The set is being stopped.
    pub fn stopping(&self) {
        self.tell("STOPPING=1");
    }

    /// The supervisor is alive; cheap when called often.
    pub fn alive(&mut self) {
        let Some(period) = self.period else { return };
        if self.last.is_none_or(|last| last.elapsed() >= period) {
            self.last = Some(Instant::now());
            self.tell("WATCHDOG=1");
        }
    }

    fn tell(&self, word: &str) {
        if let Some((socket, address)) = &self.socket {
            // Nobody listens any more: the set goes on all the same.
            let _ = socket.send_to_addr(word.as_bytes(), address);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_service_manager_hears_what_systemd_expects() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("notify");
        let listener = UnixDatagram::bind(&path).unwrap();
        let mut manager = ServiceManager::at(path.to_str(), Some(Duration::ZERO));
        manager.ready();
        manager.alive();
        manager.stopping();
        let heard = || {
            let mut bytes = [0; 32];
            let length = listener.recv(&mut bytes).unwrap();
            String::from_utf8_lossy(&bytes[..length]).into_owned()
        };
        assert_eq!([heard(), heard(), heard()], ["READY=1", "WATCHDOG=1", "STOPPING=1"]);
        ServiceManager::at(None, None).ready();
    }
}
