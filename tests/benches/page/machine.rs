//! Section `machine`, and the speed of a copy of 64 MiB, which is measured beside other times so that machines can be compared.

use std::fmt::Write;
use std::process::Command;
use std::time::Instant;

/// Bytes of the copy that tells how fast the machine was at that moment.
const COPIED_BYTES: usize = 64 << 20;
const COPIES: usize = 9;

/// The section about the machine. There is no date in it: the page changes when a figure changes.
pub fn section() -> String {
    let mut text = String::new();
    let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let _ = writeln!(
        text,
        "- processor: {}, {cores} cores",
        field("/proc/cpuinfo", "model name").unwrap_or("unknown".into())
    );
    let memory_kb = field("/proc/meminfo", "MemTotal")
        .and_then(|text| text.trim_end_matches("kB").trim().parse::<u64>().ok());
    let _ = writeln!(text, "- memory: {} MiB", memory_kb.unwrap_or(0) / 1024);
    let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let _ = writeln!(text, "- Linux {}, {}", kernel.trim(), std::env::consts::ARCH);
    let _ = writeln!(text, "- flockslam {}, {profile} profile", flockslam::VERSION);
    let _ = writeln!(text, "- {}", copy_line());
    text
}

/// The commit that is measured, as a sentence. Documents do not count as changes: the page is one.
pub fn measured_on() -> String {
    let git = |arguments: &[&str]| {
        let output =
            Command::new("git").args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=7", "HEAD"]) else { return "Of no commit.".to_owned() };
    let changes = git(&["status", "--porcelain", "--", ":/", ":!/docs"]).unwrap_or_default();
    let state = if changes.is_empty() { "" } else { " with changes" };
    format!("Commit {commit}{state}.")
}

/// What a copy of 64 MiB takes now, as a measure for every time measured beside it.
pub fn copy_line() -> String {
    let milliseconds = copy_ms();
    let gigabytes_per_s = COPIED_BYTES as f64 * 1e-6 / milliseconds;
    format!("copying 64 MiB: {milliseconds:.1} ms ({gigabytes_per_s:.1} GB/s), median of {COPIES}")
}

/// Speed of copying, GB/s.
pub fn copy_gb_per_s() -> f64 {
    COPIED_BYTES as f64 * 1e-6 / copy_ms()
}

/// The median time of a 64 MiB copy between two buffers that are in memory, milliseconds.
fn copy_ms() -> f64 {
    let source = vec![1u8; COPIED_BYTES];
    let mut target = vec![2u8; COPIED_BYTES];
    let mut times_ms: Vec<f64> = (0..COPIES)
        .map(|_| {
            let started = Instant::now();
            target.copy_from_slice(std::hint::black_box(&source));
            std::hint::black_box(&mut target);
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    times_ms[COPIES / 2]
}

fn field(path: &str, name: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(name))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}
