//! The state of a set as its supervisor tells it, and the events that follow from two successive states.

use flockslam_messages::Stage;
use flockslam_results::Unattached;
use serde::{Deserialize, Serialize};

/// How a set is, as its supervisor tells it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Health {
    /// The supervisor's process.
    pub pid: u32,
    /// `running`, or `degraded` while a stage does not get up.
    pub state: String,
    /// Whether the set rests.
    pub paused: bool,
    /// What it does with its map.
    pub mode: ModeHealth,
    /// Its belief about its pose in the known map, when it localizes.
    pub localisation: Option<LocalisationHealth>,
    /// Seconds since the supervisor began.
    pub uptime_s: f64,
    /// How the map is saved, when it is.
    pub saved: Option<serde_json::Value>,
    /// All processes.
    pub stages: Vec<StageHealth>,
    /// What nothing connects with the map; `None` when all scans are in it.
    pub unattached: Option<Unattached>,
    /// The robot's flock, when it is part of one.
    pub flock: Option<FlockHealth>,
}

/// What a set does with its map, as its supervisor tells it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ModeHealth {
    /// `map` or `localize`.
    pub name: String,
    /// It is being changed.
    pub changing: bool,
    /// Why the last change was not possible.
    pub problem: Option<String>,
}

/// The belief about the robot's pose in a known map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LocalisationHealth {
    /// `unknown`, `ambiguous` or `localized`.
    pub knowledge: String,
}

/// How it is with the flock, as the robot's sync-manager tells it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FlockHealth {
    /// Name of the flock.
    pub flock: String,
    /// Name of this robot in it.
    pub robot: String,
    /// Why the network is not open; `None` when it is.
    pub problem: Option<String>,
    /// Addresses of robots that are connected: name, `-`, digits of the key.
    pub peers: Vec<String>,
    /// Of those, robots that are near.
    pub near: Vec<String>,
    /// Names of all robots of which something is known, this one among them.
    pub robots: Vec<String>,
    /// Records that are known, and their bytes.
    pub records: (u64, u64),
    /// Names of the robots that are part of the common map.
    pub members: Vec<String>,
    /// Whether this robot is one of at least two of them.
    pub merged: bool,
    /// Bytes of messages received and sent.
    pub received_bytes: u64,
    /// Bytes of messages said.
    pub said_bytes: u64,
}

/// How one process of a set is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StageHealth {
    /// Which stage.
    pub stage: String,
    /// Which replica of it.
    pub replica: u32,
    /// The process, while there is one.
    pub pid: Option<u32>,
    /// `starting`, `running`, `down` or `degraded`.
    pub state: String,
    /// How often it was started again.
    pub restarts: u64,
    /// How often it was replaced because it hung.
    pub hangs: u64,
    /// Scans that the present process has handled.
    pub handled: u64,
    /// Seconds since its last sign of life.
    pub silent_s: Option<f64>,
}

/// What an event on the time line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A stage has a new process.
    Restart,
    /// A stage was replaced because it hung.
    Hang,
    /// A stage does not get up.
    GivenUp,
    /// What was driven is not in the map.
    Unattached,
    /// All that was driven is in the map again.
    Attached,
    /// A loop was closed.
    Closure,
    /// Something was done by the page's order.
    Order,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// When, milliseconds since the page began.
    pub at_ms: u64,
    /// What it is.
    pub kind: EventKind,
    /// The stage that it happened to, when it did to one.
    pub stage: Option<String>,
    /// For people.
    pub text: String,
}

/// What has happened to the stages between two looks.
pub fn events_between(before: &Health, after: &Health, at_ms: u64) -> Vec<Event> {
    let mut events: Vec<Event> = attachment(before, after, at_ms).into_iter().collect();
    for stage in &after.stages {
        let is_same = |other: &&StageHealth| other.stage == stage.stage && other.replica == stage.replica;
        let Some(old) = before.stages.iter().find(is_same) else { continue };
        let mut report = |kind, text: String| {
            events.push(Event { at_ms, kind, stage: Some(stage.stage.clone()), text });
        };
        let name = if stage.replica > 0 {
            format!("{} {}", stage.stage, stage.replica)
        } else {
            stage.stage.clone()
        };
        if stage.hangs > old.hangs {
            report(EventKind::Hang, format!("{name} gave no sign of life and was replaced"));
        } else if stage.restarts > old.restarts {
            let pid = stage.pid.map_or(String::new(), |pid| format!(", now process {pid}"));
            report(EventKind::Restart, format!("{name} died and was started again{pid}"));
        }
        if stage.state == "degraded" && old.state != "degraded" {
            report(EventKind::GivenUp, format!("{name} does not get up; the set goes on without it"));
        }
    }
    events
}

/// Whether what was driven has come apart from the map, or is all in it again.
fn attachment(before: &Health, after: &Health, at_ms: u64) -> Option<Event> {
    let is_known = !before.stages.is_empty() && !after.stages.is_empty();
    let (kind, text) = match (&before.unattached, &after.unattached) {
        (None, Some(unattached)) => (EventKind::Unattached, unattached.to_string()),
        (Some(_), None) => (EventKind::Attached, "all scans are in the map again".to_owned()),
        _ => return None,
    };
    let stage = Some(Stage::SyncManager.name().to_owned());
    is_known.then_some(Event { at_ms, kind, stage, text })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn health(restarts: u64, hangs: u64, state: &str) -> Health {
        let stage = StageHealth {
            stage: "mapper".to_owned(),
            pid: Some(7),
            state: state.to_owned(),
            restarts,
            hangs,
            ..StageHealth::default()
        };
        Health { stages: vec![stage], ..Health::default() }
    }

    #[test]
    fn deaths_hangs_and_giving_up_are_reported_once() {
        let kinds = |before: &Health, after: &Health| -> Vec<EventKind> {
            events_between(before, after, 5).into_iter().map(|event| event.kind).collect()
        };
        let calm = health(0, 0, "running");
        assert_eq!(kinds(&calm, &calm), []);
        assert_eq!(kinds(&calm, &health(1, 0, "running")), [EventKind::Restart]);
        assert_eq!(kinds(&calm, &health(1, 1, "starting")), [EventKind::Hang]);
        let lost = health(5, 0, "degraded");
        assert_eq!(kinds(&calm, &lost), [EventKind::Restart, EventKind::GivenUp]);
        assert_eq!(kinds(&lost, &lost), []);
        assert_eq!(kinds(&Health::default(), &lost), [], "a first look has nothing to compare with");
        let apart = Health { unattached: Some(Unattached::default()), ..calm.clone() };
        assert_eq!(kinds(&calm, &apart), [EventKind::Unattached]);
        assert_eq!(kinds(&apart, &calm), [EventKind::Attached]);
        assert_eq!((kinds(&apart, &apart), kinds(&Health::default(), &apart)), (vec![], vec![]));
    }
}
