//! Services that handle the map and the flow of scans, under the names of slam_toolbox and of nav2's types. What takes time is done on
//! a thread of its own, one call after the other.

use super::BridgeError;
use super::localisation_relay::order_near;
use super::map_picture::MapPicture;
use super::map_thread::MapOrder;
use crate::outputs::{render_pgm, render_yaml};
use crate::supervisor::{Reply, Request, ask};
use flockslam_geometry::Pose;
use flockslam_journal::{Durability, replace_file};
use flockslam_ros::messages::{
    ClearQueue, ClearQueueResponse, DeserializePoseGraph, DeserializePoseGraphResponse, Empty, EmptyResponse,
    GetMap, GetMapResponse, LoadMap, LoadMapResponse, NavigationSaveMap, NavigationSaveMapResponse,
    OccupancyGrid, Reset, ResetResponse, RosService, SerializePoseGraph, SerializePoseGraphResponse, SetBool,
    SetBoolResponse, SetInitialPose, SetInitialPoseResponse, TogglePause, TogglePauseResponse,
    ToolboxSaveMap, ToolboxSaveMapResponse, Trigger, TriggerResponse,
};
use flockslam_ros::{Call, Node};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::time::Duration;

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

/// How a set is reached.
#[derive(Clone)]
pub struct SetOrders {
    socket: PathBuf,
    map: Sender<MapOrder>,
    map_frame: String,
}

type Task = Box<dyn FnOnce(&SetOrders) + Send>;

impl SetOrders {
    /// Of the set with this control socket, the thread that has its map, and the frame of that.
    pub fn new(socket: &Path, map: Sender<MapOrder>, map_frame: &str) -> Self {
        Self { socket: socket.to_owned(), map, map_frame: map_frame.to_owned() }
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

    fn is_paused(&self) -> Result<bool, String> {
        match self.order(&Request::Status)? {
            Reply::Status(status) => Ok(status.paused),
            _ => Err("the set answered something else".to_owned()),
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
pub fn offer(node: &mut Node, orders: SetOrders) -> Result<(), BridgeError> {
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
    if services.node.answers_at_any_length() {
        services.offer_map()?;
    }
    Ok(())
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
            let toggled = orders.is_paused().and_then(|paused| orders.done(&Request::Pause(!paused)));
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
            let done = orders.done(&Request::Load(absolute(&request.filename)));
            DeserializePoseGraphResponse { result: if done.is_ok() { 0 } else { NOT_READ } }
        })?;
        // An answer with the map would not arrive (docs/ros2.md): it comes on its topic.
        self.offer::<LoadMap>("flockslam/load_map", |orders, request| {
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

    /// The whole map, where an answer may be as long.
    fn offer_map(&mut self) -> Result<(), BridgeError> {
        self.offer::<GetMap>("slam_toolbox/dynamic_map", |orders, _| {
            let frame = orders.map_frame.clone();
            let map = orders.map(move |map| map.map(|(map, stamp_ns)| map.message(stamp_ns, &frame)));
            GetMapResponse { map: map.flatten().unwrap_or_default() }
        })
    }
}
