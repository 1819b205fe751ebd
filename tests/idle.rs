//! A set that has nothing to do costs next to nothing.

use crate::support;
use crate::support::RunningSet;
use crate::support::machine_share;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::time::{Duration, Instant};

/// How long is looked at the processor time.
const SPAN: Duration = Duration::from_secs(5);
const SHARE_MAX: f64 = 0.01;
/// Other work on the machine makes idle processes more expensive as well (cold caches): there is another look.
const LOOKS: usize = 3;

/// Processor time of all threads of a process, seconds.
fn cpu_s(pid: u32) -> f64 {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let nanoseconds = threads.map(|thread| {
        // The first number is the time on a processor, nanoseconds; `stat` counts in ticks of 10 ms.
        let statistics = std::fs::read_to_string(thread.unwrap().path().join("schedstat")).unwrap();
        statistics.split(' ').next().unwrap().parse::<f64>().unwrap()
    });
    nanoseconds.sum::<f64>() * 1e-9
}

#[test]
fn a_set_whose_pipe_is_silent_uses_under_one_hundredth_of_a_core() {
    machine_share::alone();
    let directory = tempfile::tempdir().unwrap();
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("idle", directory.path(), &args);
    let mut pids = Stage::ALL.map(|stage| set.pid(stage)).to_vec();
    pids.push(set.supervisor_pid());
    let mut share = f64::INFINITY;
    for _ in 0..LOOKS {
        let (began, before): (_, Vec<_>) = (Instant::now(), pids.iter().map(|pid| cpu_s(*pid)).collect());
        std::thread::sleep(SPAN);
        let used: Vec<_> = pids.iter().zip(before).map(|(pid, before)| cpu_s(*pid) - before).collect();
        share = used.iter().sum::<f64>() / began.elapsed().as_secs_f64();
        println!("seven idle processes: {:.2} % of a core", 100.0 * share);
        for (name, used_s) in Stage::ALL.map(Stage::name).iter().chain([&"supervisor"]).zip(&used) {
            println!("  {name}: {:.3} %", 100.0 * used_s / SPAN.as_secs_f64());
        }
        if share < SHARE_MAX {
            break;
        }
    }
    assert!(share < SHARE_MAX, "{share}");
    // The stages are still the same: nothing was restarted meanwhile.
    assert_eq!(pids[..6], Stage::ALL.map(|stage| set.pid(stage)));
    support::send(set.supervisor_pid(), Signal::KILL);
    drop(set.stdin.take());
}
