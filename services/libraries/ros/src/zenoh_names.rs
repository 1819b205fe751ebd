//! What topics, services and nodes are called by rmw_zenoh: keys of data, keys that announce, and what stands beside a message.
//!
//! Source: design document and sources of `ros2/rmw_zenoh` (Jazzy).

use crate::{NodeIdentity, QualityOfService};
use xxhash_rust::xxh3::xxh3_128;

/// Before all keys that announce.
const ANNOUNCED: &str = "@ros2_lv";
/// Length of what stands beside a message.
const BESIDE_LENGTH: usize = 33;
/// The length of a publisher's number, as zenoh writes it before the number.
const NUMBER_LENGTH: u8 = 16;
/// No token is longer: a topic with its namespace, a type, a hash.
const TOKEN_LENGTH_MAX: usize = 2048;

/// What a node has in the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entity {
    /// The node itself.
    Node,
    /// Who sends on a topic.
    Publisher,
    /// Who subscribes to a topic.
    Subscription,
    /// Who answers a service.
    Service,
}

/// The type of a topic or of a service: package, `msg` or `srv`, name, hash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeName {
    /// As it stands in keys.
    key: String,
    hash: String,
}

/// A node's place in a graph of rmw_zenoh.
#[derive(Clone, Debug)]
pub struct ZenohNames {
    /// The domain.
    pub domain: u16,
    /// The session, as zenoh calls it.
    pub session: String,
    /// The node.
    pub node: NodeIdentity,
}

impl TypeName {
    /// Of a type with its hash; `of` is `msg` or `srv`.
    pub fn new((package, name): (&str, &str), of: &str, hash: String) -> Self {
        Self { key: format!("{package}::{of}::dds_::{name}_"), hash }
    }
}

impl ZenohNames {
    /// The key that messages of a topic, or calls of a service, are sent to.
    pub fn data_key(&self, full_name: &str, kind: &TypeName) -> String {
        format!("{}/{}/{}/{}", self.domain, full_name.trim_matches('/'), kind.key, kind.hash)
    }

    /// The key that announces the node.
    pub fn node_key(&self) -> String {
        self.announced(0, Entity::Node)
    }

    /// The key that announces what a node has, by its number from 1.
    pub fn entity_key(
        &self,
        number: u32,
        entity: Entity,
        full_name: &str,
        kind: &TypeName,
        quality: QualityOfService,
    ) -> String {
        let head = self.announced(number, entity);
        format!("{head}/{}/{}/{}/{}", mangled(full_name), kind.key, kind.hash, quality_in_key(quality))
    }

    /// All keys of this domain that announce the subscribers of a topic.
    pub fn subscriptions_key(&self) -> String {
        format!("{ANNOUNCED}/{}/*/*/*/MS/**", self.domain)
    }

    /// The topic of a key that announces that another session subscribes to it.
    pub fn other_subscriptions(&self, key: &str) -> Option<String> {
        let mut parts = key.split('/');
        if key.len() > TOKEN_LENGTH_MAX || parts.nth(2)? == self.session {
            return None;
        }
        (parts.nth(2)? == "MS").then_some(())?;
        Some(parts.nth(3)?.replace('%', "/"))
    }

    fn announced(&self, number: u32, entity: Entity) -> String {
        let code = match entity {
            Entity::Node => "NN",
            Entity::Publisher => "MP",
            Entity::Subscription => "MS",
            Entity::Service => "SS",
        };
        // The number of the node is 0: it is alone in its session. No enclave.
        format!(
            "{ANNOUNCED}/{}/{}/0/{number}/{code}/%/{}/{}",
            self.domain,
            self.session,
            mangled(&self.node.namespace),
            self.node.name
        )
    }
}

/// A name as one part of a key.
fn mangled(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

/// Reliability, durability, history and depth, deadline, lifespan, liveliness. What is as by default is left out, but for the depth.
fn quality_in_key(quality: QualityOfService) -> String {
    let reliability = if quality.is_reliable() { "" } else { "2" };
    let durability = if quality.is_latched() { "1" } else { "" };
    format!("{reliability}:{durability}:,{}:,:,:,,", quality.depth())
}

/// What stands beside a message: how many its sender has sent, when, and who it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beside {
    /// From 1.
    pub sequence: i64,
    /// Of the sender, UTC, nanoseconds.
    pub sent_ns: i64,
    /// Number of the sender.
    pub sender: [u8; 16],
}

impl Beside {
    /// As bytes.
    pub fn encode(self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(BESIDE_LENGTH);
        bytes.extend_from_slice(&self.sequence.to_le_bytes());
        bytes.extend_from_slice(&self.sent_ns.to_le_bytes());
        bytes.push(NUMBER_LENGTH);
        bytes.extend_from_slice(&self.sender);
        bytes
    }

    /// From bytes; `None` for what is none.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; BESIDE_LENGTH] = bytes.try_into().ok()?;
        let number = |from: usize| {
            let part: [u8; 8] = bytes[from..from + 8].try_into().expect("eight bytes");
            i64::from_le_bytes(part)
        };
        let sender = bytes[17..].try_into().expect("sixteen bytes");
        (bytes[16] == NUMBER_LENGTH).then(|| Self { sequence: number(0), sent_ns: number(8), sender })
    }
}

/// The number of a sender: the hash of the key that announces it.
pub fn sender_number(announced: &str) -> [u8; 16] {
    xxh3_128(announced.as_bytes()).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn names(namespace: &str) -> ZenohNames {
        let remaps = vec![crate::Remap { node: None, from: "__ns".to_owned(), to: namespace.to_owned() }];
        let node = NodeIdentity::new("listener", remaps).unwrap();
        ZenohNames { domain: 2, session: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(), node }
    }

    fn text() -> TypeName {
        TypeName::new(("std_msgs", "String"), "msg", HASH.to_owned())
    }

    #[test]
    fn keys_are_those_of_rmw_zenoh() {
        // Examples of its design document.
        let plain = names("/");
        assert_eq!(
            plain.data_key("/robot1/chatter", &text()),
            format!("2/robot1/chatter/std_msgs::msg::dds_::String_/{HASH}")
        );
        assert_eq!(plain.node_key(), "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener");
        let quality = QualityOfService::Reliable { depth: 10 };
        assert_eq!(
            plain.entity_key(10, Entity::Subscription, "/chatter", &text(), quality),
            format!(
                "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/\
                 std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,"
            )
        );
        assert!(names("/r1").node_key().ends_with("/NN/%/%r1/listener"));
        assert_eq!(quality_in_key(QualityOfService::Sensor { depth: 5 }), "2::,5:,:,:,,");
        assert_eq!(quality_in_key(QualityOfService::Latched { depth: 1 }), ":1:,1:,:,:,,");
    }

    #[test]
    fn subscribers_of_a_topic_are_read_from_its_key() {
        let (own, quality) = (names("/r1"), QualityOfService::Latched { depth: 1 });
        let other = ZenohNames { session: "b".to_owned(), ..own.clone() };
        let key = |names: &ZenohNames, entity| names.entity_key(3, entity, "/r1/map", &text(), quality);
        assert_eq!(own.other_subscriptions(&key(&other, Entity::Subscription)).as_deref(), Some("/r1/map"));
        assert_eq!(own.other_subscriptions(&key(&other, Entity::Publisher)), None);
        assert_eq!(own.other_subscriptions(&key(&own, Entity::Subscription)), None);
        assert_eq!(own.other_subscriptions("@ros2_lv/2/b/0/3/MS"), None);
    }

    #[test]
    fn what_stands_beside_a_message_has_33_bytes() {
        let beside = Beside { sequence: 7, sent_ns: 0x0102_0304_0506_0708, sender: [0xab; 16] };
        let bytes = beside.encode();
        assert_eq!(bytes[..8], 7_i64.to_le_bytes());
        assert_eq!(bytes[8..16], [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!((bytes[16], &bytes[17..]), (16, &[0xab; 16][..]));
        assert_eq!(Beside::decode(&bytes), Some(beside));
        assert_ne!(sender_number("a"), sender_number("b"));
    }

    proptest! {
        #[test]
        fn any_bytes_may_stand_there(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            if let Some(beside) = Beside::decode(&bytes) {
                prop_assert_eq!(beside.encode(), bytes);
            }
        }
    }
}
