//! The bridge at work: one loop that reads the graph and the bus, and publishes what is new.

mod corrector;

use super::BridgeError;
use super::bond::{Bond, HEARTBEAT_PERIOD};
use super::bridge_parameters::BridgeParameters;
use super::bridge_publishers::{BridgePublishers, quality};
use super::bridge_services::{MapSource, SetOrders, offer};
use super::diagnostics_thread::{Report, report_by};
use super::graph_clock::GraphClock;
use super::graph_subscriptions::{GraphInput, InputSender, subscribe};
use super::kept_state::KeptState;
use super::lifecycle::NodeState;
use super::localisation_relay::LocalisationRelay;
use super::log_relay::LogRelay;
use super::map_correction::MapCorrection;
use super::map_thread::{self, MapOrder, MapPlace, MapPublishers, SubscribedTopics};
use super::sensor_relay::SensorRelay;
use super::set_diagnostics::BridgeReport;
use super::track_markers::track_markers;
use flockslam_bus::{Bus, Capacity, RuntimeDir, SliceSubscriber, Subscriber};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, Quality, TracksHeader};
use flockslam_ros::messages::{
    ChangeState, ChangeStateResponse, GetAvailableTransitionsResponse, GetStateResponse, Transition,
    TransitionEvent,
};
use flockslam_ros::{Call, Environment, Node, NodeArguments, NodeIdentity, QualityOfService, RunningNode};
use flockslam_telemetry::{LatencyHistogram, monotonic_ns};
use std::num::NonZeroU64;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, sync_channel};
use std::time::{Duration, Instant};

/// Name of the node, unless the command line gives it another.
const NODE: &str = "flockslam";
/// What was received and is not yet handled; more is dropped and counted.
const INPUTS_MAX: usize = 1024;
/// While the pose of a scan is awaited, the bus is polled at this period: the matcher sends no event for each pose, and one is there within a
/// few milliseconds …
const LOOK_AWAITING: Duration = Duration::from_micros(100);
/// … when it takes longer than this, it may take much longer …
const AWAITING: Duration = Duration::from_millis(10);
const LOOK_AWAITING_LONG: Duration = Duration::from_millis(1);
/// … while poses come that are not of scans from the graph …
const LOOK_WATCHING: Duration = Duration::from_millis(10);
/// … and else.
const LOOK_IDLE: Duration = Duration::from_millis(50);
/// Poses come, when one came within this.
const WATCHING: Duration = Duration::from_secs(2);
/// Diagnostics follow one another after this.
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);
/// … so much later where the pose of a scan is awaited.
const REPORT_LATE_MAX: Duration = Duration::from_millis(500);
/// Another node that was seen to publish map → odom within this still does, nanoseconds.
const FOREIGN_NS: u64 = 5_000_000_000;
/// Lines of the log that late subscribers get.
const LINES_KEPT: usize = 100;
/// Messages that are handled before the bus is looked at again.
const BATCH: usize = 256;

/// What the bridge needs to know of the set that it serves.
pub struct BridgeSet {
    /// Its directory.
    pub runtime: RuntimeDir,
    /// Sizes of the set.
    pub capacity: Capacity,
    /// Its sync-manager says where submaps lie.
    pub optimises: bool,
    /// It localizes in a known map just now.
    pub localizes: bool,
    /// It has begun with a known map.
    pub is_map_given: bool,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// The socket that lidar-ingest reads.
    pub scan_socket: PathBuf,
}

/// Whether arguments of the node have a sense.
///
/// # Errors
/// When one has none.
pub fn check_arguments(arguments: &[String]) -> Result<(), BridgeError> {
    let arguments = NodeArguments::parse(arguments)?;
    let identity = NodeIdentity::new(NODE, arguments.remaps.clone())?;
    Environment::of_this_process()?.check()?;
    let parameters = BridgeParameters::of(&arguments, &identity)?;
    let topics = parameters.scan_topics.iter().chain([&parameters.odom_topic, &parameters.imu_topic]);
    topics.filter(|topic| !topic.is_empty()).try_for_each(|topic| identity.resolve(topic).map(drop))?;
    Ok(())
}

/// Runs the bridge until the set ends.
///
/// # Errors
/// When the graph or the bus cannot be joined, or an argument has no sense.
pub fn run_bridge(set: &BridgeSet, arguments: &[String]) -> Result<(), BridgeError> {
    let arguments = NodeArguments::parse(arguments)?;
    let environment = Environment::of_this_process()?;
    let identity = NodeIdentity::new(NODE, arguments.remaps.clone())?;
    let parameters = BridgeParameters::of(&arguments, &identity)?;
    for named in environment.unhonoured.iter().chain(&arguments.unhonoured) {
        tracing::warn!("without effect here: {named}");
    }
    if let Some(line) = parameters.unknown_line() {
        tracing::warn!("{line}");
    }
    let mut bridge = Bridge::open(set, parameters, identity, &environment)?;
    // The default slack of Linux adds 50 µs to each look. Without this looks come later, and nothing else changes.
    let _ = rustix::thread::set_current_timer_slack(Some(NonZeroU64::MIN));
    loop {
        bridge.turn()?;
    }
}

struct Bridge {
    parameters: BridgeParameters,
    name: String,
    inputs: Receiver<GraphInput>,
    dropped: Arc<AtomicU64>,
    node: RunningNode,
    publishers: BridgePublishers,
    clock: GraphClock,
    relay: SensorRelay,
    correction: MapCorrection,
    map: Sender<MapOrder>,
    reports: Sender<Report>,
    kept: KeptState,
    bond: Bond,
    poses: Subscriber<PoseEstimate>,
    tracks: SliceSubscriber<TracksHeader>,
    map_from_odom: Pose,
    robot: String,
    /// Topics that are made only while they have subscribers: changes of the map, the graph.
    on_demand_topics: [String; 2],
    subscribed_topics: SubscribedTopics,
    tracks_subscribed: bool,
    last_pose: Option<Instant>,
    /// When another node was seen to publish map → odom, on the monotonic clock, nanoseconds.
    foreign_ns: Option<u64>,
    /// How often the time of the graph has gone back.
    times_back: u64,
    latency: LatencyHistogram,
    heartbeat_due: Instant,
    report_due: Instant,
    localisation: LocalisationRelay,
    // The ports go before the bus.
    _bus: Bus,
}

impl Bridge {
    fn open(
        set: &BridgeSet,
        parameters: BridgeParameters,
        identity: NodeIdentity,
        environment: &Environment,
    ) -> Result<Self, BridgeError> {
        let name = identity.full_name();
        let bond_id = identity.name.clone();
        let mut node = Node::open(identity, environment, parameters.declared())?;
        let source = MapSource::of(set.is_map_given, parameters.use_map_topic);
        let map_publishers = MapPublishers::open(&mut node, source != MapSource::Graph)?;
        let on_demand_topics = map_publishers.on_demand_topics();
        let map_place = MapPlace {
            set_dir: set.runtime.path().to_owned(),
            capacity: set.capacity,
            optimises: set.optimises,
            localizes: set.localizes,
            cell_size_m: set.cell_size_m,
            resolution_m: parameters.resolution_m,
            map_frame: parameters.map_frame.clone(),
            interval_s: parameters.live.map_update_interval_s.clone(),
        };
        let map = map_thread::start(map_place, map_publishers)?;
        let publishers = BridgePublishers::open(&mut node, &parameters)?;
        let diagnostics = node.publisher("/diagnostics", QualityOfService::Reliable { depth: 10 })?;
        let robot = set.runtime.name().to_owned();
        let lines = node.publisher("/rosout", QualityOfService::Latched { depth: LINES_KEPT })?;
        let log = LogRelay::at_the_end(set.runtime.path(), &bond_id);
        let reports = report_by(diagnostics, lines, log, robot.clone(), set.runtime.control_socket())?;
        offer(&mut node, SetOrders::new(&set.runtime, map.clone(), &parameters.map_frame), source)?;
        let dropped = Arc::new(AtomicU64::new(0));
        let (sender, inputs) = sync_channel(INPUTS_MAX);
        subscribe(&mut node, &parameters, &InputSender::new(sender, Arc::clone(&dropped)))?;
        let bus = Bus::join(&set.runtime, "ros", set.capacity)?;
        let localisation = LocalisationRelay::open(&mut node, &bus, &set.runtime, set.localizes)?;
        let fresh = match (parameters.use_lifecycle_manager, parameters.autostart) {
            (false, true) => NodeState::Active,
            _ => NodeState::Unconfigured,
        };
        let kept = KeptState::open(&set.runtime.status(), fresh);
        let bond = Bond::new(&bond_id, &kept.instance);
        let has_odometry_topic = !parameters.odom_topic.is_empty();
        let (map_frame, odom_frame) = (&parameters.map_frame, &parameters.odom_frame);
        let mut bridge = Self {
            relay: SensorRelay::new(
                &set.scan_socket,
                map_frame,
                odom_frame,
                &parameters.base_frame,
                has_odometry_topic,
            ),
            correction: MapCorrection::new(odom_frame, &parameters.base_frame),
            clock: GraphClock::new(parameters.use_sim_time),
            name,
            inputs,
            dropped,
            node: node.run()?,
            publishers,
            map,
            reports,
            bond,
            poses: bus.subscriber()?,
            tracks: bus.slice_subscriber()?,
            map_from_odom: Pose::IDENTITY,
            robot,
            on_demand_topics,
            subscribed_topics: SubscribedTopics::default(),
            tracks_subscribed: false,
            last_pose: None,
            foreign_ns: None,
            times_back: 0,
            latency: LatencyHistogram::default(),
            heartbeat_due: Instant::now(),
            report_due: Instant::now(),
            localisation,
            _bus: bus,
            parameters,
            kept,
        };
        bridge.enter(bridge.kept.state);
        tracing::info!(node = bridge.name, domain = environment.domain, "in the graph of ROS");
        Ok(bridge)
    }

    /// One turn: receives, reads, publishes.
    fn turn(&mut self) -> Result<(), BridgeError> {
        let watching = self.last_pose.is_some_and(|at| at.elapsed() < WATCHING);
        let look = match self.relay.awaited_for() {
            Some(since) if since < AWAITING => LOOK_AWAITING,
            Some(_) => LOOK_AWAITING_LONG,
            None if watching || self.relay.holds_scans() => LOOK_WATCHING,
            None => LOOK_IDLE,
        };
        match self.inputs.recv_timeout(look) {
            Ok(first) => {
                let more: Vec<_> = self.inputs.try_iter().take(BATCH).collect();
                std::iter::once(first).chain(more).for_each(|input| self.handle(input));
            }
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => {
                return Err(std::io::Error::other("nobody reads the graph any more").into());
            }
        }
        self.relay.tick();
        self.read_poses()?;
        self.localisation.tick(&self.parameters.map_frame);
        self.correct();
        self.beat();
        self.report();
        Ok(())
    }

    fn is_active(&self) -> bool {
        self.kept.state == NodeState::Active
    }

    fn handle(&mut self, input: GraphInput) {
        match input {
            GraphInput::Scan(topic, scan, at) => {
                let stamp_ns = scan.header.stamp.ns();
                if !self.is_active() || self.clock.is_of_before(stamp_ns) {
                    return;
                }
                // A simulation says so itself.
                if self.relay.goes_back(&topic, stamp_ns) && !self.clock.is_simulated() {
                    self.begin_time_anew(&format!("the stamps of {topic} have gone back"));
                }
                self.relay.take_scan(&topic, *scan, at, self.clock.now_ns());
            }
            GraphInput::Transforms(message, is_static) => {
                let stamp_ns = message.transforms.first().map(|transform| transform.header.stamp.ns());
                if !is_static && stamp_ns.is_some_and(|stamp_ns| self.clock.is_of_before(stamp_ns)) {
                    return;
                }
                if self.relay.take_transforms(message, is_static).is_some() {
                    self.note_foreign_correction();
                }
            }
            GraphInput::Odometry(message) => {
                if self.is_active() {
                    self.relay.take_odometry(*message);
                }
            }
            GraphInput::Imu(message) => {
                if self.is_active() {
                    self.relay.take_imu(*message);
                }
            }
            GraphInput::Clock(now_ns) => {
                if let Some(back_ns) = self.clock.advance(now_ns) {
                    let back_s = back_ns as f64 * 1e-9;
                    self.begin_time_anew(&format!("the time of /clock has gone back by {back_s:.1} s"));
                }
            }
            GraphInput::InitialPose(hint) => {
                if let Err(error) = self.localisation.take_hint(&hint) {
                    tracing::warn!(%error, "a hint of where the robot is does not reach the set");
                }
            }
            GraphInput::ChangeState(call) => self.change_state(call),
            GraphInput::GetState(call) => {
                call.answer.send(GetStateResponse { current_state: self.kept.state.message() });
            }
            GraphInput::GetTransitions(call) => {
                let available_transitions = self.kept.state.available();
                call.answer.send(GetAvailableTransitionsResponse { available_transitions });
            }
        }
    }

    fn change_state(&mut self, call: Call<ChangeState>) {
        let asked: &Transition = &call.request.transition;
        let Some(made) = self.kept.state.transition(asked) else {
            tracing::warn!(state = ?self.kept.state, id = asked.id, label = asked.label, "no such transition from here");
            return call.answer.send(ChangeStateResponse { success: false });
        };
        let was_active = self.is_active();
        self.enter(made.to);
        if was_active {
            self.send_heartbeat(false);
        }
        let description = made.message();
        self.publishers.transitions.send(TransitionEvent {
            timestamp: monotonic_ns(),
            transition: description.transition,
            start_state: description.start_state,
            goal_state: description.goal_state,
        });
        tracing::info!(transition = made.transition.1, "the node's state has changed");
        call.answer.send(ChangeStateResponse { success: true });
    }

    fn enter(&mut self, state: NodeState) {
        self.kept.keep(state);
        if state != NodeState::Active {
            self.correction.clear();
        }
        // The thread ends with this process only.
        let _ = self.map.send(MapOrder::Active(state == NodeState::Active));
    }

    fn read_poses(&mut self) -> Result<(), BridgeError> {
        while let Some(estimate) = self.poses.receive()? {
            self.last_pose = Some(Instant::now());
            self.map_from_odom = estimate.map_from_odom;
            if !self.is_active() {
                continue;
            }
            let estimate = *estimate;
            // The transform is what controllers wait for: it goes first.
            if estimate.quality != Quality::Lost as u32 && self.localisation.places(&estimate) {
                self.take_pose(&estimate);
                self.correct();
                self.publishers.send_pose(&estimate, &self.parameters.map_frame);
                self.localisation.send_pose(&estimate, &self.parameters.map_frame);
            }
            self.publishers.quality.send(quality(&estimate, &self.robot));
        }
        while let Some(tracks) = self.tracks.receive()? {
            if self.tracks_subscribed && self.is_active() {
                let (stamp_ns, map) = (tracks.header().times.sensor_ns, &self.parameters.map_frame);
                let markers = track_markers(stamp_ns, map, self.map_from_odom, tracks.elements());
                self.publishers.tracks.send(markers);
            }
        }
        Ok(())
    }

    /// Checks for subscribers of the topics that are made on demand only.
    fn look_around(&mut self) {
        self.tracks_subscribed = self.node.has_subscribers(self.publishers.tracks.topic());
        let [changes, graph] = [0, 1].map(|index| self.node.has_subscribers(&self.on_demand_topics[index]));
        let subscribed = SubscribedTopics { changes, graph };
        if std::mem::replace(&mut self.subscribed_topics, subscribed) != subscribed {
            let _ = self.map.send(MapOrder::Subscribed(subscribed));
        }
    }

    fn beat(&mut self) {
        if self.heartbeat_due > Instant::now() {
            return;
        }
        self.heartbeat_due = Instant::now() + HEARTBEAT_PERIOD;
        if self.is_active() {
            self.send_heartbeat(true);
        }
    }

    fn send_heartbeat(&self, is_active: bool) {
        if let Some(publisher) = &self.publishers.bond {
            publisher.send(self.bond.status(self.clock.stamp_ns(), is_active));
        }
    }

    fn report(&mut self) {
        let late = Instant::now().saturating_duration_since(self.report_due);
        // Scans come at even times: one in ten would wait for it each time.
        let is_awaited = self.relay.awaited_for().is_some_and(|since| since < AWAITING);
        if self.report_due > Instant::now() || (is_awaited && late < REPORT_LATE_MAX) {
            return;
        }
        self.report_due = Instant::now() + DIAGNOSTICS_PERIOD;
        self.kept.keep(self.kept.state);
        self.look_around();
        let now_ns = self.clock.now_ns();
        let counts = self.relay.counts;
        let figures = [
            ("scans relayed", counts.relayed),
            ("scans without a place", counts.unplaced),
            ("scans malformed", counts.malformed),
            ("scans not taken", counts.untaken),
            ("scans apart from the clock", counts.apart),
            ("times gone back", self.times_back),
            ("poses without odometry", self.correction.without_odometry),
            ("messages dropped", self.dropped.load(Ordering::Relaxed)),
            ("messages undecodable", self.node.undecodable()),
            ("scan to transform p99 µs", self.latency.quantile_ns(0.99) / 1000),
        ];
        let report = BridgeReport {
            node: self.name.clone(),
            state: self.kept.state.message().label,
            corrects: now_ns
                .is_some_and(|now_ns| !self.correction.is_silent(self.relay.transforms(), now_ns)),
            foreign: self.foreign_ns.is_some(),
            figures: figures.into_iter().map(|(name, value)| (name, value.to_string())).collect(),
        };
        let _ = self.reports.send(Report::Regular(report, self.clock.stamp_ns()));
    }
}
