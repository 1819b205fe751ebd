//! Services that handle the map and the flow of scans, under the names of slam_toolbox and of nav2's types. What takes time is done on
//! a thread of its own, one call after the other.

use super::BridgeError;
use super::graph_map::write_grid;
use super::localisation_relay::order_near;
use super::map_beginning::MapBeginning;
use super::map_picture::MapPicture;
use super::map_thread::MapOrder;
use crate::outputs::{render_pgm, render_yaml};
use crate::supervisor::{Reply, Request, SetStatus, StageState, ask};
use flockslam_bus::RuntimeDir;
use flockslam_geometry::Pose;
use flockslam_journal::{Durability, replace_file};
use flockslam_ros::messages::{
    ClearQueue, ClearQueueResponse, DeserializePoseGraph, DeserializePoseGraphResponse, Empty, EmptyResponse,
    GetMap, GetMapResponse, LoadMap, LoadMapResponse, NavigationSaveMap, NavigationSaveMapResponse,
    OccupancyGrid, Reset, ResetResponse, RosService, SerializePoseGraph, SerializePoseGraphResponse, SetBool,
    SetBoolResponse, SetInitialPose, SetInitialPoseResponse, TogglePause, TogglePauseResponse,
    ToolboxSaveMap, ToolboxSaveMapResponse, Trigger, TriggerResponse,
};
use flockslam_ros::{Call, Node, QualityOfService};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::time::Duration;

/// So often a map of another node is brought to the set, after a pause each.
const LOADS_MAX: u32 = 20;
const LOAD_PAUSE: Duration = Duration::from_millis(500);
/// A change of the mode is looked at so often.
const MODE_LOOK: Duration = Duration::from_millis(100);
/// Calls that wait; more are not answered.
const CALLS_MAX: usize = 16;
/// The map is there within this, or there is none.
const MAP_LIMIT: Duration = Duration::from_secs(20);

/// What services answer when something is not to be had.
const FAILURE: u8 = 255;
/// `slam_toolbox/SaveMap`, `nav2_msgs/LoadMap`: there is no map.
const NO_MAP: u8 = 1;
/// `slam_toolbox/DeserializePoseGraph`: the file cannot be read.
const NOT_READ: u8 = 3;

/// … or the way to begin has no meaning.
const NO_SUCH_BEGINNING: u8 = 2;

/// Whose map it is that the set works in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapSource {
    /// The set makes it.
    Set,
    /// It was given to the set, which localizes in it, or has: this node stands where nav2's map server stood.
    Given,
    /// Another node publishes it, and the set localizes in that.
    Graph,
}

impl MapSource {
    /// Of a set that began with a known map or not, whose node was requested to use another map.
    pub fn of(is_map_given: bool, uses_map_topic: bool) -> Self {
        if uses_map_topic && !is_map_given {
            tracing::warn!("use_map_topic has no effect while the map is being made");
        }
        match (is_map_given, uses_map_topic) {
            (false, _) => Self::Set,
            (true, false) => Self::Given,
            (true, true) => Self::Graph,
        }
    }
}

/// How a set is reached.
#[derive(Clone)]
pub struct SetOrders {
    socket: PathBuf,
    results: PathBuf,
    map: Sender<MapOrder>,
    map_frame: String,
}

type Task = Box<dyn FnOnce(&SetOrders) + Send>;

impl SetOrders {
    /// Of the set in this directory, the thread that has its map, and the frame of that.
    pub fn new(set: &RuntimeDir, map: Sender<MapOrder>, map_frame: &str) -> Self {
        let (socket, results) = (set.control_socket(), set.results());
        Self { socket, results, map, map_frame: map_frame.to_owned() }
    }

    fn order(&self, request: &Request) -> Result<Reply, String> {
        match ask(&self.socket, request).map_err(|error| error.to_string())? {
            Reply::Refused(reason) => Err(reason),
            reply => Ok(reply),
        }
    }

    /// As [`Self::order`]; a refusal is said in the log.
    fn done(&self, request: &Request) -> Result<(), String> {
        self.order(request).map(drop).inspect_err(|reason| {
            tracing::warn!(reason, "a call from the graph was refused");
        })
    }

    fn status(&self) -> Result<Box<SetStatus>, String> {
        match self.order(&Request::Status)? {
            Reply::Status(status) => Ok(status),
            _ => Err("the set answered something else".to_owned()),
        }
    }

    /// Lets the set localize in its map as it is, or map again, and waits until it does.
    fn changed_mode(&self, localizes: bool) -> Result<(), String> {
        self.done(&Request::Localize(localizes))?;
        loop {
            if let Some(outcome) = self.status()?.mode.outcome() {
                return outcome;
            }
            std::thread::sleep(MODE_LOOK);
        }
    }

    /// The map now, as `make` makes it.
    fn map<T: Send + 'static>(
        &self,
        make: impl FnOnce(Option<(&MapPicture, i64)>) -> T + Send + 'static,
    ) -> Option<T> {
        let (sender, receiver) = channel();
        let show = Box::new(move |map: Option<(&MapPicture, i64)>| {
            let _ = sender.send(make(map));
        });
        self.map.send(MapOrder::Show(show)).ok()?;
        receiver.recv_timeout(MAP_LIMIT).ok()
    }

    /// Writes `NAME.pgm` and `NAME.yaml`; false while there is no map.
    fn save_picture(&self, name: &str) -> Result<bool, String> {
        let name = if name.is_empty() { "map" } else { name };
        let Some(Some(image)) = self.map(|map| map.map(|(map, _)| map.image())) else { return Ok(false) };
        let beside = |ending: &str| PathBuf::from(format!("{name}.{ending}"));
        let picture = beside("pgm");
        let picture_name =
            picture.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let put = |path: &Path, bytes: &[u8]| {
            replace_file(path, bytes, Durability::Power).map_err(|error| error.to_string())
        };
        put(&picture, &render_pgm(&image))?;
        put(&beside("yaml"), render_yaml(&image, &picture_name).as_bytes())?;
        Ok(true)
    }

    /// Lets a set that localizes in another map from now on look for the robot where a hint says.
    fn look_near(&self, hint: [f64; 5]) {
        for _ in 0..LOADS_MAX {
            // Its stages are started anew.
            if self
                .status()
                .is_ok_and(|status| status.stages.iter().all(|stage| stage.state == StageState::Running))
            {
                let _ = self.done(&Request::Relocalize(Some(hint)));
                return;
            }
            std::thread::sleep(LOAD_PAUSE);
        }
        tracing::warn!("the pose of a call from the graph was not used: the stages of the set do not get up");
    }

    /// Lets the set localize in a map that another node has published. Where it does already, nothing changes.
    fn localize_in(&self, grid: &OccupancyGrid) {
        let load = || {
            let map = write_grid(&self.results, grid)?;
            // The set may be starting just now.
            for _ in 0..LOADS_MAX {
                match ask(&self.socket, &Request::Load(map.clone())) {
                    Ok(Reply::Refused(reason)) => return Err(reason),
                    Ok(_) => return Ok(()),
                    Err(error) => tracing::debug!(%error, "the set cannot be reached"),
                }
                std::thread::sleep(LOAD_PAUSE);
            }
            Err("the set cannot be reached".to_owned())
        };
        match load() {
            Ok(()) => tracing::info!(
                width = grid.info.width,
                height = grid.info.height,
                "localizes in the map of another node"
            ),
            Err(error) => tracing::error!(error, "the map of another node is not used"),
        }
    }

    fn saved(&self, name: &str) -> Result<bool, String> {
        self.save_picture(name).inspect_err(|error| tracing::warn!(error, "the map is not saved"))
    }
}

/// A path in a call, as seen from this process; nav2 writes them as addresses, too.
fn absolute(path: &str) -> PathBuf {
    let path = path.strip_prefix("file://").unwrap_or(path);
    std::path::absolute(path).unwrap_or_else(|_| PathBuf::from(path))
}

/// Offers the services.
///
/// # Errors
/// When DDS or the system refuses.
pub fn offer(node: &mut Node, orders: SetOrders, source: MapSource) -> Result<(), BridgeError> {
    let (tasks, waiting) = sync_channel::<Task>(CALLS_MAX);
    std::thread::Builder::new().name("calls".to_owned()).spawn(move || {
        while let Ok(task) = waiting.recv() {
            task(&orders);
        }
    })?;
    let mut services = Services { node, tasks };
    services.offer_flow()?;
    services.offer_maps()?;
    services.offer_localisation()?;
    match source {
        MapSource::Set => services.offer_whole_map("slam_toolbox/dynamic_map"),
        MapSource::Given => {
            services.offer_loading("map_server/load_map")?;
            services.offer_whole_map("map_server/map")?;
            services.offer_whole_map("slam_toolbox/dynamic_map")
        }
        MapSource::Graph => services.subscribe_to_map(),
    }
}

struct Services<'n> {
    node: &'n mut Node,
    tasks: SyncSender<Task>,
}

impl Services<'_> {
    /// A service whose answer `reply` works out.
    fn offer<S: RosService>(
        &mut self,
        name: &str,
        reply: impl Fn(&SetOrders, S::Request) -> S::Response + Clone + Send + 'static,
    ) -> Result<(), BridgeError> {
        let tasks = self.tasks.clone();
        self.node.serve::<S>(name, move |Call { request, answer }| {
            let reply = reply.clone();
            let task: Task = Box::new(move |orders| answer.send(reply(orders, request)));
            if tasks.try_send(task).is_err() {
                tracing::warn!("too many calls from the graph: one is not answered");
            }
        })?;
        Ok(())
    }

    fn offer_flow(&mut self) -> Result<(), BridgeError> {
        self.offer::<TogglePause>("slam_toolbox/pause_new_measurements", |orders, _| {
            let toggled = orders
                .status()
                .map(|status| status.paused)
                .and_then(|paused| orders.done(&Request::Pause(!paused)));
            TogglePauseResponse { status: toggled.is_ok() }
        })?;
        // No scan waits here for longer than its pose takes.
        self.offer::<ClearQueue>("slam_toolbox/clear_queue", |_, _| ClearQueueResponse { status: true })?;
        self.offer::<Reset>("slam_toolbox/reset", |orders, request| {
            let reset = orders
                .done(&Request::Reset)
                .and_then(|()| orders.done(&Request::Pause(request.pause_new_measurements)));
            ResetResponse { result: if reset.is_ok() { 0 } else { FAILURE } }
        })?;
        self.offer::<SetBool>("flockslam/pause", |orders, request| {
            let done = orders.done(&Request::Pause(request.data));
            SetBoolResponse { success: done.is_ok(), message: done.err().unwrap_or_default() }
        })?;
        self.offer::<SetBool>("flockslam/localize", |orders, request| {
            let done = orders.changed_mode(request.data);
            SetBoolResponse { success: done.is_ok(), message: done.err().unwrap_or_default() }
        })?;
        self.offer::<Trigger>("flockslam/reset", |orders, _| {
            let done = orders.done(&Request::Reset);
            TriggerResponse { success: done.is_ok(), message: done.err().unwrap_or_default() }
        })
    }

    fn offer_maps(&mut self) -> Result<(), BridgeError> {
        self.offer::<ToolboxSaveMap>("slam_toolbox/save_map", |orders, request| {
            let result = match orders.saved(&request.name) {
                Ok(true) => 0,
                Ok(false) => NO_MAP,
                Err(_) => FAILURE,
            };
            ToolboxSaveMapResponse { result }
        })?;
        self.offer::<NavigationSaveMap>("flockslam/save_map", |orders, request| NavigationSaveMapResponse {
            result: orders.saved(&request.map_url) == Ok(true),
        })?;
        self.offer::<SerializePoseGraph>("slam_toolbox/serialize_map", |orders, request| {
            let done = orders.done(&Request::Save(absolute(&request.filename)));
            SerializePoseGraphResponse { result: if done.is_ok() { 0 } else { FAILURE } }
        })?;
        self.offer::<DeserializePoseGraph>("slam_toolbox/deserialize_map", |orders, request| {
            // The mode may have been changed since the start.
            let localizes = orders.status().is_ok_and(|status| status.mode.name == "localize");
            let begin = match MapBeginning::of(request.match_type, request.initial_pose, localizes) {
                Ok(begin) => begin,
                Err(reason) => {
                    tracing::warn!(reason, "a call from the graph was refused");
                    return DeserializePoseGraphResponse { result: NO_SUCH_BEGINNING };
                }
            };
            let done = orders.done(&Request::Load(absolute(&request.filename)));
            if let (Ok(()), MapBeginning::Near(hint)) = (&done, begin) {
                orders.look_near(hint);
            }
            DeserializePoseGraphResponse { result: if done.is_ok() { 0 } else { NOT_READ } }
        })?;
        self.offer_loading("flockslam/load_map")
    }

    fn offer_loading(&mut self, name: &str) -> Result<(), BridgeError> {
        // An answer with the map would not arrive (docs/ros2.md): it comes on its topic.
        self.offer::<LoadMap>(name, |orders, request| {
            let done = orders.done(&Request::Load(absolute(&request.map_url)));
            let result = if done.is_ok() { 0 } else { NO_MAP };
            LoadMapResponse { map: OccupancyGrid::default(), result }
        })
    }

    /// Under the names of AMCL.
    fn offer_localisation(&mut self) -> Result<(), BridgeError> {
        self.offer::<Empty>("reinitialize_global_localization", |orders, _| {
            // A refusal is in the log.
            let _ = orders.done(&Request::Relocalize(None));
            EmptyResponse::default()
        })?;
        // Every scan is looked at anyway.
        self.offer::<Empty>("request_nomotion_update", |_, _| EmptyResponse::default())?;
        self.offer::<SetInitialPose>("set_initial_pose", |orders, request| {
            let near = order_near(&request.pose.pose);
            let Pose { x_m, y_m, heading_rad } = near.map_from_base;
            let hint = [x_m, y_m, heading_rad, near.sigma_m, near.sigma_rad];
            let _ = orders.done(&Request::Relocalize(Some(hint)));
            SetInitialPoseResponse::default()
        })
    }

    /// Subscribes to the map that another node publishes.
    fn subscribe_to_map(&mut self) -> Result<(), BridgeError> {
        let tasks = self.tasks.clone();
        let latched = QualityOfService::Latched { depth: 1 };
        self.node.subscribe("map", latched, move |grid: OccupancyGrid| {
            let task: Task = Box::new(move |orders| orders.localize_in(&grid));
            if tasks.try_send(task).is_err() {
                tracing::error!("too many calls from the graph: a map of another node is not used");
            }
        })?;
        Ok(())
    }

    /// The whole map, where an answer may be as long.
    fn offer_whole_map(&mut self, name: &str) -> Result<(), BridgeError> {
        if !self.node.answers_at_any_length() {
            return Ok(());
        }
        self.offer::<GetMap>(name, |orders, _| {
            let frame = orders.map_frame.clone();
            let map = orders.map(move |map| map.map(|(map, stamp_ns)| map.message(stamp_ns, &frame)));
            GetMapResponse { map: map.flatten().unwrap_or_default() }
        })
    }
}
