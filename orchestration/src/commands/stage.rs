//! `flockslam stage`: one stage as a process of its own.

use crate::arguments::StageArgs;
use crate::supervisor::{EXIT_BAD_SOURCE, error_file, run_stage};
use flockslam_bus::RuntimeDir;
use flockslam_stage::StageError;
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use std::process::ExitCode;

/// Runs the stage. It is killed when its supervisor ends.
pub fn run(args: &StageArgs) -> ExitCode {
    flockslam_telemetry::init_tracing(args.stage.name());
    if !die_with(args.parent) {
        return ExitCode::FAILURE;
    }
    flockslam_telemetry::log_into_set(&args.set_dir);
    match run_stage(args.stage, args.replica, &args.set_dir, args.fallback) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            report(args, &error);
            ExitCode::from(if matches!(error, StageError::Source(_)) { EXIT_BAD_SOURCE as u8 } else { 1 })
        }
    }
}

/// From now on this process is killed when its parent ends; false when the parent is not this one any more.
pub(super) fn die_with(parent: Option<u32>) -> bool {
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    // The parent may have died before that took effect.
    parent.is_none_or(|parent| {
        getppid().is_some_and(|present| u32::try_from(present.as_raw_nonzero().get()) == Ok(parent))
    })
}

/// Leaves the reason where the supervisor finds it: one place to speak to the user is enough.
fn report(args: &StageArgs, error: &StageError) {
    let is_reported = RuntimeDir::open(&args.set_dir)
        .is_ok_and(|runtime| std::fs::write(error_file(&runtime, args.stage), error.to_string()).is_ok());
    if !is_reported {
        tracing::error!(%error, "cannot go on");
    }
}
