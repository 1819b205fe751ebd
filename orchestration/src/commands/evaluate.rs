//! `flockslam evaluate`: a trajectory against ground truth.

use super::{CommandError, print};
use crate::arguments::EvaluateArgs;
use crate::evaluation::{
    RelationsReport, TruthReport, evaluate_relations, evaluate_truth, parse_relations, parse_tum,
};
use std::path::Path;

/// What was measured.
#[derive(Debug, Default, serde::Serialize)]
struct Figures {
    #[serde(skip_serializing_if = "Option::is_none")]
    relations: Option<RelationsReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<TruthReport>,
}

/// Runs the command.
///
/// # Errors
/// When a file cannot be read, has a line that is not understood, or the figures cannot be written.
pub fn run(args: &EvaluateArgs) -> Result<(), CommandError> {
    let parsed =
        |path: &Path| parse_tum(&path.display().to_string(), &read(path)?).map_err(CommandError::user);
    let trajectory = parsed(&args.trajectory)?;
    let mut figures = Figures::default();
    if let Some(path) = &args.relations {
        let relations =
            parse_relations(&path.display().to_string(), &read(path)?).map_err(CommandError::user)?;
        let report = evaluate_relations(&trajectory, &relations);
        print(&report.to_string());
        figures.relations = Some(report);
    }
    if let Some(path) = &args.truth {
        let report = evaluate_truth(&trajectory, &parsed(path)?).map_err(CommandError::user)?;
        print(&report.to_string());
        figures.truth = Some(report);
    }
    match &args.json {
        Some(path) => write_json(path, &figures),
        None => Ok(()),
    }
}

fn read(path: &Path) -> Result<Vec<u8>, CommandError> {
    std::fs::read(path).map_err(|e| CommandError::user(format!("{}: {e}", path.display())))
}

fn write_json(path: &Path, figures: &Figures) -> Result<(), CommandError> {
    let json = serde_json::to_vec_pretty(figures).map_err(CommandError::failed)?;
    let durability = flockslam_journal::Durability::Process;
    flockslam_journal::replace_file(path, &json, durability).map_err(CommandError::user)
}
