//! Every stage answers with its metrics, and the supervisor merges them into one page.

use crate::support;
use crate::support::machine_share;
use crate::support::{Drive, LiveSet, RunningSet, free_port, http_get, live_building, wait_for};
use flockslam_messages::Stage;
use flockslam_telemetry::names;
use rustix::process::Signal;
use std::collections::BTreeSet;

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
    assert!(!series.is_empty());
    for (kind, name) in &heads {
        let other = if kind == "HELP" { "TYPE" } else { "HELP" };
        assert!(heads.contains(&(other.to_owned(), name.clone())), "{name} has no {other}");
    }
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
            format!("{}{{reason=\"died\",stage=\"{stage}\"}} 0", names::STAGE_RESTARTS.name),
        ] {
            assert!(page.lines().any(|other| other == line), "{line} is expected in\n{page}");
        }
    }
    // Those of lidars on lines of their own are in `lidar_lines.rs`.
    for metric in names::ALL.into_iter().filter(|metric| !names::OF_LIDAR_LINES.contains(metric)) {
        let head = format!("# TYPE {} {}", metric.name, metric.kind.name());
        let page = wait_for(&head, || page_at(port).filter(|page| page.lines().any(|line| line == head)));
        let plain = format!("{}{{", metric.name);
        let bucket = format!("{}_bucket{{", metric.name);
        let series = page.lines().find(|line| line.starts_with(&plain) || line.starts_with(&bucket));
        for label in metric.labels {
            let series = series.unwrap_or_else(|| panic!("{} has no labels", metric.name));
            assert!(series.contains(&format!("{label}=\"")), "{series}");
        }
    }
    println!("the merged page has {} lines", page.lines().count());
    support::send(set.supervisor_pid(), Signal::INT);
    set.finish();
}

fn value(page: &str, series: &str) -> Option<f64> {
    let line = page.lines().find(|line| line.starts_with(series))?;
    line.rsplit_once(' ')?.1.parse().ok()
}

#[test]
fn counters_go_on_when_a_stage_is_replaced_and_the_reason_is_shown() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let (port, drive) = (free_port(), Drive { scan_rate_hz: 10.0, duration_s: 2000.0, rate: 5.0 });
    let more = format!("metrics_port = {port}");
    let mut set = LiveSet::start("counters", directory.path(), drive, &more);
    set.wait_until_handled(Stage::ScanMatcher, 100);
    let handled = format!("{}{{replica=\"0\",stage=\"scan-matcher\"}}", names::SCANS_HANDLED.name);
    let bucket =
        format!("{}_bucket{{replica=\"0\",stage=\"scan-matcher\",le=\"1\"}}", names::STAGE_LATENCY.name);
    let count = || {
        let page = page_at(port)?;
        assert_valid(&page);
        Some((value(&page, &handled)?, value(&page, &bucket)?))
    };
    let before = wait_for("counts", count);
    assert!(before.0 >= 100.0 && before.1 > 0.0, "{before:?}");
    let killed = set.pid(Stage::ScanMatcher);
    support::send(killed, Signal::KILL);
    let mut last = before;
    wait_for("the counts of its successor", || {
        let now = count()?;
        assert!(now.0 >= last.0 && now.1 >= last.1, "{last:?} -> {now:?}");
        last = now;
        let replaced = set.status()?.stages.iter().any(|s| s.stage == "scan-matcher" && s.handled > 20);
        (replaced && set.pid(Stage::ScanMatcher) != killed && now.0 > before.0 + 20.0).then_some(())
    });
    set.command_well(&["restart", "mapper"]);
    for (stage, reason) in [("scan-matcher", "died"), ("mapper", "ordered")] {
        let series = format!("{}{{reason=\"{reason}\",stage=\"{stage}\"}}", names::STAGE_RESTARTS.name);
        wait_for(&series, || page_at(port).filter(|page| value(page, &series) == Some(1.0)));
    }
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
