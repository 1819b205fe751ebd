//! The time of a ROS 2 graph that goes back: a simulation was restarted, or a recording is played again.

use crate::support::ros_peers::{Graph, Peer};
use crate::support::ros_rows::{AHEAD_NS, Row, assert_composed, rows};
use crate::support::{machine_share, simulated_drive, wait_for};
use flockslam::evaluation::evaluate_truth;
use flockslam::outputs::TrajectoryPoint;
use serde_json::{Value, json};

/// Scans of a round that are not taken: the first is too early for those who listen, or shows that time has gone back.
const FIRST_SCANS: usize = 2;

/// What was noted up to where stamps go back, and from there on.
fn rounds(rows: &[Row]) -> (&[Row], &[Row]) {
    let back = rows.windows(2).position(|pair| pair[1].0 < pair[0].0);
    rows.split_at(back.expect("stamps go back") + 1)
}

/// Lines of the log of all processes, as the graph has them, that contain this.
fn lines_with(peer: &mut Peer, part: &str) -> Vec<String> {
    let heard = peer.tell(&json!(["heard", "/rosout", 200]));
    let text =
        |line: &Value| format!("{}: {}", line["name"].as_str().unwrap(), line["msg"].as_str().unwrap());
    heard["last"].as_array().unwrap().iter().map(text).filter(|line| line.contains(part)).collect()
}

#[test]
fn when_the_clock_goes_back_a_new_trajectory_begins_and_the_map_stays_connected_with_odometry() {
    machine_share::alone();
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut set = graph.set("again", directory.path(), &["-p", "use_sim_time:=true"]);
    set.wait_until("the set", |_| true);
    let mut peer = graph.peer("user");
    for (kind, name) in [
        ("diagnostic_msgs/DiagnosticArray", "/flockslam/quality"),
        ("diagnostic_msgs/DiagnosticArray", "/diagnostics"),
        ("rcl_interfaces/Log", "/rosout"),
    ] {
        assert_eq!(peer.tell(&json!(["listen", kind, name])), true);
    }
    let (log, truth) = simulated_drive(directory.path(), 40.0);
    let noted = graph.play_again(&log, 4.0, 2);
    let (sent, poses, corrections) =
        (rows(&noted, "sent"), rows(&noted, "poses"), rows(&noted, "corrections"));
    for (round, sent, poses, corrections) in [
        (0, rounds(&sent).0, rounds(&poses).0, rounds(&corrections).0),
        (1, rounds(&sent).1, rounds(&poses).1, rounds(&corrections).1),
    ] {
        assert!(poses.len() + FIRST_SCANS >= sent.len(), "{round}: {} poses of {}", poses.len(), sent.len());
        assert!(corrections.is_sorted_by(|a, b| a.0 < b.0), "no stamp comes twice");
        // Where the answer to the last scan is late, time has gone back before its correction is sent.
        for pose in &poses[..poses.len() - 1] {
            let scan = sent.iter().find(|scan| scan.0 == pose.0).unwrap();
            assert_composed(scan, pose.1, corrections);
        }
        let newest_ns = corrections.last().unwrap().0;
        assert!(newest_ns < sent.last().unwrap().0 + 10 * AHEAD_NS, "stamps are those of the log");
        let points: Vec<_> =
            poses.iter().map(|row| TrajectoryPoint { stamp_ns: row.0, map_from_base: row.1 }).collect();
        let errors = evaluate_truth(&points, &truth).unwrap().absolute.translation_m.unwrap();
        println!("{round}: {} poses of {} scans, {errors:?}", poses.len(), sent.len());
    }
    let (first, again) = (rounds(&poses).0, rounds(&poses).1);
    let same = |row: &Row| first.iter().find(|other| other.0 == row.0).map(|other| other.1.distance_m(row.1));
    let apart_m: Vec<_> = again.iter().filter_map(same).collect();
    println!(
        "a place in both rounds: {:.3} m apart at first, {:.3} m at last",
        apart_m[0],
        apart_m[apart_m.len() - 1]
    );
    let figure = |heard: &Value, name: &str| {
        let statuses = heard["last"].as_array()?.iter().flat_map(|last| last["status"].as_array().unwrap());
        let mut values = statuses.flat_map(|status| status["values"].as_array().unwrap());
        let found = values.rfind(|value| value["key"] == name)?;
        Some(found["value"].as_str()?.to_owned())
    };
    let quality = peer.tell(&json!(["heard", "/flockslam/quality"]));
    assert_eq!(figure(&quality, "trajectory").as_deref(), Some("1"));
    let is_counted = |heard: &Value| figure(heard, "times gone back").filter(|count| count == "1");
    peer.wait_for("the count", &json!(["heard", "/diagnostics"]), is_counted);
    wait_for("the lines", || (lines_with(&mut peer, "gone back").len() >= 2).then_some(()));
    let mut lines = lines_with(&mut peer, "gone back");
    lines.sort();
    assert!(
        lines.len() == 2 && lines[0].starts_with("flockslam.lidar-ingest: "),
        "one line each: {lines:#?}"
    );
    assert!(
        lines[1].contains("the time of /clock has gone back by") && lines[1].starts_with("flockslam.ros: ")
    );
    set.command_well(&["down"]);
}
