//! The command line: which command is run, and what exit code its outcome has.

use crate::arguments::{Cli, Command};
use crate::commands::{self, CommandError};
use crate::supervisor::raise_open_files;
use clap::Parser;
use std::process::ExitCode;

/// A broken assumption in any thread kills the process at once. The release profile aborts by itself; a build for tests
/// unwinds, since cargo would compile everything twice otherwise.
pub fn abort_on_panic() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        report(panic);
        tracing::error!(%panic, "a broken assumption");
        std::process::abort();
    }));
}

/// Parses the command line and runs it. What a user did wrong ends with exit code 2, what went wrong here with 1.
pub fn main() -> ExitCode {
    abort_on_panic();
    raise_open_files();
    let cli = Cli::parse();
    let outcome = match cli.command {
        Command::Stage(args) => return commands::stage::run(&args),
        Command::Doctor(args) => return ending(commands::doctor_command::run(&args)),
        Command::Manuals(args) => commands::manuals_command::run(&args),
        Command::Map(args) => commands::map::run(&args),
        Command::Inspect(args) => commands::inspect::run(&args),
        Command::Demo(args) => commands::demo::run(&args),
        Command::Swarm(args) => commands::swarm::run(&args),
        Command::Setup(args) => commands::setup_command::run(&args),
        Command::Up(args) => commands::up::run(&args),
        Command::Down(args) => commands::control_command::down(&args),
        Command::Status(args) => commands::control_command::status(&args),
        Command::Restart(args) => commands::control_command::restart(&args),
        Command::Pause(args) => commands::control_command::pause(&args, true),
        Command::Resume(args) => commands::control_command::pause(&args, false),
        Command::Reset(args) => commands::control_command::reset(&args),
        Command::Relocalize(args) => commands::control_command::relocalize(&args),
        Command::Mode(args) => commands::control_command::mode(&args),
        Command::Scale(args) => commands::control_command::scale(&args),
        Command::Top(args) => commands::top_command::run(&args),
        Command::Log(args) => commands::log_command::run(&args),
        Command::Page(args) => commands::page_command::run(&args),
        Command::Ros(args) => commands::ros_command::run(&args),
        Command::Record(args) => commands::record_command::run(&args),
        Command::Lidar(command) => commands::lidar_command::run(&command),
        Command::Store(command) => commands::store_command::run(&command),
        Command::Evaluate(args) => commands::evaluate::run(&args),
        Command::Config(args) => commands::config::run(&args),
    };
    ending(outcome.map(|()| 0))
}

/// The exit code of what a command came to.
fn ending(outcome: Result<u8, CommandError>) -> ExitCode {
    match outcome {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("flockslam: {error}");
            ExitCode::from(if matches!(error, CommandError::User(_)) { 2 } else { 1 })
        }
    }
}
