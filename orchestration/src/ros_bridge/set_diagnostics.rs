//! The state of a set as diagnostics: one status for each stage, one for poses. Pure.

use crate::supervisor::{SetState, SetStatus, StageState};
use flockslam_ros::messages::{DiagnosticStatus, KeyValue};

/// How the bridge is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BridgeReport {
    /// What it is called in the graph.
    pub node: String,
    /// Its state.
    pub state: String,
    /// Poses come, and map → odom is published.
    pub corrects: bool,
    /// Another node publishes it.
    pub foreign: bool,
    /// Figures.
    pub figures: Vec<(&'static str, String)>,
}

/// The statuses of a set and of the bridge; without a status the supervisor did not answer.
pub fn diagnostics(robot: &str, report: &BridgeReport, set: Option<&SetStatus>) -> Vec<DiagnosticStatus> {
    let mut found = vec![poses(robot, report)];
    match set {
        Some(set) => {
            found.push(whole(robot, set));
            found.extend(set.stages.iter().map(|stage| {
                let (level, message) = match stage.state {
                    StageState::Running => (DiagnosticStatus::OK, "running"),
                    StageState::Starting => (DiagnosticStatus::WARN, "starting"),
                    StageState::Down => (DiagnosticStatus::ERROR, "it has died and is started again"),
                    StageState::Degraded => (DiagnosticStatus::ERROR, "it does not get up"),
                };
                let name = match stage.replica {
                    0 => format!("flockslam: {}", stage.stage),
                    replica => format!("flockslam: {} {replica}", stage.stage),
                };
                let figures = [
                    ("scans", stage.handled.to_string()),
                    ("restarts", stage.restarts.to_string()),
                    ("hangs", stage.hangs.to_string()),
                ];
                status(level, name, message, robot, &figures)
            }));
        }
        None => {
            let name = "flockslam: set".to_owned();
            found.push(status(DiagnosticStatus::STALE, name, "the supervisor does not answer", robot, &[]));
        }
    }
    found
}

fn poses(robot: &str, report: &BridgeReport) -> DiagnosticStatus {
    let (level, message) = if report.state != "active" {
        (DiagnosticStatus::OK, "the node is not active")
    } else if report.foreign {
        (DiagnosticStatus::ERROR, "another node publishes map → odom: this one does not")
    } else if report.corrects {
        (DiagnosticStatus::OK, "map → odom is published")
    } else {
        (DiagnosticStatus::ERROR, "no poses: map → odom is not published")
    };
    status(level, "flockslam: poses".to_owned(), message, robot, &report.figures)
}

fn whole(robot: &str, set: &SetStatus) -> DiagnosticStatus {
    let name = "flockslam: set".to_owned();
    let problem =
        set.not_durable.clone().or_else(|| set.saved.as_ref().and_then(|saved| saved.problem.clone()));
    let figures = [
        ("uptime_s", format!("{:.0}", set.uptime_s)),
        ("paused", set.paused.to_string()),
        ("mode", set.mode.name.clone()),
    ];
    let (level, message) = match (set.state, &problem) {
        (SetState::Degraded, _) => (DiagnosticStatus::ERROR, "a stage does not get up"),
        (_, Some(problem)) => (DiagnosticStatus::WARN, problem.as_str()),
        (SetState::Running, None) if set.paused => (DiagnosticStatus::WARN, "paused"),
        (SetState::Running, None) => (DiagnosticStatus::OK, "running"),
    };
    status(level, name, message, robot, &figures)
}

/// A status with its figures.
pub fn status(
    level: u8,
    name: String,
    message: &str,
    robot: &str,
    figures: &[(&'static str, String)],
) -> DiagnosticStatus {
    let values = figures.iter().map(|(key, value)| KeyValue { key: (*key).to_owned(), value: value.clone() });
    DiagnosticStatus {
        level,
        name,
        message: message.to_owned(),
        hardware_id: robot.to_owned(),
        values: values.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervisor::StageStatus;

    fn set(state: StageState) -> SetStatus {
        let stage = StageStatus {
            stage: "mapper".to_owned(),
            replica: 0,
            pid: Some(1),
            state,
            restarts: 2,
            hangs: 0,
            handled: 7,
            silent_s: None,
        };
        SetStatus::of_stages(vec![stage])
    }

    #[test]
    fn there_is_one_status_for_each_stage_and_silence_is_an_error() {
        let report = BridgeReport { state: "active".to_owned(), corrects: true, ..BridgeReport::default() };
        let found = diagnostics("r1", &report, Some(&set(StageState::Running)));
        let names: Vec<_> = found.iter().map(|status| (status.name.as_str(), status.level)).collect();
        assert_eq!(names, [("flockslam: poses", 0), ("flockslam: set", 0), ("flockslam: mapper", 0)]);
        assert_eq!(found[2].values[0], KeyValue { key: "scans".to_owned(), value: "7".to_owned() });
        let silent = BridgeReport { corrects: false, ..report.clone() };
        let found = diagnostics("r1", &silent, Some(&set(StageState::Down)));
        assert_eq!([found[0].level, found[2].level], [DiagnosticStatus::ERROR; 2]);
        let foreign = BridgeReport { foreign: true, ..report.clone() };
        assert_eq!(diagnostics("r1", &foreign, None)[0].level, DiagnosticStatus::ERROR);
        let resting = BridgeReport { state: "inactive".to_owned(), ..BridgeReport::default() };
        assert_eq!(diagnostics("r1", &resting, None)[0].level, DiagnosticStatus::OK);
        assert_eq!(diagnostics("r1", &report, None)[1].level, DiagnosticStatus::STALE);
    }
}
