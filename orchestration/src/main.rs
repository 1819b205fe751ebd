//! The `flockslam` executable: the command line, and every stage when the supervisor starts it again as one.

use std::process::ExitCode;

fn main() -> ExitCode {
    flockslam::cli::main()
}
