//! What could not be tested on this machine, printed once when all tests have ended.

use std::sync::Mutex;

static LEFT_OUT: Mutex<Vec<String>> = Mutex::new(Vec::new());

unsafe extern "C" {
    safe fn atexit(function: extern "C" fn()) -> i32;
}

/// Notes that `what` was not tested, since `reason`. Where `CI=true` every test has to run, so there it fails.
///
/// The output of a test that passes is not shown, so the list is written when the process ends.
pub fn not_tested(what: &str, reason: &str) {
    let line = format!("{what}: not tested, since {reason}");
    assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{line}");
    let mut left_out = LEFT_OUT.lock().unwrap();
    if left_out.is_empty() {
        assert_eq!(atexit(list), 0);
    }
    left_out.push(line);
}

extern "C" fn list() {
    let mut left_out = LEFT_OUT.lock().map(|left_out| left_out.clone()).unwrap_or_default();
    left_out.sort();
    left_out.dedup();
    eprintln!("\n{} not tested on this machine:", left_out.len());
    left_out.iter().for_each(|line| eprintln!("    {line}"));
}
