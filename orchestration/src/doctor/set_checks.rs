//! What is wrong with a set. Takes readings; gives findings.

use super::finding::Finding;
use super::machine_readings::Machine;
use super::set_under_examination::{RunningReading, SetReading};
use crate::supervisor::{SetStatus, StageState};

/// Buffer with which large maps arrive over DDS, bytes.
const RECEIVE_BUFFER_BYTES: u64 = 4 << 20;
/// A lidar whose scans reach the set less often than this share of its turns loses some.
const RATE_SHARE_MIN: f64 = 0.7;
/// The scan-matcher handles all scans in the long run; less than this share is too slow.
const HANDLED_SHARE_MIN: f64 = 0.6;
/// More drops than this share of the scans are worth a word.
const DROPPED_SHARE_MAX: f64 = 0.01;
/// Reasons for drops that say that the machine is too slow.
const TOO_SLOW: [&str; 2] = ["overload", "deadline"];
/// Lines of the log that are shown at most.
const PROBLEMS_MAX: usize = 8;
const ERRORS_PAGE: &str = "docs/errors.md has the message and its cure";

/// All findings on a set.
pub fn check_set(set: &SetReading, machine: &Machine) -> Vec<Finding> {
    let mut found = Vec::new();
    found.extend(set.refused.clone().map(|why| Finding::error("configuration", why, "what the line says")));
    found.extend(shared_memory(set, machine));
    found.extend(ports(set, machine));
    found.extend(transforms(set));
    found.extend(network(set, machine));
    if let Some(map) = &set.lacks_known_map {
        let what = format!("there is no map to localize in at {}", map.display());
        found.push(Finding::error("map", what, "a saved map, the outputs of a run, or a nav2 map.yaml"));
    }
    match &set.running {
        Some(running) => of_running(&set.robot, running, machine, &mut found),
        None => found.push(Finding::info(
            "set",
            format!("{} does not run", set.robot),
            "flockslam up, or systemctl start flockslam@NAME",
        )),
    }
    found
}

fn shared_memory(set: &SetReading, machine: &Machine) -> Option<Finding> {
    let (needed, room) = (set.needs_bytes?, machine.shared_memory?);
    let is_short = set.running.is_none() && room.free_bytes < needed;
    is_short.then(|| {
        let what = format!("{} MB are free, {} needs {} MB", room.free_bytes >> 20, set.robot, needed >> 20);
        Finding::error("shared memory", what, "a larger /dev/shm, or a smaller set.live_tiles")
    })
}

fn ports(set: &SetReading, machine: &Machine) -> Vec<Finding> {
    let mut found: Vec<Finding> = set
        .lacking_ports
        .iter()
        .map(|path| {
            let what = format!("{} is not there", path.display());
            Finding::error("lidar", what, "plug it in; `flockslam lidar list` shows what is")
        })
        .collect();
    let moves = |path: &&std::path::PathBuf| path.to_string_lossy().starts_with("/dev/ttyUSB");
    let on_usb = machine.ports.iter().filter(|port| port.usb.is_some()).count();
    if let Some(path) = set.lidar_ports.iter().find(moves).filter(|_| on_usb > 1) {
        let what = format!("{} may be another port after the next start", path.display());
        found.push(Finding::info("lidar", what, "its name below /dev/serial/by-id"));
    }
    found
}

fn transforms(set: &SetReading) -> Option<Finding> {
    (set.lidars > set.mounted).then(|| {
        let what = format!(
            "where {} of {} lidars sit is not configured: they are taken to be in the middle of the robot, facing ahead",
            set.lidars - set.mounted,
            set.lidars
        );
        Finding::info("transforms", what, "lidar_ingest.lidars; `flockslam lidar calibrate` measures it")
    })
}

fn network(set: &SetReading, machine: &Machine) -> Vec<Finding> {
    let mut found = Vec::new();
    if set.uses_dds
        && let Some(bytes) = machine.receive_buffer_bytes.filter(|bytes| *bytes < RECEIVE_BUFFER_BYTES)
    {
        let what = format!("sockets receive into {} kB: large maps take seconds over DDS", bytes >> 10);
        let cure = format!("sudo sysctl net.core.rmem_default={RECEIVE_BUFFER_BYTES}");
        found.push(Finding::warning("network", what, cure));
    }
    if set.flock && set.flock_endpoints.is_empty() && set.running.is_none() {
        let what = "the flock connects to no address: this robot waits to be found";
        found.push(Finding::info("flock", what, "sync_manager.flock.connect, or multicast"));
    }
    for (endpoint, problem) in &set.flock_endpoints {
        if let Some(problem) = problem {
            let what = format!("{endpoint} does not answer: {problem}");
            let cure =
                "is that robot on, in the same network, and listening? (sync_manager.flock.listen there)";
            found.push(Finding::warning("flock", what, cure));
        }
    }
    if let Some(address) = &set.page_taken {
        let what = format!("another program serves at {address}");
        found.push(Finding::warning("page", what, "page.listen with another port"));
    }
    found
}

fn of_running(robot: &str, running: &RunningReading, machine: &Machine, found: &mut Vec<Finding>) {
    if let Some(version) = running.version.as_ref().filter(|version| **version != machine.version) {
        let what = format!("{robot} was started by flockslam {version}, this is {}", machine.version);
        found.push(Finding::warning("versions", what, "stop it and start it again"));
    }
    let Some(status) = &running.status else {
        let what = format!("the supervisor of {robot} does not answer");
        let cure = format!("flockslam log --robot {robot}; systemctl restart flockslam@{robot}");
        return found.push(Finding::error("set", what, cure));
    };
    of_stages(robot, status, found);
    of_lidars(running, status, found);
    of_map(status, found);
    if let Some(flock) = &status.flock {
        if let Some(problem) = &flock.problem {
            let what = format!("the network is not open: {problem}");
            found.push(Finding::error("flock", what, "sync_manager.flock: addresses and certificates"));
        } else if flock.peers.is_empty() {
            let cure = "the other robots' addresses in sync_manager.flock.connect; certificates";
            found.push(Finding::warning("flock", "no other robot is connected", cure));
        }
    }
    rates(running, found);
    for problem in running.problems.iter().take(PROBLEMS_MAX) {
        let what = format!("{}× {}: {}", problem.times, problem.stage, problem.message);
        found.push(Finding::warning("log", what, ERRORS_PAGE));
    }
}

fn of_stages(robot: &str, status: &SetStatus, found: &mut Vec<Finding>) {
    for stage in &status.stages {
        let cure = format!("flockslam log --robot {robot} says why; --bundle packs it for a report");
        let name = &stage.stage;
        if stage.state == StageState::Degraded {
            found.push(Finding::error("stages", format!("{name} does not get up"), cure));
        } else if stage.restarts + stage.hangs > 0 {
            let what =
                format!("{name} was replaced {} times, {} times since it hung", stage.restarts, stage.hangs);
            found.push(Finding::warning("stages", what, cure));
        }
    }
    if status.paused {
        found.push(Finding::warning("set", "it is paused: no scan is handled", "flockslam resume"));
    }
}

fn of_lidars(running: &RunningReading, status: &SetStatus, found: &mut Vec<Finding>) {
    for lidar in &running.silent {
        let cure = "power and wiring; the driver; `flockslam lidar watch`";
        found.push(Finding::error("lidar", format!("'{lidar}' gives no scans"), cure));
    }
    for line in &status.lidar_lines {
        if let Some(problem) = &line.problem {
            found.push(Finding::error("lidar", problem.clone(), "docs/lidars.md: wiring and permissions"));
        }
    }
}

fn of_map(status: &SetStatus, found: &mut Vec<Finding>) {
    let unsaved = status.saved.as_ref().and_then(|saved| saved.problem.clone());
    if let Some(problem) = unsaved.or(status.not_durable.clone()) {
        found.push(Finding::error("map", format!("it is not saved: {problem}"), "make room on that disk"));
    } else if status.saved.is_none() && status.localisation.is_none() {
        let what = "the map is kept nowhere: it is gone when the set ends";
        found.push(Finding::warning("map", what, "map = \"DIR\" in the description, or up --map DIR"));
    }
    if let Some(unattached) = &status.unattached {
        found.push(Finding::info("map", unattached.to_string(), "drive through places that are in the map"));
    }
    if let Some(belief) = &status.localisation
        && belief.knowledge != "localized"
    {
        let what = format!("where the robot is in the known map is {}", belief.knowledge);
        found.push(Finding::warning("localisation", what, "drive on, or flockslam relocalize --near X,Y,R"));
    }
}

fn rates(running: &RunningReading, found: &mut Vec<Finding>) {
    let mut scans_hz = 0.0;
    for rate in &running.lidar_rates {
        scans_hz += rate.scans_hz;
        if let Some(turns_hz) = rate.turns_hz
            && rate.scans_hz > 0.0
            && rate.scans_hz < RATE_SHARE_MIN * turns_hz
        {
            let what =
                format!("{:.1} scans a second of {:.1} turns of {}", rate.scans_hz, turns_hz, rate.lidar);
            found.push(Finding::warning("rates", what, "docs/lidars.md: turns that are left out"));
        }
    }
    if scans_hz > 0.0 && running.handled_hz < HANDLED_SHARE_MIN * scans_hz {
        let what = format!("{:.1} poses a second of {scans_hz:.1} scans", running.handled_hz);
        let cure = "a faster governor, less else on the machine, correlation_filter.mode=correlation";
        found.push(Finding::warning("rates", what, cure));
    }
    let handled = running
        .status
        .as_ref()
        .map_or(0, |status| status.stages.iter().map(|stage| stage.handled).max().unwrap_or(0));
    for reason in TOO_SLOW {
        let dropped = running.dropped.get(reason).copied().unwrap_or(0.0);
        if dropped > DROPPED_SHARE_MAX * handled as f64 && dropped >= 1.0 {
            let what = format!("{dropped:.0} scans were dropped as `{reason}` since the start");
            let cure = "less else on the machine, a faster governor, fewer beams";
            found.push(Finding::warning("rates", what, cure));
        }
    }
}

#[cfg(test)]
#[path = "set_checks_tests.rs"]
mod tests;
