//! Runs of the executable that sections share: takes a log or a simulation and options, gives the report and the errors.

use super::driving::{Jump, jumps};
use super::returns::{Return, of_later_laps, returns};
use flockslam::evaluation::{
    Relation, RelationsReport, TruthReport, evaluate_relations, evaluate_truth, parse_relations, parse_tum,
};
use flockslam::outputs::{Report, TrajectoryPoint};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::rc::Rc;

/// What a run is measured against: a log with relations, or the simulation with its exact truth.
#[derive(Clone, Debug)]
pub struct Subject {
    /// How the tables call it.
    pub name: String,
    /// The CARMEN log and its relations; `None` for the simulation.
    pub log: Option<(PathBuf, PathBuf)>,
    /// Options of every run of it.
    pub options: Vec<String>,
}

/// A trajectory's errors.
#[derive(Clone, Copy, Debug)]
pub enum Errors {
    /// Over relations.
    Relations(RelationsReport),
    /// Against exact truth.
    Truth(TruthReport),
}

/// One run of the executable, measured.
#[derive(Debug)]
pub struct Measured {
    /// Its report.
    pub report: Report,
    /// Errors of `trajectory.tum`.
    pub last: Errors,
    /// Errors of `trajectory_online.tum`.
    pub online: Errors,
    /// Its jumps.
    pub jumps: Vec<Jump>,
    /// Its returns to known surroundings.
    pub returns: Vec<Return>,
    /// ATE of its published and its final poses in known surroundings, metres, where the truth is known.
    pub later_laps_m: Option<[f64; 2]>,
}

/// A run, or in one line why there is none.
pub type Outcome = Result<Rc<Measured>, String>;

/// Runs the executable and keeps what came out, so that sections can share runs.
#[derive(Debug, Default)]
pub struct Runs {
    done: BTreeMap<Vec<String>, Outcome>,
    relations: BTreeMap<PathBuf, Rc<Vec<Relation>>>,
}

impl Errors {
    /// Mean translational error over all relations, or ATE, metres.
    pub fn translation_m(&self) -> f64 {
        match self {
            Self::Relations(report) => report.all.translation_m.map_or(f64::NAN, |spread| spread.mean),
            Self::Truth(report) => report.absolute.translation_m.map_or(f64::NAN, |spread| spread.rmse),
        }
    }

    /// Mean rotational error over all relations, or of absolute poses, degrees.
    pub fn rotation_deg(&self) -> f64 {
        match self {
            Self::Relations(report) => report.all.rotation_deg.map_or(f64::NAN, |spread| spread.mean),
            Self::Truth(report) => report.absolute.rotation_deg.map_or(f64::NAN, |spread| spread.mean),
        }
    }

    /// Largest translational error, metres.
    pub fn max_m(&self) -> f64 {
        let group = match self {
            Self::Relations(report) => report.all.translation_m,
            Self::Truth(report) => report.absolute.translation_m,
        };
        group.map_or(f64::NAN, |spread| spread.max)
    }

    /// Mean over short relations, metres; of the simulation: error per metre of the way.
    pub fn short_m(&self) -> f64 {
        let group = match self {
            Self::Relations(report) => report.short.translation_m,
            Self::Truth(report) => report.per_metre.translation_m,
        };
        group.map_or(f64::NAN, |spread| spread.mean)
    }

    /// Mean over loops, metres; there are none in the simulation.
    pub fn loop_m(&self) -> f64 {
        match self {
            Self::Relations(report) => report.loops.translation_m.map_or(f64::NAN, |spread| spread.mean),
            Self::Truth(_) => f64::NAN,
        }
    }

    /// Relations or true poses without an estimated pose.
    pub fn missing(&self) -> usize {
        match self {
            Self::Relations(report) => report.all.missing,
            Self::Truth(report) => report.missing,
        }
    }
}

impl Measured {
    /// Processor time of the whole set for a scan, milliseconds.
    pub fn cpu_ms_per_scan(&self) -> f64 {
        self.report.cpu_s * 1e3 / self.report.scans.max(1) as f64
    }
}

impl Runs {
    /// The run of a subject with these options; it is run once only.
    pub fn of(&mut self, subject: &Subject, options: &[String]) -> Outcome {
        let arguments = subject.arguments(options);
        if let Some(known) = self.done.get(&arguments) {
            return known.clone();
        }
        let outcome = self.run(subject, &arguments);
        self.done.insert(arguments, outcome.clone());
        outcome
    }

    /// As [`Runs::of`], but run again: for times.
    pub fn again(&mut self, subject: &Subject, options: &[String]) -> Outcome {
        self.run(subject, &subject.arguments(options))
    }

    fn run(&mut self, subject: &Subject, arguments: &[String]) -> Outcome {
        let out = tempfile::tempdir().map_err(|error| error.to_string())?;
        execute(arguments, out.path())?;
        let outcome = self.measure(subject, out.path())?;
        eprintln!(
            "  {:.1} s, error {:.4} m: flockslam {}",
            outcome.report.wall_s,
            outcome.last.translation_m(),
            arguments.join(" ")
        );
        Ok(Rc::new(outcome))
    }

    fn measure(&mut self, subject: &Subject, out: &Path) -> Result<Measured, String> {
        let report =
            serde_json::from_slice(&read(&out.join("report.json"))?).map_err(|error| error.to_string())?;
        let relations = match &subject.log {
            Some((_, path)) => Some(self.relations(path)?),
            None => None,
        };
        let errors = |name: &str| match &relations {
            Some(relations) => Ok(Errors::Relations(evaluate_relations(&trajectory(out, name)?, relations))),
            None => evaluate_truth(&trajectory(out, name)?, &trajectory(out, "truth.tum")?)
                .map(Errors::Truth)
                .map_err(|error| error.to_string()),
        };
        let [online, last] = [trajectory(out, "trajectory_online.tum")?, trajectory(out, "trajectory.tum")?];
        let later_laps_m = match &relations {
            Some(_) => None,
            None => later_laps_m(&online, &last, &trajectory(out, "truth.tum")?),
        };
        Ok(Measured {
            report,
            last: errors("trajectory.tum")?,
            online: errors("trajectory_online.tum")?,
            jumps: jumps(&online, &last),
            returns: returns(&online, &last),
            later_laps_m,
        })
    }

    fn relations(&mut self, path: &Path) -> Result<Rc<Vec<Relation>>, String> {
        if let Some(known) = self.relations.get(path) {
            return Ok(Rc::clone(known));
        }
        let name = path.display().to_string();
        let parsed = Rc::new(parse_relations(&name, &read(path)?).map_err(|error| error.to_string())?);
        self.relations.insert(path.to_owned(), Rc::clone(&parsed));
        Ok(parsed)
    }
}

impl Subject {
    /// The command line of a run, without `--out`.
    pub fn arguments(&self, options: &[String]) -> Vec<String> {
        let command = match &self.log {
            Some((log, _)) => vec!["map".to_owned(), log.display().to_string()],
            None => vec!["demo".to_owned()],
        };
        command.into_iter().chain(self.options.iter().chain(options).cloned()).collect()
    }
}

/// ATE of published and of final poses in known surroundings, metres; `None` where the robot never came back.
fn later_laps_m(
    online: &[TrajectoryPoint],
    last: &[TrajectoryPoint],
    truth: &[TrajectoryPoint],
) -> Option<[f64; 2]> {
    let ate_m = |points| {
        Some(Errors::Truth(evaluate_truth(&of_later_laps(points, last), truth).ok()?).translation_m())
    };
    Some([ate_m(online)?, ate_m(last)?])
}

/// Runs the executable with these arguments, its outputs going to `out`.
pub fn execute(arguments: &[String], out: &Path) -> Result<(), String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flockslam"));
    command
        .args(arguments)
        .arg("--out")
        .arg(out)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let output = command.output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let reason = said.trim().lines().last().unwrap_or("no reason given").to_owned();
    eprintln!("  FAILED: flockslam {}: {reason}", arguments.join(" "));
    Err(reason)
}

/// `--set KEY=VALUE` for each of these.
pub fn set(assignments: &[&str]) -> Vec<String> {
    assignments.iter().flat_map(|assignment| ["--set".to_owned(), (*assignment).to_owned()]).collect()
}

fn trajectory(out: &Path, name: &str) -> Result<Vec<TrajectoryPoint>, String> {
    parse_tum(name, &read(&out.join(name))?).map_err(|error| error.to_string())
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}
