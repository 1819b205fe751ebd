//! Every stage answers with its metrics, and the supervisor merges them into one page.

mod support;

use flockslam_messages::Stage;
use flockslam_telemetry::names;
use rustix::process::Signal;
use std::collections::BTreeSet;
use support::{RunningSet, free_port, http_get, live_building, wait_for};

fn page_at(port: u16) -> Option<String> {
    let (head, body) = http_get(port, "/metrics")?;
    assert!(head.starts_with("HTTP/1.0 200 ") && head.contains("text/plain"), "{head}");
    Some(body)
}

/// A page is valid when each metric has its HELP and TYPE once, before its series, and no series appears twice.
fn assert_valid(page: &str) {
    let (mut heads, mut series, mut current) = (BTreeSet::new(), BTreeSet::new(), String::new());
    for line in page.lines() {
        if let Some(head) = line.strip_prefix("# ") {
            let name = head.split(' ').nth(1).unwrap();
            assert!(heads.insert((head[..4].to_owned(), name.to_owned())), "twice: {line}");
            name.clone_into(&mut current);
        } else {
            let (name, value) = line.rsplit_once(' ').unwrap();
            assert!(value.parse::<f64>().is_ok() && name.starts_with(&current), "{line}");
            assert!(series.insert(name.to_owned()), "twice: {line}");
        }
    }
    assert!(!series.is_empty() && heads.len() % 2 == 0);
}

#[test]
fn stages_answer_on_their_sockets_and_one_port_has_all_of_them() {
    let directory = tempfile::tempdir().unwrap();
    let (port, mut args) = (free_port(), live_building(250, 10));
    args.extend(["--metrics-port".to_owned(), port.to_string()]);
    let mut set = RunningSet::start("metrics", directory.path(), &args);
    set.wait_until_handled(Stage::SyncManager, 20);
    for stage in Stage::ALL {
        let page = wait_for("a page", || set.metrics(stage));
        assert_valid(&page);
        let label = format!("stage=\"{}\"", stage.name());
        for metric in [names::SCANS_HANDLED, names::HEARTBEAT, names::LAST_SCAN_SEQUENCE, names::DROPPED] {
            let line = page.lines().find(|line| line.starts_with(&format!("{}{{", metric.name)));
            assert!(line.is_some_and(|line| line.contains(&label)), "{} of {}", metric.name, stage.name());
        }
        assert!(page.contains(&format!("{}_bucket{{", names::STAGE_LATENCY.name)));
    }
    let page = wait_for("the merged page", || page_at(port));
    assert_valid(&page);
    for stage in support::stage_names() {
        let label = format!("stage=\"{stage}\"");
        let handled =
            page.lines().filter(|line| line.starts_with(names::SCANS_HANDLED.name) && line.contains(&label));
        assert_eq!(handled.count(), 1, "{stage}");
    }
    for stage in support::stage_names() {
        for line in [
            format!("{}{{stage=\"{stage}\"}} 1", names::STAGE_UP.name),
            format!("{}{{stage=\"{stage}\"}} 0", names::STAGE_RESTARTS.name),
        ] {
            assert!(page.lines().any(|other| other == line), "{line} is expected in\n{page}");
        }
    }
    assert!(page.contains(names::SHARED_MEMORY.name));
    println!("the merged page has {} lines", page.lines().count());
    support::send(set.supervisor_pid(), Signal::INT);
    set.finish();
}
