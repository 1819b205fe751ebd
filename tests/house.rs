//! The house's own rules: who may import whom, what logic may touch, and how long a file may be.

use crate::support;
use crate::support::repository;
use crate::support::source::{files_of_target, product_identifiers, rust_files};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Crates that others may import, lowest layer first; an import goes to a lower layer only.
const LIBRARIES: [(&str, u32); 31] = [
    ("geometry", 0),
    ("zenoh-session", 0),
    ("random", 1),
    ("ros", 1),
    ("odometry-noise", 1),
    ("evidence", 1),
    ("messages", 2),
    ("transforms", 2),
    ("calibration", 3),
    ("lidars", 3),
    ("sensor-stream", 3),
    ("recordings", 4),
    ("ray-insertion", 2),
    ("records", 2),
    ("bus", 3),
    ("journal", 3),
    ("results", 4),
    ("telemetry", 3),
    ("registration", 4),
    ("simulation", 4),
    ("stage", 5),
    ("visibility", 4),
    ("map-fusion", 5),
    ("pose-graph", 5),
    ("loop-closure", 6),
    ("localisation", 6),
    ("flock", 7),
    ("flock-network", 8),
    ("published-methods", 8),
    ("page", 9),
    // For tests alone.
    ("drives", 11),
];
/// The library of lidars.
const LIDARS: &str = "services/libraries/lidars";
const SERVICE_LAYER: u32 = 9;
const ORCHESTRATION_LAYER: u32 = 10;
const LINES_MAX: usize = 500;
/// Names of what logic, which is a function of its inputs, must not reach for.
const OUTSIDE_WORLD: [&str; 19] = [
    "Instant",
    "SystemTime",
    "UNIX_EPOCH",
    "fs",
    "File",
    "OpenOptions",
    "thread",
    "net",
    "TcpStream",
    "TcpListener",
    "UdpSocket",
    "stdin",
    "stdout",
    "stderr",
    "env",
    "rustix",
    "tokio",
    "iceoryx2",
    "zenoh",
];

/// The packages of the workspace, as cargo describes them.
fn metadata() -> Vec<serde_json::Value> {
    let mut command = Command::new(env!("CARGO"));
    command.args(["metadata", "--no-deps", "--offline", "--format-version", "1"]).current_dir(repository());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", support::stderr(&output));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

/// Normal dependencies of every member of the workspace.
fn imports() -> BTreeMap<String, Vec<String>> {
    let packages = metadata();
    let name = |value: &serde_json::Value| value["name"].as_str().unwrap().to_owned();
    let normal = |package: &serde_json::Value| {
        let dependencies = package["dependencies"].as_array().unwrap().clone();
        dependencies.iter().filter(|dependency| dependency["kind"].is_null()).map(name).collect()
    };
    packages.iter().map(|package| (name(package), normal(package))).collect()
}

fn layer(package: &str) -> u32 {
    let short = package.strip_prefix("flockslam-").unwrap_or("");
    let library = LIBRARIES.iter().find(|(name, _)| *name == short).map(|(_, layer)| *layer);
    library.unwrap_or(if package == "flockslam" { ORCHESTRATION_LAYER } else { SERVICE_LAYER })
}

#[test]
fn imports_go_down_only() {
    let imports = imports();
    assert!(imports.len() >= 15, "{:?}", imports.keys());
    for (package, dependencies) in &imports {
        for dependency in dependencies.iter().filter(|name| imports.contains_key(*name)) {
            assert!(layer(dependency) < layer(package), "{package} must not import {dependency}");
        }
    }
}

/// The members of the workspace that use a library.
fn importers(library: &str) -> Vec<String> {
    let has = |dependencies: &Vec<String>| dependencies.iter().any(|name| name == library);
    imports().into_iter().filter(|(_, dependencies)| has(dependencies)).map(|(package, _)| package).collect()
}

#[test]
fn one_crate_each_opens_the_networks() {
    assert_eq!(importers("iceoryx2"), ["flockslam-bus"]);
    assert_eq!(importers("zenoh"), ["flockslam-zenoh-session"]);
    assert_eq!(importers("zenoh-ext"), ["flockslam-zenoh-session"]);
    assert_eq!(importers("flockslam-zenoh-session"), ["flockslam-flock-network", "flockslam-ros"]);
    assert_eq!(importers("ros2-client"), ["flockslam-ros"]);
    assert_eq!(importers("rustdds"), [""; 0]);
}

/// What lidars' bytes begin with, and words that they say.
const LIDAR_MARKS: [&str; 6] = ["0x54, 0x2c", "0xaa, 0x55", "0xa5, 0x5a", "lmdscandata", "scip2.0", "sopas"];

#[test]
fn only_lidars_parses_the_bytes_of_a_lidar() {
    assert_eq!(importers("serialport"), ["flockslam-lidar-ingest"]);
    assert_eq!(importers("flockslam-lidars"), ["flockslam", "flockslam-lidar-ingest"]);
    let product = ["interfaces", "services", "orchestration/src", "dashboards/page/src"];
    let files: Vec<PathBuf> =
        product.iter().flat_map(|below| rust_files(&repository().join(below))).collect();
    let knows = |file: &PathBuf| {
        let text = fs::read_to_string(file).unwrap().to_lowercase();
        LIDAR_MARKS.iter().any(|mark| text.contains(mark))
    };
    let (lidars, others): (Vec<_>, Vec<_>) =
        files.into_iter().filter(knows).partition(|file| file.starts_with(repository().join(LIDARS)));
    assert!(lidars.len() >= 5, "the marks are those of its files: {lidars:?}");
    assert_eq!(others, Vec::<PathBuf>::new());
}

/// Files of libraries of logic that reach for the network: what their users send with.
const SHELL_FILES: [&str; 1] = ["sensor-stream/src/producer.rs"];

fn is_shell(file: &Path) -> bool {
    if SHELL_FILES.iter().any(|name| file.ends_with(name)) {
        return true;
    }
    file.components().any(|part| part.as_os_str() == "process" || part.as_os_str() == "process.rs")
}

/// Libraries that have files, clocks and threads: what shells share, and the network.
const SHARED_SHELL: [&str; 5] = [
    "libraries/stage",
    "libraries/flock-network",
    "libraries/zenoh-session",
    "libraries/recordings",
    "libraries/ros",
];

/// Files of logic: those of the services that are no shells.
fn logic() -> Vec<PathBuf> {
    let crates =
        |below: &str| fs::read_dir(repository().join(below)).unwrap().map(|entry| entry.unwrap().path());
    let crates = crates("services").chain(crates("services/libraries"));
    let pure = crates.filter(|path| !SHARED_SHELL.iter().any(|name| path.ends_with(name)));
    pure.flat_map(|path| rust_files(&path.join("src"))).filter(|file| !is_shell(file)).collect()
}

/// Each file and the first of these names that its product part uses, in whatever form it was imported.
fn users<'n>(files: &[PathBuf], names: &[&'n str]) -> Vec<(PathBuf, &'n str)> {
    let first = |file: &PathBuf| {
        let used = product_identifiers(file);
        let name = names.iter().find(|name| used.iter().any(|used| used == *name))?;
        Some((file.strip_prefix(repository()).unwrap().to_owned(), *name))
    };
    files.iter().filter_map(first).collect()
}

#[test]
fn logic_reaches_for_no_clock_file_thread_or_network() {
    let files = logic();
    assert!(files.len() > 100, "only {} files were found", files.len());
    assert_eq!(users(&files, &OUTSIDE_WORLD), []);
}

#[test]
fn only_shells_import_bus_and_stage() {
    assert_eq!(users(&logic(), &["flockslam_bus", "flockslam_stage", "flockslam_telemetry"]), []);
}

#[test]
fn a_clock_is_found_in_any_form_of_import() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("logic.rs");
    let uses_clock = |text: &str| {
        fs::write(&file, text).unwrap();
        product_identifiers(&file).iter().any(|name| OUTSIDE_WORLD.contains(&name.as_str()))
    };
    for text in [
        "use std::time::{Duration, Instant};",
        "use std::{fmt, time::Instant as Clock};",
        "use std::time::*; fn now() -> Instant { Instant::now() }",
        "fn now() { let now = std::time::SystemTime::now(); }",
        "fn after() {}\n#[cfg(test)]\nmod tests { fn one() {} }\nfn later() { std::thread::yield_now() }",
    ] {
        assert!(uses_clock(text), "{text}");
    }
    for text in [
        "/// An Instant is not used here.\nfn f() { let text = \"std::fs\"; }",
        "#[cfg(test)]\nmod tests { use std::time::Instant; }",
        "use std::time::Duration;",
    ] {
        assert!(!uses_clock(text), "{text}");
    }
}

/// What reads the wall clock, the one place that puts it into a message, for exports, the time of a ROS graph and of its messages,
/// what stamps scans of lidars on lines: other programs stamp odometry by it; and the doctor, who says whether it can be right.
const WALL_CLOCK: [&str; 6] = [
    "telemetry/src/clock.rs",
    "lidar-ingest/src/process.rs",
    "lidar-ingest/src/process/lidar_session.rs",
    "ros_bridge/graph_clock.rs",
    "ros/src/sender_clock.rs",
    "doctor/machine_reader.rs",
];

#[test]
fn only_exports_use_the_wall_clock() {
    let tops = ["interfaces", "services", "orchestration/src", "dashboards"]
        .map(|top| rust_files(&repository().join(top)));
    let files =
        tops.concat().into_iter().filter(|file| file.components().any(|part| part.as_os_str() == "src"));
    let files: Vec<_> = files.filter(|file| !WALL_CLOCK.iter().any(|known| file.ends_with(known))).collect();
    assert_eq!(users(&files, &["SystemTime", "Realtime", "utc_ns()"]), []);
}

/// All Rust files of the project.
fn all_files() -> Vec<PathBuf> {
    ["interfaces", "services", "orchestration", "dashboards", "tests"]
        .map(|top| rust_files(&repository().join(top)))
        .concat()
}

#[test]
fn files_are_short() {
    let lines = |file: &PathBuf| fs::read_to_string(file).unwrap().lines().count();
    let long: Vec<_> = all_files().into_iter().filter(|file| lines(file) > LINES_MAX).collect();
    assert!(long.is_empty(), "more than {LINES_MAX} lines: {long:?}");
}

#[test]
fn every_file_says_first_what_it_holds() {
    let says = |file: &PathBuf| fs::read_to_string(file).unwrap().starts_with("//!");
    let silent: Vec<_> = all_files().into_iter().filter(|file| !says(file)).collect();
    assert!(silent.is_empty(), "without //! in the first line: {silent:#?}");
}

/// Files of all targets of the workspace, or of the fuzz targets, which are a workspace of their own.
fn roots_of_targets() -> Vec<PathBuf> {
    let packages = metadata();
    let targets = packages.iter().flat_map(|package| package["targets"].as_array().unwrap().clone());
    let mut roots: Vec<_> =
        targets.map(|target| PathBuf::from(target["src_path"].as_str().unwrap())).collect();
    roots.extend(rust_files(&repository().join("tests/fuzz/fuzz_targets")));
    roots
}

#[test]
fn every_file_of_the_project_belongs_to_a_target() {
    let compiled: BTreeSet<_> = roots_of_targets().iter().flat_map(|root| files_of_target(root)).collect();
    let unused: Vec<_> = all_files()
        .into_iter()
        .filter(|file| !compiled.contains(&file.canonicalize().unwrap()))
        .filter(|file| !file.ends_with("build.rs"))
        .collect();
    assert!(unused.is_empty(), "no target compiles {unused:#?}");
}

#[test]
fn system_tests_are_one_executable() {
    let tests = |package: &serde_json::Value| {
        let targets = package["targets"].as_array().unwrap().clone();
        targets.into_iter().filter(|target| target["kind"][0] == "test").count()
    };
    let packages = metadata();
    let package = packages.iter().find(|package| package["name"] == "flockslam").unwrap();
    assert_eq!(tests(package), 1);
    assert!(packages.iter().all(|package| tests(package) <= 1), "a library has at most one");
}

/// Each bullet of the section on invariants ends in `FILE.rs::NAME`: a function that asserts it, in the product or in a test.
/// Names that every crate or folder may have.
const COMMON_NAMES: [&str; 7] = ["lib", "mod", "main", "process", "settings", "metrics", "tests"];

#[test]
fn a_file_name_names_one_file() {
    let mut files: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for file in all_files().into_iter().filter(|file| file.extension().is_some_and(|kind| kind == "rs")) {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        if !COMMON_NAMES.contains(&name.as_str()) {
            files.entry(name).or_default().push(file);
        }
    }
    assert!(files.len() > 300, "{} names", files.len());
    let doubled: Vec<_> = files.iter().filter(|(_, files)| files.len() > 1).collect();
    assert!(doubled.is_empty(), "{doubled:#?}");
}

#[test]
fn each_invariant_names_what_asserts_it() {
    let text = fs::read_to_string(repository().join("ARCHITECTURE.md")).unwrap();
    let section = text.split("\n## Invariants").nth(1).expect("there is a section on invariants");
    let section = section.split("\n## ").next().unwrap();
    let bullets: Vec<_> = section.split("\n- ").skip(1).collect();
    assert!(bullets.len() >= 12, "{} invariants", bullets.len());
    let files = all_files();
    for bullet in bullets {
        let asserting: Vec<_> = bullet.split('`').filter_map(|word| word.split_once(".rs::")).collect();
        assert!(!asserting.is_empty(), "nothing is named that asserts it: {bullet}");
        for (path, name) in asserting {
            let whole = repository().join(format!("{path}.rs"));
            // Where the directory is clear from the text only the end of a path is given.
            let file = files.iter().find(|file| **file == whole);
            let file = file.or_else(|| files.iter().find(|file| file.ends_with(format!("{path}.rs"))));
            let file = file.unwrap_or_else(|| panic!("{path}.rs does not exist: {bullet}"));
            assert!(asserts(&fs::read_to_string(file).unwrap(), name), "{path}.rs::{name} asserts nothing");
        }
    }
}

/// Whether a file has a function of this name in which something is asserted or refused.
fn asserts(text: &str, name: &str) -> bool {
    let Some(at) = text.find(&format!("fn {name}(")) else { return false };
    // A function ends with a brace as far to the left as its first line.
    let first = &text[..at].rsplit('\n').next().unwrap();
    let end = format!("\n{}}}", " ".repeat(first.len() - first.trim_start().len()));
    let body = text[at..].split(&end).next().unwrap();
    ["assert", "panic!", "expect(", "Err("].iter().any(|word| body.contains(word))
}

#[test]
fn the_architecture_is_described_briefly_and_names_files_that_exist() {
    let text = fs::read_to_string(repository().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md is there");
    assert!(text.lines().count() <= 200, "{} lines", text.lines().count());
    let more = ["decisions", "exact-and-live", "seeing", "flock", "front-end", "processes"]
        .map(|name| repository().join(format!("docs/{name}.md")));
    let more = more.map(|path| fs::read_to_string(path).expect("a page of its own"));
    let named = [text, more.join("\n")].join("\n");
    let named = named.split('`').filter(|word| word.ends_with(".rs") && !word.contains(['*', '<', ' ', '{']));
    // Where the directory is clear from the text only the end of a path is given.
    let files = all_files();
    for path in named {
        assert!(files.iter().any(|file| file.ends_with(path)), "{path} is named and does not exist");
    }
}
