//! The filter as a stage of a set: replicas that share large scans, rest, and load that is shed.

use crate::support;
use crate::support::machine_share;
use crate::support::{Outputs, RunningSet, building, live_building, run_well, wait_for};
use flockslam_messages::Stage;
use flockslam_stage::metrics_socket;
use flockslam_telemetry::scrape;
use rustix::process::Signal;
use std::fmt::Write;
use std::time::Duration;

fn set(key_and_value: &str) -> [String; 2] {
    ["--set".to_owned(), key_and_value.to_owned()]
}

/// A short drive with scans of so many beams that replicas share them.
fn large_scans(replicas: usize) -> Vec<String> {
    let mut args = building(10);
    args.extend(set("simulation.beams=90000"));
    args.extend(set(&format!("correlation_filter.replicas={replicas}")));
    args
}

#[test]
fn two_replicas_share_large_scans_and_come_to_the_same_verdicts() {
    let directory = tempfile::tempdir().unwrap();
    let alone = run_well("alone", &directory.path().join("alone"), &large_scans(1));
    let running = RunningSet::start("two", &directory.path().join("two"), &large_scans(2));
    let second = metrics_socket(&running.status_dir(), "correlation-filter-1");
    wait_for("a part described by the second replica", || {
        let page = scrape(&second, Duration::from_millis(500)).ok()?;
        let line = page.lines().find(|line| line.starts_with("flockslam_scans_handled_total{"))?;
        line.rsplit(' ').next()?.parse::<u64>().ok().filter(|handled| *handled > 0)
    });
    let two = running.finish();
    println!("{:?} {:?}", two.report.dropped, two.report.kept_by_reason);
    assert_eq!(two.report.stages[Stage::CorrelationFilter.name()].pids.len(), 2);
    assert_eq!((two.report.scans, alone.report.scans), (100, 100));
    for name in ["trajectory.tum", "trajectory_online.tum"] {
        assert!(two.bytes(name) == alone.bytes(name), "{name} differs");
    }
    assert_eq!(two.report.map_hash, alone.report.map_hash);
    assert_eq!(two.report.dropped, alone.report.dropped);
    assert_eq!(two.report.kept_by_reason, alone.report.kept_by_reason);
}

fn dropped(outputs: &Outputs, reason: &str) -> u64 {
    outputs.report.dropped.get(reason).copied().unwrap_or(0)
}

#[test]
fn every_scan_is_accounted_for_by_a_reason() {
    for mode in ["correlation", "seed-exact", "motion", "off"] {
        let directory = tempfile::tempdir().unwrap();
        let mut args = building(60);
        args.extend(set(&format!("correlation_filter.mode={mode}")));
        let report = run_well("reasons", directory.path(), &args).report;
        let dropped: u64 = report.dropped.values().sum();
        let kept: u64 = report.kept_by_reason.values().sum();
        println!(
            "{mode}: {:?} {:?}, {} overridden",
            report.dropped_share, report.kept_by_reason, report.overridden
        );
        assert_eq!((report.scans, dropped + report.kept), (600, 600));
        assert_eq!(kept + report.overridden, report.kept);
        assert_eq!(dropped > 0, mode != "off");
    }
}

#[test]
fn of_a_robot_that_stands_still_nineteen_of_twenty_scans_are_dropped() {
    let directory = tempfile::tempdir().unwrap();
    let log = directory.path().join("still.clf");
    std::fs::write(&log, standing_still(1000)).unwrap();
    let args = ["map".to_owned(), log.display().to_string()];
    let outputs = run_well("still", &directory.path().join("out"), &args);
    println!("{:?}", outputs.report.dropped_share);
    assert_eq!(outputs.report.scans, 1000);
    assert!(dropped(&outputs, "unchanged") as f64 > 0.95 * outputs.report.scans as f64);
}

/// A robot in the middle of a room of 8 m × 5 m that sees it with 2 cm of noise.
fn standing_still(scans: u32) -> String {
    let mut noise = 7_u32;
    let mut log = String::new();
    for scan in 0..scans {
        log += "FLASER 180";
        for beam in 0..180 {
            let (sin, cos) = (f64::from(beam - 90).to_radians()).sin_cos();
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let error_m = (f64::from(noise >> 16) / 65536.0 - 0.5) * 0.04;
            write!(log, " {:.3}", (4.0 / cos.abs()).min(2.5 / sin.abs()) + error_m).unwrap();
        }
        writeln!(log, " 0 0 0 0 0 0 {0:.6} robot {0:.6}", 100.0 + 0.1 * f64::from(scan)).unwrap();
    }
    log
}

#[test]
fn a_stopped_matcher_makes_the_filter_shed_load_until_it_is_back() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut running = RunningSet::start("late", directory.path(), &live_building(120, 4));
    running.wait_until_handled(Stage::ScanMatcher, 50);
    let matcher = running.pid(Stage::ScanMatcher);
    support::send(matcher, Signal::STOP);
    let shed = || {
        let page = running.metrics(Stage::CorrelationFilter)?;
        let line = page.lines().find(|line| {
            line.starts_with("flockslam_dropped_total{") && line.contains("reason=\"overload\"")
        })?;
        line.rsplit(' ').next()?.parse::<u64>().ok().filter(|count| *count > 0)
    };
    wait_for("shed load", shed);
    support::send(matcher, Signal::CONT);
    wait_for("twenty scans of which none is shed", || {
        let handled = || running.handled(Stage::CorrelationFilter);
        let (count, from) = (shed()?, handled()?);
        wait_for("more scans", || handled().filter(|now| *now >= from + 20));
        (shed()? == count).then_some(())
    });
    let outputs = running.finish();
    println!("{:?} {:?}", outputs.report.dropped, outputs.report.kept_by_reason);
    assert!(dropped(&outputs, "overload") > 0);
    assert!(outputs.report.kept > 0 && dropped(&outputs, "correlated") > 0);
}
