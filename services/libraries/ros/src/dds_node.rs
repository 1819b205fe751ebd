//! A node's topics and services over DDS.

use crate::messages::{RosMessage, RosService};
use crate::ros_node::{Answer, Call, RunningTransport, SendMessage, Undecodable};
use crate::{Environment, Middleware, NodeIdentity, QualityOfService, Reach, RosError};
use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, Topic, TopicKind};
use ros2_client::{
    Context, Gid, MessageTypeName, Name, NodeName, NodeOptions, ServiceMapping, ServiceTypeName,
};
use std::future::Future;
use std::net::Ipv4Addr;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// After an invalid message the next is awaited for this time: a sender of invalid messages does not get all of a core …
const PAUSE_AFTER_MALFORMED: Duration = Duration::from_millis(1);
/// … but only after so many of them within this: good messages of the topic wait, too.
const MALFORMED_FREE: u32 = 10;
const MALFORMED_SPAN: Duration = Duration::from_millis(10);

/// What receives on a topic or a service, once the node runs.
type SubscriptionTask = Box<dyn FnOnce() -> Pin<Box<dyn Future<Output = ()>>> + Send>;

/// A node over DDS, before it receives.
pub struct DdsNode {
    participant: DomainParticipant,
    node: ros2_client::Node,
    mapping: ServiceMapping,
    tasks: Vec<SubscriptionTask>,
    undecodable: Arc<Undecodable>,
    /// Of its own publishers.
    own: Arc<Mutex<Vec<Gid>>>,
}

/// A node that receives. It leaves the graph when it is dropped.
struct RunningDdsNode {
    node: Option<ros2_client::Node>,
    thread: Option<std::thread::JoinHandle<()>>,
    end: Option<tokio::sync::oneshot::Sender<()>>,
}

impl DdsNode {
    /// Joins the graph.
    pub fn open(
        identity: &NodeIdentity,
        environment: &Environment,
        undecodable: Arc<Undecodable>,
    ) -> Result<Self, RosError> {
        let refused = |reason: String| RosError::Network { domain: environment.domain, reason };
        let builder = DomainParticipantBuilder::new(environment.domain);
        let builder = match environment.reach {
            Reach::Localhost => builder.with_only_networks([Ipv4Addr::LOCALHOST]),
            Reach::Subnet => builder,
        };
        let participant = builder.build().map_err(|error| refused(error.to_string()))?;
        let context = Context::from_domain_participant(participant.clone())
            .map_err(|error| refused(error.to_string()))?;
        let name = NodeName::new(&identity.namespace, &identity.name)
            .map_err(|error| RosError::Name { name: identity.full_name(), reason: error.to_string() })?;
        // Lines of the log are those of the whole set, and parameters are services like others.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(|error| refused(format!("{error:?}")))?;
        let mapping = match environment.middleware {
            Middleware::CycloneDds => ServiceMapping::Cyclone,
            Middleware::FastDds | Middleware::Zenoh => ServiceMapping::Enhanced,
        };
        Ok(Self { participant, node, mapping, tasks: Vec::new(), undecodable, own: Arc::default() })
    }

    /// Sends on a topic, by its full name.
    pub fn publisher<M: RosMessage>(
        &mut self,
        full: &str,
        quality: QualityOfService,
    ) -> Result<SendMessage<M>, RosError> {
        // What the profile does not say stays as the topic has it.
        let topic = self.topic::<M>(full, &quality.publisher_policies())?;
        let publisher = self
            .node
            .create_publisher::<M>(&topic, Some(quality.profile()))
            .map_err(|error| refused(full, &error))?;
        self.own.lock().expect("no thread panics with it").push(publisher.gid());
        Ok(Box::new(move |message| publisher.publish(message).map_err(|error| error.to_string())))
    }

    /// Subscribes to a topic, by its full name.
    pub fn subscribe<M: RosMessage>(
        &mut self,
        full: String,
        quality: QualityOfService,
        mut handle: impl FnMut(M) + Send + 'static,
    ) -> Result<(), RosError> {
        let topic = self.topic::<M>(&full, &quality.profile().into())?;
        let subscription = self
            .node
            .create_subscription::<M>(&topic, Some(quality.profile()))
            .map_err(|error| refused(&full, &error))?;
        let (undecodable, own) = (Arc::clone(&self.undecodable), Arc::clone(&self.own));
        let listen = async move {
            let mut malformed = MalformedMessages::default();
            loop {
                match subscription.async_take().await {
                    Ok((message, info)) => {
                        let sender = info.publisher_gid();
                        let is_own = own.lock().expect("no thread panics with it").contains(&sender);
                        if !is_own {
                            handle(message);
                        }
                    }
                    Err(error) => {
                        undecodable.note(&full, &error);
                        malformed.pause().await;
                    }
                }
            }
        };
        self.tasks.push(Box::new(move || Box::pin(listen)));
        Ok(())
    }

    /// Offers a service, by its full name.
    pub fn serve<S: RosService>(
        &mut self,
        full: String,
        mut handle: impl FnMut(Call<S>) + Send + 'static,
    ) -> Result<(), RosError> {
        let quality = QualityOfService::Reliable { depth: 10 }.profile();
        let server = self
            .node
            .create_server::<S::Request, S::Response>(
                self.mapping,
                &parsed(&full)?,
                &ServiceTypeName::new(S::TYPE.0, S::TYPE.1),
                quality.clone(),
                quality,
            )
            .map_err(|error| refused(&full, &error))?;
        let server = Arc::new(server);
        let undecodable = Arc::clone(&self.undecodable);
        let listen = async move {
            let mut malformed = MalformedMessages::default();
            loop {
                match server.async_receive_request().await {
                    Ok((id, request)) => {
                        let (server, name) = (Arc::clone(&server), full.clone());
                        let answer = move |response| {
                            if let Err(error) = server.send_response(id, response) {
                                tracing::warn!(name, ?error, "an answer could not be sent");
                            }
                        };
                        handle(Call { request, answer: Answer(Box::new(answer)) });
                    }
                    Err(error) => {
                        undecodable.note(&full, &error);
                        malformed.pause().await;
                    }
                }
            }
        };
        self.tasks.push(Box::new(move || Box::pin(listen)));
        Ok(())
    }

    /// Begins to receive, on a thread of its own.
    pub fn run(mut self, name: &str) -> Result<Box<dyn RunningTransport>, RosError> {
        let spinner = self.node.spinner().map_err(|error| refused(name, &error))?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .map_err(|error| refused(name, &error))?;
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        let subscriptions = self.tasks;
        let receive = move || {
            let tasks = Rc::new(tokio::task::LocalSet::new());
            tasks.spawn_local(async move {
                if let Err(error) = spinner.spin().await {
                    tracing::error!(%error, "the graph of ROS cannot be followed");
                }
            });
            for task in subscriptions {
                tasks.spawn_local(task());
            }
            // An end that is dropped is an end, too.
            let _ = runtime.block_on(tasks.run_until(ended));
        };
        let thread = std::thread::Builder::new()
            .name("ros".to_owned())
            .spawn(receive)
            .map_err(|error| refused(name, &error))?;
        Ok(Box::new(RunningDdsNode { node: Some(self.node), thread: Some(thread), end: Some(end) }))
    }

    fn topic<M: RosMessage>(&self, full: &str, policies: &QosPolicies) -> Result<Topic, RosError> {
        let kind = MessageTypeName::new(M::TYPE.0, M::TYPE.1).dds_msg_type();
        let topic = self.participant.create_topic(dds_name(full)?, kind, policies, TopicKind::NoKey);
        topic.map_err(|error| refused(full, &error))
    }
}

impl RunningTransport for RunningDdsNode {
    fn has_subscribers(&self, full_name: &str) -> bool {
        self.node.as_ref().is_some_and(|node| node.subscription_count(full_name) > 0)
    }
}

impl Drop for RunningDdsNode {
    fn drop(&mut self) {
        self.node = None;
        self.end = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// How many messages that cannot be decoded were received of late.
#[derive(Default)]
struct MalformedMessages {
    since: Option<Instant>,
    count: u32,
}

impl MalformedMessages {
    /// Counts one, and waits where there are too many.
    async fn pause(&mut self) {
        if self.since.is_none_or(|since| since.elapsed() > MALFORMED_SPAN) {
            *self = Self { since: Some(Instant::now()), count: 0 };
        }
        self.count += 1;
        if self.count > MALFORMED_FREE {
            tokio::time::sleep(PAUSE_AFTER_MALFORMED).await;
        }
    }
}

fn parsed(full: &str) -> Result<Name, RosError> {
    Name::parse(full).map_err(|error| RosError::Name { name: full.to_owned(), reason: error.to_string() })
}

/// The name of a topic on the wire.
fn dds_name(full: &str) -> Result<String, RosError> {
    parsed(full).map(|_| format!("rt{full}"))
}

fn refused(name: &str, error: &impl std::fmt::Display) -> RosError {
    RosError::Open { name: name.to_owned(), reason: error.to_string() }
}
