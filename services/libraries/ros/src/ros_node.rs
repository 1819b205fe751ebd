//! A node: its topics, services and parameters, over DDS or over zenoh.

use crate::dds_node::DdsNode;
use crate::messages::{RosMessage, RosService};
use crate::parameter_server::offer_parameters;
use crate::zenoh_node::ZenohNode;
use crate::{Environment, Middleware, NodeIdentity, ParameterValue, QualityOfService, RosError};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A parameter as a node declares it.
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: ParameterValue,
    /// Whether it may be changed while the node runs, and what must hold then; `None` for one that stays as it is.
    pub change: Option<Change>,
}

/// Takes a new value, or refuses it with the reason.
type Change = Box<dyn Fn(&ParameterValue) -> Result<(), String> + Send + Sync>;

/// A node of the graph, before it receives.
pub struct Node {
    identity: NodeIdentity,
    over: Over,
    undecodable: Arc<Undecodable>,
}

/// What carries its messages.
enum Over {
    Dds(Box<DdsNode>),
    Zenoh(ZenohNode),
}

/// A node that receives. It leaves the graph when it is dropped.
pub struct RunningNode {
    transport: Box<dyn RunningTransport>,
    undecodable: Arc<Undecodable>,
}

/// A node that receives, by its transport.
pub trait RunningTransport {
    /// Whether another node subscribes to a topic, by its full name.
    fn has_subscribers(&self, full_name: &str) -> bool;
}

/// Messages that were none of their type.
#[derive(Debug, Default)]
pub struct Undecodable(AtomicU64);

impl Undecodable {
    /// Counts one; logs the first, and then whenever the count has doubled.
    pub fn note(&self, name: &str, error: &dyn std::fmt::Debug) {
        let count = self.0.fetch_add(1, Ordering::Relaxed) + 1;
        if count.is_power_of_two() {
            tracing::warn!(name, ?error, count, "a message is not of the type of its topic");
        }
    }
}

/// Publishes a message, or gives the reason of the failure.
pub type SendMessage<M> = Box<dyn Fn(M) -> Result<(), String> + Send + Sync>;

/// Sends on a topic.
pub struct Publisher<M: RosMessage> {
    topic: String,
    send: SendMessage<M>,
}

/// A call of a service, and the channel to its client.
pub struct Call<S: RosService> {
    /// The request.
    pub request: S::Request,
    /// Takes the answer.
    pub answer: Answer<S>,
}

/// The channel to the client of a service.
pub struct Answer<S: RosService>(pub(crate) Box<dyn FnOnce(S::Response) + Send>);

impl<S: RosService> Answer<S> {
    /// Sends the answer. Whoever called may have gone.
    pub fn send(self, response: S::Response) {
        (self.0)(response);
    }
}

impl<M: RosMessage> Publisher<M> {
    /// The full name of its topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Publishes a message; whether it was accepted. A failure is logged.
    pub fn send(&self, message: M) -> bool {
        let sent = (self.send)(message);
        if let Err(error) = &sent {
            tracing::warn!(topic = self.topic, %error, "a message could not be sent");
        }
        sent.is_ok()
    }
}

impl Node {
    /// Joins the graph.
    ///
    /// # Errors
    /// When a name is none, or the network refuses.
    pub fn open(
        identity: NodeIdentity,
        environment: &Environment,
        parameters: Vec<Parameter>,
    ) -> Result<Self, RosError> {
        let undecodable = Arc::<Undecodable>::default();
        let counted = Arc::clone(&undecodable);
        let over = match environment.middleware {
            Middleware::Zenoh => Over::Zenoh(ZenohNode::open(&identity, environment, counted)?),
            _ => Over::Dds(Box::new(DdsNode::open(&identity, environment, counted)?)),
        };
        let mut node = Self { identity, over, undecodable };
        offer_parameters(&mut node, parameters)?;
        Ok(node)
    }

    /// Its name in the graph.
    pub fn full_name(&self) -> String {
        self.identity.full_name()
    }

    /// Whether answers of services may be longer than a datagram. RustDDS 0.15 puts one byte too many into each fragment of an answer.
    pub fn answers_at_any_length(&self) -> bool {
        matches!(self.over, Over::Zenoh(_))
    }

    /// A topic to send on.
    ///
    /// # Errors
    /// When its name is none, or the network refuses.
    pub fn publisher<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: QualityOfService,
    ) -> Result<Publisher<M>, RosError> {
        let topic = self.identity.resolve(topic)?;
        let send = match &mut self.over {
            Over::Dds(node) => node.publisher(&topic, quality)?,
            Over::Zenoh(node) => node.publisher(&topic, quality)?,
        };
        Ok(Publisher { topic, send })
    }

    /// Subscribes to a topic: `handle` gets each message of other nodes, on a thread of the node. What is no such message is counted.
    ///
    /// # Errors
    /// When its name is none, or the network refuses.
    pub fn subscribe<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: QualityOfService,
        handle: impl FnMut(M) + Send + 'static,
    ) -> Result<(), RosError> {
        let full = self.identity.resolve(topic)?;
        match &mut self.over {
            Over::Dds(node) => node.subscribe(full, quality, handle),
            Over::Zenoh(node) => node.subscribe(full, quality, handle),
        }
    }

    /// Offers a service: `handle` gets each call, on a thread of the node, and may answer at any time from any thread.
    ///
    /// # Errors
    /// When its name is none, or the network refuses.
    pub fn serve<S: RosService>(
        &mut self,
        name: &str,
        handle: impl FnMut(Call<S>) + Send + 'static,
    ) -> Result<(), RosError> {
        let full = self.identity.resolve(name)?;
        match &mut self.over {
            Over::Dds(node) => node.serve(full, handle),
            Over::Zenoh(node) => node.serve(full, handle),
        }
    }

    /// Begins to receive.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn run(self) -> Result<RunningNode, RosError> {
        let transport = match self.over {
            Over::Dds(node) => node.run(&self.identity.full_name())?,
            Over::Zenoh(node) => node.run()?,
        };
        Ok(RunningNode { transport, undecodable: self.undecodable })
    }
}

impl RunningNode {
    /// Messages that were none of their type.
    pub fn undecodable(&self) -> u64 {
        self.undecodable.0.load(Ordering::Relaxed)
    }

    /// Whether another node subscribes to a topic, by its full name.
    pub fn has_subscribers(&self, full_name: &str) -> bool {
        self.transport.has_subscribers(full_name)
    }
}
