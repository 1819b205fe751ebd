//! The house's own rules: who may import whom, what logic may touch, and how long a file may be.

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use support::repository;

/// Crates that others may import, lowest layer first; an import goes to a lower layer only.
const LIBRARIES: [(&str, u32); 11] = [
    ("geometry", 0),
    ("evidence", 1),
    ("messages", 2),
    ("records", 2),
    ("bus", 3),
    ("journal", 3),
    ("telemetry", 3),
    ("registration", 4),
    ("sight", 4),
    ("stage", 4),
    ("page", 5),
];
const SERVICE_LAYER: u32 = 5;
const ORCHESTRATION_LAYER: u32 = 6;
const LINES_MAX: usize = 500;
/// What logic, which is a function of its inputs, must not reach for.
const OUTSIDE_WORLD: [&str; 7] =
    ["std::fs", "std::thread", "std::time::Instant", "SystemTime", "std::net", "iceoryx2", "zenoh::"];

/// Normal dependencies of every member of the workspace.
fn imports() -> BTreeMap<String, Vec<String>> {
    let mut command = Command::new(env!("CARGO"));
    command.args(["metadata", "--no-deps", "--offline", "--format-version", "1"]).current_dir(repository());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", support::stderr(&output));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
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

#[test]
fn one_crate_each_opens_the_two_networks() {
    let importers = |library: &str| -> Vec<String> {
        let has = |dependencies: &Vec<String>| dependencies.iter().any(|name| name == library);
        imports()
            .into_iter()
            .filter(|(_, dependencies)| has(dependencies))
            .map(|(package, _)| package)
            .collect()
    };
    assert_eq!(importers("iceoryx2"), ["flockslam-bus"]);
    assert_eq!(importers("zenoh"), ["flockslam-sync-manager"]);
}

fn rust_files(below: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(below).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files
}

/// The part of a file that is compiled into the product.
fn product_part(file: &Path) -> String {
    let text = fs::read_to_string(file).unwrap();
    let module = file.file_stem().unwrap().to_string_lossy().into_owned();
    let parents = ["lib.rs", "mod.rs"].map(|name| file.parent().unwrap().join(name));
    let of_tests = format!("#[cfg(test)]\nmod {module};");
    if parents.iter().any(|parent| fs::read_to_string(parent).is_ok_and(|text| text.contains(&of_tests))) {
        return String::new();
    }
    text.split("#[cfg(test)]\nmod tests {").next().unwrap().to_owned()
}

fn is_shell(file: &Path) -> bool {
    let mut parts = file.components().map(|part| part.as_os_str().to_string_lossy().into_owned());
    parts.any(|part| part == "process" || part == "process.rs")
}

#[test]
fn logic_reaches_for_nothing_outside_of_its_inputs() {
    let mut looked_at = 0;
    for service in fs::read_dir(repository().join("services")).unwrap() {
        let service = service.unwrap().path();
        if service.ends_with("stage") {
            continue;
        }
        for file in rust_files(&service.join("src")).iter().filter(|file| !is_shell(file)) {
            let text = product_part(file);
            for (index, line) in text.lines().enumerate() {
                let reached = OUTSIDE_WORLD.iter().find(|name| line.contains(**name));
                assert!(reached.is_none(), "{}:{}: {}", file.display(), index + 1, line.trim());
            }
            looked_at += 1;
        }
    }
    assert!(looked_at > 40, "only {looked_at} files were found");
}

/// What reads the wall clock, and the one place that puts it into a message, for exports.
const WALL_CLOCK: [&str; 2] = ["telemetry/src/clock.rs", "lidar-ingest/src/process.rs"];

#[test]
fn nothing_but_exports_knows_the_wall_clock() {
    for top in ["interfaces", "services", "orchestration/src"] {
        for file in rust_files(&repository().join(top)) {
            let text = product_part(&file);
            let reads = ["SystemTime", "Realtime", "utc_ns()"].iter().any(|name| text.contains(name));
            let may = WALL_CLOCK.iter().any(|known| file.ends_with(known));
            assert!(!reads || may, "{} reads the wall clock", file.display());
        }
    }
}

#[test]
fn files_are_short() {
    let mut longest = (0, PathBuf::new());
    for directory in ["interfaces", "services", "orchestration", "tests"] {
        for file in rust_files(&repository().join(directory)) {
            let lines = fs::read_to_string(&file).unwrap().lines().count();
            assert!(lines <= LINES_MAX, "{} has {lines} lines", file.display());
            longest = longest.max((lines, file));
        }
    }
    println!("the longest file: {} ({} lines)", longest.1.display(), longest.0);
}

#[test]
fn the_architecture_is_described_briefly_and_names_files_that_exist() {
    let text = fs::read_to_string(repository().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md is there");
    assert!(text.lines().count() < 250, "{} lines", text.lines().count());
    let more = ["decisions", "seeing", "flock"].map(|name| repository().join(format!("docs/{name}.md")));
    let more = more.map(|path| fs::read_to_string(path).expect("a page of its own"));
    let named = [text, more.join("\n")].join("\n");
    let named = named
        .split('`')
        .filter(|word| word.ends_with(".rs") && word.contains('/') && !word.contains(['*', '<', ' ', '{']));
    // Where the directory is clear from the text only the end of a path is given.
    let files: Vec<_> = ["interfaces", "services", "orchestration", "tests"]
        .iter()
        .flat_map(|top| rust_files(&repository().join(top)))
        .collect();
    for path in named {
        assert!(
            files.iter().any(|file| file.ends_with(path)),
            "ARCHITECTURE.md names {path}, which does not exist"
        );
    }
}
