//! The thread that publishes diagnostics and the lines of the log: asking a supervisor takes time that transforms do not have.

use super::BridgeError;
use super::log_relay::LogRelay;
use super::map_correction::Correction;
use super::set_diagnostics::{BridgeReport, diagnostics, status};
use crate::supervisor::{Reply, Request, ask};
use flockslam_bus::RuntimeDir;
use flockslam_ros::Publisher;
use flockslam_ros::messages::{DiagnosticArray, DiagnosticStatus, Header, Log};
use std::path::PathBuf;
use std::sync::mpsc::{Sender, channel};

/// What the thread of diagnostics gets.
pub enum Report {
    /// How the bridge is, and the time, nanoseconds.
    Regular(BridgeReport, i64),
    /// A correction that moves the robot far, and its stamp, nanoseconds.
    Jump(Correction, i64),
}

/// Starts the thread that queries the supervisor for the set's status, and publishes it. It ends the process when the set has ended.
///
/// # Errors
/// When the system refuses.
pub fn report_by(
    publisher: Publisher<DiagnosticArray>,
    lines: Publisher<Log>,
    mut log: LogRelay,
    robot: String,
    control: PathBuf,
) -> Result<Sender<Report>, BridgeError> {
    let (sender, reports) = channel::<Report>();
    let publish = move || {
        while let Ok(report) = reports.recv() {
            let (statuses, stamp_ns) = match report {
                Report::Jump(Correction { jump: (metres, radians), .. }, stamp_ns) => {
                    let message = format!("the pose jumps by {metres:.2} m and {:.1}°", radians.to_degrees());
                    let name = "flockslam: poses".to_owned();
                    (vec![status(DiagnosticStatus::WARN, name, &message, &robot, &[])], stamp_ns)
                }
                Report::Regular(report, stamp_ns) => {
                    for line in log.read() {
                        lines.send(line);
                    }
                    let set = match ask(&control, &Request::Status) {
                        Ok(Reply::Status(status)) => Some(status),
                        _ if !RuntimeDir::running().contains(&robot) => std::process::exit(0),
                        _ => None,
                    };
                    (diagnostics(&robot, &report, set.as_deref()), stamp_ns)
                }
            };
            publisher.send(DiagnosticArray { header: Header::new(stamp_ns, ""), status: statuses });
        }
    };
    std::thread::Builder::new().name("diagnostics".to_owned()).spawn(publish)?;
    Ok(sender)
}
