//! The profile `ndt`: as a set of processes, and its settings for drives in one process.

use super::{Outputs, run_well};
use flockslam::configuration::{Configuration, Profile};
use flockslam_drives::experiments::Experiment;
use flockslam_drives::ndt_system::NdtSettings;
use std::path::Path;

/// Without the update of the map: what was seen once stays.
pub const PLAIN: &str = "dynamic_cleaner.enabled=false";

/// The profile's settings of matcher, cleaner and mapper.
pub fn ndt_settings() -> NdtSettings {
    let Configuration { scan_matcher, dynamic_cleaner, mapper, .. } = Configuration::of_profile(Profile::Ndt);
    (scan_matcher, dynamic_cleaner, mapper)
}

/// Runs the profile on the first `count` scans of an experiment, with more settings.
pub fn run_ndt(experiment: &Experiment, count: usize, directory: &Path, more: &[&str]) -> Outputs {
    let log = directory.join("experiment.clf");
    experiment.write_log(count, &log);
    let mut args =
        vec!["map".to_owned(), log.display().to_string(), "--profile".to_owned(), "ndt".to_owned()];
    args.extend(more.iter().flat_map(|set| ["--set".to_owned(), (*set).to_owned()]));
    run_well("ndt", &directory.join("out"), &args)
}
