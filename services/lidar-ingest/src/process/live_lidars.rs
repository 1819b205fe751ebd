//! The lidars of a set: one thread waits for the lines of all of them and hands their turns to the stage as frames.

use super::first_stages;
use super::lidar_board::LidarBoard;
use super::lidar_line::LidarSpec;
use super::lidar_session::{LidarHandler, LidarSession, LidarState};
use super::scan_socket::{SCAN_SOCKET, listen_beside};
use super::sensor_inlet::{SensorInlet, SensorOutlet, event_of, inlet, listen_too};
use flockslam_bus::Notifier;
use flockslam_lidars::Turn;
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_sensor_stream::{FramedScan, LidarScan, SensorFrame};
use flockslam_stage::{Mode, StageContext, StageError};
use flockslam_telemetry::monotonic_ns;
use rustix::event::{PollFd, Timespec, poll};
use std::collections::BTreeSet;
use std::time::Duration;

/// How things are is written so often, nanoseconds.
const BOARD_NS: u64 = 1_000_000_000;

/// Listens to lidars, and on the set's socket to odometry, rates of turning and other lidars.
pub fn listen_to(context: &StageContext, lidars: &[LidarSpec]) -> Result<SensorInlet, StageError> {
    let (maker, inlet) = inlet();
    listen_beside(context, &context.set_dir().join(SCAN_SOCKET), maker.clone())?;
    let board = LidarBoard::new(&context.status_dir, &context.metrics, lidars);
    let sessions = lidars.iter().cloned().map(LidarSession::new).collect();
    let started = listen_too(context, "lidars", maker, move |maker, bus| {
        // The bus must outlive its events: it holds the thread's place in the set.
        let notifier = |stage: &Stage| bus.as_ref()?.notifier(stage.name()).ok();
        let handler = LidarOutput {
            first: first_stages(Mode::Live).iter().filter_map(notifier).collect(),
            outlet: maker.outlet(event_of(bus.as_ref())),
            goes_on: true,
            changed: true,
            troubled: BTreeSet::new(),
        };
        serve(LidarPolling::new(sessions), handler, board);
    });
    started.map_err(|error| StageError::Source(format!("lidars: {error}")))?;
    Ok(inlet)
}

fn serve(mut polling: LidarPolling, mut handler: LidarOutput, mut board: LidarBoard) {
    let mut written_ns = 0;
    while handler.goes_on {
        polling.look(&mut handler);
        let now_ns = monotonic_ns();
        if std::mem::take(&mut handler.changed) || now_ns - written_ns > BOARD_NS {
            written_ns = now_ns;
            board.write(polling.sessions());
        }
    }
}

/// Lidars that are looked after together.
pub struct LidarPolling {
    sessions: Vec<LidarSession>,
}

impl LidarPolling {
    /// These lidars.
    pub fn new(sessions: Vec<LidarSession>) -> Self {
        Self { sessions }
    }

    /// How things stand with them.
    pub fn sessions(&self) -> &[LidarSession] {
        &self.sessions
    }

    /// Waits until something is to be done, and does it.
    pub fn look(&mut self, handler: &mut dyn LidarHandler) {
        let wait_max = self.sessions.iter().map(LidarSession::wait_max).min().unwrap_or(Duration::MAX);
        let limit = Timespec::try_from(wait_max.min(Duration::from_secs(1))).ok();
        let mut waits: Vec<PollFd<'_>> = self.sessions.iter().filter_map(LidarSession::poll_fd).collect();
        let polled = poll(&mut waits, limit.as_ref());
        let mut ready = waits.iter().map(|wait| polled.is_ok() && !wait.revents().is_empty());
        let ready: Vec<bool> = self
            .sessions
            .iter()
            .map(|lidar| lidar.poll_fd().is_some() && ready.next() == Some(true))
            .collect();
        for (lidar, ready) in self.sessions.iter_mut().zip(ready) {
            lidar.go_on(ready, handler);
        }
    }
}

struct LidarOutput {
    /// The stages that read a scan first.
    first: Vec<Notifier>,
    outlet: SensorOutlet,
    /// The stage goes on.
    goes_on: bool,
    changed: bool,
    /// Lidars with a logged problem.
    troubled: BTreeSet<String>,
}

impl LidarHandler for LidarOutput {
    fn turn(&mut self, spec: &LidarSpec, turn: &Turn) {
        // They wake up while this process publishes the turn.
        self.first.iter().for_each(Notifier::announce);
        let mut scan = ScanBuffer::default();
        turn.write_scan(&mut scan);
        let scan = FramedScan { frame: String::new(), scan, mounting: None };
        let frame = SensorFrame::Scan(LidarScan { lidar: spec.name.clone(), scan });
        self.goes_on &= self.outlet.send_frame(Ok(frame));
    }

    fn state(&mut self, session: &LidarSession) {
        self.changed = true;
        let (lidar, state) = (session.spec(), session.current());
        if *state == LidarState::Measuring {
            let (speed_hz, beams) = session.last_turn();
            let rate = session.rate().map_or_else(String::new, |rate| format!(" at {rate} baud"));
            let line =
                format!("{lidar} measures{rate}: {beams} beams, {speed_hz:.1} Hz; {}", session.device());
            // After a logged problem its end is logged, too.
            if self.troubled.remove(&lidar.name) {
                tracing::warn!("{line}");
            } else {
                tracing::info!("{line}");
            }
        } else {
            self.troubled.insert(lidar.name.clone());
            tracing::warn!("{lidar} {state}");
        }
    }
}
