//! How the lidars of a set are: a file in its status directory, and metrics.

use super::lidar_line::LidarSpec;
use super::lidar_session::{LidarSession, LidarState};
use flockslam_lidars::Counts;
use flockslam_telemetry::{CountersByLabels, GaugesByLabels, StageMetrics, names};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

/// The file in the status directory of the set.
const FILE: &str = "lidar-lines.json";

/// How a lidar is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LidarLineStatus {
    /// Its name on the robot.
    pub name: String,
    /// Its family.
    pub kind: String,
    /// Its port or address.
    pub at: String,
    /// In one word.
    pub state: String,
    /// What is the matter, where something is.
    pub problem: Option<String>,
    /// Its model, as it reports.
    pub model: Option<String>,
    /// Its firmware, as it reports.
    pub firmware: Option<String>,
    /// Its serial number, as it reports.
    pub serial_number: Option<String>,
    /// Its health, as it reports.
    pub health: Option<String>,
    /// The rate of its line, bits a second.
    pub baud: Option<u32>,
    /// Turns a second of its last turn.
    pub speed_hz: f64,
    /// Beams of its last turn.
    pub beams: usize,
    /// How often it came back.
    pub returns: u64,
    /// What its decoder met.
    pub counts: BTreeMap<String, u64>,
}

impl LidarLineStatus {
    /// Of a lidar, as it is now.
    pub fn of(session: &LidarSession) -> Self {
        let (device, (speed_hz, beams)) = (session.device(), session.last_turn());
        let state = session.current();
        let fine = matches!(state, LidarState::Measuring | LidarState::Starting);
        let counts = session.counts();
        let named = counts.named().into_iter().map(|(name, count)| (name.to_owned(), count));
        Self {
            name: session.spec().name.clone(),
            kind: session.spec().family.name().to_owned(),
            at: session.spec().place.to_string(),
            state: state.name().to_owned(),
            problem: (!fine).then(|| state.to_string()),
            model: device.model.clone(),
            firmware: device.firmware.clone(),
            serial_number: device.serial_number.clone(),
            health: device.health.map(|health| health.to_string()),
            baud: session.rate(),
            speed_hz,
            beams,
            returns: session.returns(),
            counts: named.collect(),
        }
    }
}

impl fmt::Display for LidarLineStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.name.is_empty() { String::new() } else { format!(" '{}'", self.name) };
        let state = self.problem.as_ref().map_or_else(|| self.state.clone(), |problem| problem.clone());
        write!(f, "lidar{name} ({} at {}): {state}", self.kind, self.at)?;
        if self.state == "measuring" {
            write!(f, ", {:.1} Hz, {} beams", self.speed_hz, self.beams)?;
        }
        let parts = [
            ("", &self.model),
            ("firmware ", &self.firmware),
            ("serial number ", &self.serial_number),
            ("health ", &self.health),
        ];
        for (what, value) in parts {
            if let Some(value) = value {
                write!(f, ", {what}{value}")?;
            }
        }
        if self.returns > 0 { write!(f, ", came back {} times", self.returns) } else { Ok(()) }
    }
}

/// How the lidars of a set are; empty where it has none on lines of its own.
pub fn read_lidar_lines(status_dir: &Path) -> Vec<LidarLineStatus> {
    let text = fs::read(status_dir.join(FILE)).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default()
}

/// Writes how lidars are, for others.
pub struct LidarBoard {
    file: PathBuf,
    lost: CountersByLabels,
    returns: CountersByLabels,
    state: GaugesByLabels,
    speed: GaugesByLabels,
    /// What was counted at the last writing, by lidar.
    counted: Vec<(Counts, u64)>,
    /// Labels of the state that is shown, by lidar.
    shown: Vec<Option<[String; 6]>>,
}

impl LidarBoard {
    /// For these lidars.
    pub fn new(status_dir: &Path, metrics: &StageMetrics, lidars: &[LidarSpec]) -> Self {
        let state_labels = [
            names::LABEL_LIDAR,
            names::LABEL_STATE,
            names::LABEL_MODEL,
            names::LABEL_FIRMWARE,
            names::LABEL_SERIAL_NUMBER,
            names::LABEL_HEALTH,
        ];
        let of_lidar = [names::LABEL_LIDAR];
        Self {
            file: status_dir.join(FILE),
            lost: metrics.counters_by(names::LIDAR_LOST, &[names::LABEL_LIDAR, names::LABEL_REASON]),
            returns: metrics.counters_by(names::LIDAR_RETURNS, &of_lidar),
            state: metrics.gauges_by(names::LIDAR_STATE, &state_labels),
            speed: metrics.gauges_by(names::LIDAR_SPEED, &of_lidar),
            counted: vec![Default::default(); lidars.len()],
            shown: vec![None; lidars.len()],
        }
    }

    /// Writes how they are.
    pub fn write(&mut self, sessions: &[LidarSession]) {
        let all: Vec<LidarLineStatus> = sessions.iter().map(LidarLineStatus::of).collect();
        // Nobody reads half a file: it is put in place whole. A failure has no other effect.
        let new = self.file.with_extension("new");
        if let Ok(text) = serde_json::to_vec(&all)
            && fs::write(&new, text).is_ok()
        {
            let _ = fs::rename(&new, &self.file);
        }
        for (at, (session, status)) in sessions.iter().zip(all).enumerate() {
            self.count(at, session, &status);
        }
    }

    fn count(&mut self, at: usize, session: &LidarSession, status: &LidarLineStatus) {
        let name = if status.name.is_empty() { &status.kind } else { &status.name };
        let (now, returns) = (session.counts(), session.returns());
        let (before, returned) = std::mem::replace(&mut self.counted[at], (now, returns));
        self.returns.count_by(&[name], returns - returned);
        for ((reason, now), (_, before)) in now.named().into_iter().zip(before.named()) {
            if !["bytes", "packets", "turns"].contains(&reason) {
                self.lost.count_by(&[name, reason], now - before);
            }
        }
        self.speed.one(&[name]).set(if status.state == "measuring" { status.speed_hz } else { 0.0 });
        let known = |value: &Option<String>| value.clone().unwrap_or_default();
        let labels = [
            name.clone(),
            status.state.clone(),
            known(&status.model),
            known(&status.firmware),
            known(&status.serial_number),
            known(&status.health),
        ];
        if self.shown[at].as_ref() != Some(&labels) {
            if let Some(old) = &self.shown[at] {
                self.state.remove(&old.each_ref().map(String::as_str));
            }
            self.state.one(&labels.each_ref().map(String::as_str)).set(1.0);
            self.shown[at] = Some(labels);
        }
    }
}
