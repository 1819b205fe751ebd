//! The one place that opens the network between robots.

use super::drops::{Dropped, Drops};
use super::thread_state::locked;
use crate::settings::FlockSettings;
use flockslam_records::{MESSAGE_BYTES_MAX, Message, RobotId};
use flockslam_zenoh_session::{
    Announcement, ReceivedMessage as ReceivedBytes, Session, SessionConfiguration, SessionError, Subscription,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Messages that wait to be looked at: more are dropped.
const WAITING_MAX: usize = 64;
/// Messages of one sender in a second: more are dropped.
const SENDER_RATE_MAX: u32 = 100;
/// Greatest number of senders and peers: all further senders share one account, further peers are ignored.
const PEERS_MAX: usize = 256;
/// Robots whose traffic is counted apart.
const TRAFFIC_PEERS_MAX: usize = 32;
/// What stands for all further ones.
pub const OTHERS: &str = "others";
/// How long a message may wait for room on its way out before it is dropped, microseconds.
const WAIT_TO_SEND_US: u64 = 1_000_000;

/// What was received.
pub struct ReceivedMessage {
    /// Where to answer.
    pub sender: String,
    /// What was sent: not looked at yet.
    pub bytes: Vec<u8>,
}

/// Bytes that went through the link, by robot: of messages that were looked at, and of messages that were sent.
#[derive(Debug, Default)]
pub struct Traffic(Mutex<BTreeMap<String, (u64, u64)>>);

impl Traffic {
    fn received(&self, peer: &str, bytes: usize) {
        self.count(peer, (bytes as u64, 0));
    }

    fn sent(&self, peer: &str, bytes: usize) {
        self.count(peer, (0, bytes as u64));
    }

    fn count(&self, peer: &str, (received, sent): (u64, u64)) {
        let mut peers = locked(&self.0);
        let known = peers.contains_key(peer) || peers.len() < TRAFFIC_PEERS_MAX;
        let account = peers.entry(if known { peer } else { OTHERS }.to_owned()).or_default();
        *account = (account.0 + received, account.1 + sent);
    }

    /// Bytes received and sent so far, by robot.
    pub fn by_peer(&self) -> BTreeMap<String, (u64, u64)> {
        locked(&self.0).clone()
    }
}

/// The robots that are connected.
#[derive(Debug, Default)]
struct Presence {
    connected: BTreeSet<String>,
    /// Robots whose source has ended, with the hash of the records that they have nothing to add to. Who has sent so may leave.
    ended: BTreeMap<String, String>,
}

/// The way to the other robots: peer to peer, without a broker.
///
/// Messages from a robot to another are published on `flockslam/FLOCK/to/RECEIVER/SENDER`. Messages may be lost at any time: they are sent again
/// as long as a robot lacks records. Presence is announced by tokens `flockslam/FLOCK/there/ROBOT`, which go with their robot.
pub struct Link {
    session: Session,
    prefix: String,
    own: String,
    received: Receiver<ReceivedMessage>,
    presence: Arc<Mutex<Presence>>,
    ended: Option<(String, Instant, Announcement)>,
    drops: Arc<Drops>,
    traffic: Arc<Traffic>,
    // Kept alive: what they receive comes through `received` and `presence`.
    _subscriptions: Vec<Subscription>,
    _there: Announcement,
}

impl Link {
    /// Joins the flock that settings name.
    ///
    /// # Errors
    /// When the network cannot be opened: why, for people.
    pub fn open(
        settings: &FlockSettings,
        robot: &RobotId,
        drops: &Arc<Drops>,
        traffic: &Arc<Traffic>,
    ) -> Result<Self, String> {
        let session = Session::open(configuration(settings).map_err(text)?).map_err(text)?;
        let prefix = format!("flockslam/{}", settings.flock);
        let own = address(robot);
        let (queue, received) = sync_channel(WAITING_MAX);
        let presence = Arc::new(Mutex::new(Presence::default()));
        let mailbox = Mutex::new(Mailbox {
            queue,
            own: own.clone(),
            drops: Arc::clone(drops),
            traffic: Arc::clone(traffic),
            gate: Gate::default(),
        });
        let mail = format!("{prefix}/to/{own}/*");
        let mail = session.subscribe(mail, move |received| locked(&mailbox).take(received)).map_err(text)?;
        let there = watch(&session, format!("{prefix}/there/*"), &presence, Presence::there)?;
        let ended = watch(&session, format!("{prefix}/ended/*/*"), &presence, Presence::ended)?;
        let token = format!("{prefix}/there/{own}");
        let token = session.announce(token).map_err(text)?;
        Ok(Self {
            session,
            prefix,
            own,
            received,
            presence,
            ended: None,
            drops: Arc::clone(drops),
            traffic: Arc::clone(traffic),
            _subscriptions: vec![mail, there, ended],
            _there: token,
        })
    }

    /// Says something to one robot; gives its bytes. What finds no room on its way is dropped and counted.
    pub fn send_to(&self, receiver: &str, message: &Message) -> usize {
        let bytes = message.encode();
        let length = bytes.len();
        let key = format!("{}/to/{receiver}/{}", self.prefix, self.own);
        match self.session.put(key, bytes) {
            Ok(()) => {
                self.traffic.sent(receiver, length);
            }
            Err(error) => {
                tracing::debug!(%error, receiver, "a message to the flock was not sent");
                self.drops.count(Dropped::NotSent, 1);
            }
        }
        length
    }

    /// The next message that was received, if there is one.
    pub fn next(&self) -> Option<ReceivedMessage> {
        self.received.try_recv().ok()
    }

    /// Addresses of all robots that are connected.
    pub fn connected(&self) -> BTreeSet<String> {
        locked(&self.presence).connected.clone()
    }

    /// Tells that this robot's source has ended and that it has nothing to add to the records with this hash; gives for how long it has
    /// been saying so.
    pub fn announce_end(&mut self, hash: &str) -> Duration {
        if let Some((_, since, _)) = self.ended.as_ref().filter(|(text, ..)| text == hash) {
            return since.elapsed();
        }
        let key = format!("{}/ended/{}/{hash}", self.prefix, self.own);
        match self.session.announce(key) {
            Ok(token) => self.ended = Some((hash.to_owned(), Instant::now(), token)),
            Err(error) => tracing::warn!(%error, "the end is not announced to the flock"),
        }
        Duration::ZERO
    }

    /// Robots that have ended with the records of this hash.
    pub fn ended_with(&self, hash: &str) -> BTreeSet<String> {
        let presence = locked(&self.presence);
        presence.ended.iter().filter(|(_, text)| *text == hash).map(|(robot, _)| robot.clone()).collect()
    }
}

/// How a robot is called on the network.
pub fn address(robot: &RobotId) -> String {
    format!("{}-{}", robot.name(), hexadecimal(&robot.public_key()[..8]))
}

/// Bytes as people write them.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Presence {
    fn there(&mut self, parts: &[&str], is_there: bool) {
        let [robot] = parts else { return };
        if !is_there {
            self.connected.remove(*robot);
        } else if self.connected.len() < PEERS_MAX {
            self.connected.insert((*robot).to_owned());
        }
    }

    fn ended(&mut self, parts: &[&str], is_there: bool) {
        // A robot that has ended and disconnected counts as ended.
        let [robot, hash] = parts else { return };
        if is_there && (self.ended.contains_key(*robot) || self.ended.len() < PEERS_MAX) {
            self.ended.insert((*robot).to_owned(), (*hash).to_owned());
        }
    }
}

fn watch(
    session: &Session,
    key: String,
    presence: &Arc<Mutex<Presence>>,
    note: fn(&mut Presence, &[&str], bool),
) -> Result<Subscription, String> {
    let presence = Arc::clone(presence);
    let kinds = key.matches('*').count();
    let seen = move |key: &str, is_there: bool| {
        let parts: Vec<&str> = key.rsplitn(kinds + 1, '/').take(kinds).collect();
        let parts: Vec<&str> = parts.into_iter().rev().collect();
        note(&mut locked(&presence), &parts, is_there);
    };
    session.subscribe_to_announcements(key, seen).map_err(text)
}

/// Takes messages from the network's own threads to that of the flock, as far as they are not too long or too many.
struct Mailbox {
    queue: SyncSender<ReceivedMessage>,
    own: String,
    drops: Arc<Drops>,
    traffic: Arc<Traffic>,
    gate: Gate,
}

impl Mailbox {
    fn take(&mut self, sample: &ReceivedBytes<'_>) {
        let Some(sender) = sample.key().rsplit('/').next().filter(|sender| *sender != self.own) else {
            return;
        };
        let length = sample.length();
        if length > MESSAGE_BYTES_MAX {
            return self.drops.count(Dropped::TooLong, 1);
        }
        if !self.gate.admits(sender, Instant::now()) {
            return self.drops.count(Dropped::TooMany, 1);
        }
        let received = ReceivedMessage { sender: sender.to_owned(), bytes: sample.bytes().into_owned() };
        match self.queue.try_send(received) {
            Ok(()) => self.traffic.received(sender, length),
            Err(TrySendError::Full(_)) => self.drops.count(Dropped::Overflow, 1),
            Err(TrySendError::Disconnected(_)) => {}
        }
    }
}

/// How much each sender has sent lately.
#[derive(Default)]
struct Gate {
    senders: BTreeMap<String, (Option<Instant>, u32)>,
}

impl Gate {
    fn admits(&mut self, sender: &str, now: Instant) -> bool {
        let known = self.senders.contains_key(sender) || self.senders.len() < PEERS_MAX;
        let account = self.senders.entry(if known { sender.to_owned() } else { String::new() }).or_default();
        if account.0.is_none_or(|since| now.duration_since(since) >= Duration::from_secs(1)) {
            *account = (Some(now), 0);
        }
        account.1 = account.1.saturating_add(1);
        account.1 <= SENDER_RATE_MAX
    }
}

/// Peer to peer; what settings do not name stays off.
fn configuration(settings: &FlockSettings) -> Result<SessionConfiguration, SessionError> {
    let mut config = match settings.zenoh_file.as_os_str().is_empty() {
        true => SessionConfiguration::default(),
        false => SessionConfiguration::from_file(&settings.zenoh_file)?,
    };
    let quoted = |text: &str| format!("{text:?}");
    let listed = |endpoints: &[String]| format!("{endpoints:?}");
    let mut set = |key: &str, value: &str| config.set(key, value);
    set("mode", "\"peer\"")?;
    set("scouting/multicast/enabled", if settings.multicast { "true" } else { "false" })?;
    set("scouting/gossip/enabled", "false")?;
    set("listen/endpoints", &listed(&settings.listen))?;
    set("connect/endpoints", &listed(&settings.connect))?;
    // Whoever is found by multicast is no reason to open another door.
    set("transport/link/protocols", if settings.uses_tls() { "[\"tls\"]" } else { "[\"tcp\"]" })?;
    // Others may come later, and come back.
    set("connect/timeout_ms", "-1")?;
    set("connect/exit_on_failure", "false")?;
    set("transport/link/tx/lease", "3000")?;
    set("transport/link/tx/queue/congestion_control/drop/wait_before_drop", &WAIT_TO_SEND_US.to_string())?;
    set(
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
        &WAIT_TO_SEND_US.to_string(),
    )?;
    // A message may be as long, and a little for what is around it.
    set("transport/link/rx/max_message_size", &(MESSAGE_BYTES_MAX + 65_536).to_string())?;
    set("transport/unicast/max_sessions", &PEERS_MAX.to_string())?;
    if settings.uses_tls() {
        let file = |path: &std::path::Path| quoted(&path.to_string_lossy());
        set("transport/link/tls/root_ca_certificate", &file(&settings.tls_ca))?;
        set("transport/link/tls/enable_mtls", "true")?;
        for side in ["listen", "connect"] {
            set(&format!("transport/link/tls/{side}_certificate"), &file(&settings.tls_certificate))?;
            set(&format!("transport/link/tls/{side}_private_key"), &file(&settings.tls_key))?;
        }
    }
    Ok(config)
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sender_has_so_many_messages_a_second_and_unknown_ones_share_one_account() {
        let (mut gate, start) = (Gate::default(), Instant::now());
        let admitted = |gate: &mut Gate, sender: &str, now| {
            (0..2 * SENDER_RATE_MAX).filter(|_| gate.admits(sender, now)).count() as u32
        };
        assert_eq!(admitted(&mut gate, "a", start), SENDER_RATE_MAX);
        assert_eq!(admitted(&mut gate, "b", start), SENDER_RATE_MAX);
        assert_eq!(admitted(&mut gate, "a", start + Duration::from_secs(1)), SENDER_RATE_MAX);
        let admitted: u32 =
            (0..10_000).map(|number| u32::from(gate.admits(&format!("unknown-{number}"), start))).sum();
        // a and b have an account each; one unknown sender each has the others, and the rest share one more.
        assert_eq!(admitted, PEERS_MAX as u32 - 2 + SENDER_RATE_MAX);
        assert_eq!(gate.senders.len(), PEERS_MAX + 1);
    }

    #[test]
    fn a_configuration_of_ours_is_one_of_zenoh() {
        let settings =
            FlockSettings { listen: vec!["tcp/127.0.0.1:0".to_owned()], ..FlockSettings::default() };
        configuration(&settings).unwrap();
        let file = |name: &str| std::path::PathBuf::from(format!("/etc/flockslam/{name}"));
        let secret = FlockSettings {
            tls_ca: file("ca.pem"),
            tls_certificate: file("robot.pem"),
            tls_key: file("robot.key"),
            ..settings
        };
        configuration(&secret).unwrap();
    }
}
