//! The benchmark logs: runs of them, which tests share, and how far off their trajectories are.

use super::{Outputs, benchmark_file, data_dir, evaluate_relations, evaluate_trajectory, run_well};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, OnceLock};

/// A benchmark log.
#[derive(Clone, Copy, Debug)]
pub struct Log {
    pub name: &'static str,
    /// What the published program reaches over short relations, metres.
    pub published_m: f64,
}

pub const INTEL: Log = Log { name: "intel", published_m: 0.031 };
pub const FR079: Log = Log { name: "fr079", published_m: 0.035 };
pub const ACES: Log = Log { name: "aces", published_m: 0.061 };
pub const LOGS: [Log; 3] = [INTEL, FR079, ACES];

/// Every scan is processed.
pub const FILTER_OFF: &str = "correlation_filter.mode=off";

/// Errors of a trajectory over the relations of its log.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    pub mean_m: f64,
    pub mean_deg: f64,
    pub max_m: f64,
    pub short_m: f64,
    pub loop_m: f64,
    pub loop_max_m: f64,
    pub missing: u64,
}

impl Errors {
    /// Of what `flockslam evaluate` prints.
    pub fn of(figures: &Value) -> Self {
        let number = |group: &str, kind: &str, figure: &str| figures[group][kind][figure].as_f64().unwrap();
        Self {
            mean_m: number("all", "translation_m", "mean"),
            mean_deg: number("all", "rotation_deg", "mean"),
            max_m: number("all", "translation_m", "max"),
            short_m: number("short", "translation_m", "mean"),
            loop_m: number("loop", "translation_m", "mean"),
            loop_max_m: number("loop", "translation_m", "max"),
            missing: figures["all"]["missing"].as_u64().unwrap(),
        }
    }
}

/// A tenth more than before is a regression.
const TOLERANCE: f64 = 1.1;

/// Fails where an error of a log, given as (now, before), has grown.
pub fn assert_no_worse(log: &Log, errors: &Errors, figures: &[(f64, f64)]) {
    println!("{}: {errors:?}", log.name);
    for (now, before) in figures {
        assert!(*now <= TOLERANCE * before, "{}: {now}, {before} before; {errors:?}", log.name);
    }
}

/// A run that several tests read.
type Shared = Arc<OnceLock<Outputs>>;

impl Log {
    /// A file of the log: `clf` is the log, `relations` what is known to be true of it.
    pub fn file(&self, extension: &str) -> Option<PathBuf> {
        Some(benchmark_file(&data_dir()?, self.name, extension))
    }

    /// Maps the log, or another in its place, with these arguments.
    pub fn map(log: &Path, out: &Path, more: &[&str]) -> Outputs {
        let mut args = vec!["map".to_owned(), log.display().to_string()];
        args.extend(more.iter().map(|arg| (*arg).to_owned()));
        run_well("log", out, &args)
    }

    /// The outputs of the log with these arguments: each run is made once, by who asks first, and read by all.
    pub fn shared_run(&self, more: &[&str]) -> Option<Arc<OnceLock<Outputs>>> {
        static RUNS: LazyLock<Mutex<BTreeMap<String, Shared>>> = LazyLock::new(Mutex::default);
        let log = self.file("clf")?;
        let key = [&[self.name], more].concat().join("_").replace(['/', '=', '.', ','], "-");
        let run = Arc::clone(RUNS.lock().unwrap().entry(key.clone()).or_default());
        // Kept after the tests for inspection, and overwritten by the next run.
        let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("runs").join(key);
        run.get_or_init(|| {
            let _ = std::fs::remove_dir_all(&out);
            std::fs::create_dir_all(out.parent().unwrap()).unwrap();
            Self::map(&log, &out, more)
        });
        Some(run)
    }

    /// Errors of a final trajectory, which has to have all poses that the relations ask for.
    pub fn errors(&self, outputs: &Outputs) -> Errors {
        let errors = self.errors_of_a_part(outputs);
        assert_eq!(errors.missing, 0, "{}", self.name);
        errors
    }

    /// Errors of the poses as they were published, of all that the relations ask for.
    pub fn errors_online(&self, outputs: &Outputs) -> Errors {
        let data = data_dir().expect("the log was there");
        let errors = Errors::of(&evaluate_trajectory(&data, self.name, outputs, "trajectory_online"));
        assert_eq!(errors.missing, 0, "{}", self.name);
        errors
    }

    /// As [`Log::errors`], where scans were taken out of the log.
    pub fn errors_of_a_part(&self, outputs: &Outputs) -> Errors {
        Errors::of(&evaluate_relations(&data_dir().expect("the log was there"), self.name, outputs))
    }
}
