//! The session of a lidar: its line is opened, its driver is run; when it is gone, silent or garbled, it is tried again.

use super::lidar_line::{LidarSpec, Line};
use flockslam_lidars::{Counts, Device, Driver, Turn};
use flockslam_telemetry::{monotonic_ns, utc_ns};
use rustix::event::PollFd;
use std::fmt;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;
use std::time::Duration;

/// After a failure the next try comes after so long …
const RETRY_FIRST_NS: u64 = 100_000_000;
/// … and twice as long each time, up to this.
const RETRY_LAST_NS: u64 = 2_000_000_000;
/// A lidar of which no packet has come for so long is silent, or garbled; nanoseconds. A motor needs less to start.
const SILENT_NS: u64 = 3_000_000_000;
/// One that sends packets and no turn stands; nanoseconds.
const STANDS_NS: u64 = 6_000_000_000;
/// While a driver asks and a line is opened, this is looked at so often.
const LOOK: Duration = Duration::from_millis(10);
/// While all is well, this is enough.
const REST: Duration = Duration::from_millis(200);
/// Read at once: some turns of the fastest lidar.
const BUFFER_BYTES: usize = 1 << 16;

/// How it stands with a lidar.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LidarState {
    /// It was not tried yet, or is being started.
    Starting,
    /// Turns come.
    Measuring,
    /// Its line is not there: why.
    Absent(String),
    /// Its line was there, and is gone.
    Gone(String),
    /// Nothing comes.
    Silent(Option<u32>),
    /// What comes are no packets of its family.
    Garbled(Option<u32>),
    /// Packets come, and no turns.
    Stands,
}

impl LidarState {
    /// One word for it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Measuring => "measuring",
            Self::Absent(_) => "absent",
            Self::Gone(_) => "gone",
            Self::Silent(_) => "silent",
            Self::Garbled(_) => "garbled",
            Self::Stands => "stands",
        }
    }
}

impl fmt::Display for LidarState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = |rate: &Option<u32>| rate.map_or_else(String::new, |rate| format!(" at {rate} baud"));
        match self {
            Self::Starting => write!(f, "is being started"),
            Self::Measuring => write!(f, "measures"),
            Self::Absent(reason) => write!(f, "is not there: {reason}; tried again until it is"),
            Self::Gone(reason) => write!(f, "is gone: {reason}; tried again until it is back"),
            Self::Silent(rate) => {
                write!(f, "says nothing{}: is it powered, and its line the right one? Tried again", at(rate))
            }
            Self::Garbled(rate) => write!(
                f,
                "sends what is no packet of this family{}: another baud rate, or another lidar; `flockslam lidar list` \
                 finds out. Tried again",
                at(rate)
            ),
            Self::Stands => {
                write!(f, "sends measurements, but does not turn: is something in its way? Tried again")
            }
        }
    }
}

/// Result of polling a lidar.
pub trait LidarHandler {
    /// A turn is complete.
    fn turn(&mut self, spec: &LidarSpec, turn: &Turn);

    /// Something else is the case from now on.
    fn state(&mut self, session: &LidarSession);
}

/// A lidar, and how it stands with it.
pub struct LidarSession {
    spec: LidarSpec,
    rates: Vec<Option<u32>>,
    /// Of the rates, the one that is tried.
    rate: usize,
    state: LidarState,
    open: Option<Open>,
    opening: Option<Receiver<Result<Line, String>>>,
    retry_ns: u64,
    pause_ns: u64,
    /// What drivers before the present one have counted.
    before: Counts,
    device: Device,
    speed_hz: f64,
    beams: usize,
    /// How often turns came again after they had not.
    returns: u64,
    bytes: Vec<u8>,
}

/// A line and its driver.
struct Open {
    line: Line,
    driver: Box<dyn Driver>,
    packets: u64,
    /// When the last packet and the last turn came, or the line was opened.
    packet_ns: u64,
    turn_ns: u64,
    /// Bytes at the last packet.
    bytes: u64,
    /// It has given a turn.
    measures: bool,
}

impl LidarSession {
    /// Of this lidar; nothing is opened yet.
    pub fn new(spec: LidarSpec) -> Self {
        Self {
            rates: spec.rates(),
            spec,
            rate: 0,
            state: LidarState::Starting,
            open: None,
            opening: None,
            retry_ns: 0,
            pause_ns: RETRY_FIRST_NS,
            before: Counts::default(),
            device: Device::default(),
            speed_hz: 0.0,
            beams: 0,
            returns: 0,
            bytes: vec![0; BUFFER_BYTES],
        }
    }

    /// The lidar.
    pub fn spec(&self) -> &LidarSpec {
        &self.spec
    }

    /// How it stands with it.
    pub fn current(&self) -> &LidarState {
        &self.state
    }

    /// Its identification.
    pub fn device(&self) -> &Device {
        self.open.as_ref().map_or(&self.device, |open| open.driver.device())
    }

    /// What was met so far, by all its drivers.
    pub fn counts(&self) -> Counts {
        self.before.plus(self.open.as_ref().map(|open| open.driver.counts()).unwrap_or_default())
    }

    /// Turns a second and beams of the last turn.
    pub fn last_turn(&self) -> (f64, usize) {
        (self.speed_hz, self.beams)
    }

    /// How often turns came again after they had not.
    pub fn returns(&self) -> u64 {
        self.returns
    }

    /// The rate of its line, bits a second.
    pub fn rate(&self) -> Option<u32> {
        self.rates.get(self.rate).copied().flatten()
    }

    /// To wait for bytes, while its line is open.
    pub fn poll_fd(&self) -> Option<PollFd<'_>> {
        self.open.as_ref().map(|open| open.line.poll_fd())
    }

    /// How long nothing needs to be done, unless bytes come.
    pub fn wait_max(&self) -> Duration {
        match &self.open {
            Some(open) if open.measures => REST,
            Some(_) => LOOK,
            None if self.opening.is_some() => LOOK,
            None => Duration::from_nanos(self.retry_ns.saturating_sub(monotonic_ns())).min(REST),
        }
    }

    /// Does what is due. `ready`: its line has bytes, or is gone.
    pub fn go_on(&mut self, ready: bool, handler: &mut dyn LidarHandler) {
        let now_ns = monotonic_ns();
        let Some(open) = &mut self.open else {
            self.reach_for(now_ns, handler);
            return;
        };
        let mut gone = None;
        if ready {
            match open.line.read(&mut self.bytes) {
                Ok(length) => {
                    let (spec, last) = (&self.spec, (&mut self.speed_hz, &mut self.beams));
                    let mut turned = false;
                    open.driver.take(&self.bytes[..length], utc_ns(), &mut |turn| {
                        (*last.0, *last.1, turned) = (turn.speed_hz, turn.len(), true);
                        handler.turn(spec, turn);
                    });
                    open.note(now_ns, turned);
                }
                Err(error) => gone = Some(error.to_string()),
            }
        }
        while gone.is_none() {
            let Some(act) = open.driver.act(now_ns as i64) else { break };
            gone = open.line.carry_out(&act).err().map(|error| error.to_string());
        }
        let rate = self.rates.get(self.rate).copied().flatten();
        let is_first = open.measures && self.state != LidarState::Measuring;
        let problem = gone.map(LidarState::Gone).or_else(|| open.problem(now_ns, rate));
        match problem {
            Some(problem) => self.close(problem, now_ns, handler),
            None if is_first => {
                self.returns += u64::from(self.before.turns > 0);
                self.pause_ns = RETRY_FIRST_NS;
                self.change(LidarState::Measuring, handler);
            }
            None => {}
        }
    }

    /// Opens the line, in a thread of its own: others do not wait for it.
    fn reach_for(&mut self, now_ns: u64, handler: &mut dyn LidarHandler) {
        match self.opening.as_ref().map(Receiver::try_recv) {
            Some(Ok(Ok(line))) => {
                self.opening = None;
                let rate = self.rate();
                let driver = self.spec.family.driver(self.spec.model.as_deref(), rate);
                self.open = Some(Open {
                    line,
                    driver,
                    packets: 0,
                    packet_ns: now_ns,
                    turn_ns: now_ns,
                    bytes: 0,
                    measures: false,
                });
            }
            Some(Ok(Err(reason))) => {
                self.opening = None;
                self.close(LidarState::Absent(reason), now_ns, handler);
            }
            Some(Err(TryRecvError::Disconnected)) => self.opening = None,
            Some(Err(TryRecvError::Empty)) => {}
            None if now_ns >= self.retry_ns => {
                let (sender, receiver) = channel();
                let (spec, rate) = (self.spec.clone(), self.rate());
                let opener = thread::Builder::new().name("lidar-open".to_owned());
                let opened = opener.spawn(move || {
                    let _ = sender.send(Line::open(&spec, rate));
                });
                // Without a thread it is tried again as if the line were not there.
                self.opening = opened.is_ok().then_some(receiver);
                self.retry_ns = now_ns + self.pause_ns;
            }
            None => {}
        }
    }

    fn close(&mut self, problem: LidarState, now_ns: u64, handler: &mut dyn LidarHandler) {
        if let Some(open) = self.open.take() {
            self.before = self.before.plus(open.driver.counts());
            self.device = open.driver.device().clone();
        }
        let other_rate = matches!(problem, LidarState::Silent(_) | LidarState::Garbled(_));
        if other_rate && self.before.turns == 0 {
            self.rate = (self.rate + 1) % self.rates.len().max(1);
        }
        self.retry_ns = now_ns + self.pause_ns;
        self.pause_ns = (2 * self.pause_ns).min(RETRY_LAST_NS);
        // An unchanged state is logged once; so is each further rate without data.
        if problem.name() == self.state.name() {
            self.state = problem;
        } else {
            self.change(problem, handler);
        }
    }

    fn change(&mut self, state: LidarState, handler: &mut dyn LidarHandler) {
        self.state = state;
        handler.state(self);
    }
}

impl Open {
    fn note(&mut self, now_ns: u64, turned: bool) {
        let counts = self.driver.counts();
        if counts.packets > self.packets {
            (self.packets, self.packet_ns, self.bytes) = (counts.packets, now_ns, counts.bytes);
        }
        if turned {
            (self.turn_ns, self.measures) = (now_ns, true);
        }
    }

    fn problem(&self, now_ns: u64, rate: Option<u32>) -> Option<LidarState> {
        if now_ns.saturating_sub(self.packet_ns) > SILENT_NS {
            let garbled = self.driver.counts().bytes > self.bytes;
            return Some(if garbled { LidarState::Garbled(rate) } else { LidarState::Silent(rate) });
        }
        (now_ns.saturating_sub(self.turn_ns) > STANDS_NS).then_some(LidarState::Stands)
    }
}
