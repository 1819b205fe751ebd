//! A set that localizes, as a node of a ROS 2 graph: it stands where AMCL stands.

use crate::ros2::bridges;
use crate::support::ros_peers::Graph;
use crate::support::ros_rows::rows;
use crate::support::{Outputs, flockslam, machine_share, run_well, send, simulated_drive, wait_for};
use flockslam_bus::RuntimeDir;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::path::Path;

/// Side of a cell of the map, and of the set's own.
const RESOLUTION_M: f64 = 0.045;

/// The origin of the map of a run, metres.
fn origin_of(outputs: &Path) -> [f64; 2] {
    let yaml = std::fs::read_to_string(outputs.join("map.yaml")).unwrap();
    let origin = yaml.lines().find_map(|line| line.strip_prefix("origin: [")).unwrap();
    let mut numbers = origin.split(',').map(|number| number.trim().parse().unwrap());
    [(); 2].map(|()| numbers.next().unwrap())
}

/// What a robot noted while it drove are the poses of the run that made the map.
fn assert_true(noted: &Value, mapped: &Outputs) {
    let (corrections, poses) = (rows(noted, "corrections"), rows(noted, "poses"));
    // The poses begin when the robot has been found, later on a machine that is busy.
    let sent = rows(noted, "sent").len();
    assert!(4 * poses.len() > 3 * sent, "{} poses for {sent} scans", poses.len());
    let trajectory = mapped.trajectory("trajectory.tum");
    let truth = |stamp_ns: i64| trajectory.iter().find(|point| (point.stamp_ns - stamp_ns).abs() < 1_000_000);
    let off_m = poses.iter().filter_map(|row| Some(truth(row.0)?.map_from_base.distance_m(row.1)));
    let farthest_m = off_m.fold(0.0, f64::max);
    println!("{} poses, {} corrections, at most {farthest_m:.3} m off", poses.len(), corrections.len());
    assert!(corrections.len() > 100 && farthest_m < 0.12, "{farthest_m} m");
}

/// nav2's map server publishes the map: the set has none of its own, publishes none, and localizes in that.
#[test]
fn beside_a_map_server_a_set_localizes_in_its_map_and_publishes_none() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let (log, _) = simulated_drive(directory.path(), 24.0);
    let known = directory.path().join("known");
    let mapped = run_well("known", &known, &["map".to_owned(), log.display().to_string()]);
    let mut set = graph.localizing_set("beside", directory.path(), Path::new("ros"));
    set.wait_until("the set", |_| true);
    let mut peer = graph.peer("server");
    let [x_m, y_m] = origin_of(&known);
    let picture = known.join("map.pgm");
    let sides = peer.tell(&json!(["serve_map", picture, RESOLUTION_M, x_m, y_m]));
    let results = RuntimeDir::open(&set.runtime_dir()).unwrap().results();
    let size = |name: &str| std::fs::metadata(results.join(name)).map_or(0, |file| file.len());
    wait_for("the map of the server", || (size("known.map") > 1000).then_some(()));
    println!("{sides} cells, {} bytes", size("known.map"));
    assert_true(&graph.play(&log, 2.0, "/"), &mapped);
    assert_eq!(
        peer.tell(&json!(["qos", "flockslam", "/map"])),
        json!([["RELIABLE", "TRANSIENT_LOCAL"]]),
        "it takes the map, and does not publish it"
    );
    let services = &peer.tell(&json!(["graph"]))["services"];
    assert!(services.get("/flockslam/load_map").is_some() && services.get("/map_server/load_map").is_none());
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn a_peer_receives_the_known_map_the_pose_in_it_and_moves_the_robot_by_a_hint() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let (log, _) = simulated_drive(directory.path(), 24.0);
    let known = directory.path().join("known");
    let mapped = run_well("known", &known, &["map".to_owned(), log.display().to_string()]);
    let mut set = graph.localizing_set("amcl", directory.path(), &known);
    set.wait_until("the set", |_| true);
    let mut peer = graph.peer("user");

    let (found, cells) = peer.map(directory.path());
    let (width, height) = (found["width"].as_u64().unwrap() as i64, found["height"].as_u64().unwrap() as i64);
    let low = |axis: usize| (found["origin"][axis].as_f64().unwrap() / RESOLUTION_M).round() as i64;
    let picture = image::open(known.join("map.pgm")).unwrap().into_luma8();
    let origin = origin_of(&known).map(|along_m| (along_m / RESOLUTION_M).round() as i64);
    let (mut walls, mut wrong) = (0, Vec::new());
    for (x, row, pixel) in picture.enumerate_pixels() {
        let y = i64::from(picture.height() - 1 - row);
        let (column, line) = (origin[0] + i64::from(x) - low(0), origin[1] + y - low(1));
        assert!((0..width).contains(&column) && (0..height).contains(&line), "{x}, {y} is not in {found}");
        let expected = match pixel.0[0] {
            0 => 100,
            254 => 0,
            _ => -1,
        };
        let found = cells[(line * width + column) as usize];
        if found != expected {
            wrong.push((x, row, found, expected));
        }
        walls += u32::from(expected == 100);
    }
    assert!(
        wrong.is_empty(),
        "{} of {} pixels differ, as {:?}; {found}, {origin:?}",
        wrong.len(),
        picture.len(),
        &wrong[..9.min(wrong.len())]
    );
    assert!(walls > 500, "{walls}");

    let (pose_type, pose_topic) = ("geometry_msgs/PoseWithCovarianceStamped", "/amcl_pose");
    assert_eq!(peer.tell(&json!(["listen", pose_type, pose_topic])), true);
    let noted = graph.play(&log, 2.0, "/");
    assert_true(&noted, &mapped);
    let heard = peer.tell(&json!(["heard", pose_topic]));
    assert!(heard["count"].as_u64().unwrap() > 100, "{heard}");
    let variance = heard["last"][0]["pose"]["covariance"][0].as_f64().unwrap();
    assert!(variance > 0.0 && variance < 0.01, "{variance}");

    let url = json!({ "map_url": known.join("map.yaml") });
    let loaded = peer.call("nav2_msgs/LoadMap", "/map_server/load_map", url);
    assert_eq!(loaded["result"].as_u64(), Some(0), "it stands where the map server stood: {loaded}");

    let searches = |set: &crate::support::LiveSet| set.status().unwrap().localisation.unwrap().searches;
    let before = searches(&set);
    let answer: Value = peer.call("std_srvs/Empty", "/reinitialize_global_localization", json!({}));
    assert!(!answer.is_null(), "the service answers");
    // The robot stands: it is looked for with its next scans.
    graph.play(&log, 4.0, "/");
    set.wait_until("the robot was looked for anew", |status| {
        status.localisation.as_ref().is_some_and(|localisation| localisation.searches > before)
    });
    let before = searches(&set);
    let hint = json!({ "header": { "frame_id": "map" }, "pose": { "pose": { "position": { "x": 0.2 } } } });
    assert_eq!(peer.tell(&json!(["say", pose_type, "/initialpose", hint])), true);
    graph.play(&log, 4.0, "/");
    set.wait_until("the hint is tried", |status| {
        status.localisation.as_ref().is_some_and(|localisation| localisation.searches > before)
    });
    let before = searches(&set);
    let load =
        json!({ "filename": known.join("map.yaml"), "match_type": 3, "x": 0.2, "y": 0.0, "theta": 0.0 });
    let loaded = peer.call("slam_toolbox/DeserializePoseGraph", "/slam_toolbox/deserialize_map", load);
    assert_eq!(loaded["result"].as_u64(), Some(0), "{loaded}");
    graph.play(&log, 4.0, "/");
    set.wait_until("its pose is tried", |status| {
        status.localisation.as_ref().is_some_and(|localisation| localisation.searches > before)
    });
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

/// What the graph was offered when the set began stays when the bridge dies after the set has changed its mode.
#[test]
fn a_bridge_that_starts_again_after_a_change_of_the_mode_offers_the_same_services() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let (log, _) = simulated_drive(directory.path(), 24.0);
    let [known, saved] = ["known", "saved"].map(|name| directory.path().join(name));
    run_well("known", &known, &["map".to_owned(), log.display().to_string()]);
    let import =
        flockslam().args(["store", "import"]).arg(known.join("map.yaml")).arg("--out").arg(&saved).status();
    assert!(import.unwrap().success());
    let mut set = graph.localizing_set("changes", directory.path(), &saved);
    set.wait_until("the set", |_| true);
    let mut peer = graph.peer("user");
    let offered = |services: &Value| {
        ["/map_server/load_map", "/slam_toolbox/dynamic_map", "/flockslam/load_map"]
            .map(|name| services.get(name).is_some())
    };
    // They are discovered one after the other.
    let all = [true, false, true];
    peer.wait_for("the services", &json!(["graph"]), |seen| {
        (offered(&seen["services"]) == all).then_some(())
    });
    graph.play(&log, 2.0, "/");
    set.wait_until("the robot is localized", |status| {
        status.localisation.as_ref().is_some_and(|localisation| localisation.knowledge == "localized")
    });
    set.command_well(&["mode", "map"]);
    let dead = wait_for("the bridge", || bridges(&set).first().copied());
    send(dead, Signal::KILL);
    wait_for("its successor", || bridges(&set).into_iter().find(|pid| *pid != dead));
    let mut late = graph.peer("late");
    late.wait_for("the services again", &json!(["graph"]), |seen| {
        let offered = offered(&seen["services"]);
        assert!(!offered[1], "it offers the map that it was given as its own");
        (offered == all).then_some(())
    });
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
