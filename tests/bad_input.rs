//! Input that is not usable: one clear line with place and reason, exit code 2, nothing written. Single bad lines are
//! counted and skipped. A run that is interrupted ends with what it has.

use crate::support;
use crate::support::{
    Outputs, RunningSet, building, flockslam, live_building, run, run_well, simulated_log, stderr,
};
use flockslam_messages::Stage;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::Path;

/// What an earlier run left.
const EARLIER: &[u8] = b"from an earlier run";

/// Runs with outputs of an earlier run in place and demands a refusal; gives back what was said.
fn refused(args: &[&str]) -> String {
    let directory = tempfile::tempdir().unwrap();
    for name in ["trajectory.tum", "map.pgm", "report.json"] {
        std::fs::write(directory.path().join(name), EARLIER).unwrap();
    }
    let args: Vec<_> = args.iter().map(|arg| (*arg).to_owned()).collect();
    let output = run("refused", directory.path(), &args);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
    assert!(output.stdout.is_empty(), "{args:?}: {}", support::stdout(&output));
    let mut left = 0;
    for entry in std::fs::read_dir(directory.path()).unwrap() {
        assert_eq!(std::fs::read(entry.unwrap().path()).unwrap(), EARLIER);
        left += 1;
    }
    assert_eq!(left, 3, "{args:?}: files were added or removed");
    stderr(&output)
}

/// As [`refused`]: what is said is one line that begins with `place` and has `reason` in it.
fn refused_at(args: &[&str], place: &str, reason: &str) {
    let text = refused(args);
    println!("{}", text.trim_end());
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(text.starts_with(&format!("flockslam: {place}")), "{place} is expected in: {text}");
    assert!(text.contains(reason), "{reason:?} is expected in: {text}");
}

/// A log with these bytes is refused at this line for this reason.
fn log_refused(bytes: &[u8], line: usize, reason: &str, more: &[&str]) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bad.log");
    std::fs::write(&path, bytes).unwrap();
    let name = path.to_str().unwrap();
    refused_at(&[&["map", name], more].concat(), &format!("{name}:{line}: "), reason);
}

#[test]
fn files_that_cannot_be_read_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("nowhere.log");
    let missing = missing.to_str().unwrap();
    refused_at(&["map", missing], &format!("{missing}: "), "No such file");
    let directory = directory.path().to_str().unwrap();
    refused_at(&["map", directory], &format!("{directory}: "), "not a recording that can be read");
    refused_at(&["demo", "--world", missing], &format!("{missing}: "), "No such file");
}

#[test]
fn logs_without_a_scan_are_refused() {
    log_refused(b"", 1, "empty", &[]);
    log_refused(&[0x00, 0xff, 0xfe, b'\n', 0x80, 0x81, b'\n'], 1, "not text", &[]);
    let noise: Vec<u8> =
        (0..100_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8 | 0x80).collect();
    log_refused(&noise, 1, "not text", &[]);
    log_refused(b"# only words\nPARAM robot_length 1\n", 2, "no scan", &[]);
    let longer = simulated_log(0.5).replace(" localhost", " 1.5 localhost");
    log_refused(longer.as_bytes(), 1, "the line has more fields", &[]);
}

#[test]
fn a_log_whose_poses_are_no_numbers_is_refused() {
    let mut log = String::new();
    for i in 0..50 {
        log += &format!("FLASER 3 1.0 1.5 2.0 nan nan nan nan nan nan {i}.000000 robot {i}.0\n");
    }
    log_refused(log.as_bytes(), 11, "not a finite number", &[]);
    let few: String = log.lines().take(4).map(|line| format!("{line}\n")).collect();
    log_refused(few.as_bytes(), 1, "not a finite number", &[]);
}

#[test]
fn a_log_that_breaks_off_is_refused_unless_that_is_allowed() {
    let log = simulated_log(5.0);
    let cut = &log[..log.len() - 300];
    log_refused(cut.as_bytes(), 50, "ends in the middle of this line", &[]);
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cut.log");
    std::fs::write(&path, cut).unwrap();
    let taken =
        ["map", path.to_str().unwrap(), "--set", "lidar_ingest.accept_truncated=true"].map(str::to_owned);
    let outputs = run_well("taken", &directory.path().join("out"), &taken);
    assert_eq!(outputs.report.scans, 49);
}

#[test]
fn a_line_without_end_or_with_too_many_beams_is_refused() {
    let huge = "FLASER ".to_owned() + &"1 ".repeat(34 << 20);
    log_refused(huge.as_bytes(), 1, "longer than 64 MiB", &[]);
    let announced = "FLASER 4000000000 1 2 3 0 0 0 0 0 0 1.0 robot 1.0\n".repeat(30);
    log_refused(announced.as_bytes(), 11, "number of beams", &[]);
}

#[test]
fn a_log_with_too_many_bad_lines_is_refused() {
    let bad = "FLASER 3 1.0 far 2.0 0 0 0 0 0 0 1.000000 robot 1.0\n".repeat(11);
    let log = simulated_log(3.0) + &bad;
    log_refused(log.as_bytes(), 41, "max_bad_line_share", &[]);
    let one = simulated_log(3.0) + bad.lines().next().unwrap() + "\n";
    log_refused(one.as_bytes(), 31, "max_bad_line_share", &["--set", "lidar_ingest.max_bad_line_share=0"]);
}

#[test]
fn single_bad_lines_are_counted_and_skipped() {
    let directory = tempfile::tempdir().unwrap();
    let good = simulated_log(5.0);
    let mut log = String::new();
    for (i, line) in good.lines().enumerate() {
        match i {
            10 => log += "FLASER 3 1.0 far 2.0 0 0 0 0 0 0 1.000000 robot 1.0\n",
            20 => log += "FLASER 3 1.0 2.0 2.0 0 0 nan 0 0 0 1.000000 robot 1.0\n",
            21 | 30 => log += "FLASER 3 1.0\n",
            _ => {}
        }
        log += &format!("{line}\n");
    }
    let map = |name: &str, text: &str| {
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        run_well(
            "skipped",
            &directory.path().join(format!("{name}.out")),
            &["map".to_owned(), path.display().to_string()],
        )
    };
    let (clean, dirty) = (map("clean.log", &good), map("dirty.log", &log));
    let expected =
        [("bad_number", 1), ("bad_pose", 1), ("too_few_fields", 2)].map(|(name, n)| (name.to_owned(), n));
    let counted = dirty.report.rejected.iter().filter(|(_, n)| **n > 0).map(|(name, n)| (name.clone(), *n));
    assert_eq!(counted.collect::<Vec<_>>(), expected);
    assert_eq!(dirty.bytes("trajectory.tum"), clean.bytes("trajectory.tum"));
    assert_eq!(dirty.report.map_hash, clean.report.map_hash);
}

#[test]
fn a_directory_that_cannot_be_written_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("file");
    std::fs::write(&file, b"precious").unwrap();
    for below in [file.clone(), file.join("out")] {
        let output = run("unwritable", &below, &building(10));
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.lines().count()), (Some(2), 1), "{text}");
        assert!(text.starts_with(&format!("flockslam: {}: ", below.display())), "{text}");
    }
    assert_eq!(std::fs::read(&file).unwrap(), b"precious");
}

#[test]
fn configurations_that_are_not_understood_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("robot.toml");
    let name = path.to_str().unwrap();
    std::fs::write(&path, "[mapper]\ncel_size_m = 0.1\n").unwrap();
    refused_at(&["demo", "--config", name], &format!("{name}:2: "), "did you mean `cell_size_m`?");
    std::fs::write(&path, "[mapper\n").unwrap();
    refused_at(&["demo", "--config", name], &format!("{name}:1: "), "");
    refused_at(&["demo", "--config", "/no/such.toml"], "/no/such.toml: ", "No such file");
    for (assignment, reason) in [
        ("maper.cell_size_m=0.1", "did you mean `mapper`?"),
        ("mapper.cell_size_m=wide", "wide"),
        ("mapper.cell_size_m", "section.key=value"),
    ] {
        refused_at(&["demo", "--set", assignment], &format!("--set {assignment}: "), reason);
    }
    refused_at(&["demo", "--set", "simulation.scan_rate_hz=-1"], "simulation", "scan_rate_hz");
    refused_at(&["demo", "--set", "simulation.wheel_slips=99999"], "simulation", "wheel_slips");
}

#[test]
fn keys_of_earlier_versions_are_refused_with_what_became_of_them() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("robot.toml");
    let name = path.to_str().unwrap();
    std::fs::write(&path, "[mapper]\ncell_size_m = 0.1\nhit_nat = 2.0\n").unwrap();
    let single = "sync_manager.closure.enabled=false";
    let in_file = format!("{name}:3: mapper.hit_nat is now fixed at 1.5");
    let alone =
        format!("--set {single}: sync_manager.closure.enabled is now called sync_manager.close_loops");
    for (option, value, text) in [("--config", name, in_file), ("--set", single, alone)] {
        refused_at(&["demo", option, value], &text, "");
        let output = flockslam().args(["config", option, value]).output().unwrap();
        let found = (output.status.code(), stderr(&output));
        assert_eq!(found, (Some(2), format!("flockslam: {text}\n")));
    }
}

#[test]
fn arguments_that_make_no_sense_are_refused() {
    refused_at(&["map", "--source", "x"], "--source x: ", "standard input");
    for rate in ["0", "-1", "fast", "inf"] {
        let text = refused(&["demo", &format!("--rate={rate}")]);
        assert!(text.contains("--rate"), "{text}");
    }
    assert!(refused(&["map"]).contains("RECORDING"));
}

#[test]
fn a_pipe_gives_the_same_result_as_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let log = simulated_log(20.0);
    let path = directory.path().join("piped.log");
    std::fs::write(&path, &log).unwrap();
    let from_file =
        run_well("file", &directory.path().join("file"), &["map".to_owned(), path.display().to_string()]);
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("pipe", &directory.path().join("pipe"), &args);
    let mut stdin = set.stdin.take().unwrap();
    // In pieces that do not end where lines end.
    for piece in log.as_bytes().chunks(1000) {
        stdin.write_all(piece).unwrap();
    }
    drop(stdin);
    let piped = set.finish();
    assert_eq!((piped.report.scans, from_file.report.scans), (200, 200));
    for name in ["trajectory.tum", "trajectory_online.tum", "map.pgm"] {
        assert!(piped.bytes(name) == from_file.bytes(name), "{name} differs");
    }
    assert_eq!(piped.report.map_hash, from_file.report.map_hash);
}

#[test]
fn an_empty_pipe_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start("silent", directory.path(), &args);
    assert_eq!(set.wait(), Some(2));
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

/// Starts a run, interrupts it, and demands outputs of what it had until then.
fn ends_in_good_order(out: &Path, args: &[String], interrupt: impl Fn(u32)) -> Outputs {
    let mut set = RunningSet::start_with("interrupted", out, args, |command| {
        command.process_group(0);
    });
    set.wait_until_handled(Stage::SyncManager, 60);
    interrupt(set.supervisor_pid());
    let outputs = set.finish();
    let lines = outputs.lines("trajectory.tum").len();
    assert!((60..2500).contains(&lines), "{lines}");
    // A stage that ends between receiving a scan and naming its pose takes that scan with it: counted, without a line.
    let lost = outputs.report.dropped.get("lost").copied().unwrap_or(0);
    assert_eq!(outputs.report.scans, lines as u64 + lost);
    for file in ["trajectory_online.tum", "map.pgm", "map.yaml", "map.png"] {
        assert!(!outputs.bytes(file).is_empty());
    }
    outputs
}

fn assert_no_restarts(outputs: &Outputs) {
    assert!(outputs.report.stages.values().all(|stage| stage.restarts == 0));
}

#[test]
fn an_interrupted_live_run_ends_with_what_it_has() {
    let directory = tempfile::tempdir().unwrap();
    let args = live_building(250, 20);
    assert_no_restarts(&ends_in_good_order(directory.path(), &args, |pid| support::send(pid, Signal::INT)));
}

#[test]
fn a_live_run_whose_processes_are_all_interrupted_at_once_ends_with_what_it_has() {
    let directory = tempfile::tempdir().unwrap();
    let outputs = ends_in_good_order(directory.path(), &live_building(250, 20), |pid| {
        // As a terminal does.
        kill_process_group(Pid::from_raw(pid as i32).unwrap(), Signal::INT).unwrap();
    });
    assert_no_restarts(&outputs);
}

#[test]
fn a_live_run_whose_processes_are_all_terminated_at_once_ends_with_what_it_has() {
    let directory = tempfile::tempdir().unwrap();
    // As a service manager does. Stages that end on their own are started again to finish the work.
    ends_in_good_order(directory.path(), &live_building(250, 20), |pid| {
        kill_process_group(Pid::from_raw(pid as i32).unwrap(), Signal::TERM).unwrap();
    });
}
