//! The thread that keeps the map and publishes it: it may take its time, transforms do not wait for it.

use super::BridgeError;
use super::bridge_parameters::LiveNumber;
use super::graph_markers::GraphMarkers;
use super::map_change::map_change;
use super::map_picture::{MapPainter, MapPicture};
use crate::recording::request_tiles;
use crate::time_slice;
use flockslam_bus::{Bus, Capacity, RuntimeDir, Subscriber};
use flockslam_geometry::Pose;
use flockslam_messages::{Commit, Control, PoseEstimate, TileMessage};
use flockslam_page::{FollowedMap, Version, version_of};
use flockslam_results::SetMode;
use flockslam_ros::messages::{MapMetaData, MarkerArray, OccupancyGrid, OccupancyGridUpdate};
use flockslam_ros::{Node, Publisher, QualityOfService, RosError};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// Added to the niceness that a process begins with.
const NICENESS: i32 = 10;
/// The bus is looked at so often.
const LOOK: Duration = Duration::from_millis(200);
/// Submaps are brought to their places for no longer than this at a time.
const STEPS: Duration = Duration::from_millis(50);
/// A request for the map is answered after this time, even when submaps are not at their places yet.
const SETTLE: Duration = Duration::from_secs(10);
/// The first map is published within this time.
const FIRST: Duration = Duration::from_millis(500);

/// Changes of the map are published this often, while they have subscribers.
const CHANGE_PERIOD: Duration = Duration::from_secs(1);

/// Orders to the thread.
pub enum MapOrder {
    /// Publish, or rest.
    Active(bool),
    /// Who subscribes to what is made on demand only.
    Subscribed(SubscribedTopics),
    /// Bring the map up to date, publish it if it has changed, and hand it over with its stamp.
    Show(ShowMap),
}

/// Topics of the thread that have subscribers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscribedTopics {
    /// Changes of the map.
    pub changes: bool,
    /// The graph.
    pub graph: bool,
}

/// Takes the map, and its stamp in nanoseconds; `None` while there is none.
pub type ShowMap = Box<dyn FnOnce(Option<(&MapPicture, i64)>) + Send>;

/// Where and what the map is.
pub struct MapPlace {
    /// The set's directory.
    pub set_dir: PathBuf,
    /// Sizes of the set.
    pub capacity: Capacity,
    /// Its sync-manager says where submaps lie.
    pub optimises: bool,
    /// The set localizes at first: the map is the known one, and nothing of what it sees now.
    pub localizes: bool,
    /// Side of a cell of the set's map, metres …
    pub cell_size_m: f64,
    /// … and of the map that is published.
    pub resolution_m: f64,
    /// Frame of the map.
    pub map_frame: String,
    /// The map is published at most so often, seconds.
    pub interval_s: LiveNumber,
}

/// Publishers of the map.
pub struct MapPublishers {
    /// Those of the map itself; `None` where it is that of another node, which publishes it.
    own: Option<OwnMapPublishers>,
    /// The graph.
    graph: Publisher<MarkerArray>,
}

struct OwnMapPublishers {
    map: Publisher<OccupancyGrid>,
    metadata: Publisher<MapMetaData>,
    changes: Publisher<OccupancyGridUpdate>,
}

impl MapPublishers {
    /// Opens the topics, those of the map itself where it `is_own`.
    ///
    /// # Errors
    /// When the graph refuses.
    pub fn open(node: &mut Node, is_own: bool) -> Result<Self, RosError> {
        let latched = QualityOfService::Latched { depth: 1 };
        let own = is_own.then(|| -> Result<_, RosError> {
            Ok(OwnMapPublishers {
                map: node.publisher("map", QualityOfService::Latest)?,
                metadata: node.publisher("map_metadata", latched)?,
                changes: node.publisher("map_updates", QualityOfService::Reliable { depth: 10 })?,
            })
        });
        let own = own.transpose()?;
        let reliable = QualityOfService::Reliable { depth: 1 };
        Ok(Self { own, graph: node.publisher("slam_toolbox/graph_visualization", reliable)? })
    }

    /// Topics that are made only while they have subscribers: changes of the map, the graph. One that is not published has no name.
    pub fn on_demand_topics(&self) -> [String; 2] {
        let changes = self.own.as_ref().map_or("", |own| own.changes.topic());
        [changes, self.graph.topic()].map(str::to_owned)
    }
}

/// Starts the thread; it ends with the sender of orders.
///
/// # Errors
/// When the system refuses.
pub fn start(place: MapPlace, publishers: MapPublishers) -> Result<Sender<MapOrder>, BridgeError> {
    let (sender, orders) = channel();
    std::thread::Builder::new().name("map".to_owned()).spawn(move || {
        // Transforms go before maps. Should it be refused, a map takes a processor from them for some milliseconds.
        let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICENESS);
        let _ = time_slice::set(None, Duration::ZERO);
        if let Err(error) = keep(&place, &publishers, &orders) {
            // Without the bus there is nothing to do for this process; its successor may have it.
            tracing::error!(%error, "the map cannot be read");
            std::process::exit(1);
        }
    })?;
    Ok(sender)
}

struct MapThread<'p> {
    place: &'p MapPlace,
    publishers: &'p MapPublishers,
    tiles: Subscriber<TileMessage>,
    /// The publisher of the request for all tiles: the request ends with it.
    asked: Option<flockslam_bus::Publisher<Control>>,
    commits: Subscriber<Commit>,
    poses: Subscriber<PoseEstimate>,
    runtime: RuntimeDir,
    followed: FollowedMap,
    painter: MapPainter,
    map_from_odom: Pose,
    stamp_ns: i64,
    is_active: bool,
    subscribed: SubscribedTopics,
    graph: GraphMarkers,
    graph_sent: Instant,
    /// Whether it localizes now.
    localizes: bool,
    /// The set's file: it is written anew when the set begins another map, and when its mode changes.
    set_file: Option<Version>,
    /// Something has changed since the map was painted.
    is_stale: bool,
    painted: Option<MapPicture>,
    published: Option<MapPicture>,
    published_at: Option<Instant>,
    /// The map of subscribers that have received all changes; `None` when it is the published one.
    changed: Option<MapPicture>,
    /// When changes are looked for again.
    change_due: Instant,
    // The ports go before the bus.
    bus: Bus,
}

fn keep(
    place: &MapPlace,
    publishers: &MapPublishers,
    orders: &Receiver<MapOrder>,
) -> Result<(), BridgeError> {
    let mut thread = MapThread::join(place, publishers)?;
    loop {
        match orders.recv_timeout(LOOK) {
            Ok(MapOrder::Active(is_active)) => thread.set_active(is_active),
            Ok(MapOrder::Subscribed(subscribed)) => thread.subscribed = subscribed,
            Ok(MapOrder::Show(show)) => {
                thread.read()?;
                thread.bring_up(SETTLE);
                thread.paint();
                thread.publish();
                show(thread.painted.as_ref().map(|map| (map, thread.stamp_ns)));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        thread.read()?;
        thread.bring_up(STEPS);
        if thread.is_due() {
            thread.paint();
            thread.publish();
        } else {
            thread.publish_change();
        }
        thread.publish_graph();
    }
}

impl<'p> MapThread<'p> {
    fn join(place: &'p MapPlace, publishers: &'p MapPublishers) -> Result<Self, BridgeError> {
        let runtime = RuntimeDir::open(&place.set_dir).map_err(std::io::Error::other)?;
        let bus = Bus::join(&runtime, "ros-map", place.capacity)?;
        let mut thread = Self {
            place,
            publishers,
            tiles: bus.subscriber()?,
            asked: None,
            commits: bus.subscriber()?,
            poses: bus.subscriber()?,
            followed: FollowedMap::new(&runtime, place.optimises, place.cell_size_m),
            painter: MapPainter::new(place.resolution_m, place.cell_size_m),
            map_from_odom: Pose::IDENTITY,
            stamp_ns: 0,
            is_active: false,
            subscribed: SubscribedTopics::default(),
            graph: GraphMarkers::default(),
            graph_sent: Instant::now(),
            localizes: SetMode::read(&runtime.results()).map_or(place.localizes, |mode| mode.localizes),
            set_file: version_of(&runtime.configuration()),
            is_stale: false,
            painted: None,
            published: None,
            published_at: None,
            changed: None,
            change_due: Instant::now(),
            runtime,
            bus,
        };
        thread.request_tiles()?;
        Ok(thread)
    }

    /// The mapper sends all its tiles once more; otherwise only those came that change.
    fn request_tiles(&mut self) -> Result<(), BridgeError> {
        self.asked = None;
        self.asked = Some(request_tiles(&self.bus)?);
        Ok(())
    }

    fn set_active(&mut self, is_active: bool) {
        self.is_active = is_active;
        if is_active {
            // Who comes later than the last map gets the newest.
            (self.published, self.published_at, self.changed) = (None, None, None);
            self.is_stale = true;
        }
    }

    fn read(&mut self) -> Result<(), BridgeError> {
        while let Some(pose) = self.poses.receive()? {
            self.map_from_odom = pose.map_from_odom;
            self.graph.push(&pose);
        }
        while let Some(commit) = self.commits.receive()? {
            self.stamp_ns = commit.times.sensor_ns;
        }
        let present = version_of(&self.runtime.configuration());
        if present != self.set_file {
            self.set_file = present;
            let mode = SetMode::read(&self.runtime.results());
            self.localizes = mode.map_or(self.place.localizes, |mode| mode.localizes);
            self.followed = FollowedMap::new(&self.runtime, self.place.optimises, self.place.cell_size_m);
            self.painter.clear();
            (self.painted, self.published, self.changed) = (None, None, None);
            self.graph = GraphMarkers::default();
            self.is_stale = true;
            self.request_tiles()?;
        }
        while let Some(tile) = self.tiles.receive()? {
            if !self.localizes {
                self.painter.take(&tile);
                self.is_stale = true;
            }
        }
        let stored = self.followed.look();
        self.is_stale |= stored.is_new;
        stored.poses.into_iter().for_each(|solution| self.graph.solve(solution));
        Ok(())
    }

    /// Brings submaps to their places, for a time.
    fn bring_up(&mut self, limit: Duration) {
        let began = Instant::now();
        while began.elapsed() < limit && self.followed.step() {
            self.is_stale = true;
        }
    }

    fn is_due(&self) -> bool {
        let interval = Duration::from_secs_f64(self.place.interval_s.get());
        let interval = if self.published.is_some() { interval } else { interval.min(FIRST) };
        let is_new = self.is_stale || self.changed.is_some();
        self.is_active && is_new && self.published_at.is_none_or(|at| at.elapsed() >= interval)
    }

    fn paint(&mut self) {
        if self.is_stale {
            self.painted = self.painter.paint(self.followed.map(), self.map_from_odom);
            self.is_stale = false;
        }
    }

    /// Publishes the map when it has changed.
    fn publish(&mut self) {
        if !self.is_active {
            return;
        }
        (self.published_at, self.changed) = (Some(Instant::now()), None);
        self.change_due = Instant::now() + CHANGE_PERIOD;
        let Some(painted) = self.painted.as_ref().filter(|painted| self.published.as_ref() != Some(*painted))
        else {
            return;
        };
        if let Some(own) = &self.publishers.own {
            let message = painted.message(self.stamp_ns, &self.place.map_frame);
            own.metadata.send(message.info.clone());
            if !own.map.send(message) {
                // A subscriber has not received the ones before: the next one is sent when it is due.
                self.is_stale = true;
                return;
            }
        }
        self.published = Some(painted.clone());
    }

    /// Publishes what has changed since the map was published, while somebody subscribes to it.
    fn publish_change(&mut self) {
        let Some(own) = self.publishers.own.as_ref().filter(|_| self.subscribed.changes) else { return };
        if !(self.is_active && self.is_stale && self.change_due <= Instant::now()) {
            return;
        }
        self.change_due = Instant::now() + CHANGE_PERIOD;
        self.paint();
        let before = self.changed.as_ref().or(self.published.as_ref());
        let (Some(before), Some(painted)) = (before, &self.painted) else { return };
        if let Some(change) = map_change(before, painted, self.stamp_ns, &self.place.map_frame) {
            own.changes.send(change);
            self.changed = Some(painted.clone());
        } else if before != painted {
            // Another size: the whole map comes when it is due.
            self.is_stale = true;
        }
    }

    fn publish_graph(&mut self) {
        let interval = Duration::from_secs_f64(self.place.interval_s.get());
        if self.is_active && self.subscribed.graph && self.graph_sent.elapsed() >= interval {
            self.graph_sent = Instant::now();
            let origins = self.followed.origins();
            let stamp_ns = self.stamp_ns;
            self.publishers.graph.send(self.graph.message(stamp_ns, &self.place.map_frame, origins));
        }
    }
}
