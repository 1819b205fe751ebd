//! A node's topics and services over zenoh, as rmw_zenoh has them.

use crate::messages::{RosMessage, RosService};
use crate::ros_node::{Answer, Call, RunningTransport, SendMessage, Undecodable};
use crate::sender_clock::sender_clock_ns;
use crate::type_hash::type_hash;
use crate::zenoh_names::{Beside, Entity, TypeName, ZenohNames, sender_number};
use crate::{Environment, NodeIdentity, QualityOfService, RosError};
use byteorder::{BigEndian, LittleEndian};
use flockslam_zenoh_session::{
    Announcement, Delivery, Question, Session, SessionConfiguration, SessionError, Subscription,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Before a message in CDR, least byte first.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
/// A router is waited for at most so often, each time so long; it is joined whenever it comes.
const LOOKS_FOR_ROUTER: u32 = 20;
const LOOK_PERIOD: Duration = Duration::from_millis(50);
/// Greatest number of keys of others with their subscriptions: more are not read.
const SUBSCRIPTIONS_MAX: usize = 4096;
/// What rmw_zenoh has by default; a bound for what is put together of fragments, as a scan of ten million beams has 80 MB; and how long a
/// message waits for room before it is dropped, microseconds. Zenoh waits 1 ms; a transform behind a map may have to wait longer for a processor.
const DEFAULTS: [(&str, &str); 8] = [
    ("mode", "\"peer\""),
    ("connect/endpoints", "[\"tcp/localhost:7447\"]"),
    ("connect/timeout_ms", "-1"),
    ("connect/exit_on_failure", "false"),
    ("listen/endpoints", "[\"tcp/localhost:0\"]"),
    ("scouting/multicast/enabled", "false"),
    ("transport/link/rx/max_message_size", "134217728"),
    ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "20000"),
];

/// What begins to receive once the node runs.
type SubscriptionTask = Box<dyn FnOnce(&Session) -> Result<Subscription, SessionError> + Send>;
/// Other sessions that subscribe to each topic, by the key of the subscription.
type OtherSubscriptions = Arc<Mutex<BTreeMap<String, String>>>;

/// A node over zenoh, before it receives.
pub struct ZenohNode {
    session: Session,
    names: ZenohNames,
    entities: u32,
    tasks: Vec<(String, SubscriptionTask)>,
    announced: Vec<Announcement>,
    other_subscriptions: OtherSubscriptions,
    undecodable: Arc<Undecodable>,
    subscriptions: Vec<Subscription>,
}

/// A node that receives. It leaves the graph when it is dropped.
struct RunningZenohNode {
    other_subscriptions: OtherSubscriptions,
    _announced: Vec<Announcement>,
    _subscriptions: Vec<Subscription>,
    _session: Session,
}

impl ZenohNode {
    /// Joins the graph.
    pub fn open(
        identity: &NodeIdentity,
        environment: &Environment,
        undecodable: Arc<Undecodable>,
    ) -> Result<Self, RosError> {
        let refused =
            |error: SessionError| RosError::Network { domain: environment.domain, reason: error.to_string() };
        let session = Session::open(zenoh_configuration(environment)?).map_err(refused)?;
        let names = ZenohNames { domain: environment.domain, session: session.id(), node: identity.clone() };
        let is_connected = (0..LOOKS_FOR_ROUTER).any(|_| {
            let is_connected = session.is_connected();
            if !is_connected {
                std::thread::sleep(LOOK_PERIOD);
            }
            is_connected
        });
        if !is_connected {
            tracing::warn!(
                "no router of zenoh is reached: start `ros2 run rmw_zenoh_cpp rmw_zenohd`, or say where it is in ZENOH_CONFIG_OVERRIDE; \
                 it is joined as soon as it is there"
            );
        }
        let other_subscriptions = OtherSubscriptions::default();
        let (known, own) = (Arc::clone(&other_subscriptions), names.clone());
        let note = move |key: &str, is_there: bool| {
            let mut known = known.lock().expect("no thread panics with it");
            if !is_there {
                known.remove(key);
            } else if known.len() < SUBSCRIPTIONS_MAX
                && let Some(topic) = own.other_subscriptions(key)
            {
                known.insert(key.to_owned(), topic);
            }
        };
        let watching =
            session.subscribe_to_announcements(names.subscriptions_key(), note).map_err(refused)?;
        let node = session.announce(names.node_key()).map_err(refused)?;
        Ok(Self {
            session,
            names,
            entities: 0,
            tasks: Vec::new(),
            announced: vec![node],
            other_subscriptions,
            undecodable,
            subscriptions: vec![watching],
        })
    }

    /// Sends on a topic, by its full name.
    pub fn publisher<M: RosMessage>(
        &mut self,
        full: &str,
        quality: QualityOfService,
    ) -> Result<SendMessage<M>, RosError> {
        let kind = type_name(M::TYPE, "msg")?;
        let kept = if quality.is_latched() { quality.depth() } else { 0 };
        let delivery = Delivery { is_reliable: quality.is_reliable(), kept };
        let publication = self
            .session
            .publish(self.names.data_key(full, &kind), delivery)
            .map_err(|error| refused(full, &error))?;
        let sender = self.announce(full, Entity::Publisher, &kind, quality)?;
        let sent = AtomicI64::new(0);
        Ok(Box::new(move |message: M| {
            let bytes = encode(&message)?;
            let sequence = sent.fetch_add(1, Ordering::Relaxed) + 1;
            let beside = Beside { sequence, sent_ns: sender_clock_ns(), sender };
            publication.send(bytes, beside.encode()).map_err(|error| error.to_string())
        }))
    }

    /// Subscribes to a topic, by its full name.
    pub fn subscribe<M: RosMessage>(
        &mut self,
        full: String,
        quality: QualityOfService,
        handle: impl FnMut(M) + Send + 'static,
    ) -> Result<(), RosError> {
        let kind = type_name(M::TYPE, "msg")?;
        let key = self.names.data_key(&full, &kind);
        self.announce(&full, Entity::Subscription, &kind, quality)?;
        let (undecodable, handle, name) = (Arc::clone(&self.undecodable), Mutex::new(handle), full.clone());
        let task = move |session: &Session| {
            let take = move |message: &flockslam_zenoh_session::ReceivedMessage<'_>| match decode::<M>(
                &message.bytes(),
            ) {
                Ok(message) => handle.lock().expect("no thread panics with it")(message),
                Err(error) => undecodable.note(&name, &error),
            };
            if quality.is_latched() {
                session.subscribe_with_history(key, quality.depth(), take)
            } else {
                session.subscribe(key, take)
            }
        };
        self.tasks.push((full, Box::new(task)));
        Ok(())
    }

    /// Offers a service, by its full name.
    pub fn serve<S: RosService>(
        &mut self,
        full: String,
        handle: impl FnMut(Call<S>) + Send + 'static,
    ) -> Result<(), RosError> {
        let kind = type_name(S::TYPE, "srv")?;
        let key = self.names.data_key(&full, &kind);
        self.announce(&full, Entity::Service, &kind, QualityOfService::Reliable { depth: 10 })?;
        let (undecodable, handle, name) = (Arc::clone(&self.undecodable), Mutex::new(handle), full.clone());
        let take = move |question: Question| {
            let beside = question.attachment().and_then(|bytes| Beside::decode(&bytes));
            let Some(beside) = beside else {
                return undecodable.note(&name, &"who has called is not said");
            };
            let request = match decode::<S::Request>(&question.bytes()) {
                Ok(request) => request,
                Err(error) => return undecodable.note(&name, &error),
            };
            let name = name.clone();
            let answer = move |response: S::Response| {
                let beside = Beside { sent_ns: sender_clock_ns(), ..beside };
                let sent = encode(&response).and_then(|bytes| {
                    question.answer(bytes, beside.encode()).map_err(|error| error.to_string())
                });
                if let Err(error) = sent {
                    tracing::warn!(name, error, "an answer could not be sent");
                }
            };
            let call = Call { request, answer: Answer(Box::new(answer)) };
            handle.lock().expect("no thread panics with it")(call);
        };
        self.tasks.push((full, Box::new(move |session: &Session| session.take_questions(key, take))));
        Ok(())
    }

    /// Begins to receive, on threads of zenoh.
    pub fn run(mut self) -> Result<Box<dyn RunningTransport>, RosError> {
        for (full, task) in self.tasks {
            self.subscriptions.push(task(&self.session).map_err(|error| refused(&full, &error))?);
        }
        Ok(Box::new(RunningZenohNode {
            other_subscriptions: self.other_subscriptions,
            _announced: self.announced,
            _subscriptions: self.subscriptions,
            _session: self.session,
        }))
    }

    /// Announces what the node has; returns its number as a sender.
    fn announce(
        &mut self,
        full: &str,
        entity: Entity,
        kind: &TypeName,
        quality: QualityOfService,
    ) -> Result<[u8; 16], RosError> {
        self.entities += 1;
        let key = self.names.entity_key(self.entities, entity, full, kind, quality);
        let sender = sender_number(&key);
        self.announced.push(self.session.announce(key).map_err(|error| refused(full, &error))?);
        Ok(sender)
    }
}

impl RunningTransport for RunningZenohNode {
    fn has_subscribers(&self, full_name: &str) -> bool {
        let known = self.other_subscriptions.lock().expect("no thread panics with it");
        known.values().any(|topic| topic == full_name)
    }
}

/// The configuration from the environment, by the variables of rmw_zenoh.
pub fn zenoh_configuration(environment: &Environment) -> Result<SessionConfiguration, RosError> {
    let refused = |name: &'static str, value: &str, error: SessionError| RosError::Zenoh {
        name,
        value: value.to_owned(),
        reason: error.to_string(),
    };
    let file = environment.zenoh_file.as_str();
    let mut configuration = SessionConfiguration::default();
    if file.is_empty() {
        for (key, value) in DEFAULTS {
            configuration.set(key, value).expect("zenoh knows its keys");
        }
    } else {
        configuration = SessionConfiguration::from_file(Path::new(file))
            .map_err(|error| refused("ZENOH_SESSION_CONFIG_URI", file, error))?;
    }
    for part in environment.zenoh_overrides.split(';').map(str::trim).filter(|part| !part.is_empty()) {
        let (key, value) = part.split_once('=').unwrap_or((part, ""));
        configuration
            .set(key.trim(), value.trim())
            .map_err(|error| refused("ZENOH_CONFIG_OVERRIDE", part, error))?;
    }
    Ok(configuration)
}

fn type_name(name: (&str, &str), of: &str) -> Result<TypeName, RosError> {
    let full = format!("{}/{of}/{}", name.0, name.1);
    let hash = type_hash(&full).ok_or_else(|| RosError::Open {
        name: full.clone(),
        reason: "its definition is not known here".to_owned(),
    })?;
    Ok(TypeName::new(name, of, hash))
}

fn encode(message: &impl Serialize) -> Result<Vec<u8>, String> {
    let body = cdr_encoding::to_vec::<_, LittleEndian>(message).map_err(|error| error.to_string())?;
    Ok([&LITTLE_ENDIAN[..], &body].concat())
}

fn decode<M: DeserializeOwned>(bytes: &[u8]) -> Result<M, String> {
    let (head, body) = bytes.split_at_checked(LITTLE_ENDIAN.len()).ok_or("it has no head")?;
    let decoded = match head[..2] {
        [0, 1] => cdr_encoding::from_bytes::<M, LittleEndian>(body),
        [0, 0] => cdr_encoding::from_bytes::<M, BigEndian>(body),
        _ => return Err("it is not in plain CDR".to_owned()),
    };
    decoded.map(|(message, _)| message).map_err(|error| error.to_string())
}

fn refused(name: &str, error: &impl std::fmt::Display) -> RosError {
    RosError::Open { name: name.to_owned(), reason: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Header, LaserScan};
    use proptest::prelude::*;

    #[test]
    fn messages_have_a_header_and_round_trip_in_both_byte_orders() {
        let scan =
            LaserScan { header: Header::new(5, "laser"), ranges: vec![1.0, 2.5], ..LaserScan::default() };
        let bytes = encode(&scan).unwrap();
        assert_eq!(bytes[..4], [0, 1, 0, 0]);
        assert_eq!(decode::<LaserScan>(&bytes).unwrap(), scan);
        let big = [&[0; 4][..], &cdr_encoding::to_vec::<_, BigEndian>(&scan).unwrap()].concat();
        assert_eq!(decode::<LaserScan>(&big).unwrap(), scan);
        assert!(decode::<LaserScan>(&bytes[..3]).is_err());
    }

    #[test]
    fn a_configuration_follows_the_variables_and_what_zenoh_does_not_know_is_refused() {
        let with = |name: &str, value: &str| {
            let given = (name.to_owned(), value.to_owned());
            let find = move |name: &str| (name == given.0).then(|| given.1.clone());
            zenoh_configuration(&Environment::from_variables(find).unwrap())
                .map(drop)
                .map_err(|e| e.to_string())
        };
        assert_eq!(with("", ""), Ok(()));
        let good = "mode=\"client\"; connect/endpoints=[\"tcp/10.0.0.1:7447\"];";
        assert_eq!(with("ZENOH_CONFIG_OVERRIDE", good), Ok(()));
        let error = with("ZENOH_CONFIG_OVERRIDE", "conect/endpoints=[]").unwrap_err();
        assert!(error.starts_with("ZENOH_CONFIG_OVERRIDE=conect/endpoints=[]: "), "{error}");
        let error = with("ZENOH_SESSION_CONFIG_URI", "/nowhere.json5").unwrap_err();
        assert!(error.starts_with("ZENOH_SESSION_CONFIG_URI=/nowhere.json5: "), "{error}");
    }

    proptest! {
        #[test]
        fn any_bytes_may_come(bytes in proptest::collection::vec(any::<u8>(), 0..200), little in any::<bool>()) {
            let _ = decode::<LaserScan>(&bytes);
            let _ = decode::<LaserScan>(&[&[0, u8::from(little), 0, 0][..], &bytes].concat());
        }
    }
}
