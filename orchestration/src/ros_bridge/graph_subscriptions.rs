//! What the bridge receives from the graph: topics and calls, put into one bounded queue.

use super::bridge_parameters::BridgeParameters;
use super::lifecycle::NodeState;
use super::transform_filter::TransformFilter;
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
pub enum GraphInput {
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
    /// An initial pose of the robot.
    InitialPose(Box<PoseWithCovariance>),
    /// A transition is requested.
    ChangeState(Call<ChangeState>),
    /// The state is requested.
    GetState(Call<GetState>),
    /// The available transitions are requested.
    GetTransitions(Call<GetAvailableTransitions>),
}

/// Hands on what is received.
pub struct InputSender {
    inputs: SyncSender<GraphInput>,
    dropped: Arc<AtomicU64>,
}

impl InputSender {
    /// A sender that puts what is received into `inputs`; what does not fit is counted in `dropped`.
    pub fn new(inputs: SyncSender<GraphInput>, dropped: Arc<AtomicU64>) -> Self {
        Self { inputs, dropped }
    }

    fn put(&self) -> impl Fn(GraphInput) + Send + 'static {
        let (inputs, dropped) = (self.inputs.clone(), Arc::clone(&self.dropped));
        move |what| {
            if inputs.try_send(what).is_err() {
                dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

/// Subscribes to everything that the bridge needs.
///
/// # Errors
/// When DDS refuses.
pub fn subscribe(
    node: &mut Node,
    parameters: &BridgeParameters,
    sender: &InputSender,
) -> Result<(), RosError> {
    let sensor = |depth| QualityOfService::Sensor { depth };
    for topic in &parameters.scan_topics {
        let (put, name) = (sender.put(), Arc::<str>::from(topic.as_str()));
        node.subscribe(topic, sensor(10), move |scan| {
            put(GraphInput::Scan(Arc::clone(&name), Box::new(scan), Instant::now()));
        })?;
    }
    let (put, mut filter) = (sender.put(), TransformFilter::of_moving());
    node.subscribe("/tf", QualityOfService::Reliable { depth: 100 }, move |message| {
        if let Some(message) = filter.filter(message) {
            put(GraphInput::Transforms(message, false));
        }
    })?;
    let (put, mut filter) = (sender.put(), TransformFilter::of_static());
    node.subscribe("/tf_static", QualityOfService::Latched { depth: 100 }, move |message| {
        if let Some(message) = filter.filter(message) {
            put(GraphInput::Transforms(message, true));
        }
    })?;
    if !parameters.odom_topic.is_empty() {
        let put = sender.put();
        node.subscribe(&parameters.odom_topic, sensor(50), move |message| {
            put(GraphInput::Odometry(Box::new(message)))
        })?;
    }
    if !parameters.imu_topic.is_empty() {
        let put = sender.put();
        node.subscribe(&parameters.imu_topic, sensor(50), move |message| {
            put(GraphInput::Imu(Box::new(message)))
        })?;
    }
    if parameters.use_sim_time {
        let put = sender.put();
        node.subscribe("/clock", sensor(10), move |message: Clock| {
            put(GraphInput::Clock(message.clock.ns()))
        })?;
    }
    let put = sender.put();
    node.subscribe(
        "/initialpose",
        QualityOfService::Reliable { depth: 10 },
        move |message: PoseWithCovarianceStamped| {
            put(GraphInput::InitialPose(Box::new(message.pose)));
        },
    )?;
    let put = sender.put();
    node.serve::<ChangeState>("~/change_state", move |call| put(GraphInput::ChangeState(call)))?;
    let put = sender.put();
    node.serve::<GetState>("~/get_state", move |call| put(GraphInput::GetState(call)))?;
    let put = sender.put();
    node.serve::<GetAvailableTransitions>("~/get_available_transitions", move |call| {
        put(GraphInput::GetTransitions(call));
    })?;
    node.serve::<GetAvailableTransitions>("~/get_transition_graph", |call| {
        call.answer.send(GetAvailableTransitionsResponse { available_transitions: NodeState::graph() });
    })?;
    node.serve::<GetAvailableStates>("~/get_available_states", |call| {
        call.answer.send(GetAvailableStatesResponse { available_states: NodeState::messages() });
    })
}
