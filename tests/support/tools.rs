//! Public tools that tests run beside the executable: where one cannot be had, the test says what it left out.

use super::{not_tested, stderr, stdout};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Once, OnceLock};

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

/// An environment of Python with packages of the public index: installed by the first test that asks, kept in the target folder.
pub struct Environment {
    name: &'static str,
    packages: &'static [&'static str],
    modules: &'static str,
    python: OnceLock<Option<PathBuf>>,
}

/// What reads and writes recordings.
pub static RECORDINGS: Environment =
    Environment::new("recordings", &["rosbags", "mcap", "jsonschema"], "rosbags, mcap, jsonschema");
/// The client library of ROS, Cyclone DDS and zenoh, by the versions that they were tested with.
pub static ROS: Environment = Environment::new(
    "ros-peers",
    &[
        "ros-jazzy-rclpy==7.1.*",
        "ros-jazzy-rmw-fastrtps-cpp==8.4.*",
        "ros-jazzy-nav-msgs",
        "ros-jazzy-sensor-msgs",
        "ros-jazzy-std-srvs",
        "ros-jazzy-diagnostic-msgs",
        "ros-jazzy-lifecycle-msgs",
        "ros-jazzy-visualization-msgs",
        "cyclonedds==11.*",
        "eclipse-zenoh==1.10.*",
    ],
    "rclpy, cyclonedds, zenoh",
);

impl Environment {
    const fn new(name: &'static str, packages: &'static [&'static str], modules: &'static str) -> Self {
        Self { name, packages, modules, python: OnceLock::new() }
    }

    /// Its interpreter, beside which the programs of the packages lie; `None` as [`tool`].
    pub fn python(&self) -> Option<PathBuf> {
        self.python.get_or_init(|| self.install()).clone()
    }

    fn install(&self) -> Option<PathBuf> {
        let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(self.name);
        let (python, complete) = (place.join("venv/bin/python"), place.join("complete"));
        let packages = self.packages.join("\n");
        if std::fs::read_to_string(&complete).is_ok_and(|with| with == packages) {
            return Some(python);
        }
        std::fs::create_dir_all(&place).unwrap();
        tool(&place, Path::new("python3"), &["-m", "venv", "venv"])?;
        tool(&place, &place.join("venv/bin/pip"), &[&["install", "--quiet"], self.packages].concat())?;
        tool(&place, &python, &["-c", &format!("import {}", self.modules)])?;
        std::fs::write(complete, packages).unwrap();
        Some(python)
    }
}

/// Where all tests run, environments are installed beside the first of them: that is mostly waiting for the network.
pub fn install_early() {
    static BEGUN: Once = Once::new();
    let runs_all = std::env::args().len() == 1;
    let install = || [&ROS, &RECORDINGS].map(Environment::python);
    BEGUN.call_once(|| drop(runs_all.then(|| std::thread::spawn(install))));
}
