//! What is deployed: the systemd unit is well formed, the example sets can be read and do not clash, and the service manager is notified.

use crate::support;
use crate::support::{Drive, LiveSet, machine_share, not_tested, repository};
use flockslam::supervisor::SetDescription;
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

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

#[test]
fn the_service_manager_is_notified_of_ready_alive_and_stopping() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let address = directory.path().join("notify");
    let manager = UnixDatagram::bind(&address).unwrap();
    manager.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut command = support::flockslam();
    command.env("NOTIFY_SOCKET", &address).env("WATCHDOG_USEC", "200000");
    let drive = Drive { scan_rate_hz: 5.0, duration_s: 600.0, rate: 1.0 };
    let mut set = LiveSet::start_by(command, "notified", directory.path(), drive, "");
    let next = || {
        let mut bytes = [0; 64];
        let length = manager.recv(&mut bytes).expect("the supervisor notifies");
        String::from_utf8_lossy(&bytes[..length]).trim().to_owned()
    };
    assert_eq!([next(), next(), next()], ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]);
    set.command_well(&["down"]);
    let last = std::iter::repeat_with(next).find(|state| state != "WATCHDOG=1");
    assert_eq!(last.as_deref(), Some("STOPPING=1"));
    assert_eq!(set.wait(), Some(0));
}
