//! The tree of the Debian package, laid out with the executable under test: what is in it, and that it fits together.

use crate::support::{not_tested, repository, stderr, stdout};
use flockslam::supervisor::SetDescription;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// No service is less shut off than this, by the count of systemd-analyze.
const EXPOSURE_MAX: f64 = 3.0;
/// The glibc of Debian 12 and Ubuntu 22.04 has all symbols up to this version.
const GLIBC_MAX: (u32, u32) = (2, 35);

fn deploy(file: &str) -> PathBuf {
    repository().join("orchestration/deploy").join(file)
}

fn run(command: &mut Command) -> Option<Output> {
    command.output().ok()
}

/// The tree; `None` where the tools for it are missing.
fn staged(directory: &Path) -> Option<PathBuf> {
    if run(Command::new("python3").arg("--version")).is_none() {
        not_tested("the tree of the package", "there is no python3");
        return None;
    }
    let tree = directory.join("tree");
    let mut command = Command::new("bash");
    command.arg(deploy("package.sh")).arg("--stage").arg(&tree);
    let output = command.arg("--executable").arg(env!("CARGO_BIN_EXE_flockslam")).output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    Some(tree)
}

fn files_below(folder: &Path, root: &Path, found: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() && !entry.is_symlink() {
            files_below(&entry, root, found);
        } else {
            found.insert(entry.strip_prefix(root).unwrap().display().to_string());
        }
    }
}

fn unzipped(path: &Path) -> String {
    let output = Command::new("gzip").arg("-dc").arg(path).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&output)
}

#[test]
fn the_tree_has_all_parts_of_the_package_and_they_name_each_other_rightly() {
    let directory = tempfile::tempdir().unwrap();
    let Some(tree) = staged(directory.path()) else { return };
    let mut files = BTreeSet::new();
    files_below(&tree, &tree, &mut files);
    for file in [
        "usr/bin/flockslam",
        "usr/lib/systemd/system/flockslam@.service",
        "usr/lib/udev/rules.d/60-flockslam-lidars.rules",
        "usr/lib/sysctl.d/60-flockslam.conf",
        "usr/share/doc/flockslam/examples/one-robot.toml",
        "usr/share/doc/flockslam/copyright",
        "usr/share/flockslam/dashboards/prometheus.yml",
        "usr/share/man/man1/flockslam.1.gz",
        "usr/share/man/man1/flockslam-doctor.1.gz",
        "usr/share/man/man1/flockslam-lidar-list.1.gz",
        "usr/share/bash-completion/completions/flockslam",
        "usr/share/zsh/vendor-completions/_flockslam",
        "usr/share/fish/vendor_completions.d/flockslam.fish",
        "opt/flockslam/lib/flockslam/flockslam",
        "opt/flockslam/share/flockslam/launch/flockslam.launch.py",
        "opt/flockslam/share/flockslam/config/parameters.yaml",
        "opt/flockslam/share/ament_index/resource_index/packages/flockslam",
        "opt/flockslam/setup.bash",
        "etc/flockslam/ros2/parameters.yaml",
    ] {
        assert!(files.contains(file), "{file} is not among {files:?}");
    }
    let link = fs::read_link(tree.join("opt/flockslam/lib/flockslam/flockslam")).unwrap();
    assert_eq!(link, Path::new("/usr/bin/flockslam"));
    let package = fs::read_to_string(tree.join("opt/flockslam/share/flockslam/package.xml")).unwrap();
    assert!(package.contains(&format!("<version>{}</version>", flockslam::VERSION)), "{package}");
    let licences = unzipped(&tree.join("usr/share/doc/flockslam/third-party-licences.txt.gz"));
    for library in ["iceoryx2 ", "zenoh ", "clap ", "serialport ", "nalgebra "] {
        assert!(licences.contains(&format!("\n{library}")), "{library}");
    }
    assert!(!licences.contains("\nproptest "), "libraries of tests are not in the executable");
    // A set that is in the package can be read with what is beside it.
    let set = SetDescription::read(&tree.join("opt/flockslam/share/flockslam/config/robot.toml")).unwrap();
    let arguments = set.ros.unwrap().args;
    let parameters = arguments.last().unwrap().strip_prefix('/').unwrap();
    assert!(files.contains(parameters), "{parameters}");
    let source = format!("source {}/opt/flockslam/setup.bash; echo $AMENT_PREFIX_PATH", tree.display());
    let prefix = stdout(
        &Command::new("bash").args(["-c", &source]).env("AMENT_PREFIX_PATH", "/ros").output().unwrap(),
    );
    assert_eq!(prefix.trim(), format!("{}/opt/flockslam:/ros", tree.display()));
}

#[test]
fn what_is_missing_to_build_for_another_processor_is_named_in_one_line() {
    let directory = tempfile::tempdir().unwrap();
    for tool in ["dirname", "uname", "sed", "head"] {
        std::os::unix::fs::symlink(Path::new("/usr/bin").join(tool), directory.path().join(tool)).unwrap();
    }
    let (other, compiler) = if cfg!(target_arch = "aarch64") {
        ("amd64", "x86_64-linux-gnu-gcc")
    } else {
        ("arm64", "aarch64-linux-gnu-gcc")
    };
    let mut command = Command::new("/bin/bash");
    command.arg(deploy("package.sh")).args(["--arch", other, "--build", "dev"]);
    let output = command.env("PATH", directory.path()).output().unwrap();
    let text = stderr(&output);
    assert_eq!((output.status.code(), text.lines().count()), (Some(3), 1), "{text}");
    assert!(text.starts_with(&format!("package.sh: {other} cannot be built here, missing: ")), "{text}");
    assert!(text.contains(compiler), "{text}");
}

#[test]
fn the_service_is_shut_off_from_the_rest_of_the_system() {
    let directory = tempfile::tempdir().unwrap();
    let unit = directory.path().join("flockslam@r1.service");
    fs::copy(deploy("flockslam@.service"), &unit).unwrap();
    let analysis = Command::new("systemd-analyze").args(["security", "--offline=yes"]).arg(&unit).output();
    let Ok(analysis) = analysis else {
        return not_tested("how far the unit is shut off", "there is no systemd-analyze");
    };
    let text = stdout(&analysis);
    let last = text.lines().rfind(|line| line.contains("exposure level"));
    let Some(last) = last else {
        return not_tested("how far the unit is shut off", "systemd-analyze cannot tell");
    };
    let exposure: f64 = last.split(": ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(exposure < EXPOSURE_MAX, "{last}");
}

#[test]
fn the_launch_file_has_the_arguments_of_nav2_and_is_python() {
    let launch = deploy("ros2/flockslam.launch.py");
    let text = fs::read_to_string(&launch).unwrap();
    for argument in ["use_sim_time", "slam_params_file", "autostart", "use_lifecycle_manager", "namespace"] {
        assert!(text.contains(&format!("\"{argument}\": (")), "{argument}");
    }
    let check = "import ast, sys; ast.parse(open(sys.argv[1]).read())";
    match Command::new("python3").args(["-c", check]).arg(&launch).output() {
        Ok(output) => assert!(output.status.success(), "{}", stderr(&output)),
        Err(_) => not_tested("the launch file", "there is no python3"),
    }
}

#[test]
fn scripts_of_the_package_are_shell_and_keep_maps_unless_purged() {
    for name in ["postinst", "prerm", "postrm"] {
        let output = Command::new("sh").arg("-n").arg(deploy("package").join(name)).output().unwrap();
        assert!(output.status.success(), "{name}: {}", stderr(&output));
    }
    let text = fs::read_to_string(deploy("package/postrm")).unwrap();
    let (before, behind) = text.split_once("rm -rf /var/lib").unwrap();
    assert!(before.contains("if [ \"$1\" = purge ]; then") && !before.contains("\nfi\n"), "{before}");
    assert!(behind.contains("\nfi\n"));
}

#[test]
fn no_symbol_is_newer_than_the_glibc_that_the_package_names() {
    let Some(output) = run(Command::new("objdump").args(["-T", env!("CARGO_BIN_EXE_flockslam")])) else {
        return not_tested("the symbols of glibc", "there is no objdump");
    };
    let text = stdout(&output);
    let version = |symbol: &str| {
        let (major, minor) = symbol.split_once('.')?;
        let minor = minor.split(|c: char| !c.is_ascii_digit()).next()?;
        Some((major.parse().ok()?, minor.parse().ok()?))
    };
    let newest = text.split("GLIBC_").skip(1).filter_map(version).max();
    let newest: (u32, u32) = newest.expect("it uses glibc");
    assert!(newest <= GLIBC_MAX, "{newest:?}");
}
