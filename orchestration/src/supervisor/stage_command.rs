//! What a stage process does: it reads `set.json`, joins the bus, and runs the stage of its name until the stage ends.

use super::SetFile;
use flockslam_bus::RuntimeDir;
use flockslam_lidar_ingest::process::Task;
use flockslam_messages::Stage;
use flockslam_scan_matcher::process::GridFormat;
use flockslam_stage::{Actor, StageContext, StageError, StopFlag};
use std::path::Path;

/// Runs one stage of the set in `set_dir`, or what stands in for it, in this process, until SIGTERM.
///
/// # Errors
/// What the stage could not go on from.
pub fn run_stage(stage: Stage, replica: u32, set_dir: &Path, is_fallback: bool) -> Result<(), StageError> {
    let stop = StopFlag::on_signals()?;
    let runtime = RuntimeDir::open(set_dir)?;
    let set = SetFile::read(&runtime.configuration())?;
    let mut context = StageContext::join(stage, replica, &runtime, &set.options, stop)?;
    if is_fallback && stage == Stage::ScanMatcher {
        let settings = set.configuration.scan_matcher;
        return flockslam_scan_matcher::process::run_odometry_fallback(&mut context, settings);
    }
    run_in(&mut context, set)
}

/// What the matcher has to know of the grid that it reads.
fn grid_format(mapper: &flockslam_mapper::Settings) -> GridFormat {
    let unknown_score = f64::from(mapper.read_out().unknown()) / f64::from(u16::MAX);
    GridFormat { cell_size_m: mapper.cell_size_m, unknown_score }
}

/// Runs a stage on a context that is already there.
///
/// # Errors
/// As [`run_stage`].
pub fn run_in(context: &mut StageContext, set: SetFile) -> Result<(), StageError> {
    let SetFile { source, rate, world, configuration, .. } = set;
    let grid = grid_format(&configuration.mapper);
    let cell_size_m = grid.cell_size_m;
    match context.stage {
        Stage::LidarIngest => {
            let (settings, simulation) = (configuration.lidar_ingest, configuration.simulation);
            flockslam_lidar_ingest::process::run_stage(
                context,
                Task { source, rate, settings, simulation, world },
            )
        }
        Stage::CorrelationFilter => {
            flockslam_correlation_filter::process::run_stage(context, configuration.correlation_filter)
        }
        Stage::ScanMatcher => {
            flockslam_scan_matcher::process::run_stage(context, configuration.scan_matcher, grid)
        }
        Stage::Mapper => flockslam_mapper::process::run_stage(context, configuration.mapper),
        Stage::DynamicCleaner => {
            flockslam_dynamic_cleaner::process::run_stage(context, configuration.dynamic_cleaner, cell_size_m)
        }
        Stage::SyncManager => flockslam_sync_manager::process::run_stage(context, configuration.sync_manager),
    }
}

/// A stage as steps, on a context that is already there: one thread can drive a whole set under a virtual clock.
///
/// # Errors
/// As [`run_stage`].
pub fn shell_in(context: &mut StageContext, set: SetFile) -> Result<Box<dyn Actor>, StageError> {
    let SetFile { source, rate, world, configuration, .. } = set;
    let grid = grid_format(&configuration.mapper);
    let cell_size_m = grid.cell_size_m;
    match context.stage {
        Stage::LidarIngest => {
            let (settings, simulation) = (configuration.lidar_ingest, configuration.simulation);
            let task = Task { source, rate, settings, simulation, world };
            flockslam_lidar_ingest::process::shell(context, task)
        }
        Stage::CorrelationFilter => {
            flockslam_correlation_filter::process::shell(context, configuration.correlation_filter)
        }
        Stage::ScanMatcher => {
            flockslam_scan_matcher::process::shell(context, configuration.scan_matcher, grid)
        }
        Stage::Mapper => flockslam_mapper::process::shell(context, configuration.mapper),
        Stage::DynamicCleaner => {
            flockslam_dynamic_cleaner::process::shell(context, configuration.dynamic_cleaner, cell_size_m)
        }
        Stage::SyncManager => flockslam_sync_manager::process::shell(context, configuration.sync_manager),
    }
}
