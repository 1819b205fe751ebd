//! A set that has nothing to do costs next to nothing.

use crate::support;
use crate::support::RunningSet;
use crate::support::machine_share;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::time::{Duration, Instant};

/// How long is looked at the set.
const SPAN: Duration = Duration::from_secs(5);
/// So often all seven processes together may wake up, a second: a tenth more than the 33.0 that were measured. Processor time would
/// depend on the machine and on what else runs there.
const WAKES_MAX: f64 = 36.3;

/// How often the threads of a process have gone to sleep, and their processor time, seconds.
fn effort(pid: u32) -> (u64, f64) {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let of_thread = |thread: std::io::Result<std::fs::DirEntry>| {
        let thread = thread.unwrap().path();
        let status = std::fs::read_to_string(thread.join("status")).unwrap();
        let sleeps = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
        // The first number is the time on a processor, nanoseconds; `stat` counts in ticks of 10 ms.
        let statistics = std::fs::read_to_string(thread.join("schedstat")).unwrap();
        let on_processor_ns: f64 = statistics.split(' ').next().unwrap().parse().unwrap();
        (sleeps.unwrap().trim().parse::<u64>().unwrap(), on_processor_ns * 1e-9)
    };
    threads.map(of_thread).fold((0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
}

#[test]
fn a_set_with_an_idle_pipe_has_few_wakeups() {
    machine_share::alone();
    let directory = tempfile::tempdir().unwrap();
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("idle", directory.path(), &args);
    let mut pids = Stage::ALL.map(|stage| set.pid(stage)).to_vec();
    pids.push(set.supervisor_pid());
    let before: Vec<_> = pids.iter().map(|pid| effort(*pid)).collect();
    let began = Instant::now();
    std::thread::sleep(SPAN);
    let span_s = began.elapsed().as_secs_f64();
    let mut wakes = 0;
    for ((name, pid), before) in
        Stage::ALL.map(Stage::name).iter().chain([&"supervisor"]).zip(&pids).zip(before)
    {
        let now = effort(*pid);
        wakes += now.0 - before.0;
        let share = (now.1 - before.1) / span_s;
        println!(
            "{name}: {:.1} times a second, {:.3} % of a core",
            (now.0 - before.0) as f64 / span_s,
            100.0 * share
        );
    }
    let wakes = wakes as f64 / span_s;
    println!("seven idle processes: {wakes:.1} times a second");
    assert!(wakes < WAKES_MAX, "{wakes}");
    // The stages are still the same: nothing was restarted meanwhile.
    assert_eq!(pids[..6], Stage::ALL.map(|stage| set.pid(stage)));
    support::send(set.supervisor_pid(), Signal::KILL);
    drop(set.stdin.take());
}
