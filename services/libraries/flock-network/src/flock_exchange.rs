//! The exchange of records with the flock: takes what comes over the network, answers, publishes what is new, and works out the common map in between.

use super::common::Common;
use super::drops::{Dropped, Drops};
use super::link::{Link, ReceivedMessage, Traffic, address, hexadecimal};
use super::metrics::FlockMetrics;
use super::pace::{Budget, Pace};
use super::proximity::Proximity;
use super::record_publisher::RecordPublisher;
use super::relay::Relay;
use super::robot_poses::RobotPoses;
use super::thread_state::{Shared, Task, locked};
use crate::settings::FlockSettings;
use flockslam_flock::Flock;
use flockslam_geometry::Pose;
use flockslam_records::{Message, RecordError};
use flockslam_stage::StageError;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

mod exchange_status;
mod presence_exchange;

/// How long the thread sleeps when nothing happens.
const PAUSE: Duration = Duration::from_millis(50);
/// The version vector is sent to a neighbour this often, when nothing is new …
const ANNOUNCE_PERIOD: Duration = Duration::from_secs(5);
/// … when something is …
const OFFER_PERIOD: Duration = Duration::from_secs(2);
/// … and when records have just come: there may be more where they come from.
const HURRY: Duration = Duration::from_millis(500);
/// A neighbour is sent records no more often than this: what it was sent last may still be on its way.
const ANSWER_PERIOD: Duration = Duration::from_millis(500);
/// Records in answer to one message, bytes: what a slow radio link carries in a second.
const ANSWER_BYTES: usize = 1 << 20;
/// Bytes that each other robot is sent in a minute at most; a minute's worth may go at once. 100 kB/s leave room on a radio link
/// that several robots share.
const BYTES_PER_MINUTE: u64 = 6_000_000;
/// Searches between two polls for received messages.
const SEARCHES: u64 = 10;
/// Looking for shared places takes at most half of a processor's time as long as the robot drives …
const SEARCH_PACE: (Duration, u32) = (Duration::from_millis(200), 1);
/// … and laying them out a quarter.
const SOLUTION_PACE: (Duration, u32) = (Duration::from_secs(1), 3);
/// A network that cannot be opened is tried again after this.
const OPEN_PERIOD: Duration = Duration::from_secs(3);
/// What a robot sends before it leaves is received within this.
const FLUSH_TIME: Duration = Duration::from_millis(500);

/// A robot that is near.
struct Neighbour {
    /// When the version vector was sent to it last, and the hash of that.
    published: Option<(Instant, [u8; 32])>,
    /// When it was sent records last.
    answered: Option<Instant>,
    budget: Budget,
}

/// What the thread of the flock knows.
pub struct FlockExchange {
    settings: FlockSettings,
    publisher: RecordPublisher,
    link: Option<Link>,
    opened: Option<Instant>,
    problem: Option<String>,
    proximity: Box<dyn Proximity>,
    connected: BTreeSet<String>,
    near: BTreeMap<String, Neighbour>,
    /// When records of others came last.
    enriched: Option<Instant>,
    relay: Relay,
    drops: Arc<Drops>,
    traffic: Arc<Traffic>,
    /// Hash of the records in which everything has been looked for.
    searched: [u8; 32],
    search_pace: Pace,
    common: Common,
    solution_pace: Pace,
    revision: u32,
    /// Where this robot's submaps lie in its own map.
    map_from_odom: Vec<(u32, Pose)>,
    shared: Arc<Shared>,
    robot_poses: RobotPoses,
    /// When the robot's pose was sent to neighbours last, and the scan of that.
    was_here: Option<(Instant, u64)>,
    status_dir: PathBuf,
    metrics: FlockMetrics,
    shown: Option<Instant>,
    ending: Option<(Sender<()>, Instant)>,
}

impl FlockExchange {
    /// An exchange that has not begun.
    pub fn new(
        settings: &FlockSettings,
        publisher: RecordPublisher,
        proximity: Box<dyn Proximity>,
        status_dir: PathBuf,
        metrics: FlockMetrics,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            settings: settings.clone(),
            publisher,
            link: None,
            opened: None,
            problem: None,
            proximity,
            connected: BTreeSet::new(),
            near: BTreeMap::new(),
            enriched: None,
            relay: Relay::default(),
            drops: Arc::default(),
            traffic: Arc::default(),
            searched: [0; 32],
            search_pace: Pace::new(SEARCH_PACE.0, SEARCH_PACE.1),
            common: Common::default(),
            solution_pace: Pace::new(SOLUTION_PACE.0, SOLUTION_PACE.1),
            revision: 0,
            map_from_odom: Vec::new(),
            shared,
            robot_poses: RobotPoses::default(),
            was_here: None,
            status_dir,
            metrics,
            shown: None,
            ending: None,
        }
    }

    /// Goes on until the stage has gone.
    pub fn run(&mut self, tasks: &Receiver<Task>) {
        loop {
            let mut task = tasks.recv_timeout(PAUSE);
            loop {
                match task {
                    Ok(task) => self.take(task),
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                task = tasks.recv_timeout(Duration::ZERO);
            }
            self.open();
            self.look_around();
            self.receive();
            self.search();
            self.conclude();
            self.announce_to_neighbours();
            self.publish_place();
            self.end();
            self.show();
        }
    }

    fn take(&mut self, task: Task) {
        let outcome = match task {
            Task::Findings(findings) => self.publisher.publish(findings),
            Task::Submap(submap) => self.publisher.publish_submap(&submap),
            Task::Clearances(store, numbers) => numbers
                .into_iter()
                .try_for_each(|number| self.publisher.publish_clearances(&store.load(number)?)),
            Task::SubmapPoses(map_from_odom) => {
                self.map_from_odom = map_from_odom;
                self.place();
                Ok(())
            }
            Task::Finish(done) => {
                self.ending = Some((done, Instant::now()));
                Ok(())
            }
        };
        kept(outcome);
    }

    /// Opens the network, when it is time to try: nothing else depends on it.
    fn open(&mut self) {
        let now = Instant::now();
        if self.link.is_some() || self.opened.is_some_and(|at| now - at < OPEN_PERIOD) {
            return;
        }
        self.opened = Some(now);
        let opened = Link::open(&self.settings, self.publisher.flock().robot(), &self.drops, &self.traffic);
        match opened {
            Ok(link) => (self.link, self.problem) = (Some(link), None),
            Err(error) => {
                if self.problem.as_ref() != Some(&error) {
                    tracing::error!(error, "the network of the flock cannot be opened; the robot maps alone");
                }
                self.problem = Some(error);
            }
        }
    }

    /// Determines the robots that are near.
    fn look_around(&mut self) {
        let (Some(link), now) = (&self.link, Instant::now()) else { return };
        self.connected = link.connected();
        self.connected.remove(&address(self.publisher.flock().robot()));
        let proximity = &mut self.proximity;
        let near: BTreeSet<&String> =
            self.connected.iter().filter(|peer| proximity.is_near(peer, now)).collect();
        self.near.retain(|peer, _| near.contains(peer));
        for peer in near {
            if !self.near.contains_key(peer) {
                let budget = Budget::new(BYTES_PER_MINUTE, now);
                self.near.insert(peer.clone(), Neighbour { published: None, answered: None, budget });
            }
        }
    }

    fn receive(&mut self) {
        self.relay.look(Instant::now(), self.publisher.flock().collection());
        while let Some(received) = self.link.as_ref().and_then(Link::next) {
            self.answer(&received);
        }
    }

    fn answer(&mut self, received: &ReceivedMessage) {
        let message = match Message::decode(&received.bytes) {
            Ok(message) => message,
            Err(RecordError::Version(_)) => return self.drops.count(Dropped::Version, 1),
            Err(_) => return self.drops.count(Dropped::Malformed, 1),
        };
        let Some(neighbour) = self.near.get_mut(&received.sender) else {
            return self.drops.count(Dropped::NotNear, 1);
        };
        if let Message::Here(presence) = message {
            return self.meet(presence, &received.sender);
        }
        let now = Instant::now();
        let asks = !matches!(message, Message::Records(_));
        if !asks {
            self.enriched = Some(now);
        }
        if asks && neighbour.answered.is_some_and(|at| now - at < ANSWER_PERIOD) {
            // It asks again.
            return;
        }
        let budget = neighbour.budget.left(now).min(ANSWER_BYTES);
        if asks && budget == 0 {
            return self.drops.count(Dropped::Budget, 1);
        }
        let message = match message {
            Message::Have(theirs) => {
                let near = self.near.keys().filter(|peer| **peer != received.sender);
                Message::Have(self.relay.held_back(theirs, self.publisher.flock().collection(), near))
            }
            other => other,
        };
        let neighbour = self.near.get_mut(&received.sender).expect("it was there");
        let answers = match self.publisher.answer(&message, budget, &self.drops) {
            Ok(answers) => answers,
            Err(error) => return kept(Err(error)),
        };
        if !answers.is_empty() {
            neighbour.answered = Some(now);
        }
        let Some(link) = &self.link else { return };
        for answer in &answers {
            neighbour.budget.spend(link.send_to(&received.sender, answer));
        }
    }

    /// Looks for shared places while there is something that was not looked at.
    fn search(&mut self) {
        let known = self.known();
        if known == self.searched || !(self.search_pace.is_due(Instant::now()) || self.ending.is_some()) {
            return;
        }
        if self.is_alone() {
            self.searched = known;
            return;
        }
        let publisher = &mut self.publisher;
        match self.search_pace.keep(|| publisher.search(SEARCHES)) {
            Ok(true) => self.searched = self.known(),
            Ok(false) => {}
            Err(error) => kept(Err(error)),
        }
    }

    /// Computes the common solution of the records received so far.
    fn conclude(&mut self) {
        let known = self.known();
        let due =
            self.solution_pace.is_due(Instant::now()) || self.ending.is_some() && known == self.searched;
        if known == self.common.of_records || self.is_alone() || !due {
            return;
        }
        let (publisher, epoch) = (&self.publisher, self.publisher.epoch());
        self.common = self.solution_pace.keep(|| Common::of(publisher.flock(), epoch));
        self.revision += 1;
        self.place();
    }

    /// Tells the stage the pose of its map in that of the flock.
    fn place(&self) {
        let frame = self.common.frame(&self.map_from_odom, self.revision);
        *locked(&self.shared.frame) = frame;
        self.show_robot_poses();
    }

    fn announce_to_neighbours(&mut self) {
        let (known, now) = (self.known(), Instant::now());
        let Some(link) = &self.link else { return };
        let mut have = None;
        let offer_period =
            if self.enriched.is_some_and(|at| now - at < 2 * HURRY) { HURRY } else { OFFER_PERIOD };
        for (peer, neighbour) in &mut self.near {
            let due = neighbour.published.is_none_or(|(at, published)| {
                let period = if published == known { ANNOUNCE_PERIOD } else { offer_period };
                now - at >= period
            });
            if !due {
                continue;
            }
            neighbour.published = Some((now, known));
            if neighbour.budget.left(now) == 0 {
                self.drops.count(Dropped::Budget, 1);
                continue;
            }
            let have = have.get_or_insert_with(|| self.publisher.flock().have());
            neighbour.budget.spend(link.send_to(peer, have));
        }
    }

    /// After the end of the source: waits for the others, but not for ever.
    fn end(&mut self) {
        let Some((_, since)) = &self.ending else { return };
        let over = since.elapsed().as_secs_f64() > self.settings.wait_max_s;
        let known = self.known();
        let quiet = known == self.searched && (self.is_alone() || known == self.common.of_records);
        let mut agreed = quiet && self.settings.wait_for_robots == 0 && self.near.is_empty();
        if let (Some(link), true) = (&mut self.link, quiet) {
            let hash = hexadecimal(&known[..16]);
            let was_sent = link.announce_end(&hash) >= FLUSH_TIME;
            let mut ended = link.ended_with(&hash);
            ended.remove(&address(self.publisher.flock().robot()));
            let all_ended = self.near.keys().all(|peer| ended.contains(peer));
            agreed |= was_sent && all_ended && ended.len() >= self.settings.wait_for_robots;
        }
        // Nobody will come to a robot without a network.
        agreed |= self.link.is_none() && self.problem.is_some();
        if agreed || over {
            self.shown = None;
            self.show();
            let (done, _) = self.ending.take().expect("it was there");
            // The stage may have gone.
            let _ = done.send(());
        }
    }

    fn known(&self) -> [u8; 32] {
        self.flock().collection().hash()
    }

    fn is_alone(&self) -> bool {
        self.flock().collection().robots().count() < 2
    }

    fn flock(&self) -> &Flock {
        self.publisher.flock()
    }
}

/// Only the disk can fail here: the failure is logged, and the robot goes on mapping.
fn kept(outcome: Result<(), StageError>) {
    if let Err(error) = outcome {
        tracing::error!(%error, "the flock's records or status are not kept");
    }
}
