//! The files that a run has written, read back, and the error of its trajectory against the truth.

use flockslam::evaluation::{evaluate_truth, parse_tum};
use flockslam::outputs::{Report, TrajectoryPoint};
use std::path::{Path, PathBuf};

/// What a run left in its directory, read back.
pub struct Outputs {
    pub directory: PathBuf,
    pub report: Report,
}

impl Outputs {
    /// Reads the report; the rest is read when it is asked for.
    pub fn read(directory: &Path) -> Self {
        let report = serde_json::from_slice(&bytes_of(directory, "report.json")).unwrap();
        Self { directory: directory.to_owned(), report }
    }

    /// The bytes of one output.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        bytes_of(&self.directory, name)
    }

    /// The lines of one output.
    pub fn lines(&self, name: &str) -> Vec<String> {
        String::from_utf8(self.bytes(name)).unwrap().lines().map(str::to_owned).collect()
    }

    /// The first field of every line of a trajectory.
    pub fn stamps(&self, name: &str) -> Vec<String> {
        self.lines(name).iter().map(|line| line.split(' ').next().unwrap().to_owned()).collect()
    }

    /// A trajectory.
    pub fn trajectory(&self, name: &str) -> Vec<TrajectoryPoint> {
        parse_tum(name, &self.bytes(name)).unwrap()
    }
}

/// Root mean square of the absolute translational error of the final trajectory, metres.
pub fn truth_error_m(outputs: &Outputs) -> f64 {
    known_truth_error_m(outputs).unwrap()
}

/// As [`truth_error_m`]; `None` when the trajectory is not one that can be compared.
pub fn known_truth_error_m(outputs: &Outputs) -> Option<f64> {
    let report = evaluate_truth(&outputs.trajectory("trajectory.tum"), &outputs.trajectory("truth.tum"));
    Some(report.ok()?.absolute.translation_m?.rmse)
}

fn bytes_of(directory: &Path, name: &str) -> Vec<u8> {
    let path = directory.join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
