//! Settings of the flock: names, addresses, trust.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The robots that this one shares its map with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlockSettings {
    /// Name of this robot in its flock: letters, digits, `-`, `_` and `.`, at most 32; empty = it is alone and keeps no records.
    pub name: String,
    /// Whether the robot exchanges records with others over the network; otherwise it only keeps its own, for `flockslam store merge`.
    pub enabled: bool,
    /// Name of the flock: robots of different flocks do not exchange anything.
    pub flock: String,
    /// Where the robot can be reached, as endpoints of zenoh: `tcp/0.0.0.0:7447`, or `tls/…` with certificates.
    pub listen: Vec<String>,
    /// Where other robots can be reached; those that are not there yet are tried again and again.
    pub connect: Vec<String>,
    /// Whether robots look for each other by multicast in the local network.
    pub multicast: bool,
    /// Who is near, so that records are exchanged with it: `always` – Whoever is connected; `contacts` – Whom an outside program
    /// reports on the set's socket.
    pub proximity: ProximitySource,
    /// File with the robot's secret key and the number of its last epoch, made when it is not there; empty = `flock.key` beside
    /// the saved map, or, without one, a key that goes with the set.
    pub key_file: PathBuf,
    /// Public keys of the robots whose records are used, hexadecimal; empty = all that are not banned.
    pub trusted: Vec<String>,
    /// Public keys of robots whose records are dropped.
    pub banned: Vec<String>,
    /// Certificate of the authority that all robots of the flock are certified by (PEM); with it and the next two only robots that
    /// it has certified are connected.
    pub tls_ca: PathBuf,
    /// This robot's certificate (PEM).
    pub tls_certificate: PathBuf,
    /// The key of the certificate (PEM).
    pub tls_key: PathBuf,
    /// Further configuration of zenoh (JSON5), for example access control; what the other keys say goes over it.
    pub zenoh_file: PathBuf,
    /// When the source has ended, the robot stays in the flock until so many others have ended too …
    pub wait_for_robots: usize,
    /// … and all know the same, but no longer than this, seconds.
    pub wait_max_s: f64,
}

/// How near robots are determined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProximitySource {
    /// Whoever is connected.
    #[default]
    Always,
    /// Whom an outside program reports on the set's socket.
    Contacts,
}

impl Default for FlockSettings {
    fn default() -> Self {
        Self {
            name: String::new(),
            enabled: false,
            flock: "flock".to_owned(),
            listen: Vec::new(),
            connect: Vec::new(),
            multicast: false,
            proximity: ProximitySource::Always,
            key_file: PathBuf::new(),
            trusted: Vec::new(),
            banned: Vec::new(),
            tls_ca: PathBuf::new(),
            tls_certificate: PathBuf::new(),
            tls_key: PathBuf::new(),
            zenoh_file: PathBuf::new(),
            wait_for_robots: 0,
            wait_max_s: 10.0,
        }
    }
}

impl FlockSettings {
    /// Whether only certified robots are connected.
    pub fn uses_tls(&self) -> bool {
        !self.tls_ca.as_os_str().is_empty()
    }

    /// The public keys of a list.
    pub fn keys(listed: &[String]) -> Option<Vec<[u8; 32]>> {
        let digit = |text: &str| u8::from_str_radix(text, 16).ok();
        let key = |text: &String| {
            let plain = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
            let bytes: Option<Vec<u8>> =
                (0..32).map(|i| digit(text.get(2 * i..2 * i + 2)?)).collect::<Option<_>>();
            bytes.filter(|_| plain).and_then(|bytes| bytes.try_into().ok())
        };
        listed.iter().map(key).collect()
    }

    /// Says what cannot be: (key, reason).
    ///
    /// # Errors
    /// `Err` with the key below `sync_manager.flock` and what is wrong with it.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        let plain = |text: &str| {
            let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
            text.len() <= 32 && text.chars().all(fits)
        };
        let secret = [&self.tls_ca, &self.tls_certificate, &self.tls_key];
        let given = secret.iter().filter(|path| !path.as_os_str().is_empty()).count();
        let mut endpoints = self.listen.iter().chain(&self.connect);
        let transports: &[&str] = if given == 3 { &["tls/"] } else { &["tcp/"] };
        let rules = [
            (plain(&self.name), "name", "letters, digits, '-', '_' and '.', at most 32"),
            (!self.enabled || !self.name.is_empty(), "name", "a robot that exchanges records needs a name"),
            (
                plain(&self.flock) && !self.flock.is_empty(),
                "flock",
                "letters, digits, '-', '_' and '.', at most 32",
            ),
            (Self::keys(&self.trusted).is_some(), "trusted", "a public key has 64 hexadecimal digits"),
            (Self::keys(&self.banned).is_some(), "banned", "a public key has 64 hexadecimal digits"),
            (given == 0 || given == 3, "tls_ca", "give tls_ca, tls_certificate and tls_key, or none of them"),
            (
                endpoints.all(|endpoint| transports.iter().any(|transport| endpoint.starts_with(transport))),
                "listen",
                "endpoints are tcp/ADDRESS:PORT; with certificates tls/ADDRESS:PORT, and no others",
            ),
        ];
        rules.into_iter().find(|(kept, ..)| !kept).map_or(Ok(()), |(_, key, rule)| Err((key, rule)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_named() {
        let wrong = |change: fn(&mut FlockSettings)| {
            let mut settings = FlockSettings::default();
            change(&mut settings);
            settings.check().err().map(|(key, _)| key)
        };
        assert_eq!(wrong(|_| ()), None);
        assert_eq!(wrong(|s| s.enabled = true), Some("name"));
        assert_eq!(wrong(|s| s.flock = "a/b".to_owned()), Some("flock"));
        assert_eq!(wrong(|s| s.banned = vec!["0f".to_owned()]), Some("banned"));
        assert_eq!(wrong(|s| s.trusted = vec!["0F".repeat(32)]), None);
        assert_eq!(wrong(|s| s.tls_ca = "ca.pem".into()), Some("tls_ca"));
        assert_eq!(wrong(|s| s.listen = vec!["udp/0.0.0.0:1".to_owned()]), Some("listen"));
        let open = |s: &mut FlockSettings| {
            (s.tls_ca, s.tls_certificate, s.tls_key) = ("a".into(), "b".into(), "c".into());
            s.listen = vec!["tcp/0.0.0.0:1".to_owned()];
        };
        assert_eq!(wrong(open), Some("listen"), "an open door beside the locked one");
    }
}
