//! What is deployed: the systemd unit is well formed, and the example sets can be read and do not clash.

mod support;

use flockslam::supervisor::SetDescription;
use flockslam_telemetry::names;
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use support::repository;

fn deploy_dir() -> PathBuf {
    repository().join("orchestration/deploy")
}

fn sets(prefix: &str) -> Vec<SetDescription> {
    let mut paths: Vec<_> = fs::read_dir(deploy_dir())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(prefix))
        .collect();
    paths.sort();
    paths.iter().map(|path| SetDescription::read(path).unwrap()).collect()
}

#[test]
fn the_example_sets_can_be_read_and_three_on_one_machine_do_not_clash() {
    assert_eq!(sets("one-robot").len(), 1);
    let three = sets("three-robots");
    assert_eq!(three.len(), 3);
    for (i, set) in three.iter().enumerate() {
        set.configuration(&[]).unwrap();
        for other in &three[i + 1..] {
            assert_ne!(set.robot, other.robot);
            assert_ne!(set.map, other.map);
            assert_ne!(set.metrics_port, other.metrics_port);
        }
    }
}

#[test]
fn alerts_are_about_metrics_that_exist() {
    let rules = fs::read_to_string(repository().join("dashboards/alerts.yml")).unwrap();
    let is_part = |c: char| c.is_ascii_lowercase() || c == '_';
    let named: Vec<_> = rules.split(|c| !is_part(c)).filter(|word| word.starts_with(names::PREFIX)).collect();
    assert!(named.len() >= 3, "{named:?}");
    for name in named {
        assert!(names::ALL.iter().any(|metric| metric.name == name), "{name} is no metric");
    }
}

#[test]
fn systemd_accepts_the_unit() {
    let unit = fs::read_to_string(deploy_dir().join("flockslam@.service")).unwrap();
    for needed in ["Type=notify", "WatchdogSec=", "Restart=always", "RuntimeDirectory=", "MemoryMax="] {
        assert!(unit.contains(needed), "{needed} is missing");
    }
    let directory = tempfile::tempdir().unwrap();
    let instance = directory.path().join("flockslam@r1.service");
    // It looks for the executable, which is not installed here.
    fs::write(&instance, unit.replace("/usr/bin/flockslam", env!("CARGO_BIN_EXE_flockslam"))).unwrap();
    match Command::new("systemd-analyze").arg("verify").arg(&instance).output() {
        Ok(output) => {
            let told = support::stderr(&output);
            assert!(output.status.success() && !told.contains("flockslam@"), "{told}");
        }
        Err(_) => println!("NOT TESTED: there is no systemd-analyze here"),
    }
}
