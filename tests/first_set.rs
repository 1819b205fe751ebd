//! `flockslam setup` with a lidar that is played at a pseudo terminal: by options, by answers, and what it refuses.

use crate::support::lidar_player::{LidarPlayer, Played};
use crate::support::{assert_nothing_left, flockslam, machine_share, robot, send, stderr, stdout, wait_for};
use flockslam::supervisor::{Reply, Request, SetDescription, SetStatus, SourceDescription, ask};
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use rustix::process::Signal;
use serialport::{SerialPort, TTYPort};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

fn setup(arguments: &[&str], out: &Path) -> Command {
    let mut command = flockslam();
    command.arg("setup").args(arguments).arg("--out").arg(out).stdin(Stdio::null());
    command
}

fn status(robot: &str) -> Option<SetStatus> {
    match ask(&RuntimeDir::path_of(robot).join("control"), &Request::Status) {
        Ok(Reply::Status(status)) => Some(*status),
        _ => None,
    }
}

#[test]
fn a_set_that_setup_wrote_and_started_by_options_alone_maps_with_its_lidar() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let (port, out, map) =
        (directory.path().join("lidar"), directory.path().join("new/set.toml"), directory.path().join("map"));
    let _player = LidarPlayer::plug(&port, Played::ld06());
    let (name, port, map) = (robot("setup"), port.display().to_string(), map.display().to_string());
    let options =
        ["--port", &port, "--robot", &name, "--mounting", "-0.1,0,90", "--mode", "map", "--map", &map];
    let more = ["--ros", "no", "--start", "yes", "--set", "page.enabled=false"];
    let mut command = setup(&[options.as_slice(), &more].concat(), &out);
    let mut running = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let poses = |status: &SetStatus| {
        let matcher = status.stages.iter().find(|stage| stage.stage == Stage::ScanMatcher.name());
        matcher.is_some_and(|stage| stage.handled >= 10)
    };
    let status = wait_for("poses", || status(&name).filter(|status| poses(status)));
    assert_eq!(status.lidar_lines[0].state, "measuring");
    let set = SetDescription::read(&out).unwrap();
    let lidar = &set.configuration(&[]).unwrap().lidar_ingest.lidars[0];
    assert_eq!((lidar.x_m, lidar.y_m, lidar.heading_deg, lidar.upside_down), (-0.1, 0.0, 90.0, false));
    let SourceDescription::Ld06(line) = set.source else { panic!("{:?}", set.source) };
    assert_eq!(line.baud, Some(230_400));
    send(running.id(), Signal::TERM);
    assert_eq!(running.wait().unwrap().code(), Some(0));
    assert!(Path::new(&map).exists(), "the map was saved");
    assert_nothing_left(&name);
}

#[test]
fn answers_in_a_terminal_make_the_same_description_after_the_scan_was_shown() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let (port, out) = (directory.path().join("lidar"), directory.path().join("set.toml"));
    let _player = LidarPlayer::plug(&port, Played::ld06());
    let (mut master, slave) = TTYPort::pair().unwrap();
    master.set_timeout(Duration::from_secs(60)).unwrap();
    let terminal = std::fs::File::options().read(true).open(slave.name().unwrap()).unwrap();
    // Robot, mounting (one wrong, one right), upside down, mode, map, ROS, start.
    master.write_all(b"r7\nnonsense\n0.2,0,180\nyes\nmap\nsome/map\nno\nno\n").unwrap();
    let port = port.display().to_string();
    let output = setup(&["--port", &port], &out).stdin(terminal).output().unwrap();
    let shown = stdout(&output);
    assert!(output.status.success(), "{shown}{}", stderr(&output));
    assert!(shown.contains(" beams, ") && shown.contains("nonsense: write it as X_M"), "{shown}");
    assert!(shown.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "points are drawn: {shown}");
    let set = SetDescription::read(&out).unwrap();
    let lidar = &set.configuration(&[]).unwrap().lidar_ingest.lidars[0];
    assert_eq!((set.robot.as_str(), lidar.x_m, lidar.heading_deg), ("r7", 0.2, 180.0));
    assert!(lidar.upside_down && set.map.unwrap().ends_with("some/map"));
}

#[test]
fn without_a_terminal_missing_options_are_named_in_one_line_and_nothing_is_written() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("set.toml");
    let refused = |arguments: &[&str]| {
        let output = setup(arguments, &out).output().unwrap();
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.lines().count()), (Some(2), 1), "{text}");
        text
    };
    let text = refused(&["--robot", "r1", "--ros", "no"]);
    for option in ["--mounting X_M,Y_M,HEADING_DEG", "--mode map|localize", "--map DIR", "--start yes|no"] {
        assert!(text.contains(option), "{option}: {text}");
    }
    assert!(!text.contains("--robot") && !text.contains("--ros") && !out.exists(), "{text}");
    let all = [
        "--robot",
        "r1",
        "--mounting",
        "0,0,0",
        "--mode",
        "map",
        "--map",
        "m",
        "--ros",
        "no",
        "--start",
        "no",
    ];
    let text = refused(&[all.as_slice(), &["--port", "/dev/no-lidar-here"]].concat());
    assert!(text.contains("/dev/no-lidar-here: ") && !out.exists(), "{text}");
    std::fs::write(&out, "precious").unwrap();
    let text = refused(&[all.as_slice(), &["--port", "/dev/no-lidar-here"]].concat());
    assert!(text.contains("--force overwrites it"), "{text}");
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "precious");
}
