//! A set as a node of a graph of rmw_zenoh, against a robot made of the library of zenoh and the messages of ROS, and against the hashes
//! that the packages of ROS have.

use crate::support::ros_peers::{Graph, packages_of_ros};
use crate::support::ros_rows::{AHEAD_NS, REPEATED_MAX_NS, assert_composed, rows};
use crate::support::{flockslam, free_port, machine_share, simulated_drive, stderr};
use flockslam_ros::interface_names;
use serde_json::Value;

/// Types that packages of the public index have.
const PUBLISHED_MIN: usize = 40;

fn variables(port: u16) -> [(&'static str, String); 2] {
    let keys = format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"];listen/endpoints=[\"tcp/127.0.0.1:0\"]");
    [("RMW_IMPLEMENTATION", "rmw_zenoh_cpp".to_owned()), ("ZENOH_CONFIG_OVERRIDE", keys)]
}

#[test]
fn a_robot_in_a_graph_of_rmw_zenoh_is_served() {
    machine_share::alone();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let (log, _) = simulated_drive(directory.path(), 24.0);
    let port = free_port();
    let robot = graph.zenoh_robot(port, &log, 2.0);
    let variables = variables(port);
    let variables = variables.each_ref().map(|(name, value)| (*name, value.as_str()));
    let arguments = ["-p", "map_update_interval:=1.0"];
    let set = graph.set_with("zenoh", directory.path(), &arguments, &variables);
    let noted = robot.noted();

    let (sent, poses, corrections) =
        (rows(&noted, "sent"), rows(&noted, "poses"), rows(&noted, "corrections"));
    assert_eq!(poses.len(), sent.len(), "no scan is lost");
    assert!(corrections.is_sorted_by(|a, b| a.0 < b.0), "no stamp comes twice");
    // In one run of twenty no correction had come to the robot for the first scan; why is not known. All later scans must have theirs.
    let first_ns = corrections.first().expect("corrections come").0;
    let unreached = sent.iter().take_while(|scan| scan.0 + AHEAD_NS + REPEATED_MAX_NS <= first_ns).count();
    println!("{unreached} first scans without a correction");
    assert!(unreached < 20, "{unreached} first scans without a correction");
    let mut delays_ms: Vec<f64> = sent
        .iter()
        .zip(&poses)
        .skip(unreached)
        .map(|(scan, pose)| {
            assert_eq!(scan.0, pose.0);
            (assert_composed(scan, pose.1, &corrections) - scan.2) as f64 * 1e-6
        })
        .collect();
    delays_ms.sort_by(f64::total_cmp);
    println!(
        "scan to /tf at the robot: median {:.1} ms of {}",
        delays_ms[delays_ms.len() / 2],
        delays_ms.len()
    );

    // Somebody who comes late gets the map at once, and the same by a call: no answer is too long.
    let number = |of: &str, index: usize| noted[of][index].as_u64().unwrap();
    assert!(number("map", 0) % 128 == 0 && number("map", 2) > 300, "{}", noted["map"]);
    assert!(
        number("whole", 0) * number("whole", 1) > 128 * 128 && number("whole", 2) > 300,
        "{}",
        noted["whole"]
    );
    assert_eq!(noted["state"], serde_json::json!(["active", true]));
    assert_eq!(noted["parameters"], serde_json::json!(["odom", 0.05]));
    assert_announced(&noted);
    assert_beside(&noted);
    set.command_well(&["down"]);
}

/// What the node announces, by types whose hashes are those of their packages.
fn assert_announced(noted: &Value) {
    let hashes = noted["hashes"].as_array().unwrap();
    let published: Vec<_> = hashes.iter().filter(|row| !row[2].is_null()).collect();
    assert!(published.len() > 20, "{hashes:?}");
    for row in published {
        assert_eq!(row[1], row[2], "{}", row[0]);
    }
    let tokens: Vec<_> =
        noted["tokens"].as_array().unwrap().iter().map(|token| token.as_str().unwrap()).collect();
    let hash = |name: &str| flockslam_ros::type_hash(name).unwrap();
    let grid = format!("nav_msgs::msg::dds_::OccupancyGrid_/{}", hash("nav_msgs/msg/OccupancyGrid"));
    let scan = format!("sensor_msgs::msg::dds_::LaserScan_/{}", hash("sensor_msgs/msg/LaserScan"));
    let state = format!("lifecycle_msgs::srv::dds_::GetState_/{}", hash("lifecycle_msgs/srv/GetState"));
    for expected in [
        "NN/%/%/flockslam".to_owned(),
        format!("MP/%/%/flockslam/%map/{grid}/:1:,1:,:,:,,"),
        format!("MS/%/%/flockslam/%scan/{scan}/2::,10:,:,:,,"),
        format!("SS/%/%/flockslam/%flockslam%get_state/{state}/::,10:,:,:,,"),
    ] {
        assert!(tokens.contains(&expected.as_str()), "{expected} is not among {tokens:#?}");
    }
}

/// What stands beside messages: numbers in a row from 1, a time that goes on, and one sender for each topic.
fn assert_beside(noted: &Value) {
    for topic in ["tf", "pose"] {
        let rows = noted["beside"].as_array().unwrap().iter().filter(|row| row[0] == topic);
        let rows: Vec<&str> = rows.map(|row| row[1].as_str().unwrap()).collect();
        assert!(rows.len() > 100 && rows.iter().all(|row| row.len() == 66), "{topic}: {} rows", rows.len());
        let number = |text: &str| u64::from_str_radix(text, 16).unwrap().swap_bytes();
        let first = number(&rows[0][..16]);
        assert!(rows.iter().enumerate().all(|(index, row)| number(&row[..16]) == first + index as u64));
        assert!(rows.is_sorted_by_key(|row| number(&row[16..32])));
        assert!(rows.iter().all(|row| row[32..] == rows[0][32..] && row[32..34] == *"10"));
    }
}

#[test]
fn hashes_of_types_are_those_of_their_packages() {
    let Some(packages) = packages_of_ros() else { return };
    let mut compared = 0;
    for name in interface_names() {
        let Ok(json) = std::fs::read(packages.join(format!("{name}.json"))) else { continue };
        let json: Value = serde_json::from_slice(&json).unwrap();
        let published = json["type_hashes"][0]["hash_string"].as_str().unwrap();
        assert_eq!(flockslam_ros::type_hash(name).as_deref(), Some(published), "{name}");
        compared += 1;
    }
    assert!(compared >= PUBLISHED_MIN, "{compared} compared");
}

#[test]
fn what_zenoh_does_not_know_is_one_line() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let description = "robot = \"never\"\n[source]\nkind = \"scans\"\n[ros]\n";
    std::fs::write(directory.path().join("set.toml"), description).unwrap();
    let mut command = flockslam();
    command.args(["up", "set.toml"]).current_dir(directory.path());
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env("ZENOH_CONFIG_OVERRIDE", "conect/endpoints=[]");
    let output = command.output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("ZENOH_CONFIG_OVERRIDE=conect/endpoints=[]: ") && said.trim().lines().count() == 1,
        "{said}"
    );
}
