//! A node: its topics, services and parameters over DDS. One thread hears for it.

use crate::messages::{RosMessage, RosService};
use crate::{Callers, Environment, NodeIdentity, ParameterValue, QualityOfService, Reach, RosError};
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::{
    Context, Gid, MessageTypeName, Name, NodeName, NodeOptions, ServiceMapping, ServiceTypeName,
};
use std::future::Future;
use std::net::Ipv4Addr;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// After a message that is none the next is waited for so long: who sends nothing else does not get all of a core.
const PAUSE_AFTER_GARBAGE: Duration = Duration::from_millis(1);

/// What hears on a topic or a service, once the node runs.
type Ear = Box<dyn FnOnce() -> Pin<Box<dyn Future<Output = ()>>> + Send>;

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

/// A node of the graph, before it hears.
pub struct Node {
    identity: NodeIdentity,
    node: ros2_client::Node,
    callers: Callers,
    ears: Vec<Ear>,
    undecodable: Arc<AtomicU64>,
    /// Of its own publishers.
    own: Arc<Mutex<Vec<Gid>>>,
}

/// A node that hears. It leaves the graph when it is dropped.
pub struct RunningNode {
    node: Option<ros2_client::Node>,
    undecodable: Arc<AtomicU64>,
    hearing: Option<std::thread::JoinHandle<()>>,
    end: Option<tokio::sync::oneshot::Sender<()>>,
}

/// Sends on a topic.
pub struct Publisher<M: RosMessage> {
    topic: String,
    publisher: ros2_client::Publisher<M>,
}

/// A call of a service, and the way back to who called.
pub struct Call<S: RosService> {
    /// What is asked.
    pub request: S::Request,
    /// Takes the answer.
    pub answer: Answer<S>,
}

/// The way back to who called a service.
pub struct Answer<S: RosService>(Box<dyn FnOnce(S::Response) + Send>);

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

    /// Sends a message. One that cannot be sent is said in the log.
    pub fn send(&self, message: M) {
        if let Err(error) = self.publisher.publish(message) {
            tracing::warn!(topic = self.topic, %error, "a message could not be sent");
        }
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
        let refused = |reason: String| RosError::Network { domain: environment.domain, reason };
        let builder = DomainParticipantBuilder::new(environment.domain);
        let builder = match environment.reach {
            Reach::Localhost => builder.with_only_networks([Ipv4Addr::LOCALHOST]),
            Reach::Subnet => builder,
        };
        let participant = builder.build().map_err(|error| refused(error.to_string()))?;
        let context =
            Context::from_domain_participant(participant).map_err(|error| refused(error.to_string()))?;
        let name = NodeName::new(&identity.namespace, &identity.name)
            .map_err(|error| RosError::Name { name: identity.full_name(), reason: error.to_string() })?;
        let node =
            context.new_node(name, options(parameters)).map_err(|error| refused(format!("{error:?}")))?;
        let callers = environment.callers;
        Ok(Self {
            identity,
            node,
            callers,
            ears: Vec::new(),
            undecodable: Arc::default(),
            own: Arc::default(),
        })
    }

    /// A topic to send on.
    ///
    /// # Errors
    /// When its name is none, or DDS refuses.
    pub fn publisher<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: QualityOfService,
    ) -> Result<Publisher<M>, RosError> {
        let (topic, full) = self.topic::<M>(topic, quality)?;
        let publisher = self
            .node
            .create_publisher(&topic, Some(quality.profile()))
            .map_err(|error| refused(&full, &error))?;
        self.own.lock().expect("no thread panics with it").push(publisher.gid());
        Ok(Publisher { topic: full, publisher })
    }

    /// Hears a topic: `hear` gets each message of other nodes, on the node's thread. What is no such message is counted.
    ///
    /// # Errors
    /// When its name is none, or DDS refuses.
    pub fn subscribe<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: QualityOfService,
        mut hear: impl FnMut(M) + Send + 'static,
    ) -> Result<(), RosError> {
        let (topic, full) = self.topic::<M>(topic, quality)?;
        let subscription = self
            .node
            .create_subscription::<M>(&topic, Some(quality.profile()))
            .map_err(|error| refused(&full, &error))?;
        let (undecodable, own) = (Arc::clone(&self.undecodable), Arc::clone(&self.own));
        let listen = async move {
            loop {
                match subscription.async_take().await {
                    Ok((message, info)) => {
                        let sender = info.publisher_gid();
                        let is_own = own.lock().expect("no thread panics with it").contains(&sender);
                        if !is_own {
                            hear(message);
                        }
                    }
                    Err(error) => note(&undecodable, &full, &error).await,
                }
            }
        };
        self.ears.push(Box::new(move || Box::pin(listen)));
        Ok(())
    }

    /// Offers a service: `hear` gets each call, on the node's thread, and may answer at any time from any thread.
    ///
    /// # Errors
    /// When its name is none, or DDS refuses.
    pub fn serve<S: RosService>(
        &mut self,
        name: &str,
        mut hear: impl FnMut(Call<S>) + Send + 'static,
    ) -> Result<(), RosError> {
        let full = self.identity.resolve(name)?;
        let quality = QualityOfService::Reliable { depth: 10 }.profile();
        let mapping = match self.callers {
            Callers::FastDds => ServiceMapping::Enhanced,
            Callers::CycloneDds => ServiceMapping::Cyclone,
        };
        let server = self
            .node
            .create_server::<S::Request, S::Response>(
                mapping,
                &parsed(&full)?,
                &ServiceTypeName::new(S::TYPE.0, S::TYPE.1),
                quality.clone(),
                quality,
            )
            .map_err(|error| refused(&full, &error))?;
        let server = Arc::new(server);
        let undecodable = Arc::clone(&self.undecodable);
        let listen = async move {
            loop {
                match server.async_receive_request().await {
                    Ok((id, request)) => {
                        let (server, name) = (Arc::clone(&server), full.clone());
                        let answer = move |response| {
                            if let Err(error) = server.send_response(id, response) {
                                tracing::warn!(name, ?error, "an answer could not be sent");
                            }
                        };
                        hear(Call { request, answer: Answer(Box::new(answer)) });
                    }
                    Err(error) => note(&undecodable, &full, &error).await,
                }
            }
        };
        self.ears.push(Box::new(move || Box::pin(listen)));
        Ok(())
    }

    /// Begins to hear, on a thread of its own.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn run(mut self) -> Result<RunningNode, RosError> {
        let name = self.identity.full_name();
        let spinner = self.node.spinner().map_err(|error| refused(&name, &error))?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .map_err(|error| refused(&name, &error))?;
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        let ears = self.ears;
        let hear = move || {
            let tasks = Rc::new(tokio::task::LocalSet::new());
            tasks.spawn_local(async move {
                if let Err(error) = spinner.spin().await {
                    tracing::error!(%error, "the graph of ROS cannot be heard");
                }
            });
            for ear in ears {
                tasks.spawn_local(ear());
            }
            // An end that is dropped is an end, too.
            let _ = runtime.block_on(tasks.run_until(ended));
        };
        let hearing = std::thread::Builder::new()
            .name("ros".to_owned())
            .spawn(hear)
            .map_err(|error| refused(&name, &error))?;
        Ok(RunningNode {
            node: Some(self.node),
            undecodable: self.undecodable,
            hearing: Some(hearing),
            end: Some(end),
        })
    }

    fn topic<M: RosMessage>(
        &self,
        name: &str,
        quality: QualityOfService,
    ) -> Result<(ros2_client::dds::rustdds::Topic, String), RosError> {
        let full = self.identity.resolve(name)?;
        let kind = MessageTypeName::new(M::TYPE.0, M::TYPE.1);
        let topic = self.node.create_topic(&parsed(&full)?, kind, &quality.profile());
        Ok((topic.map_err(|error| refused(&full, &error))?, full))
    }
}

impl RunningNode {
    /// Messages that were none of their type.
    pub fn undecodable(&self) -> u64 {
        self.undecodable.load(Ordering::Relaxed)
    }

    /// Whether another node hears a topic, by its full name.
    pub fn is_heard(&self, full_name: &str) -> bool {
        self.node.as_ref().is_some_and(|node| node.subscription_count(full_name) > 0)
    }
}

impl Drop for RunningNode {
    fn drop(&mut self) {
        self.node = None;
        self.end = None;
        if let Some(hearing) = self.hearing.take() {
            let _ = hearing.join();
        }
    }
}

fn options(parameters: Vec<Parameter>) -> NodeOptions {
    // Lines of the log are those of the whole set: a publisher like others sends them.
    let mut options = NodeOptions::new().enable_rosout(false);
    let mut changes = Vec::new();
    for parameter in parameters {
        options = options.declare_parameter(&parameter.name, parameter.value.into());
        // The client looks after the time itself.
        if parameter.name != "use_sim_time" {
            changes.push((parameter.name, parameter.change));
        }
    }
    // Each parameter is validated once when it is declared; what comes later is a change.
    let declared = changes.len();
    let seen = AtomicU64::new(0);
    let is_open = AtomicBool::new(declared == 0);
    options.parameter_validator(Box::new(move |name, value| {
        if !is_open.load(Ordering::Relaxed) {
            let before = seen.fetch_add(1, Ordering::Relaxed);
            is_open.store(before + 1 >= declared as u64, Ordering::Relaxed);
            return Ok(());
        }
        let change = changes.iter().find(|(known, _)| known == name).and_then(|(_, change)| change.as_ref());
        let change = change.ok_or_else(|| format!("{name} cannot be changed while the node runs"))?;
        let value = ParameterValue::from_wire(value).ok_or("a value of this type has no meaning here")?;
        change(&value)
    }))
}

async fn note(undecodable: &AtomicU64, name: &str, error: &impl std::fmt::Debug) {
    let before = undecodable.fetch_add(1, Ordering::Relaxed);
    if before.is_power_of_two() || before == 0 {
        tracing::warn!(name, ?error, count = before + 1, "a message is not of the type of its topic");
    }
    tokio::time::sleep(PAUSE_AFTER_GARBAGE).await;
}

fn parsed(full: &str) -> Result<Name, RosError> {
    Name::parse(full).map_err(|error| RosError::Name { name: full.to_owned(), reason: error.to_string() })
}

fn refused(name: &str, error: &impl std::fmt::Display) -> RosError {
    RosError::Open { name: name.to_owned(), reason: error.to_string() }
}
