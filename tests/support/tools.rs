//! Public tools that tests run beside the executable: where one cannot be had, the test says what it left out.

use super::{not_tested, stderr, stdout};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs a tool in a directory; `None`, said clearly, where it is not there or does not work.
pub fn tool(directory: &Path, program: &Path, args: &[&str]) -> Option<String> {
    let output = Command::new(program).args(args).current_dir(directory).output();
    match output {
        Ok(output) if output.status.success() => Some(stdout(&output)),
        Ok(output) => {
            not_tested(&format!("{} {}", program.display(), args.join(" ")), stderr(&output).trim());
            None
        }
        Err(error) => {
            not_tested(&program.display().to_string(), &error.to_string());
            None
        }
    }
}

/// The interpreter of an environment in this directory that has these packages of the public index; `None` as [`tool`].
pub fn python_with(place: &Path, packages: &[&str]) -> Option<PathBuf> {
    tool(place, Path::new("python3"), &["-m", "venv", "venv"])?;
    tool(place, &place.join("venv/bin/pip"), &[&["install", "--quiet"], packages].concat())?;
    Some(place.join("venv/bin/python"))
}
