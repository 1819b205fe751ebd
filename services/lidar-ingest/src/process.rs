//! The shell of lidar-ingest: reads a source, gives every scan its name and times, and puts it on the bus – by credit
//! in exact replay, by the clock when live.

mod cursor;
mod feed;
mod lidar_board;
mod lidar_line;
mod lidar_names;
mod lidar_search;
mod lidar_session;
mod lidar_watch;
mod live_lidars;
mod pacer;
mod pipe;
mod recording_inspection;
mod recording_reader;
mod scan_socket;
mod sensor_feed;
mod sensor_inlet;
mod topic_choice;
mod truth_file;
mod world_file;

use crate::Settings;
use cursor::Cursor;
use feed::{Fed, Feed};

pub use feed::count_scans;
use flockslam_bus::{ScanPublisher, Subscriber};
use flockslam_messages::{ControlKind, DropReason, LARGE_SCAN_BEAMS, Progress, ScanBuffer, ScanId, Stage};
use flockslam_stage::{
    Actor, FinalMessage, LeaderLock, Mode, Notifiers, Pause, StageContext, StageError, StreamEnd, run,
    step_aside,
};
use flockslam_telemetry::{failpoint, utc_ns};
pub use lidar_board::{LidarLineStatus, read_lidar_lines};
pub use lidar_line::{LidarPlace, LidarSpec};
pub use lidar_names::read_lidar_names;
pub use lidar_search::{FoundLidar, FoundPort, identify, serial_ports};
pub use lidar_session::{LidarHandler, LidarSession, LidarState};
use lidar_watch::LidarWatch;
pub use live_lidars::LidarPolling;
use pacer::Pacer;
pub use recording_inspection::{Inspection, LidarSummary, TopicSummary, TransformSummary, inspect};
pub use recording_reader::RecordingReader;
pub use scan_socket::SCAN_SOCKET;
use std::path::PathBuf;
use std::time::Duration;
pub use topic_choice::ReadRecordingError;
pub use world_file::read as read_world;

/// The source of scans.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// A CARMEN log, or a recording: a ROS 1 bag, rosbag2 files.
    Log(PathBuf),
    /// CARMEN lines or frames on the standard input of the process.
    Pipe,
    /// Frames on a local socket: at this path, or in the directory of the set.
    Scans(Option<PathBuf>),
    /// Lidars on lines of their own; odometry, rates of turning and scans of others on the local socket of the set.
    Lidars(Vec<LidarSpec>),
    /// The simulated world.
    Simulation,
    /// No source: the stream ends before its first scan. The run only has the map that it continues.
    Nothing,
}

/// Everything that the stage needs to start.
#[derive(Clone, Debug)]
pub struct Task {
    /// The source of scans.
    pub source: Source,
    /// Live replay: log seconds per second. `None` takes scans as they come.
    pub rate: Option<f64>,
    /// Settings of the stage.
    pub settings: Settings,
    /// Settings of the simulated world.
    pub simulation: flockslam_simulation::Settings,
    /// The YAML file of a map (nav2 conventions) to simulate in, in place of a built-in world.
    pub world: Option<PathBuf>,
}

/// Stages whose progress gives credit in exact replay.
const CONSUMERS: [Stage; 5] =
    [Stage::CorrelationFilter, Stage::ScanMatcher, Stage::Mapper, Stage::DynamicCleaner, Stage::SyncManager];
/// The one run of a process set that starts cold.
const RUN: u32 = 1;
/// Large scans on their way at once: their topic has a buffer of two.
const LARGE_CREDIT: u64 = 2;

/// Live replay: a scan is announced so long before it is due, as the first bytes from a sensor would announce it. Of this time, waking up
/// takes about a quarter in this process, and then up to a third in the others.
const ANNOUNCED_AHEAD: Duration = Duration::from_micros(400);

/// The stages that are woken for each scan. Live, the matcher wakes up while the filter runs: one after the other they would take as
/// long again as the matching itself. The matcher is woken first: the filter may take this very processor, and its
/// verdict is there before the matcher is awake.
fn first_stages(mode: Mode) -> &'static [Stage] {
    match mode {
        Mode::Exact => &[Stage::CorrelationFilter],
        Mode::Live => &[Stage::ScanMatcher, Stage::CorrelationFilter],
    }
}

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the source is not usable ([`StageError::Source`]) or the bus fails.
pub fn run_stage(context: &mut StageContext, task: Task) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::LidarIngest.name())?;
    let mut sent = 0;
    let lock = LeaderLock::ask(context)?;
    if !lock.stand_by(context, &event, |context| followed(context, &mut sent))? {
        return Ok(());
    }
    let mut shell = shell(context, task)?;
    run(context, &mut *shell, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// As [`run_stage`].
pub fn shell(context: &mut StageContext, task: Task) -> Result<Box<dyn Actor>, StageError> {
    Ok(Box::new(Ingest::open(context, task)?))
}

/// Scans that the active process has sent since the last call. Nothing else is to be followed: the cursor has its position.
fn followed(context: &StageContext, sent: &mut u64) -> Result<u64, StageError> {
    let next = Cursor::open(&context.status_dir, context.first_sequence)?.next_sequence();
    let before = std::mem::replace(sent, next);
    Ok(next.saturating_sub(before))
}

struct Ingest {
    feed: Feed,
    pacer: Option<Pacer>,
    cursor: Option<Cursor>,
    scans: ScanPublisher,
    watch: LidarWatch,
    /// Publishes the number of scans.
    end: FinalMessage,
    progress: Subscriber<Progress>,
    /// The stages that read a scan first.
    first: Notifiers,
    done: [u64; CONSUMERS.len()],
    scan: ScanBuffer,
    /// A scan is in `scan` and not yet sent.
    loaded: bool,
    /// It has been announced.
    announced: bool,
    sequence: u64,
    /// Scans were sent that the first stages have not been woken for.
    unnotified: bool,
    pause: Pause,
    /// The set was paused at the last look.
    rests: bool,
    stream: StreamEnd,
}

impl Ingest {
    fn open(context: &mut StageContext, task: Task) -> Result<Self, StageError> {
        let first = context.first_sequence;
        let cursor = match context.mode {
            Mode::Live => Some(Cursor::open(&context.status_dir, first)?),
            Mode::Exact => None,
        };
        let resumed = cursor.as_ref().filter(|_| !failpoint("no-cursor"));
        let resumed = resumed.map_or(first, Cursor::next_sequence);
        let pacer = task.rate.map(|rate| Pacer::new(rate, cursor.as_ref().and_then(Cursor::anchor)));
        let mut feed = Feed::open(context, &task)?;
        feed.skip(context, resumed.saturating_sub(first))?;
        let notifiers = |stages: &[Stage]| {
            let names: Vec<_> = stages.iter().map(|stage| stage.name()).collect();
            Notifiers::open(context, &names)
        };
        Ok(Self {
            feed,
            pacer,
            cursor,
            scans: context.bus.scan_publisher()?,
            watch: LidarWatch::new(context),
            end: FinalMessage::open(context, ControlKind::StreamEnd, RUN, notifiers(&CONSUMERS)?)?,
            progress: context.bus.subscriber()?,
            first: notifiers(first_stages(context.mode))?,
            done: [0; CONSUMERS.len()],
            scan: ScanBuffer::default(),
            loaded: false,
            announced: false,
            sequence: resumed,
            unnotified: false,
            pause: Pause::of(&context.status_dir),
            rests: false,
            stream: StreamEnd::open(context)?,
        })
    }

    fn read_progress(&mut self) -> Result<(), StageError> {
        while let Some(progress) = self.progress.receive()? {
            if let Some(at) = CONSUMERS.iter().position(|stage| *stage as u32 == progress.stage) {
                self.done[at] = self.done[at].max(progress.done);
            }
        }
        Ok(())
    }

    /// Exact replay: whether every consumer has room for the loaded scan.
    fn has_credit(&self, context: &StageContext) -> bool {
        let slowest = self.done.iter().copied().min().unwrap_or(0);
        let large = self.scan.numbers.len() > LARGE_SCAN_BEAMS;
        self.sequence < slowest + if large { LARGE_CREDIT } else { context.capacity.window as u64 }
    }

    fn is_due(&mut self, context: &StageContext) -> bool {
        match (context.mode, &mut self.pacer) {
            (Mode::Exact, _) => self.has_credit(context),
            (Mode::Live, Some(pacer)) => pacer.is_due(self.scan.header.times.sensor_ns, context.now_ns()),
            (Mode::Live, None) => true,
        }
    }

    /// Until the loaded scan is due.
    fn ahead(&self, now_ns: u64) -> Option<Duration> {
        let pacer = self.pacer.as_ref().filter(|_| self.loaded)?;
        Some(pacer.wait(self.scan.header.times.sensor_ns, now_ns))
    }

    /// Live: whether the set is paused. Meanwhile scans of a sensor are dropped; a replay goes on where it
    /// was, with a new time origin.
    fn rests(&mut self, context: &mut StageContext) -> bool {
        let rests = context.mode == Mode::Live && self.pause.is_set();
        if rests && self.loaded && self.feed.is_sensor() {
            self.loaded = false;
            context.dropped(DropReason::Paused.name());
        }
        if self.rests && !rests {
            self.pacer.iter_mut().for_each(Pacer::begin_anew);
        }
        self.rests = rests;
        rests
    }

    fn announce(&mut self, now_ns: u64) {
        if !self.announced && self.ahead(now_ns).is_some_and(|ahead| ahead <= ANNOUNCED_AHEAD) {
            self.announced = true;
            self.first.announce();
        }
    }

    fn publish(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        let now_ns = context.now_ns();
        let header = &mut self.scan.header;
        header.id = ScanId { run: RUN, sequence: self.sequence, lidar: header.id.lidar };
        header.times.monotonic_ns = now_ns;
        header.times.utc_ns = utc_ns();
        let view = self.scan.view().map_err(|problem| StageError::Source(problem.to_string()))?;
        self.scans.send(view)?;
        self.unnotified = true;
        // A stage that waits awake needs the processor rather than the notification.
        let wakes =
            context.mode == Mode::Live || (self.sequence + 1).is_multiple_of(self.notified_scans(context));
        if wakes && !self.announced {
            self.notify();
        }
        if context.mode == Mode::Live {
            // A stage that was woken may wait for this very processor: reading the next scan has time.
            step_aside();
        }
        if self.announced {
            self.notify();
        }
        (self.loaded, self.announced) = (false, false);
        self.sequence += 1;
        if let Some(cursor) = &mut self.cursor {
            cursor.advance(self.sequence, self.pacer.as_ref().and_then(Pacer::anchor))?;
        }
        tracing::debug!(scan = self.sequence - 1, "sent");
        self.watch.gave(self.scan.header.id.lidar, now_ns, |number| self.feed.lidar_name(number));
        context.handled(self.sequence - 1, now_ns, now_ns);
        Ok(())
    }

    /// Exact replay: a wake costs about as much as handling a scan, so it is for so many, or for as many as there is credit for.
    fn notified_scans(&self, context: &StageContext) -> u64 {
        (context.capacity.window as u64 / 8).max(1)
    }

    fn notify(&mut self) {
        self.unnotified = false;
        self.first.notify();
    }

    /// Sends what is due; whether there was anything.
    fn send_due(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while !self.end.is_sent() && !context.stop.is_set() {
            if !self.loaded {
                match self.feed.next(&mut self.scan)? {
                    Fed::Scan => self.loaded = true,
                    Fed::NotYet => return Ok(any),
                    Fed::End => {
                        self.announce_end(context)?;
                        return Ok(true);
                    }
                }
            }
            if self.rests(context) {
                if self.loaded {
                    return Ok(any);
                }
                continue;
            }
            if !self.is_due(context) {
                self.announce(context.now_ns());
                return Ok(any);
            }
            self.publish(context)?;
            any = true;
            self.read_progress()?;
        }
        Ok(any)
    }

    fn announce_end(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.count(context);
        self.name_what_is_missing();
        self.feed.store_truth()?;
        self.end.send(self.sequence)
    }

    /// Stores what was read and left out so far.
    fn count(&self, context: &mut StageContext) {
        let Some(tally) = self.feed.tally() else { return };
        for (rejection, count) in &tally.rejected {
            context.report.count(&format!("rejected/{}", rejection.name()), *count);
        }
        context.report.count("unknown_lines", tally.unknown);
        context.report.count("invalid_beams", tally.invalid_beams);
        context.report.count("stamps_backward", tally.steps_backward);
        self.feed.counts().into_iter().for_each(|(name, count)| context.report.count(name, count));
        if tally.missing > 0 {
            context.report.count("missing_scans", tally.missing);
        }
        if self.feed.cut_short().is_some() {
            context.report.count("cut_short", 1);
        }
    }

    fn name_what_is_missing(&self) {
        let tally = self.feed.tally().unwrap_or_default();
        if tally.missing > 0 {
            tracing::warn!(missing = tally.missing, "the recorder missed scans: this is not an exact replay");
        }
        self.feed.ended_early().iter().for_each(|line| tracing::warn!("{line}"));
        if let Some(reason) = self.feed.cut_short() {
            tracing::warn!(scans = tally.scans, "{reason}: read up to where it ends");
        }
    }
}

impl Actor for Ingest {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        self.read_progress()?;
        self.stream.drain()?;
        if self.stream.end_wanted && !self.end.is_sent() {
            self.announce_end(context)?;
        }
        let any = self.send_due(context)?;
        if self.unnotified {
            self.notify();
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.scans.refresh();
        self.watch.look(context, context.now_ns());
        self.count(context);
        self.end.repeat()
    }

    fn wait_max(&self, now_ns: u64) -> Duration {
        if self.rests {
            return Duration::from_millis(100);
        }
        let until_announcement = if self.announced { Duration::ZERO } else { ANNOUNCED_AHEAD };
        let ahead = self.ahead(now_ns).map(|ahead| ahead.saturating_sub(until_announcement));
        ahead.or(self.feed.wait_max()).unwrap_or(Duration::from_millis(100))
    }
}
