//! `flockslam demo`: a map from a simulated building, measured against the exact truth.

use super::run::{Run, points, run as run_set, summary};
use super::{CommandError, print};
use crate::arguments::DemoArgs;
use crate::evaluation::evaluate_truth;
use crate::outputs::write_trajectory;
use flockslam_lidar_ingest::process::Source;

/// Runs the command.
///
/// # Errors
/// When the world, the configuration or the directory is not usable, or the set fails.
pub fn run(args: &DemoArgs) -> Result<(), CommandError> {
    let absolute = |path| std::path::absolute(path).map_err(CommandError::user);
    let world = args.world.as_deref().map(absolute).transpose()?;
    let outcome =
        run_set(&args.run, Run { source: Source::Simulation, world, scans: None, continues: None })?;
    print(&summary(&args.run.out, &outcome.report));
    let truth = outcome.truth.ok_or_else(|| CommandError::failed("the simulation left no truth"))?;
    let truth = points(&truth);
    write_trajectory(&args.run.out.join("truth.tum"), &truth).map_err(CommandError::failed)?;
    print("wrote truth.tum beside them\n");
    for (name, trajectory) in [("online", &outcome.online), ("final", &outcome.last)] {
        let report = evaluate_truth(trajectory, &truth).map_err(CommandError::failed)?;
        print(&format!("\n{name} trajectory against the truth\n{report}"));
    }
    Ok(())
}
