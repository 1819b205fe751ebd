//! The executable for processors of 64-bit ARM, run by an emulator: same bytes as here. `.ci/run` builds it where that is possible.

use crate::support::public_logs::ACES;
use crate::support::{self, Outputs, assert_nothing_left, building, run_well, stderr};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Path of the executable.
const EXECUTABLE: &str = "FLOCKSLAM_ARM64";
/// Lets the kernel start such executables by the emulator, for what is started from here on alone: the supervisor starts itself again as
/// every stage.
const BY_EMULATOR: &str = r#"
mount -t binfmt_misc none /proc/sys/fs/binfmt_misc
head=':flockslam-arm64:M::\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00'
mask=':\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff'
printf '%s%s:%s:F' "$head" "$mask" "$(command -v qemu-aarch64)" >/proc/sys/fs/binfmt_misc/register
exec "$0" "$@""#;
/// The system's loader for it. Where there is none, the libraries of the cross compiler serve; the two do not mix.
const LOADER: &str = "/lib/ld-linux-aarch64.so.1";
const LIBRARIES: (&str, &str) = ("QEMU_LD_PREFIX", "/usr/aarch64-linux-gnu");
const COMPARED: [&str; 5] = ["trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml", "truth.tum"];
const DURATION_S: u32 = 40;

/// The executable, as the machine starts it by itself or within namespaces of its own.
fn emulated() -> Command {
    let executable =
        std::env::var_os(EXECUTABLE).map(PathBuf::from).expect("FLOCKSLAM_ARM64 names the executable");
    let starts = with_libraries(Command::new(&executable)).arg("--version").output();
    if starts.is_ok_and(|output| output.status.success()) {
        return with_libraries(Command::new(executable));
    }
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "sh", "-ec", BY_EMULATOR]).arg(executable);
    with_libraries(command)
}

fn with_libraries(mut command: Command) -> Command {
    if !Path::new(LOADER).exists() {
        command.env(LIBRARIES.0, LIBRARIES.1);
    }
    command
}

fn run_emulated(out: &Path, args: &[String]) -> Outputs {
    let robot = support::robot("arm64");
    let output = emulated().args(args).args(["--robot", &robot, "--out"]).arg(out).output().unwrap();
    assert_nothing_left(&robot);
    assert!(output.status.success(), "{}", stderr(&output));
    Outputs::read(out)
}

#[test]
#[ignore = "needs FLOCKSLAM_ARM64, the executable for arm64"]
fn a_simulated_drive_gives_the_same_bytes_on_arm64() {
    let directories = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let args = building(DURATION_S);
    let here = run_well("here", directories[0].path(), &args);
    let there = run_emulated(directories[1].path(), &args);
    for name in COMPARED {
        assert!(here.bytes(name) == there.bytes(name), "{name} differs");
    }
    assert_eq!(here.report.map_hash, there.report.map_hash);
    println!("map hash {}", there.report.map_hash);
}

#[test]
#[ignore = "needs FLOCKSLAM_ARM64, the executable for arm64"]
fn a_log_gives_the_same_map_on_arm64() {
    let Some(here) = ACES.shared_run(&[]) else { return };
    let (here, directory) = (here.wait(), tempfile::tempdir().unwrap());
    let there =
        run_emulated(directory.path(), &["map".to_owned(), ACES.file("clf").unwrap().display().to_string()]);
    assert_eq!(here.report.map_hash, there.report.map_hash);
    println!("map hash {}", there.report.map_hash);
}
