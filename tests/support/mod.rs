//! What the tests of the whole system share: they run the real executable, each under a robot name of its own, and
//! wait for conditions with generous limits.

mod benchmark;
mod browser;
pub mod faults;
pub mod flocks;
mod http_get;
pub mod kidnapped_log;
mod later_free;
pub mod lidar_player;
pub mod limited_machine;
mod live;
pub mod machine_share;
mod montage;
mod moved_map;
mod moving_drive;
pub mod ndt_runs;
mod not_tested;
mod outputs;
mod pictures;
pub mod plan_pictures;
mod poses;
pub mod public_logs;
pub mod ros_peers;
pub mod ros_recording;
pub mod ros_rows;
mod running;
pub mod seeded_drives;
pub mod sensor_drive;
mod simulated_log;
pub mod slow_link;
pub mod small_mounts;
pub mod source;
pub mod tools;

pub use benchmark::{benchmark_file, evaluate_relations, evaluate_trajectory};
pub use browser::Browser;
pub use http_get::{free_port, http_get};
pub use later_free::later_free;
pub use live::{Drive, LiveSet, is_localized, of};
pub use montage::{montage, panel, picture_of_ways, store_picture};
pub use moved_map::{MapFigures, occupied_cells};
pub use moving_drive::{BUILDINGS, MovingDrive, MovingRun, UNCLEANED, moving_building, with_movers};
pub use not_tested::not_tested;
pub use outputs::{Outputs, known_truth_error_m, truth_error_m, truth_offsets_m};
pub use pictures::keep_picture;
pub use poses::{PoseWatch, SeenPose};
pub use running::{RunningSet, send, try_send};
pub use simulated_log::{simulated_drive, simulated_log};

use flockslam_messages::Stage;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Nothing that is waited for takes longer than this, however busy the machine is.
pub const LIMIT: Duration = Duration::from_secs(600);

/// A seeded drive through the simulated building.
pub fn building(duration_s: u32) -> Vec<String> {
    vec!["demo".to_owned(), "--set".to_owned(), format!("simulation.duration_s={duration_s}")]
}

/// As [`building`], replayed live at this many log seconds per second.
pub fn live_building(duration_s: u32, rate: u32) -> Vec<String> {
    let mut args = building(duration_s);
    args.extend(["--rate".to_owned(), rate.to_string()]);
    args
}

/// The executable under test.
pub fn flockslam() -> Command {
    Command::new(env!("CARGO_BIN_EXE_flockslam"))
}

/// Characters in the name of a set, at most.
const ROBOT_NAME_MAX: usize = 22;

/// A name for a process set that no other test and no other run has.
pub fn robot(test: &str) -> String {
    tools::install_early();
    machine_share::computes();
    static COUNT: AtomicU32 = AtomicU32::new(0);
    // The last letter keeps one name from being a prefix of another.
    let number = format!("-{}-{}t", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    // A longer name is refused, and so would be that of a late test in a process with a great number.
    let kept = test.len().min(ROBOT_NAME_MAX - number.len());
    format!("{}{number}", &test[..kept])
}

/// Runs the executable to its end under a name of its own.
pub fn run(test: &str, out: &Path, args: &[String]) -> Output {
    let robot = robot(test);
    let output = flockslam().args(args).args(["--robot", &robot, "--out"]).arg(out).output().unwrap();
    assert_nothing_left(&robot);
    output
}

/// As [`run`], and it must succeed.
pub fn run_well(test: &str, out: &Path, args: &[String]) -> Outputs {
    let output = run(test, out, args);
    assert!(output.status.success(), "{args:?}: {}\n{}", output.status, stderr(&output));
    Outputs::read(out)
}

/// What a process wrote to its standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What a process wrote to its standard output.
pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A set that has ended leaves neither a process nor anything in shared memory.
pub fn assert_nothing_left(robot: &str) {
    let in_memory: Vec<_> = std::fs::read_dir("/dev/shm")
        .unwrap()
        .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
        .filter(|name| name.contains(robot))
        .collect();
    assert!(in_memory.is_empty(), "left in shared memory: {in_memory:?}");
    let on_disk = flockslam::state_directory::spill_directory(None, None)
        .map(|directory| directory.join(format!("flockslam-spill-{robot}")));
    assert!(on_disk.as_ref().is_none_or(|folder| !folder.exists()), "left on disk: {on_disk:?}");
    let processes = processes_of(robot);
    assert!(processes.is_empty(), "left running: {processes:?}");
}

/// Processes whose command line names the set.
pub fn processes_of(robot: &str) -> Vec<u32> {
    let command_line = |pid: &u32| std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    std::fs::read_dir("/proc")
        .unwrap()
        .filter_map(|entry| entry.ok()?.file_name().to_string_lossy().parse().ok())
        .filter(|pid| String::from_utf8_lossy(&command_line(pid)).contains(robot))
        .collect()
}

/// Looks until there is something to see.
pub fn wait_for<T>(what: &str, look: impl FnMut() -> Option<T>) -> T {
    wait_for_every(Duration::from_millis(2), what, look)
}

/// As [`wait_for`], with so long a pause between two looks: who looks all the time takes the processor from what is waited for.
pub fn wait_for_every<T>(pause: Duration, what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + LIMIT;
    loop {
        if let Some(seen) = look() {
            return seen;
        }
        assert!(Instant::now() < deadline, "{what}: not within {} s", LIMIT.as_secs());
        std::thread::sleep(pause);
    }
}

/// The benchmark logs, where they are at hand.
pub fn data_dir() -> Option<PathBuf> {
    let beside = repository().join("../shared/data");
    let directory = std::env::var_os("FLOCKSLAM_DATA").map_or(beside, PathBuf::from);
    if directory.join("intel/intel.clf").is_file() {
        return Some(directory);
    }
    not_tested("real logs", &format!("there are none in {} (set FLOCKSLAM_DATA)", directory.display()));
    None
}

/// The top of the source tree.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The stages by the names used everywhere.
pub fn stage_names() -> [&'static str; 6] {
    Stage::ALL.map(Stage::name)
}
