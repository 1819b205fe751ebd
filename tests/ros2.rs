//! A set as a node of a ROS 2 graph, against nodes of the client library of ROS (Fast DDS) and of Cyclone DDS.

use crate::support::ros_peers::{Graph, Peer, udp_ports};
use crate::support::ros_rows::{AHEAD_NS, assert_composed, rows};
use crate::support::{
    LiveSet, flockslam, machine_share, processes_of, run_well, send, simulated_drive, wait_for,
};
use flockslam::evaluation::evaluate_truth;
use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use rustix::process::Signal;
use serde_json::{Value, json};

fn points(rows: &[(i64, Pose, i64)]) -> Vec<TrajectoryPoint> {
    rows.iter()
        .map(|(stamp_ns, pose, _)| TrajectoryPoint { stamp_ns: *stamp_ns, map_from_base: *pose })
        .collect()
}

fn error_m(points: &[TrajectoryPoint], truth: &[TrajectoryPoint]) -> f64 {
    evaluate_truth(points, truth).unwrap().absolute.translation_m.unwrap().rmse
}

/// The processes of a set that are bridges.
pub(crate) fn bridges(set: &LiveSet) -> Vec<u32> {
    let is_bridge = |pid: &u32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).nth(1) == Some(b"ros")
    };
    processes_of(&set.runtime_dir().display().to_string()).into_iter().filter(is_bridge).collect()
}

/// Nodes find each other within this, seconds.
const DISCOVERY_MAX_S: f64 = 2.0;

/// Memory that a process has of the machine.
fn memory_mib(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

/// Scans of a drive that begins as soon as the robot's writer knows a reader.
const FIRST_SCANS: usize = 2;

#[test]
fn a_log_played_into_the_graph_is_mapped_as_the_file_is() {
    // Forty scans a second from one process to another, best effort: a busy machine loses one.
    machine_share::alone();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let (log, truth) = simulated_drive(directory.path(), 40.0);
    let mut set = graph.set("graph", directory.path(), &[]);
    set.wait_until("the set", |_| true);
    // Ten scans a second, four times as fast.
    let noted = graph.play(&log, 4.0, "/");
    let (sent, poses, corrections) =
        (rows(&noted, "sent"), rows(&noted, "poses"), rows(&noted, "corrections"));
    // A writer knows its readers a little before they know it: the first scan may be too early.
    let heard = sent.iter().position(|scan| scan.0 == poses[0].0).unwrap();
    assert!(heard <= FIRST_SCANS, "{heard} scans were not received at the start");
    let sent = &sent[heard..];
    assert_eq!(poses.len(), sent.len(), "no scan is lost at 40 a second");
    assert!(corrections.is_sorted_by(|a, b| a.0 < b.0), "no stamp comes twice");
    let mut delays_ms = Vec::new();
    for (scan, pose) in sent.iter().zip(&poses) {
        assert_eq!(scan.0, pose.0);
        let received_ns = assert_composed(scan, pose.1, &corrections);
        delays_ms.push((received_ns - scan.2) as f64 * 1e-6);
    }
    delays_ms.sort_by(f64::total_cmp);
    let quantile = |share: f64| delays_ms[((delays_ms.len() - 1) as f64 * share) as usize];
    println!("scan to /tf at the peer: p50 {:.1} ms, p99 {:.1} ms", quantile(0.5), quantile(0.99));

    let mut late = graph.peer("late");
    let saved = directory.path().join("saved/map");
    std::fs::create_dir(directory.path().join("saved")).unwrap();
    // The map that is saved is the one that is published, and both are the newest.
    let answer = late.call("slam_toolbox/SaveMap", "/slam_toolbox/save_map", json!({ "name": saved }));
    assert_eq!(answer["result"], 0);
    let picture = image::open(saved.with_extension("pgm")).unwrap().into_luma8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    // An older map may come before the newest, whose fragments fill the buffers of a peer.
    let (found, cells) = wait_for("the newest map", || {
        let (found, cells) = late.map(directory.path());
        println!("a map came after {} s, {} in all", found["seconds"], found["maps"]);
        let is_newest = found["width"] == width && found["height"] == height;
        is_newest.then_some((found, cells))
    });
    for (index, value) in cells.iter().enumerate() {
        let pixel = picture.get_pixel((index % width) as u32, (height - 1 - index / width) as u32).0[0];
        let expected = match value {
            -1 => 205,
            0 => 254,
            100 => 0,
            other => panic!("{other} is no value of a map"),
        };
        assert_eq!(pixel, expected, "cell {index}");
    }
    assert!(cells.iter().filter(|value| **value == 100).count() > 500, "walls are in the map");
    let origin = found["origin"][0].as_f64().unwrap();
    assert!((origin / 6.4 - (origin / 6.4).round()).abs() < 1e-6 && width % 128 == 0, "{found}");
    set.command_well(&["down"]);

    let out = directory.path().join("file");
    let arguments = ["map", &log.display().to_string(), "--rate", "4"].map(str::to_owned);
    let replay = run_well("graph-file", &out, &arguments);
    let replayed = error_m(&replay.trajectory("trajectory_online.tum"), &truth);
    let played = error_m(&points(&poses), &truth);
    println!("error of poses: {played:.4} m through the graph, {replayed:.4} m from the file");
    // A tenth, and what two live replays of one file differ by.
    assert!(played < 1.1 * replayed + 0.006, "{played} m through the graph, {replayed} m from the file");
}

#[test]
fn a_manager_takes_the_node_up_and_down_and_the_bond_outlives_a_kill() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let arguments = ["-r", "__node:=slam_toolbox", "-p", "use_lifecycle_manager:=true"];
    let set = graph.set("managed", directory.path(), &arguments);
    let mut manager = graph.peer("manager");
    let state = json!(["call", "lifecycle_msgs/GetState", "/slam_toolbox/get_state", {}]);
    let label = |answer: &Value| answer["current_state"]["label"].as_str().map(str::to_owned);
    assert_eq!(manager.wait_for("the node", &state, label), "unconfigured");
    let change = |manager: &mut Peer, id: u8| {
        let asked = json!({ "transition": { "id": id } });
        let answer = manager.call("lifecycle_msgs/ChangeState", "/slam_toolbox/change_state", asked);
        answer["success"].as_bool().unwrap()
    };
    assert!(!change(&mut manager, 3), "it is not activated before it is configured");
    assert!(change(&mut manager, 1) && change(&mut manager, 3));
    manager.tell(&json!(["bond", "slam_toolbox"]));
    let formed = |bond: &Value| bond["formed"].as_bool().unwrap().then(|| bond["instance"].clone());
    let instance = manager.wait_for("the bond", &json!(["bonded"]), formed);

    // Killed, it is back within the timeout of the bond, and goes on.
    let before = wait_for("the bridge", || bridges(&set).first().copied());
    send(before, Signal::KILL);
    wait_for("its successor", || bridges(&set).into_iter().find(|pid| *pid != before));
    let again = manager.wait_for("its answer", &state, label);
    assert_eq!(again, "active");
    let bond = manager.tell(&json!(["bonded"]));
    assert_eq!((&bond["broken"], &bond["instance"]), (&Value::Null, &instance));

    assert!(change(&mut manager, 4));
    let ended = |bond: &Value| bond["broken"].as_str().map(str::to_owned);
    assert_eq!(manager.wait_for("the end of the bond", &json!(["bonded"]), ended), "ended");
    assert!(change(&mut manager, 2));
    assert_eq!(manager.wait_for("the node", &state, label), "unconfigured");
    set.command_well(&["down"]);
}

#[test]
fn services_and_parameters_have_their_documented_effect() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut set = graph.set("services", directory.path(), &["-p", "map_update_interval:=1.0"]);
    let mut peer = graph.peer("user");
    let is_paused = |set: &LiveSet| set.status().unwrap().paused;
    set.wait_until("the set", |_| true);
    for (called, expected) in [(true, true), (false, false)] {
        let answer = peer.call("std_srvs/SetBool", "/flockslam/pause", json!({ "data": called }));
        assert_eq!((answer["success"].as_bool(), is_paused(&set)), (Some(true), expected));
    }
    // This one toggles, as that of slam_toolbox does.
    for expected in [true, false] {
        let answer =
            peer.call("slam_toolbox/Pause", "/slam_toolbox/pause_new_measurements", json!({ "nothing": 0 }));
        assert_eq!((answer["status"].as_bool(), is_paused(&set)), (Some(true), expected));
    }

    let names = ["odom_frame", "resolution", "map_update_interval", "use_sim_time"];
    let values = peer.tell(&json!(["parameters", "flockslam", names]));
    assert_eq!(values, json!(["odom", 0.05, 1.0, false]));
    let set_to =
        |peer: &mut Peer, name: &str, value: Value| peer.tell(&json!(["set", "flockslam", name, value]));
    assert_eq!(set_to(&mut peer, "map_update_interval", json!(2.5))[0], true);
    assert_eq!(peer.tell(&json!(["parameters", "flockslam", ["map_update_interval"]])), json!([2.5]));
    let refused = set_to(&mut peer, "map_update_interval", json!(0.0));
    assert_eq!(refused, json!([false, "0 is not between 0.1 and 3600"]));
    let refused = set_to(&mut peer, "odom_frame", json!("other"));
    assert_eq!(refused, json!([false, "odom_frame cannot be changed while the node runs"]));

    assert_eq!(peer.tell(&json!(["follow"])), true);
    for (kind, name) in [
        ("visualization_msgs/MarkerArray", "/slam_toolbox/graph_visualization"),
        ("visualization_msgs/MarkerArray", "/flockslam/tracks"),
        ("diagnostic_msgs/DiagnosticArray", "/flockslam/quality"),
        ("rcl_interfaces/Log", "/rosout"),
    ] {
        assert_eq!(peer.tell(&json!(["listen", kind, name])), true);
    }
    let (log, _) = simulated_drive(directory.path(), 16.0);
    let noted = graph.play(&log, 1.0, "/");
    let heard = |peer: &mut Peer, name: &str| peer.tell(&json!(["heard", name]));
    let count = |heard: &Value| heard["count"].as_u64().unwrap() as usize;
    let quality = heard(&mut peer, "/flockslam/quality");
    // Scans are sent best effort, and of quality the last ten are kept: on a busy machine some are lost.
    assert!(4 * count(&quality) >= 3 * rows(&noted, "sent").len(), "{quality}");
    assert_eq!(quality["last"][0]["status"][0]["message"], "tracking");
    assert!(count(&heard(&mut peer, "/flockslam/tracks")) > 0);
    let is_compared = |followed: &Value| (!followed["nearer"].is_null()).then(|| followed.clone());
    let followed = peer.wait_for("a map after changes", &json!(["followed"]), is_compared);
    assert!(followed["changes"].as_u64().unwrap() > 0 && followed["nearer"] == true, "{followed}");
    let graph_received = heard(&mut peer, "/slam_toolbox/graph_visualization");
    let last = graph_received["last"].as_array().unwrap().last().unwrap();
    let way = last["markers"].as_array().unwrap().iter().find(|marker| marker["ns"] == "way").unwrap();
    assert!(way["points"].as_array().unwrap().len() > 5 && way["header"]["frame_id"] == "map", "{way}");
    let hint = json!({ "header": { "frame_id": "map" }, "pose": { "pose": { "position": { "x": 1.0 } } } });
    for _ in 0..2 {
        let said = json!(["say", "geometry_msgs/PoseWithCovarianceStamped", "/initialpose", hint]);
        assert_eq!(peer.tell(&said), true);
    }
    let hints = |heard: &Value| {
        let lines = heard["last"].as_array().unwrap();
        lines
            .iter()
            .filter(|line| line["msg"].as_str().unwrap().contains("/initialpose has no effect"))
            .count()
    };
    let said = peer.wait_for("the line", &json!(["heard", "/rosout"]), |heard| {
        Some(hints(heard)).filter(|found| *found > 0)
    });
    assert_eq!(said, 1, "one line is enough");
    let values = peer.tell(&json!(["all parameters", "flockslam"]));
    assert_eq!(values.as_array().map(Vec::len), Some(17), "an answer with all of them fits a datagram");
    let walls = |cells: &[i8]| cells.iter().filter(|value| **value == 100).count();
    let (_, cells) = peer.map(directory.path());
    assert!(walls(&cells) > 100);
    let kept = directory.path().join("kept");
    let filename = json!({ "filename": kept });
    let answer = peer.call("slam_toolbox/SerializePoseGraph", "/slam_toolbox/serialize_map", filename);
    assert_eq!(answer["result"], 0);
    assert!(flockslam().args(["store", "check"]).arg(&kept).output().unwrap().status.success());
    let answer =
        peer.call("slam_toolbox/Reset", "/slam_toolbox/reset", json!({ "pause_new_measurements": false }));
    assert_eq!(answer["result"], 0);
    let picture = directory.path().join("picture");
    let save = |peer: &mut Peer| {
        peer.call("slam_toolbox/SaveMap", "/slam_toolbox/save_map", json!({ "name": picture }))["result"]
            .as_u64()
    };
    assert_eq!(save(&mut peer), Some(1), "there is no map any more");
    // To localize in a map has no meaning for a set that makes one.
    for (match_type, result) in [(3, 2), (9, 2), (1, 0)] {
        let load = json!({ "filename": kept, "match_type": match_type, "x": 0.0, "y": 0.0, "theta": 0.0 });
        let answer = peer.call("slam_toolbox/DeserializePoseGraph", "/slam_toolbox/deserialize_map", load);
        assert_eq!(answer["result"], result, "{match_type}");
    }
    wait_for("the loaded map", || (save(&mut peer) == Some(0)).then_some(()));
    let image = image::open(picture.with_extension("pgm")).unwrap().into_luma8();
    assert!(image.pixels().filter(|pixel| pixel.0 == [0]).count() > 100, "walls are in it");
    let url = |path: &std::path::Path| json!({ "map_url": format!("file://{}", path.display()) });
    let load = |peer: &mut Peer, path: &std::path::Path| {
        peer.call("nav2_msgs/LoadMap", "/flockslam/load_map", url(path))["result"].as_u64()
    };
    assert_eq!(load(&mut peer, &kept), Some(0));
    assert_eq!(load(&mut peer, &directory.path().join("nowhere")), Some(1));
    let by_nav2 = directory.path().join("by-nav2");
    let fields = json!({
        "map_topic": "map", "map_url": by_nav2, "image_format": "pgm", "map_mode": "trinary",
        "free_thresh": 0.25, "occupied_thresh": 0.65
    });
    wait_for("the loaded map", || {
        let answer = peer.call("nav2_msgs/SaveMap", "/flockslam/save_map", fields.clone());
        (answer["result"] == true).then_some(())
    });
    assert!(by_nav2.with_extension("yaml").is_file());
    // The mode is changed while no scan comes; what is not localized cannot make the map further.
    let mut localize = |on: bool| peer.call("std_srvs/SetBool", "/flockslam/localize", json!({ "data": on }));
    assert_eq!(localize(true)["success"], true);
    assert_eq!(set.status().unwrap().mode.name, "localize");
    let refused = localize(false);
    let reason = refused["message"].as_str().unwrap();
    assert!(refused["success"] == false && reason.contains("not localized in the known map"), "{refused}");
    set.command_well(&["down"]);
}

#[test]
fn corrections_follow_bad_wheels_and_callers_of_cyclone_dds_are_answered() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let arguments = ["-p", "use_sim_time:=true"];
    let set = graph.set_with(
        "cyclone",
        directory.path(),
        &arguments,
        &[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")],
    );
    let mut peer = graph.peer("caller");
    // On the way: odometry that is wrong and begins anew, and the time of a log.
    let (log, _) = simulated_drive(directory.path(), 12.0);
    let noted = graph.play_with_wheels(&log, 2.0, 1.05);
    let (sent, poses, corrections) =
        (rows(&noted, "sent"), rows(&noted, "poses"), rows(&noted, "corrections"));
    for (scan_ns, pose, _) in &poses {
        let scan = sent.iter().find(|scan| scan.0 == *scan_ns).unwrap();
        assert_composed(scan, *pose, &corrections);
    }
    println!("{} poses of {} scans", poses.len(), sent.len());
    assert_eq!(poses.last().unwrap().0, sent.last().unwrap().0);
    // Between scans as well: the clock of the graph is received.
    assert!(corrections.len() > poses.len() && corrections.is_sorted_by(|a, b| a.0 < b.0));
    let newest_ns = corrections.last().unwrap().0;
    assert!(newest_ns < sent.last().unwrap().0 + 10 * AHEAD_NS, "stamps are those of the log");
    // Somebody else corrects it: this node says so, and does not.
    assert_eq!(peer.tell(&json!(["correct"])), true);
    let is_withheld = |heard: &Value| {
        let text = heard["flockslam: poses"][1].as_str()?;
        text.contains("another node publishes map → odom").then_some(())
    };
    peer.wait_for("the status", &json!(["diagnostics"]), is_withheld);
    let called = json!({ "guid": 71, "sequence": 5, "nothing": 0 });
    let state = peer.call("lifecycle_msgs/GetState by header", "/flockslam/get_state", called.clone());
    assert_eq!(state, json!({ "guid": 71, "sequence": 5, "id": 3, "label": "active" }));
    set.command_well(&["down"]);
}

#[test]
fn callers_of_cyclone_dds_read_and_set_parameters_and_change_the_state() {
    machine_share::mostly_waits();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let variables = [("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")];
    let mut set = graph.set_with("cyclone-calls", directory.path(), &[], &variables);
    set.wait_until("the set", |_| true);
    wait_for("the bridge", || bridges(&set).first().copied());
    let mut peer = graph.peer("caller");
    let is_there = |graph: &Value| graph["nodes"].as_array()?.contains(&json!("/flockslam")).then_some(());
    peer.wait_for("the node of the set", &json!(["graph"]), is_there);
    let mut sequence = 0;
    let mut call = |kind: &str, name: &str, fields: Value| {
        sequence += 1;
        let mut called = json!({ "guid": 71, "sequence": sequence });
        called.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
        let answer = peer.call(&format!("{kind} by header"), &format!("/flockslam/{name}"), called);
        assert_eq!((&answer["guid"], &answer["sequence"]), (&json!(71), &json!(sequence)), "{name}");
        answer
    };
    let listed =
        call("rcl_interfaces/ListParameters", "list_parameters", json!({ "prefixes": [], "depth": 10 }));
    assert_eq!(listed["result"]["names"].as_array().map(Vec::len), Some(17), "{listed}");
    let names = json!({ "names": ["odom_frame", "resolution", "use_sim_time"] });
    let values = &call("rcl_interfaces/GetParameters", "get_parameters", names)["values"];
    assert_eq!((&values[0]["type"], &values[0]["string_value"]), (&json!(4), &json!("odom")));
    assert_eq!((&values[1]["type"], &values[1]["double_value"]), (&json!(3), &json!(0.05)));
    assert_eq!((&values[2]["type"], &values[2]["bool_value"]), (&json!(1), &json!(false)));
    let given = json!({ "parameters": [["transform_timeout", 0.3], ["map_update_interval", 0.0]] });
    let results = &call("rcl_interfaces/SetParameters", "set_parameters", given)["results"];
    let expected = json!([
        { "successful": true, "reason": "" },
        { "successful": false, "reason": "0 is not between 0.1 and 3600" }
    ]);
    assert_eq!(results, &expected);
    let names = json!({ "names": ["transform_timeout"] });
    let values = &call("rcl_interfaces/GetParameters", "get_parameters", names)["values"];
    assert_eq!(values[0]["double_value"], json!(0.3));

    let nothing = json!({ "nothing": 0 });
    for (transition, is_one, state) in
        [(3, false, "active"), (4, true, "inactive"), (2, true, "unconfigured")]
    {
        let changed = call("lifecycle_msgs/ChangeState", "change_state", json!({ "transition": transition }));
        assert_eq!(changed["success"], json!(is_one), "{transition}");
        assert_eq!(call("lifecycle_msgs/GetState", "get_state", nothing.clone())["label"], json!(state));
    }
    let available = call("lifecycle_msgs/GetAvailableTransitions", "get_available_transitions", nothing);
    let labels: Vec<_> = available["available_transitions"].as_array().unwrap().iter().collect();
    assert!(labels.iter().any(|found| found["transition"]["label"] == "configure"), "{labels:?}");
    set.command_well(&["down"]);
}

#[test]
fn hostile_traffic_harms_neither_the_bridge_nor_a_pose() {
    machine_share::alone();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut set = graph.set("hostile", directory.path(), &[]);
    set.wait_until("the set", |_| true);
    let bridge = wait_for("the bridge", || bridges(&set).first().copied());
    let mut peer = graph.peer("observer");
    let state = json!(["call", "lifecycle_msgs/GetState", "/flockslam/get_state", {}]);
    let is_active = |answer: &Value| (answer["current_state"]["label"] == "active").then_some(());
    peer.wait_for("the node", &state, is_active);
    let before_mib = memory_mib(bridge);
    let ports = udp_ports(bridge);
    assert!(ports.len() >= 2, "{ports:?}");
    let mut hostile = graph.hostile(12, 2000, &ports);
    let (log, _) = simulated_drive(directory.path(), 10.0);
    let noted = graph.play(&log, 1.0, "/");
    assert!(wait_for("the end of it", || hostile.try_wait().unwrap()).success());
    assert_eq!(bridges(&set), [bridge], "it is the same process");
    let (sent, poses) = (rows(&noted, "sent").len(), rows(&noted, "poses").len());
    println!(
        "{poses} poses of {sent} scans; memory {before_mib:.0} MiB, {:.0} MiB after",
        memory_mib(bridge)
    );
    assert!(poses + FIRST_SCANS >= sent, "{poses} poses of {sent} scans");
    assert!(
        memory_mib(bridge) < before_mib + 40.0,
        "{before_mib} MiB before, {} MiB after",
        memory_mib(bridge)
    );
    peer.wait_for("its answer", &state, is_active);
    set.command_well(&["down"]);
}

#[test]
fn peers_come_and_go_and_domains_do_not_see_each_other() {
    machine_share::mostly_waits();
    let (Some(graph), Some(other)) = (Graph::new(), Graph::new()) else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut first = graph.peer("first");
    first.tell(&json!(["graph"]));
    let set = graph.set("graphs", directory.path(), &["-r", "__ns:=/r1", "-r", "/tf:=tf"]);
    wait_for("the bridge", || bridges(&set).first().copied());
    let began = std::time::Instant::now();
    let seen = |peer: &mut Peer| peer.tell(&json!(["seen", "/r1/flockslam", "/r1"])).as_f64().unwrap();
    seen(&mut first);
    let found_s = began.elapsed().as_secs_f64();
    println!("found {found_s:.2} s after the start of the bridge");
    assert!(found_s < DISCOVERY_MAX_S);
    let found_s = seen(&mut graph.peer("later"));
    println!("found {found_s:.2} s after the start of a peer");
    assert!(found_s < DISCOVERY_MAX_S);
    let node = |answer: &Value| {
        let nodes = answer["nodes"].as_array()?;
        nodes.iter().any(|name| name == "/r1/flockslam").then(|| answer.clone())
    };
    let seen = first.wait_for("the node", &json!(["graph"]), |answer| {
        let answer = node(answer)?;
        let has = |of: &str, name: &str, kind: &str| answer[of][name] == json!([kind]);
        let all = has("topics", "/r1/map", "nav_msgs/msg/OccupancyGrid")
            && has("topics", "/r1/scan", "sensor_msgs/msg/LaserScan")
            && has("topics", "/r1/tf", "tf2_msgs/msg/TFMessage")
            && has("services", "/r1/slam_toolbox/save_map", "slam_toolbox/srv/SaveMap")
            && has("services", "/r1/flockslam/get_state", "lifecycle_msgs/srv/GetState");
        all.then_some(answer)
    });
    assert!(seen["services"].as_object().unwrap().len() > 15);
    for (topic, expected) in [
        ("/r1/map", ["RELIABLE", "TRANSIENT_LOCAL"]),
        ("/r1/map_metadata", ["RELIABLE", "TRANSIENT_LOCAL"]),
        ("/r1/pose", ["RELIABLE", "VOLATILE"]),
        ("/r1/scan", ["BEST_EFFORT", "VOLATILE"]),
        ("/tf_static", ["RELIABLE", "TRANSIENT_LOCAL"]),
    ] {
        assert_eq!(first.tell(&json!(["qos", "flockslam", topic])), json!([expected]), "{topic}");
    }
    let both_ways = first.tell(&json!(["qos", "flockslam", "/r1/tf"]));
    assert_eq!(both_ways, json!([["RELIABLE", "VOLATILE"], ["RELIABLE", "VOLATILE"]]));
    let bridge = bridges(&set)[0];
    let memory = || memory_mib(bridge);
    let descriptors = || std::fs::read_dir(format!("/proc/{bridge}/fd")).unwrap().count();
    let (before_mib, before) = (memory(), descriptors());
    for round in 0..20 {
        let mut peer = graph.peer("passing");
        let began = std::time::Instant::now();
        let answer = peer.call("std_srvs/SetBool", "/r1/flockslam/pause", json!({ "data": false }));
        assert_eq!(answer["success"], true);
        if round == 0 {
            println!("called {:.2} s after the peer's start", began.elapsed().as_secs_f64());
        }
        peer.kill();
    }
    println!("memory {before_mib:.0} MiB, {:.0} MiB after twenty peers", memory());
    assert!(memory() < before_mib + 10.0, "{before_mib} MiB before, {} MiB after", memory());
    assert!(descriptors() <= before + 2);
    let mut outsider = other.peer("outsider");
    let there = outsider.tell(&json!(["graph"]));
    assert_eq!(there["nodes"], json!(["/outsider"]), "another domain sees nothing of it");
    assert!(node(&first.tell(&json!(["graph"]))).is_some());
    set.command_well(&["down"]);
}
