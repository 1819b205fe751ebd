//! `flockslam setup`: finds the lidar, shows its scan, asks for the rest, writes the description of a set and starts it.

use super::lidar_command::Scans;
use super::{CommandError, print};
use crate::arguments::RobotArgs;
use crate::lidar_arguments::LidarAtArgs;
use crate::lidar_view::LidarPicture;
use crate::setup::{
    AnsweredLidar, Mounting, NoTerminal, Questions, SetAnswers, SetupError, SetupMode, TerminalQuestions,
    scan_picture, set_name,
};
use crate::setup_arguments::{SetupArgs, YesNo};
use crate::supervisor::SetDescription;
use flockslam_journal::{Durability, replace_file};
use flockslam_lidar_ingest::process::{FoundLidar, LidarPlace, identify, serial_ports};
use std::io::{self, IsTerminal};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Turns that are waited for before one is drawn: motors take a while to get up.
const TURNS: u64 = 3;
/// No longer than this.
const SHOWN_WITHIN: Duration = Duration::from_secs(12);
/// Where the units of the package look for descriptions.
const SERVICE_DIR: &str = "/etc/flockslam";

/// Runs the command.
///
/// # Errors
/// When no lidar is found, an option is missing or not usable, or the description cannot be written.
pub fn run(args: &SetupArgs) -> Result<(), CommandError> {
    let terminal = io::stdin().is_terminal();
    let mut people;
    let mut nobody = NoTerminal::default();
    let questions: &mut dyn Questions = if terminal {
        people = TerminalQuestions { input: io::stdin().lock(), output: io::stdout() };
        &mut people
    } else {
        // All that is missing is named before a lidar is searched for.
        others(args, &mut nobody).and_then(|_| nobody.finish()).map_err(CommandError::user)?;
        &mut nobody
    };
    if let Some(path) = &args.out {
        refuse_existing(path, args.force)?;
    }
    let lidar = lidar(args, questions)?;
    show(&lidar)?;
    let others = others(args, questions).map_err(CommandError::user)?;
    let path = std::path::absolute(&others.out).map_err(CommandError::user)?;
    refuse_existing(&path, args.force)?;
    if others.mode == SetupMode::Localize && !others.map.exists() {
        return Err(CommandError::user(format!("{}: there is no map to localize in", others.map.display())));
    }
    let answers = SetAnswers {
        robot: others.robot.clone(),
        lidar,
        mounting: others.mounting,
        upside_down: others.upside_down,
        mode: others.mode,
        map: std::path::absolute(&others.map).map_err(CommandError::user)?,
        ros: others.ros,
        assignments: args.assignments.clone(),
    };
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory)
            .map_err(|error| CommandError::user(format!("{}: {error}", directory.display())))?;
    }
    replace_file(&path, answers.text().as_bytes(), Durability::Power).map_err(CommandError::failed)?;
    let page = SetDescription::read(&path)?.configuration(&[])?.page;
    let page = page.enabled.then_some(page.listen);
    let path_shown = path.display();
    print(&format!("written: {path_shown}\n"));
    if !others.start {
        print(&format!(
            "start it: flockslam up {path_shown}; where the lidar sits is measured by: flockslam lidar calibrate\n"
        ));
        return Ok(());
    }
    start(&path, &others.robot, page)
}

/// What is asked beside the lidar.
struct Others {
    robot: String,
    mounting: Mounting,
    upside_down: bool,
    mode: SetupMode,
    map: PathBuf,
    ros: bool,
    out: PathBuf,
    start: bool,
}

/// Options, and answers where there are none.
fn others(args: &SetupArgs, questions: &mut dyn Questions) -> Result<Others, SetupError> {
    let mut others = Others {
        robot: args.robot.clone().unwrap_or_default(),
        mounting: args.mounting.unwrap_or_default(),
        upside_down: args.upside_down,
        mode: args.mode.unwrap_or(SetupMode::Map),
        map: args.map.clone().unwrap_or_default(),
        ros: args.ros == Some(YesNo::Yes),
        out: args.out.clone().unwrap_or_default(),
        start: args.start == Some(YesNo::Yes),
    };
    if args.robot.is_none() {
        let mut take = |text: &str| set_name(text).map(|name| others.robot = name);
        questions.ask("--robot NAME", "What is the robot called?", "r1", &mut take)?;
    }
    if args.mounting.is_none() {
        let question = "Where does the lidar sit: metres ahead, metres to the left, degrees?";
        let mut take = |text: &str| text.parse().map(|mounting| others.mounting = mounting);
        questions.ask("--mounting X_M,Y_M,HEADING_DEG", question, "0,0,0", &mut take)?;
        let mut take = |text: &str| yes_no(text).map(|yes| others.upside_down |= yes);
        if !args.upside_down && questions.is_interactive() {
            questions.ask("--upside-down", "Does it hang upside down?", "no", &mut take)?;
        }
    }
    if args.mode.is_none() {
        let mut take = |text: &str| match text {
            "map" => put(&mut others.mode, SetupMode::Map),
            "localize" => put(&mut others.mode, SetupMode::Localize),
            _ => Err("map or localize".to_owned()),
        };
        questions.ask("--mode map|localize", "Make a map, or localize in a known one?", "map", &mut take)?;
    }
    if args.map.is_none() {
        let (question, usual) = match others.mode {
            SetupMode::Map if serves() => {
                ("Where is the map kept?", format!("/var/lib/flockslam-{}", others.robot))
            }
            SetupMode::Map => ("Where is the map kept?", format!("maps/{}", others.robot)),
            SetupMode::Localize => ("Where is the known map?", "flockslam-out/map.yaml".to_owned()),
        };
        let mut take = |text: &str| put(&mut others.map, PathBuf::from(text));
        questions.ask("--map DIR", question, &usual, &mut take)?;
    }
    if args.ros.is_none() {
        let mut take = |text: &str| yes_no(text).map(|yes| others.ros = yes);
        questions.ask("--ros yes|no", "Shall it be a node of a ROS 2 graph?", "no", &mut take)?;
    }
    if args.out.is_none() {
        let usual = format!("{}.toml", others.robot);
        let usual = if serves() { format!("{SERVICE_DIR}/{usual}") } else { usual };
        let mut take = |text: &str| put(&mut others.out, PathBuf::from(text));
        questions.ask("--out SET.toml", "Which file shall describe the set?", &usual, &mut take)?;
    }
    if args.start.is_none() {
        let mut take = |text: &str| yes_no(text).map(|yes| others.start = yes);
        questions.ask("--start yes|no", "Start it now?", "yes", &mut take)?;
    }
    Ok(others)
}

/// Whether the user may make a service of the set: the package is installed, and its directory can be written.
fn serves() -> bool {
    rustix::fs::access(SERVICE_DIR, rustix::fs::Access::WRITE_OK).is_ok()
}

/// Takes an answer that is always good.
fn put<T>(place: &mut T, answer: T) -> Result<(), String> {
    *place = answer;
    Ok(())
}

fn yes_no(text: &str) -> Result<bool, String> {
    match text.to_lowercase().as_str() {
        "y" | "yes" => Ok(true),
        "n" | "no" => Ok(false),
        _ => Err("yes or no".to_owned()),
    }
}

fn refuse_existing(path: &Path, force: bool) -> Result<(), CommandError> {
    if path.exists() && !force {
        return Err(CommandError::user(format!(
            "{}: is there already; --force overwrites it",
            path.display()
        )));
    }
    Ok(())
}

/// A lidar that answers: the one that is named, the only one on USB, or the one that is chosen.
fn lidar(args: &SetupArgs, questions: &mut dyn Questions) -> Result<AnsweredLidar, CommandError> {
    let named = args.port.clone().map(LidarPlace::Port).or(args.address.clone().map(LidarPlace::Address));
    if let Some(place) = named {
        let found = match args.kind {
            Some(_) => None,
            None => {
                let found =
                    identify(&place, true).map_err(|why| CommandError::user(format!("{place}: {why}")))?;
                Some(found.ok_or_else(|| CommandError::user(format!("{place}: no lidar answers")))?)
            }
        };
        return answered(args, place, found.as_ref());
    }
    let mut found: Vec<(LidarPlace, FoundLidar)> = Vec::new();
    let mut problems = Vec::new();
    for port in serial_ports().into_iter().filter(|port| port.usb.is_some()) {
        let place = LidarPlace::Port(port.stable.clone().unwrap_or(port.path));
        print(&format!("looking at {place} …\n"));
        match identify(&place, true) {
            Ok(Some(lidar)) => found.push((place, lidar)),
            Ok(None) => problems.push(format!("{place}: no lidar answers")),
            Err(why) => problems.push(format!("{place}: {why}")),
        }
    }
    let mut chosen = 1;
    match found.len() {
        0 => {
            let seen = if problems.is_empty() {
                "no serial port on USB is here".to_owned()
            } else {
                problems.join("; ")
            };
            return Err(CommandError::user(format!(
                "no lidar is found ({seen}): --port PORT or --address HOST names it"
            )));
        }
        1 => {}
        several => {
            for (number, (place, lidar)) in (1..).zip(&found) {
                print(&format!("{number}: {} at {place}, {}\n", lidar.family.name(), lidar.device));
            }
            let mut take = |text: &str| match text.parse() {
                Ok(number) if (1..=several).contains(&number) => put(&mut chosen, number),
                _ => Err(format!("a number from 1 to {several}")),
            };
            questions.ask("--port PORT", "Which lidar?", "1", &mut take).map_err(CommandError::user)?;
            questions.finish().map_err(CommandError::user)?;
        }
    }
    let (place, lidar) = found.swap_remove(chosen - 1);
    answered(args, place, Some(&lidar))
}

fn answered(
    args: &SetupArgs,
    place: LidarPlace,
    found: Option<&FoundLidar>,
) -> Result<AnsweredLidar, CommandError> {
    let family = args.kind.or(found.map(|found| found.family));
    let family = family.ok_or_else(|| CommandError::failed(format!("{place}: no lidar answers")))?;
    let baud = args.baud.or(found.and_then(|found| found.rate));
    let (port, address) = match place {
        LidarPlace::Port(port) => (Some(port), None),
        LidarPlace::Address(address) => (None, Some(address)),
    };
    Ok(AnsweredLidar { family, port, address, baud, model: args.model.clone() })
}

/// Draws a scan of it.
fn show(lidar: &AnsweredLidar) -> Result<(), CommandError> {
    let at = LidarAtArgs {
        kind: Some(lidar.family),
        port: lidar.port.clone(),
        address: lidar.address.clone(),
        baud: lidar.baud,
        model: lidar.model.clone(),
        robot: RobotArgs { robot: None },
    };
    let mut scans = Scans::open(&at)?;
    let mut picture = LidarPicture::default();
    let until = Instant::now() + SHOWN_WITHIN;
    while picture.turns() < TURNS {
        let seen = scans.look()?;
        seen.change.into_iter().for_each(|change| picture.note(change));
        seen.scans.iter().for_each(|scan| picture.show(scan));
        if Instant::now() > until {
            return Err(CommandError::failed(
                "the lidar answers, but gives no turn: is something in its way?",
            ));
        }
    }
    print(&scan_picture(&picture));
    Ok(())
}

/// Starts the set: by the service manager where the description is one of its units, else in the place of this process.
fn start(path: &Path, robot: &str, page: Option<SocketAddr>) -> Result<(), CommandError> {
    let map = page.map(|address| format!("; its map is at http://{address}/")).unwrap_or_default();
    let of_service = path.parent() == Some(Path::new(SERVICE_DIR));
    if of_service && Path::new("/run/systemd/system").exists() {
        let unit = format!("flockslam@{robot}");
        let status = Command::new("systemctl").args(["enable", "--now", &unit]).status();
        return match status {
            Ok(status) if status.success() => {
                print(&format!("{unit} runs: flockslam status, flockslam top{map}\n"));
                Ok(())
            }
            Ok(status) => Err(CommandError::failed(format!("systemctl enable --now {unit}: {status}"))),
            Err(error) => Err(CommandError::failed(format!("systemctl: {error}"))),
        };
    }
    let own = std::env::current_exe().map_err(CommandError::failed)?;
    print(&format!("the set runs until Ctrl-C{map}\n"));
    Err(CommandError::failed(Command::new(own).arg("up").arg(path).exec()))
}
