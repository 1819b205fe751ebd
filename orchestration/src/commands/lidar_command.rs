//! `flockslam lidar`: which lidars are there, what they see, where they see their own robot, and where they sit.

use super::control_command::choose;
use super::lidar_calibration::{of_journal, setting};
use super::run::count_interrupts;
use super::{CommandError, print};
use crate::arguments::RobotArgs;
use crate::lidar_arguments::{LearnMaskArgs, LidarAtArgs, LidarCommand, LidarListArgs, LidarWatchArgs};
use crate::lidar_view::{LidarPicture, draw};
use crate::supervisor::SetFile;
use flockslam_bus::{Bus, Capacity, RuntimeDir, ScanSubscriber};
use flockslam_calibration::BodyMask;
use flockslam_lidar_ingest::process::{
    FoundLidar, LidarHandler, LidarPlace, LidarPolling, LidarSession, LidarSpec, identify, serial_ports,
};
use flockslam_lidars::{Family, Turn};
use flockslam_messages::ScanBuffer;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How long to sleep when no scan of a set waits.
const PAUSE: Duration = Duration::from_millis(5);

/// Runs the command.
///
/// # Errors
/// When what was given is not usable, or no lidar is there.
pub fn run(command: &LidarCommand) -> Result<(), CommandError> {
    match command {
        LidarCommand::List(args) => list(args),
        LidarCommand::Watch(args) => watch(args),
        LidarCommand::LearnMask(args) => learn_mask(args),
        LidarCommand::Calibrate(robot) => calibrate(robot),
    }
}

/// A place that was looked at.
#[derive(Serialize)]
struct Looked {
    at: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    stable: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    usb: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    kind: Option<Family>,
    #[serde(skip_serializing_if = "Option::is_none")]
    baud: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    says: Option<String>,
}

fn list(args: &LidarListArgs) -> Result<(), CommandError> {
    let named = !args.port.is_empty() || !args.address.is_empty();
    let mut places: Vec<(LidarPlace, Option<PathBuf>, Option<String>)> = Vec::new();
    if !named {
        // Ports of the board itself may have anything at them: those are looked at when they are named.
        let on_usb = serial_ports().into_iter().filter(|port| port.usb.is_some());
        places.extend(on_usb.map(|port| (LidarPlace::Port(port.path), port.stable, port.usb)));
    }
    places.extend(args.port.iter().map(|port| (LidarPlace::Port(port.clone()), None, None)));
    places.extend(args.address.iter().map(|address| (LidarPlace::Address(address.clone()), None, None)));
    let looked: Vec<Looked> = places
        .into_iter()
        .map(|(place, stable, usb)| {
            let (found, problem) = match identify(&place, !args.listen) {
                Ok(found) => (found, None),
                Err(problem) => (None, Some(problem)),
            };
            let says = found.as_ref().map(|found| found.device.to_string());
            let (kind, baud) = (found.as_ref().map(|found| found.family), found.and_then(|found| found.rate));
            Looked { at: place.to_string(), stable, usb, problem, kind, baud, says }
        })
        .collect();
    if args.json {
        let json = serde_json::to_string_pretty(&looked).map_err(CommandError::failed)?;
        print(&format!("{json}\n"));
        return Ok(());
    }
    if looked.is_empty() {
        print("no serial port on USB is here; others are looked at with --port PORT\n");
    }
    looked.iter().for_each(|looked| print(&looked.line()));
    Ok(())
}

impl Looked {
    fn line(&self) -> String {
        let at = match &self.usb {
            Some(usb) => format!("{}, {usb}", self.at),
            None => self.at.clone(),
        };
        let found = match (self.kind, &self.problem) {
            (Some(kind), _) => {
                let place = self.stable.as_ref().map_or(self.at.clone(), |path| path.display().to_string());
                let key = if place.starts_with('/') { "port" } else { "address" };
                let baud = self.baud.map_or_else(String::new, |baud| format!(", baud = {baud}"));
                let says = self.says.as_deref().unwrap_or_default();
                format!("{says}\n  source = {{ kind = \"{}\", {key} = \"{place}\"{baud} }}", kind.name())
            }
            (None, Some(problem)) => problem.clone(),
            (None, None) => "no lidar answers".to_owned(),
        };
        format!("{at}: {found}\n")
    }
}

/// Where scans come from.
pub(super) enum Scans {
    Line(Box<LidarPolling>),
    Set { robot: String, scans: ScanSubscriber, _bus: Bus },
}

/// What a look has brought.
#[derive(Default)]
pub(super) struct Seen {
    /// New scans.
    pub(super) scans: Vec<ScanBuffer>,
    /// What is new with the lidar.
    pub(super) change: Option<String>,
}

impl LidarHandler for Seen {
    fn turn(&mut self, _spec: &LidarSpec, turn: &Turn) {
        let mut scan = ScanBuffer::default();
        turn.write_scan(&mut scan);
        self.scans.push(scan);
    }

    fn state(&mut self, session: &LidarSession) {
        self.change = Some(format!("{} {}; {}", session.spec(), session.current(), session.device()));
    }
}

impl Scans {
    /// Opens the line to a lidar, or the scans of a set.
    ///
    /// # Errors
    /// When there is no lidar, or no set.
    pub(super) fn open(at: &LidarAtArgs) -> Result<Self, CommandError> {
        let Some(line) = at.line() else {
            let robot = choose(&at.robot)?;
            let runtime = RuntimeDir::open(&RuntimeDir::path_of(&robot)).map_err(CommandError::user)?;
            let name = format!("lidar-{}", std::process::id());
            // Sizes matter to publishers only.
            let bus = Bus::join(&runtime, &name, Capacity::default()).map_err(CommandError::failed)?;
            let scans = bus.scan_subscriber().map_err(CommandError::failed)?;
            return Ok(Self::Set { robot, scans, _bus: bus });
        };
        let mut line = line;
        let family = match at.kind {
            Some(family) => family,
            None => {
                let spec = line.spec("", Family::Urg).map_err(|(_, reason)| CommandError::user(reason))?;
                let found: FoundLidar = identify(&spec.place, true)
                    .map_err(|reason| CommandError::user(format!("{}: {reason}", spec.place)))?
                    .ok_or_else(|| CommandError::user(format!("{}: no lidar answers", spec.place)))?;
                line.baud = line.baud.or(found.rate);
                found.family
            }
        };
        let spec = line
            .spec("", family)
            .map_err(|(key, reason)| CommandError::user(format!("--{key}: {reason}")))?;
        Ok(Self::Line(Box::new(LidarPolling::new(vec![LidarSession::new(spec)]))))
    }

    /// Waits a moment for what comes.
    ///
    /// # Errors
    /// When the set has ended, or the bus refuses.
    pub(super) fn look(&mut self) -> Result<Seen, CommandError> {
        let mut seen = Seen::default();
        match self {
            Self::Line(polling) => polling.look(&mut seen),
            Self::Set { robot, scans, .. } => {
                while let Some(sample) = scans.receive().map_err(CommandError::failed)? {
                    let numbers = sample.view().map_err(CommandError::failed)?.numbers().to_vec();
                    seen.scans.push(ScanBuffer { header: *sample.header(), numbers });
                }
                if seen.scans.is_empty() {
                    if !RuntimeDir::running().contains(robot) {
                        return Err(CommandError::user(format!("the set {robot} has ended")));
                    }
                    std::thread::sleep(PAUSE);
                }
            }
        }
        Ok(seen)
    }
}

fn watch(args: &LidarWatchArgs) -> Result<(), CommandError> {
    let mut scans = Scans::open(&args.at)?;
    let mut picture = LidarPicture::default();
    if args.plain || !io::stdout().is_terminal() {
        return watch_plainly(args, &mut scans, &mut picture);
    }
    let mut terminal = ratatui::try_init().map_err(CommandError::failed)?;
    let shown = watch_drawn(args, &mut scans, &mut picture, &mut terminal);
    ratatui::restore();
    shown
}

fn watch_plainly(
    args: &LidarWatchArgs,
    scans: &mut Scans,
    picture: &mut LidarPicture,
) -> Result<(), CommandError> {
    let interrupts = count_interrupts()?;
    while interrupts.load(Ordering::Relaxed) == 0 && args.turns.is_none_or(|turns| picture.turns() < turns) {
        let seen = scans.look()?;
        if let Some(change) = seen.change {
            print(&format!("{change}\n"));
        }
        for scan in &seen.scans {
            picture.show(scan);
            print(&format!("{}\n", picture.caption()));
        }
    }
    Ok(())
}

fn watch_drawn(
    args: &LidarWatchArgs,
    scans: &mut Scans,
    picture: &mut LidarPicture,
    terminal: &mut ratatui::DefaultTerminal,
) -> Result<(), CommandError> {
    while args.turns.is_none_or(|turns| picture.turns() < turns) {
        let seen = scans.look()?;
        if let Some(change) = seen.change {
            picture.note(change);
        }
        seen.scans.iter().for_each(|scan| picture.show(scan));
        terminal.draw(|frame| draw(frame, picture)).map_err(CommandError::failed)?;
        while event::poll(Duration::ZERO).map_err(CommandError::failed)? {
            if let Event::Key(key) = event::read().map_err(CommandError::failed)?
                && key.kind == KeyEventKind::Press
            {
                match key.code {
                    KeyCode::Char('q') | KeyCode::Esc => return Ok(()),
                    KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Ok(()),
                    KeyCode::Char('+') => picture.zoom(0.8),
                    KeyCode::Char('-') => picture.zoom(1.25),
                    _ => {}
                }
            }
        }
    }
    Ok(())
}

fn learn_mask(args: &LearnMaskArgs) -> Result<(), CommandError> {
    let mut scans = Scans::open(&args.at)?;
    let interrupts = count_interrupts()?;
    eprintln!("drive the robot about, or turn it, with nobody near it: {} s, or until Ctrl-C", args.seconds);
    let mut masks: BTreeMap<u32, BodyMask> = BTreeMap::new();
    let since = Instant::now();
    while interrupts.load(Ordering::Relaxed) == 0 && since.elapsed() < Duration::from_secs(args.seconds) {
        let seen = scans.look()?;
        if let Some(change) = seen.change {
            eprintln!("{change}");
        }
        for scan in &seen.scans {
            let Ok(view) = scan.view() else { continue };
            masks.entry(scan.header.id.lidar).or_default().push(view);
        }
    }
    if masks.is_empty() {
        return Err(CommandError::failed("no scan has come"));
    }
    let mut boxes = Vec::new();
    for mask in masks.values() {
        boxes.extend(mask.boxes().map_err(CommandError::failed)?);
    }
    let text = |[x, to_x, y, to_y]: &[f64; 4]| format!("[{x:.2}, {to_x:.2}, {y:.2}, {to_y:.2}]");
    print(&format!(
        "[lidar_ingest]\nself_mask = [{}]\n",
        boxes.iter().map(text).collect::<Vec<_>>().join(", ")
    ));
    Ok(())
}

/// What the journal of a running set tells of its lidars.
fn calibrate(robot: &RobotArgs) -> Result<(), CommandError> {
    let robot = choose(robot)?;
    let runtime = RuntimeDir::open(&RuntimeDir::path_of(&robot)).map_err(CommandError::user)?;
    let set = SetFile::read(&runtime.configuration()).map_err(CommandError::user)?;
    let rows = of_journal(&runtime.journal(), 0, &set.configuration).map_err(CommandError::failed)?;
    if rows.is_empty() {
        return Err(CommandError::user(format!(
            "the drive of {robot} so far shows of no lidar where it sits: that takes odometry and some turns"
        )));
    }
    rows.iter().for_each(|row| print(&row.line()));
    print(&format!("[lidar_ingest]\ncalibration = {}\n", setting(&rows, &set.configuration)));
    Ok(())
}
