//! A broken assumption ends a process, whatever thread it is found in.

use flockslam::cli::abort_on_panic;
use std::os::unix::process::ExitStatusExt;
use std::process::Command;

/// Tells a second process of this executable to panic.
const PANIC: &str = "FLOCKSLAM_TEST_PANIC";

#[test]
fn a_panic_in_any_thread_kills_the_process() {
    if std::env::var_os(PANIC).is_some() {
        abort_on_panic();
        let _ = std::thread::spawn(|| panic!("an assumption is broken")).join();
        return;
    }
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--exact", "panics::a_panic_in_any_thread_kills_the_process", "--nocapture"])
        .env(PANIC, "1");
    let output = command.output().unwrap();
    assert_eq!(output.status.signal(), Some(6), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("an assumption is broken"));
}
