//! Which robots are near: all that are connected, or those that an outside program reports on a socket.

use crate::settings::{FlockSettings, ProximitySource};
use flockslam_stage::StageError;
use std::collections::BTreeMap;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::{Duration, Instant};

/// Contacts that are kept at once.
const CONTACTS_MAX: usize = 256;
/// A report lasts no longer than this, seconds.
const LASTING_MAX_S: f64 = 3600.0;
/// Name of the socket in the set's status directory.
const SOCKET: &str = "contacts";

/// Robots that are near: records are exchanged only with those.
pub trait Proximity: Send {
    /// Whether the robot with this address, which is connected, is near now.
    fn is_near(&mut self, address: &str, now: Instant) -> bool;
}

/// The source that settings name; `status_dir` is where a socket for reports is made.
///
/// # Errors
/// When the socket cannot be made.
pub fn proximity(settings: &FlockSettings, status_dir: &Path) -> Result<Box<dyn Proximity>, StageError> {
    match settings.proximity {
        ProximitySource::Always => Ok(Box::new(Always)),
        ProximitySource::Contacts => Ok(Box::new(Contacts::open(&status_dir.join(SOCKET))?)),
    }
}

/// Whoever is connected is near.
struct Always;

impl Proximity for Always {
    fn is_near(&mut self, _address: &str, _now: Instant) -> bool {
        true
    }
}

/// Near are the robots that an outside program reports, in datagrams on a socket: `near NAME SECONDS`, one or several lines. The robot of that
/// name is near for so long from then on; 0 ends it. A line that is something else is ignored.
struct Contacts {
    socket: UnixDatagram,
    until: BTreeMap<String, Instant>,
}

impl Contacts {
    fn open(path: &Path) -> Result<Self, StageError> {
        // A predecessor's.
        let _ = std::fs::remove_file(path);
        let wrong = |error| StageError::file(path, error);
        let socket = UnixDatagram::bind(path).map_err(wrong)?;
        socket.set_nonblocking(true).map_err(wrong)?;
        Ok(Self { socket, until: BTreeMap::new() })
    }

    fn receive(&mut self, now: Instant) {
        let mut bytes = [0; 4096];
        // As many as a peer may be asked about between two looks.
        for _ in 0..CONTACTS_MAX {
            let Ok(length) = self.socket.recv(&mut bytes) else { break };
            let text = String::from_utf8_lossy(&bytes[..length]).into_owned();
            text.lines().for_each(|line| self.take(line, now));
        }
        self.until.retain(|_, until| *until > now);
    }

    fn take(&mut self, line: &str, now: Instant) {
        let mut words = line.split_whitespace();
        let (Some("near"), Some(name), Some(seconds), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return;
        };
        let Some(lasting_s) = seconds.parse::<f64>().ok().filter(|s| (0.0..=LASTING_MAX_S).contains(s))
        else {
            return;
        };
        if self.until.contains_key(name) || self.until.len() < CONTACTS_MAX {
            self.until.insert(name.to_owned(), now + Duration::from_secs_f64(lasting_s));
        }
    }
}

impl Proximity for Contacts {
    fn is_near(&mut self, address: &str, now: Instant) -> bool {
        self.receive(now);
        // An address is the name, and then digits of the key.
        let name = address.rsplit_once('-').map_or(address, |(name, _)| name);
        [address, name].iter().any(|known| self.until.contains_key(*known))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reported_contact_expires_after_its_duration() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("contacts");
        let (mut contacts, now) = (Contacts::open(&path).unwrap(), Instant::now());
        let report = |text: &str| drop(UnixDatagram::unbound().unwrap().send_to(text.as_bytes(), &path));
        assert!(!contacts.is_near("a-b-0123", now));
        report("near a-b 2\nnear c 5 6\nfar d 3\nnear e nan\nnear f 1e9\n");
        assert!(contacts.is_near("a-b-0123", now) && contacts.is_near("a-b-4567", now));
        assert!(["c-01", "d-01", "e-01", "f-01"].iter().all(|address| !contacts.is_near(address, now)));
        assert!(!contacts.is_near("a-b-0123", now + Duration::from_secs(3)));
        report("near a-b 9");
        assert!(contacts.is_near("a-b-0123", now));
        report("near a-b 0");
        assert!(!contacts.is_near("a-b-0123", now + Duration::from_millis(1)));
    }
}
