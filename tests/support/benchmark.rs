//! Files of a benchmark log, and the errors of a run's trajectories over the relations of that log.

use super::outputs::Outputs;
use super::{flockslam, stderr};
use std::path::{Path, PathBuf};

/// A file of a benchmark log: `clf` is the log, `relations` what is known to be true of it.
pub fn benchmark_file(data: &Path, log: &str, extension: &str) -> PathBuf {
    data.join(log).join(format!("{log}.{extension}"))
}

/// The figures of `flockslam evaluate` for the final trajectory of a benchmark log against its relations.
pub fn evaluate_relations(data: &Path, log: &str, outputs: &Outputs) -> serde_json::Value {
    evaluate_trajectory(data, log, outputs, "trajectory")
}

/// The same for one of its trajectories: the name of the file, without `.tum`.
pub fn evaluate_trajectory(data: &Path, log: &str, outputs: &Outputs, name: &str) -> serde_json::Value {
    let json = outputs.directory.join(format!("figures-{name}.json"));
    let mut command = flockslam();
    command.arg("evaluate").arg("--relations").arg(benchmark_file(data, log, "relations"));
    command.arg("--trajectory").arg(outputs.directory.join(format!("{name}.tum"))).arg("--json").arg(&json);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let figures: serde_json::Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
    figures["relations"].clone()
}
