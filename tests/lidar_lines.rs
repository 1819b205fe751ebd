//! Lidars on lines of their own, played at pseudo terminals and TCP ports: their scans become poses, they come back when they were gone, and
//! what is wrong is said.

use crate::support::lidar_player::{LidarPlayer, Played, room};
use crate::support::{LiveSet, PoseWatch, data_dir, machine_share, not_tested, of, robot, stderr, wait_for};
use flockslam::supervisor::SetStatus;
use flockslam_geometry::Pose;
use flockslam_lidars::encoders::rplidar_encoder::RplidarEncoder;
use flockslam_lidars::encoders::sick_tim_encoder::SickTimEncoder;
use flockslam_lidars::encoders::urg_encoder::UrgEncoder;
use flockslam_lidars::encoders::ydlidar_encoder::YdlidarEncoder;
use flockslam_messages::{Quality, Stage};
use flockslam_stage::metrics_socket;
use flockslam_telemetry::{names, scrape};
use std::path::Path;
use std::process::Output;
use std::time::Duration;

/// The robot stands: its poses stay within this, metres and radians; without odometry it wanders within a cell or two of the grid.
const STANDS: (f64, f64) = (0.08, 0.02);
/// So often a lidar is unplugged.
const UNPLUGGED: u64 = 20;

/// A set whose source is described by these lines.
fn set_of(test: &str, directory: &Path, source: &str) -> LiveSet {
    let robot = robot(test);
    let description = format!("robot = \"{robot}\"\nset = [\"page.enabled=false\"]\n[source]\n{source}\n");
    std::fs::write(directory.join("set.toml"), description).unwrap();
    LiveSet::start_again(robot, directory, &[])
}

fn at_port(kind: &str, path: &Path) -> String {
    format!("kind = \"{kind}\"\nport = {path:?}")
}

fn handled(set: &SetStatus) -> u64 {
    of(set, Stage::ScanMatcher).handled
}

/// The set has poses of so many scans, and they stay where the robot stands.
fn assert_stands(set: &mut LiveSet, scans: u64) -> SetStatus {
    let status = set.wait_until_handled(Stage::ScanMatcher, 3);
    let poses = PoseWatch::start(&set.runtime_dir());
    let wanted = handled(&status) + scans;
    let status = set.wait_until("poses", |status| handled(status) >= wanted);
    let seen = wait_for("poses", || Some(poses.seen()).filter(|seen| seen.len() as u64 >= scans));
    for seen in seen {
        let at: Pose = seen.pose.odom_from_base;
        assert!(at.distance_m(Pose::IDENTITY) < STANDS.0 && at.heading_rad.abs() < STANDS.1, "{at:?}");
        assert_eq!(seen.pose.quality, Quality::Tracking as u32);
    }
    status
}

fn stage_page(set: &LiveSet) -> Option<String> {
    let socket = metrics_socket(&set.runtime_dir().join("status"), "lidar-ingest-0");
    scrape(&socket, Duration::from_secs(5)).ok()
}

fn lidar_log(set: &LiveSet) -> String {
    let lines = std::fs::read_to_string(flockslam_telemetry::log_stream_file(&set.runtime_dir()));
    lines.unwrap_or_default()
}

#[test]
fn each_family_gives_poses() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    let serial = [
        ("ld06", Played::ld06(), "LD06"),
        ("rplidar", Played::Rplidar(RplidarEncoder::new(0x85, 10.0)), "RPLIDAR A3M1, firmware 1.29"),
        (
            "rplidar",
            Played::Rplidar(RplidarEncoder::new(0x81, 10.0).with_firmware(0x18, (1, 16))),
            "RPLIDAR A1M8",
        ),
        ("ydlidar", Played::Ydlidar(YdlidarEncoder::new("T-mini Plus", 3, 8.0)), "ydlidar"),
    ];
    for (kind, lidar, said) in serial {
        let _player = LidarPlayer::plug(&path, lidar);
        let mut set = set_of("families", directory.path(), &at_port(kind, &path));
        let status = assert_stands(&mut set, 10);
        let line = &status.lidar_lines[0];
        assert!(line.state == "measuring" && line.to_string().contains(said), "{line}");
        assert!((190..=1000).contains(&line.beams) && (7.0..12.0).contains(&line.speed_hz), "{line}");
        set.command_well(&["down"]);
        assert_eq!(set.wait(), Some(0));
    }
    let network = [
        ("urg", Played::Urg(UrgEncoder::new()), "UST-10LX"),
        ("sick-tim", Played::SickTim(SickTimEncoder::new()), "TiM561"),
    ];
    for (kind, lidar, said) in network {
        let (_player, address) = LidarPlayer::listen(lidar);
        let mut set =
            set_of("families", directory.path(), &format!("kind = \"{kind}\"\naddress = \"{address}\""));
        let status = assert_stands(&mut set, 10);
        let line = &status.lidar_lines[0];
        assert!(line.to_string().contains(said) && line.health.as_deref() == Some("good"), "{line}");
        set.command_well(&["down"]);
        assert_eq!(set.wait(), Some(0));
    }
}

#[test]
fn a_lidar_that_is_unplugged_twenty_times_comes_back_each_time_and_the_map_is_not_harmed() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    let mut player = LidarPlayer::plug(&path, Played::ld06());
    let mut set = set_of("unplugged", directory.path(), &at_port("ld06", &path));
    set.wait_until_handled(Stage::ScanMatcher, 5);
    let ingest = set.pid(Stage::LidarIngest);
    for time in 1..=UNPLUGGED {
        drop(player);
        set.wait_until("it to be gone", |status| status.lidar_lines[0].state != "measuring");
        player = LidarPlayer::plug(&path, Played::ld06());
        let status = set.wait_until("it to be back", |status| {
            status.lidar_lines[0].state == "measuring" && status.lidar_lines[0].returns == time
        });
        let before = handled(&status);
        set.wait_until("more poses", |status| handled(status) > before + 2);
    }
    assert_stands(&mut set, 5);
    assert_eq!(set.pid(Stage::LidarIngest), ingest, "no process was replaced");
    let log = lidar_log(&set);
    assert!(log.contains("is gone: ") && log.contains("measures"), "{log}");
    let page = wait_for("metrics", || stage_page(&set));
    for metric in names::OF_LIDAR_LINES {
        assert!(page.contains(&format!("{}{{", metric.name)), "{}", metric.name);
    }
    let returns = format!("{}{{lidar=\"ld06\"", names::LIDAR_RETURNS.name);
    let line = page.lines().find(|line| line.starts_with(&returns)).unwrap();
    assert!(line.ends_with(&format!(" {UNPLUGGED}")), "{line}");
}

#[test]
fn a_lidar_fault_is_reported_in_one_line_and_the_lidar_is_used_once_it_is_repaired() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    let mut set = set_of("wrong", directory.path(), &format!("{}\nbaud = 230400", at_port("ld06", &path)));
    let mut in_state = |state: &str| {
        let status = set
            .wait_until(state, |status| status.lidar_lines.first().is_some_and(|line| line.state == state));
        status.lidar_lines[0].problem.clone().unwrap_or_default()
    };
    assert!(in_state("absent").contains("No such file"));
    let player = LidarPlayer::plug(&path, Played::Nothing);
    assert!(in_state("silent").contains("says nothing at 230400 baud"));
    drop(player);
    let player = LidarPlayer::plug(&path, Played::Garbage);
    assert!(in_state("garbled").contains("no packet of this family at 230400 baud"));
    drop(player);
    let _player = LidarPlayer::plug(&path, Played::ld06());
    in_state("measuring");
    let log = lidar_log(&set);
    for said in ["is not there: ", "says nothing", "no packet of this family", "measures at 230400 baud: "] {
        let lines = log.lines().filter(|line| line.contains("lidar (ld06 at") && line.contains(said));
        assert_eq!(lines.count(), 1, "{said} in {log}");
    }
}

#[test]
fn a_lidar_of_another_rate_than_usual_is_found_by_trying() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    let _player = LidarPlayer::plug(&path, Played::Nothing);
    // A pseudo terminal carries bytes at any rate: what is seen is which ones are asked for.
    let mut set = set_of("rates", directory.path(), &at_port("ld06", &path));
    for baud in [230_400, 115_200, 230_400] {
        set.wait_until("a rate", |status| {
            status.lidar_lines.first().is_some_and(|line| line.baud == Some(baud) && line.state == "silent")
                || baud == 230_400 && status.lidar_lines.first().is_some_and(|line| line.baud == Some(baud))
        });
    }
}

#[test]
fn two_lidars_of_different_families_give_poses_of_every_scan_while_one_comes_and_goes() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let paths = ["front", "rear"].map(|name| directory.path().join(name));
    let _front = LidarPlayer::plug(&paths[0], Played::ld06());
    let rear = || Played::Rplidar(RplidarEncoder::new(0x85, 10.0));
    let mut player = LidarPlayer::plug(&paths[1], rear());
    let source = format!(
        "kind = \"lidars\"\nlidars = [{{ name = \"front\", kind = \"ld06\", port = {:?} }}, \
         {{ name = \"rear\", kind = \"rplidar\", port = {:?} }}]",
        paths[0], paths[1]
    );
    let mut set = set_of("two-lines", directory.path(), &source);
    set.wait_until("both", |status| {
        status.lidar_lines.len() == 2 && status.lidar_lines.iter().all(|line| line.state == "measuring")
    });
    let poses = PoseWatch::start(&set.runtime_dir());
    for _ in 0..3 {
        drop(player);
        set.wait_until("one", |status| status.lidar_lines[1].state != "measuring");
        let seen = poses.count();
        wait_for("poses by the other", || (poses.count() > seen + 10).then_some(()));
        player = LidarPlayer::plug(&paths[1], rear());
        set.wait_until("both", |status| status.lidar_lines[1].state == "measuring");
        let seen = poses.count();
        wait_for("poses by both", || {
            let by_rear = poses.seen()[seen..].iter().filter(|seen| seen.pose.id.lidar == 1).count();
            (by_rear > 4).then_some(())
        });
    }
    let seen = poses.seen();
    let sequences: Vec<_> = seen.iter().map(|seen| seen.pose.id.sequence).collect();
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "every scan has a pose: {sequences:?}");
    let of_lidar = |lidar: u32| seen.iter().filter(|seen| seen.pose.id.lidar == lidar).count();
    assert!(of_lidar(0) > 30 && of_lidar(1) > 12, "{} {}", of_lidar(0), of_lidar(1));
    for seen in &seen {
        let at = seen.pose.odom_from_base;
        assert!(at.distance_m(Pose::IDENTITY) < STANDS.0 && at.heading_rad.abs() < STANDS.1, "{at:?}");
    }
}

#[test]
fn bytes_of_a_real_lidar_give_poses() {
    machine_share::mostly_waits();
    let Some(data) = data_dir() else { return };
    let Ok(text) = std::fs::read_to_string(data.join("lidar-bytes/ydlidar-t-mini-plus.hex.txt")) else {
        not_tested("bytes of a real lidar", "there are none among the logs");
        return;
    };
    let bytes: Vec<u8> = text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    // Points come 4000 a second, three bytes each with a tenth of a byte of head.
    let _player = LidarPlayer::plug(&path, Played::Bytes(bytes, 13_000.0));
    let mut set = set_of(
        "real-bytes",
        directory.path(),
        &format!("{}\nmodel = \"T-mini Plus\"", at_port("ydlidar", &path)),
    );
    set.wait_until_handled(Stage::ScanMatcher, 20);
    // Where the recording begins again a turn is not whole.
    let status = set.wait_until("a whole turn", |status| (580..=680).contains(&status.lidar_lines[0].beams));
    let line = &status.lidar_lines[0];
    assert_eq!((line.state.as_str(), line.model.as_deref()), ("measuring", Some("T-mini Plus")));
}

fn lidar(arguments: &[&str]) -> Output {
    crate::support::flockslam().arg("lidar").args(arguments).output().unwrap()
}

#[test]
fn list_says_what_answers_and_watch_prints_its_turns() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lidar");
    let port = path.display().to_string();
    let found = |expected: &str, lidar_played: Played| {
        let _player = LidarPlayer::plug(&path, lidar_played);
        let output = lidar(&["list", "--port", &port, "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json[0]["kind"], expected, "{json}");
        json[0]["says"].as_str().unwrap().to_owned()
    };
    assert_eq!(found("ld06", Played::ld06()), "LD06 or alike");
    let said = found("rplidar", Played::Rplidar(RplidarEncoder::new(0x84, 10.0)));
    assert!(said.starts_with("RPLIDAR A3M1, firmware 1.29"), "{said}");
    let said = found("urg", Played::Urg(UrgEncoder::new()));
    assert!(said.starts_with("UST-10LX"), "{said}");
    let _player = LidarPlayer::plug(&path, Played::ld06());
    let output = lidar(&["watch", "--kind", "ld06", "--port", &port, "--turns", "3"]);
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    let last = text.lines().last().unwrap_or_default().to_owned();
    let nearest_m = (0..360).map(|degree| room(f64::from(degree).to_radians())).fold(f64::INFINITY, f64::min);
    assert!(last.starts_with("turn 3, ") && last.contains(&format!("nearest {nearest_m:.2} m")), "{text}");
    let nobody = lidar(&["watch", "--kind", "ld06"]);
    assert_eq!(nobody.status.code(), Some(2), "neither a port nor a set: {}", stderr(&nobody));
}
