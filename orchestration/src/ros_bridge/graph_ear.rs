//! What the bridge hears of the graph: topics and calls, put into one bounded queue.

use super::bridge_parameters::BridgeParameters;
use super::lifecycle::NodeState;
use super::transform_sieve::TransformSieve;
use flockslam_ros::messages::{
    ChangeState, Clock, GetAvailableStates, GetAvailableStatesResponse, GetAvailableTransitions,
    GetAvailableTransitionsResponse, GetState, Imu, LaserScan, Odometry, PoseWithCovariance,
    PoseWithCovarianceStamped, TFMessage,
};
use flockslam_ros::{Call, Node, QualityOfService, RosError};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::Instant;

/// What the graph says.
pub enum Heard {
    /// A scan, the topic that it came on, and when it came.
    Scan(Arc<str>, Box<LaserScan>, Instant),
    /// Transforms; whether they hold at all times.
    Transforms(TFMessage, bool),
    /// Odometry.
    Odometry(Box<Odometry>),
    /// Rates of turning.
    Imu(Box<Imu>),
    /// The time, nanoseconds.
    Clock(i64),
    /// Where somebody says that the robot is.
    InitialPose(Box<PoseWithCovariance>),
    /// A transition is asked for.
    ChangeState(Call<ChangeState>),
    /// The state is asked for.
    GetState(Call<GetState>),
    /// The transitions from here are asked for.
    GetTransitions(Call<GetAvailableTransitions>),
}

/// Hands on what is heard.
pub struct Ear {
    heard: SyncSender<Heard>,
    dropped: Arc<AtomicU64>,
}

impl Ear {
    /// An ear that puts what it hears into `heard`; what does not fit is counted in `dropped`.
    pub fn new(heard: SyncSender<Heard>, dropped: Arc<AtomicU64>) -> Self {
        Self { heard, dropped }
    }

    fn put(&self) -> impl Fn(Heard) + Send + 'static {
        let (heard, dropped) = (self.heard.clone(), Arc::clone(&self.dropped));
        move |what| {
            if heard.try_send(what).is_err() {
                dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

/// Hears everything that the bridge wants to hear.
///
/// # Errors
/// When DDS refuses.
pub fn listen(node: &mut Node, parameters: &BridgeParameters, ear: &Ear) -> Result<(), RosError> {
    let sensor = |depth| QualityOfService::Sensor { depth };
    for topic in &parameters.scan_topics {
        let (put, name) = (ear.put(), Arc::<str>::from(topic.as_str()));
        node.subscribe(topic, sensor(10), move |scan| {
            put(Heard::Scan(Arc::clone(&name), Box::new(scan), Instant::now()));
        })?;
    }
    let (put, mut sieve) = (ear.put(), TransformSieve::of_moving());
    node.subscribe("/tf", QualityOfService::Reliable { depth: 100 }, move |message| {
        if let Some(message) = sieve.sift(message) {
            put(Heard::Transforms(message, false));
        }
    })?;
    let (put, mut sieve) = (ear.put(), TransformSieve::of_static());
    node.subscribe("/tf_static", QualityOfService::Latched { depth: 100 }, move |message| {
        if let Some(message) = sieve.sift(message) {
            put(Heard::Transforms(message, true));
        }
    })?;
    if !parameters.odom_topic.is_empty() {
        let put = ear.put();
        node.subscribe(&parameters.odom_topic, sensor(50), move |message| {
            put(Heard::Odometry(Box::new(message)))
        })?;
    }
    if !parameters.imu_topic.is_empty() {
        let put = ear.put();
        node.subscribe(&parameters.imu_topic, sensor(50), move |message| put(Heard::Imu(Box::new(message))))?;
    }
    if parameters.use_sim_time {
        let put = ear.put();
        node.subscribe("/clock", sensor(10), move |message: Clock| put(Heard::Clock(message.clock.ns())))?;
    }
    let put = ear.put();
    node.subscribe(
        "/initialpose",
        QualityOfService::Reliable { depth: 10 },
        move |message: PoseWithCovarianceStamped| {
            put(Heard::InitialPose(Box::new(message.pose)));
        },
    )?;
    let put = ear.put();
    node.serve::<ChangeState>("~/change_state", move |call| put(Heard::ChangeState(call)))?;
    let put = ear.put();
    node.serve::<GetState>("~/get_state", move |call| put(Heard::GetState(call)))?;
    let put = ear.put();
    node.serve::<GetAvailableTransitions>("~/get_available_transitions", move |call| {
        put(Heard::GetTransitions(call));
    })?;
    node.serve::<GetAvailableTransitions>("~/get_transition_graph", |call| {
        call.answer.send(GetAvailableTransitionsResponse { available_transitions: NodeState::graph() });
    })?;
    node.serve::<GetAvailableStates>("~/get_available_states", |call| {
        call.answer.send(GetAvailableStatesResponse { available_states: NodeState::messages() });
    })
}
