//! What is deployed: the systemd unit is well formed, and the example sets can be read and do not clash.

use crate::support;
use crate::support::{not_tested, repository};
use flockslam::supervisor::SetDescription;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

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
    let one = sets("one-robot");
    assert_eq!(one.len(), 1);
    one[0].configuration(&[]).unwrap();
    let three = sets("three-robots");
    assert_eq!(three.len(), 3);
    for (i, set) in three.iter().enumerate() {
        set.configuration(&[]).unwrap();
        for other in &three[i + 1..] {
            assert_ne!(set.robot, other.robot);
            assert_ne!(set.map, other.map);
            assert_ne!(set.metrics_port, other.metrics_port);
            let page = |set: &SetDescription| set.configuration(&[]).unwrap().page.listen;
            assert_ne!(page(set), page(other));
        }
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
            let text = support::stderr(&output);
            assert!(output.status.success() && !text.contains("flockslam@"), "{text}");
        }
        Err(_) => not_tested("the systemd unit", "there is no systemd-analyze"),
    }
}
