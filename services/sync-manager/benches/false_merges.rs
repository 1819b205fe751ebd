//! Trials of meetings with false constraints: how many are merged that should be, and how many that should not.
//!
//! `cargo bench -p flockslam-sync-manager --bench false_merges -- [FIRST] [COUNT]` prints a line for each trial and the sum; 200 from 0 on by default.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[path = "../tests/synthetic/meeting_trials.rs"]
mod meeting_trials;
#[allow(dead_code, reason = "what several tests share, one of them does not need all of")]
#[path = "../tests/synthetic/support.rs"]
mod support;
#[path = "../tests/synthetic/synthetic_flock.rs"]
mod synthetic_flock;

use std::collections::BTreeMap;
use std::time::Instant;

/// How trials of one kind went.
#[derive(Default)]
struct Tally {
    trials: u32,
    merged: u32,
    wrongly: u32,
    worst_m: f64,
    searches: u64,
}

fn main() {
    // Cargo adds an option of its own.
    let arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let mut arguments = arguments.map(|argument| argument.parse().expect("a number"));
    let (first, count): (u64, u64) = (arguments.next().unwrap_or(0), arguments.next().unwrap_or(200));
    let mut tallies: BTreeMap<(bool, &str), Tally> = BTreeMap::new();
    for number in first..first + count {
        let (trial, started) = (meeting_trials::trial(number), Instant::now());
        let outcome = meeting_trials::run(&trial);
        let tally = tallies.entry((trial.is_meeting, trial.kind)).or_default();
        tally.trials += 1;
        tally.merged += u32::from(outcome.merged);
        tally.wrongly += u32::from(outcome.is_false_merge());
        tally.worst_m = tally.worst_m.max(outcome.worst_m);
        tally.searches += outcome.searches;
        println!(
            "{number:3} {:32} {} worst {:.3} m, {} records of true constraints, {} of false ones, {} searches, {:.1} s",
            trial.kind,
            if outcome.is_false_merge() {
                "MERGED WRONGLY"
            } else if outcome.merged {
                "merged"
            } else {
                "apart"
            },
            outcome.worst_m,
            outcome.closures.0,
            outcome.closures.1,
            outcome.searches,
            started.elapsed().as_secs_f64()
        );
    }
    let mut sums = [Tally::default(), Tally::default()];
    for ((is_meeting, kind), tally) in &tallies {
        println!(
            "{kind}: {} trials, {} merged, {} of them wrongly, worst error {:.3} m, {} searches",
            tally.trials, tally.merged, tally.wrongly, tally.worst_m, tally.searches
        );
        let sum = &mut sums[usize::from(*is_meeting)];
        sum.trials += tally.trials;
        sum.merged += tally.merged;
        sum.wrongly += tally.wrongly;
    }
    let [different, meetings] = sums;
    println!(
        "{} of {} meetings merged rightly; {} false merges in {} trials",
        meetings.merged - meetings.wrongly,
        meetings.trials,
        meetings.wrongly + different.wrongly,
        meetings.trials + different.trials
    );
}
