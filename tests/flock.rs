//! Robots that meet: real process sets, each with its own root and names, over the real network on this machine.

use crate::support::flocks::{FlockRobot, Namespace, hostile, own_certificates};
use crate::support::machine_share;
use crate::support::slow_link::SlowLink;
use crate::support::{Drive, LiveSet, flockslam, free_port, of, send, stderr, wait_for};
use flockslam_messages::Stage;
use flockslam_results::FlockStatus;
use rustix::process::Signal;
use serde_json::Value;
use std::process::Command;
use std::time::Instant;

/// A drive long enough for robots to come through the same places.
const MEETING: Drive = Drive { scan_rate_hz: 5.0, duration_s: 100.0, rate: 5.0 };
/// A drive that no test sees the end of.
const LONG: Drive = Drive { scan_rate_hz: 5.0, duration_s: 2000.0, rate: 5.0 };

/// Memory of a sync-manager that is flooded with messages.
const RESIDENT_MAX_KB: u64 = 400_000;

/// Waits until a robot is in one map with so many robots, itself among them.
fn wait_until_merged(robot: &mut FlockRobot, members: usize) -> FlockStatus {
    let what = format!("a map of {members} robots");
    robot.wait_for_flock(&what, |flock| flock.merged && flock.members.len() == members)
}

#[test]
fn three_robots_of_a_swarm_end_with_one_map() {
    let directory = tempfile::tempdir().unwrap();
    let mut command = flockslam();
    command.args(["swarm", "--robots", "3", "--rate", "5", "--set", "simulation.duration_s=100"]);
    command.args(["--set", "simulation.scan_rate_hz=5"]).arg("--out").arg(directory.path());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let read = |name: &str| -> Value {
        serde_json::from_slice(&std::fs::read(directory.path().join(name)).unwrap()).unwrap()
    };
    let joined = read("flock.json");
    println!("{}", serde_json::to_string_pretty(&joined).unwrap());
    assert_eq!(joined["members"].as_array().unwrap().len(), 3);
    assert_eq!(joined["all_agree"], true);
    let own: Vec<_> = ["r01", "r02", "r03"].map(|name| read(&format!("{name}/flock.json"))).into();
    assert!(own.iter().all(|status| status["map_hash"] == own[0]["map_hash"] && status["merged"] == true));
    assert!(own.iter().all(|status| status["flock_from_map"].is_array()));
    for file in ["trajectory.tum", "map.png", "map.pgm", "r02/trajectory_flock.tum"] {
        assert!(directory.path().join(file).metadata().unwrap().len() > 0, "{file}");
    }
}

#[test]
fn robots_die_until_one_is_left_which_goes_on_and_one_without_its_log_rejoins() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut robots = FlockRobot::start_all("mortal", directory.path(), LONG, 3);
    for robot in &mut robots {
        wait_until_merged(robot, 3);
    }
    let mut last = robots.pop().unwrap();
    let names = |flock: &FlockStatus| flock.robots.clone();
    let known = last.flock().unwrap();
    let mut dead = Vec::new();
    for mut robot in robots {
        let address = robot.address();
        robot.kill();
        last.wait_for_flock("the death of another", |flock| !flock.peers.contains(&address));
        dead.push(robot);
    }
    let handled =
        |robot: &FlockRobot| robot.set.status().map(|status| of(&status, Stage::SyncManager).handled);
    let before = wait_for("a status", || handled(&last));
    wait_for("more scans", || handled(&last).filter(|scans| *scans > before + 50));
    let alone = last.wait_for_flock("more of its own", |flock| flock.records.0 > known.records.0);
    assert!(alone.peers.is_empty() && alone.merged, "{alone:?}");
    assert_eq!(names(&alone), names(&known), "it still knows all of them");
    assert_eq!(alone.members.len(), 3);
    // What it has received outlives its own process too.
    send(last.set.pid(Stage::SyncManager), Signal::KILL);
    let again = last.wait_for_flock("the same after a restart", |flock| {
        flock.records.0 >= alone.records.0 && flock.members.len() == 3 && flock.merged
    });
    assert_eq!((again.epoch, names(&again)), (alone.epoch, names(&known)));
    // One comes back that has lost everything but its key.
    let mut restarted = dead.remove(0).start_without_log();
    let back = wait_until_merged(&mut restarted, 3);
    assert_eq!(back.epoch, 2);
    let address = restarted.address();
    last.wait_for_flock("the restarted one", |flock| flock.peers.contains(&address));
    dead.into_iter().for_each(FlockRobot::leave_nothing);
}

/// Maps of different sessions, none of which knew of the other, become one.
#[test]
fn saved_maps_are_merged() {
    let directory = tempfile::tempdir().unwrap();
    let saved = ["monday", "tuesday"].map(|day| {
        let own = directory.path().join(day);
        std::fs::create_dir(&own).unwrap();
        let drive = Drive { rate: 20.0, duration_s: 160.0, ..MEETING };
        let lead_s = if day == "monday" { 0 } else { 60 };
        let world = format!("[simulation]\nseed = {}\nlead_s = {lead_s}.0\n", 1 + lead_s);
        std::fs::write(own.join("world.toml"), world).unwrap();
        let set = LiveSet::start(day, &own, drive, "map = \"map\"\nconfig = \"world.toml\"");
        (set, own.join("map"))
    });
    let saved = saved.map(|(set, map)| {
        set.finish();
        map
    });
    let out = directory.path().join("both");
    let mut command = flockslam();
    command.args(["store", "merge"]).args(&saved).arg("--out").arg(&out);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let joined: Value = serde_json::from_slice(&std::fs::read(out.join("flock.json")).unwrap()).unwrap();
    assert_eq!(
        (joined["members"].as_array().unwrap().len(), &joined["all_agree"]),
        (2, &true.into()),
        "{joined:#}"
    );
    for file in ["trajectory.tum", "map.png", "map.pgm"] {
        assert!(out.join(file).metadata().unwrap().len() > 0, "{file}");
    }
}

/// What a late joiner has to receive goes through a slow radio link: 10 Mbit/s. How long that takes is printed.
#[test]
fn a_late_joiner_receives_all_over_a_slow_link() {
    machine_share::mostly_waits();
    join_late("office", 400.0, |late| drop(wait_until_merged(late, 2)));
}

/// The same of a map of more than 1000 m²: the demo that drives so long there maps 1281.
#[test]
fn a_late_joiner_receives_a_large_building_over_a_slow_link() {
    machine_share::mostly_waits();
    join_late("warehouse", 500.0, |_| ());
}

/// A robot drives; another, which begins when that one is through, receives all that it has recorded over a slow link.
fn join_late(world: &str, duration_s: f64, then: impl FnOnce(&mut FlockRobot)) {
    let directory = tempfile::tempdir().unwrap();
    let [first, second] = [(); 2].map(|()| format!("tcp/127.0.0.1:{}", free_port()));
    // The first one stays when its drive has ended.
    let stays = (world, "wait_for_robots = 1\nwait_max_s = 80.0");
    let drive = Drive { duration_s, rate: 20.0, ..MEETING };
    let test = format!("late-{}", &world[..4]);
    let mut early =
        FlockRobot::start_one(&test, directory.path(), drive, std::slice::from_ref(&first), 0, stays);
    let all = early.wait_for_flock("the end of the first drive", |flock| flock.has_ended && flock.converged);
    let link = SlowLink::to(&first, 10e6 / 8.0);
    let endpoints = [link.endpoint.clone(), second];
    let mut late = FlockRobot::start_one(&test, directory.path(), LONG, &endpoints, 1, (world, ""));
    late.wait_for_flock("a peer", |flock| !flock.peers.is_empty());
    let (met, carried) = (Instant::now(), link.carried());
    // It counts its own records too: what it has received must be as much as the other has recorded.
    late.wait_for_flock("all records", |flock| {
        flock.robots.len() == 2 && flock.records.0 >= all.records.0 && flock.received_bytes >= all.records.1
    });
    assert!(link.carried() >= all.records.1, "{} bytes came over the slow link", link.carried());
    println!(
        "{world}: {} records, {} bytes, in {:.2} s over 10 Mbit/s, {} bytes on the link",
        all.records.0,
        all.records.1,
        met.elapsed().as_secs_f64(),
        link.carried() - carried
    );
    then(&mut late);
}

#[test]
fn a_process_killed_while_publishing_is_not_quarantined_and_keeps_its_epoch() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut robots = FlockRobot::start_all("twice", directory.path(), LONG, 2);
    for robot in &mut robots {
        wait_until_merged(robot, 2);
    }
    for _ in 0..3 {
        let before = robots[0].flock().unwrap();
        let pid = robots[0].set.pid(Stage::SyncManager);
        send(pid, Signal::KILL);
        robots[0].set.wait_until("a successor", |status| {
            of(status, Stage::SyncManager).pid.is_some_and(|now| now != pid)
        });
        robots[0].wait_for_flock("more records", |flock| flock.records.0 > before.records.0);
    }
    for robot in &mut robots {
        let flock = wait_until_merged(robot, 2);
        assert!(!flock.dropped.contains_key("quarantined"), "{:?}", flock.dropped);
        assert_eq!(flock.epoch, 1);
    }
}

#[test]
fn a_link_that_was_cut_and_mended_leaves_both_robots_with_one_map() {
    machine_share::mostly_waits();
    let Some(namespaces) = Namespace::pair("flock-cut") else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut robots = FlockRobot::start_in(&namespaces, "cut", directory.path(), MEETING);
    for robot in &mut robots {
        robot.wait_for_flock("a peer", |flock| flock.peers.len() == 1);
    }
    namespaces[0].cut(true);
    let mut parted = Vec::new();
    for robot in &mut robots {
        parted.push(robot.wait_for_flock("a cut link", |flock| flock.peers.is_empty()));
    }
    for (robot, parted) in robots.iter_mut().zip(&parted) {
        robot.wait_for_flock("records of its own", |flock| flock.records.0 > parted.records.0);
    }
    namespaces[0].cut(false);
    let statuses: Vec<FlockStatus> = robots.into_iter().map(FlockRobot::finish).collect();
    assert!(statuses.iter().all(|status| status.converged && status.map_hash == statuses[0].map_hash));
    assert!(statuses.iter().all(|status| status.robots.len() == 2), "{statuses:?}");
}

#[test]
fn a_hostile_peer_is_counted_by_reason_and_nothing_is_merged_or_restarted() {
    let directory = tempfile::tempdir().unwrap();
    let mut robots = FlockRobot::start_all("hostile", directory.path(), LONG, 1);
    let robot = &mut robots[0];
    robot.wait_for_flock("a record", |flock| flock.records.0 > 2);
    let stage = |robot: &FlockRobot| {
        let status = robot.set.status()?;
        Some(of(&status, Stage::SyncManager).clone())
    };
    let before = wait_for("a status", || stage(robot));
    let sent = hostile(robot, 30_000);
    let reasons = ["malformed", "unknown-version", "bad-record", "too-long", "too-many-messages"];
    let flock = robot.wait_for_flock("all reasons", |flock| {
        reasons.iter().all(|reason| flock.dropped.get(*reason).is_some_and(|count| *count > 0))
    });
    let dropped: u64 = flock.dropped.values().sum();
    println!("{sent} messages sent, {dropped} dropped: {:?}", flock.dropped);
    assert!(!flock.merged && flock.flock_from_map.is_none() && flock.members.len() <= 1, "{flock:?}");
    let after = wait_for("more scans", || stage(robot).filter(|now| now.handled > before.handled + 20));
    assert_eq!((after.restarts, after.hangs), (0, 0));
    let rss_kb = resident_kb(after.pid.unwrap());
    println!("sync-manager takes {rss_kb} kB");
    assert!(rss_kb < RESIDENT_MAX_KB, "{rss_kb} kB");
}

fn resident_kb(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn a_peer_without_a_certificate_of_the_flock_is_rejected() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let Some([good, other]) = own_certificates(directory.path()) else { return };
    let mut robots =
        FlockRobot::start_certified("certified", directory.path(), LONG, &[&good, &good, &other]);
    let mut uncertified = robots.pop().unwrap();
    for robot in &mut robots {
        robot.wait_for_flock("a peer", |flock| flock.peers.len() == 1);
        robot.wait_for_flock("its records", |flock| flock.robots.len() == 2);
    }
    let outside = uncertified.wait_for_flock("records of its own", |flock| flock.records.0 > 2);
    assert!(outside.peers.is_empty() && outside.robots.len() == 1, "{outside:?}");
    let inside = robots[0].flock().unwrap();
    assert!(!inside.peers.contains(&uncertified.address()), "{inside:?}");
}

#[test]
fn robots_exchange_records_only_during_a_reported_contact() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let more = "proximity = \"contacts\"";
    let mut robots = FlockRobot::start_with("contacts", directory.path(), LONG, 2, more);
    for robot in &mut robots {
        // It has had several records to tell and somebody to tell them to.
        let flock = robot.wait_for_flock("a peer", |flock| flock.peers.len() == 1 && flock.records.0 > 3);
        assert!(flock.near.is_empty() && flock.robots.len() == 1, "{flock:?}");
    }
    let names: Vec<String> = robots.iter().map(FlockRobot::name).collect();
    let socket = std::os::unix::net::UnixDatagram::unbound().unwrap();
    for (robot, other) in robots.iter().zip(names.iter().rev()) {
        let report = format!("near {other} 3600\n");
        socket.send_to(report.as_bytes(), robot.set.runtime_dir().join("status/contacts")).unwrap();
    }
    for robot in &mut robots {
        robot.wait_for_flock("the other", |flock| flock.robots.len() == 2 && flock.near.len() == 1);
    }
}

#[test]
fn a_mistake_in_the_settings_is_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let refused = |assignment: &str| {
        let mut command: Command = flockslam();
        command.args(["demo", "--set", "sync_manager.flock.enabled=true", "--set", assignment]);
        let output = command.arg("--out").arg(directory.path().join("out")).output().unwrap();
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.lines().count()), (Some(2), 1), "{text}");
        text
    };
    assert!(refused("sync_manager.flock.name=").contains("sync_manager.flock.name: "));
}
