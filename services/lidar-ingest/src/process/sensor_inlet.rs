//! Messages from the threads that receive sensor data to the stage: frames, scans, and errors of their senders.

use crate::carmen::Tally;
use crossbeam::channel::{Receiver, Sender, bounded};
use flockslam_bus::Notifier;
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_sensor_stream::{FrameProblem, SensorFrame};
use flockslam_stage::StageContext;
use flockslam_telemetry::monotonic_ns;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// What a thread that listens has to say.
pub enum SensorEvent {
    /// A frame, and when it was received on the monotonic clock, nanoseconds.
    Frame(SensorFrame, u64),
    /// A scan that has its place and its odometry: a line of CARMEN.
    Scan(ScanBuffer),
    /// Bytes that are no frame.
    Problem(FrameProblem),
    /// A producer has come.
    Came,
    /// A producer has gone; whether in the middle of a frame.
    Went {
        /// Its last frame was broken off.
        within_frame: bool,
    },
    /// The source cannot be read any more, and why.
    Failed(String),
}

/// Frames that wait for the stage: a full channel makes their producers wait.
const AHEAD: usize = 64;

/// The stage's end.
pub struct SensorInlet {
    events: Receiver<SensorEvent>,
    awaits: Arc<AtomicBool>,
    tally: Arc<Mutex<Tally>>,
}

/// The end of a thread that listens.
pub struct SensorOutlet {
    events: Sender<SensorEvent>,
    awaits: Arc<AtomicBool>,
    tally: Arc<Mutex<Tally>>,
    event: Option<Notifier>,
}

/// What becomes an outlet in the thread that it is for: ports of the bus stay within their thread. Several threads may have one each.
#[derive(Clone)]
pub struct OutletMaker {
    events: Sender<SensorEvent>,
    awaits: Arc<AtomicBool>,
    tally: Arc<Mutex<Tally>>,
}

/// Both ends.
pub fn inlet() -> (OutletMaker, SensorInlet) {
    let (sender, events) = bounded(AHEAD);
    let (awaits, tally) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Tally::default())));
    let maker = OutletMaker { events: sender, awaits: Arc::clone(&awaits), tally: Arc::clone(&tally) };
    (maker, SensorInlet { events, awaits, tally })
}

impl OutletMaker {
    /// The outlet, with the stage's event in the thread's own bus.
    pub fn outlet(self, event: Option<Notifier>) -> SensorOutlet {
        SensorOutlet { events: self.events, awaits: self.awaits, tally: self.tally, event }
    }
}

impl SensorInlet {
    /// What was received next; `None` for nothing yet, an error when the sending threads have ended.
    pub fn take(&self) -> Result<Option<SensorEvent>, ()> {
        match self.events.try_recv() {
            Ok(event) => Ok(Some(event)),
            Err(crossbeam::channel::TryRecvError::Empty) => Ok(None),
            Err(crossbeam::channel::TryRecvError::Disconnected) => Err(()),
        }
    }

    /// Whether the stage is to be woken by whatever comes, and not by scans alone.
    pub fn await_anything(&self, awaits: bool) {
        self.awaits.store(awaits, Ordering::Release);
    }

    /// Counts of lines of CARMEN so far.
    pub fn tally(&self) -> Tally {
        self.tally.lock().expect("the reading thread does not panic").clone()
    }
}

impl SensorOutlet {
    /// Hands on what was received; false when the stage has ended.
    pub fn send(&self, event: SensorEvent) -> bool {
        let wakes = !matches!(
            event,
            SensorEvent::Frame(
                SensorFrame::Odometry(_) | SensorFrame::Imu(_) | SensorFrame::Transforms(_),
                _
            )
        );
        if self.events.send(event).is_err() {
            return false;
        }
        if wakes || self.awaits.load(Ordering::Acquire) || self.events.len() > AHEAD / 2 {
            self.notify();
        }
        true
    }

    /// Hands on a frame, or what is wrong with one.
    pub fn send_frame(&self, frame: Result<SensorFrame, FrameProblem>) -> bool {
        match frame {
            Ok(frame) => self.send(SensorEvent::Frame(frame, monotonic_ns())),
            Err(problem) => self.send(SensorEvent::Problem(problem)),
        }
    }

    /// Stores the counts of lines of CARMEN.
    pub fn store_tally(&self, tally: &Tally) {
        *self.tally.lock().expect("the stage does not panic") = tally.clone();
    }

    fn notify(&self) {
        if let Some(event) = &self.event {
            event.notify();
        }
    }
}

impl Drop for SensorOutlet {
    /// The stage is to notice that the sending thread has ended.
    fn drop(&mut self) {
        let (unused, _) = bounded(0);
        self.events = unused;
        self.notify();
    }
}

/// The stage's event on a bus.
pub fn event_of(bus: Option<&flockslam_bus::Bus>) -> Option<Notifier> {
    bus.and_then(|bus| bus.notifier(Stage::LidarIngest.name()).ok())
}

/// Starts a thread that listens: it gets its own end, which it makes with a bus of its own.
pub fn listen(
    context: &StageContext,
    name: &str,
    work: impl FnOnce(OutletMaker, Option<flockslam_bus::Bus>) + Send + 'static,
) -> std::io::Result<SensorInlet> {
    let (maker, inlet) = inlet();
    listen_too(context, name, maker, work)?;
    Ok(inlet)
}

/// As [`listen`], for one more thread with the same inlet.
pub fn listen_too(
    context: &StageContext,
    name: &str,
    maker: OutletMaker,
    work: impl FnOnce(OutletMaker, Option<flockslam_bus::Bus>) + Send + 'static,
) -> std::io::Result<()> {
    let join = context.joiner();
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(move || work(maker, join()))?;
    Ok(())
}
