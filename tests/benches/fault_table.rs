//! `cargo bench -p flockslam --bench faults`: the long form of the fault suite, as a table. A word behind `--` runs the rows that
//! have it in their names, a number sets how often each stage is killed (100). `journal` alone measures what the journal costs a pose.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_messages::Stage;
use support::faults::{
    JournalCost, Overload, Trial, corrupt_scans, crashing_starts, endless_loop, everything_at_once,
    jumping_clock, kills_of_each_stage, kills_of_the_leader, kills_while_localized, kills_while_saving,
    overload, refusing_disk, repetitions, stops_of_each_stage, storm, terminations, torn_files,
};

const RUNS: usize = 100;

type Row = (String, Box<dyn Fn(usize) -> Trial>);

fn rows() -> Vec<Row> {
    let of_stage = |stage: Stage| {
        let kills = move |runs| kills_of_each_stage(&[stage], runs, 1);
        let stops = move |runs: usize| stops_of_each_stage(&[stage], runs.div_ceil(10), 2);
        [
            (format!("kill {}", stage.name()), Box::new(kills) as Box<dyn Fn(usize) -> Trial>),
            (format!("stop {}", stage.name()), Box::new(stops)),
        ]
    };
    let mut rows: Vec<Row> =
        Stage::ALL.into_iter().filter(|s| *s != Stage::SyncManager).flat_map(of_stage).collect();
    rows.push((
        "kill sync-manager".to_owned(),
        Box::new(|runs| kills_of_each_stage(&[Stage::SyncManager], runs, 1)),
    ));
    for stage in [Stage::LidarIngest, Stage::ScanMatcher, Stage::SyncManager] {
        let kills = move |runs: usize| kills_of_the_leader(stage, runs.div_ceil(2), 6);
        rows.push((format!("turns {}", stage.name()), Box::new(kills)));
    }
    for stage in Stage::ALL.into_iter().filter(|stage| *stage != Stage::SyncManager) {
        rows.push((format!("loop {}", stage.name()), Box::new(move |_| endless_loop(stage))));
    }
    rows.push(("torn".to_owned(), Box::new(|_| torn_files(7))));
    rows.push(("disk".to_owned(), Box::new(|runs| refusing_disk(runs.div_ceil(20)))));
    rows.push(("corrupt".to_owned(), Box::new(|_| corrupt_scans(1..13))));
    let overloads = [
        Overload::Slow(Stage::ScanMatcher, 10),
        Overload::Slow(Stage::ScanMatcher, 100),
        Overload::Slow(Stage::Mapper, 10),
        Overload::Hog,
    ];
    for kind in overloads {
        rows.push(("overload".to_owned(), Box::new(move |_| overload(kind))));
    }
    rows.push(("again".to_owned(), Box::new(|runs| repetitions(runs.div_ceil(10)))));
    rows.push(("terminate".to_owned(), Box::new(|runs| terminations(runs.div_ceil(5), 9))));
    rows.push(("clock".to_owned(), Box::new(|runs| jumping_clock(0.3 * runs as f64))));
    rows.push(("storm".to_owned(), Box::new(|runs| storm(0.6 * runs as f64, 3))));
    rows.push(("all at once".to_owned(), Box::new(|runs| everything_at_once(runs.div_ceil(10)))));
    rows.push(("saving".to_owned(), Box::new(|runs| kills_while_saving(runs, 5))));
    rows.push(("localized".to_owned(), Box::new(|runs| kills_while_localized(runs, 8))));
    rows.push(("starts".to_owned(), Box::new(|runs| crashing_starts(Stage::DynamicCleaner, 30 * runs, 4))));
    rows
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let runs = words.iter().find_map(|word| word.parse().ok()).unwrap_or(RUNS);
    let wanted: Vec<&String> = words.iter().filter(|word| word.parse::<usize>().is_err()).collect();
    if wanted.iter().any(|word| *word == "journal") {
        return println!("{}", JournalCost::measure(runs.div_ceil(10)).table());
    }
    println!("{}", Trial::HEAD);
    for (name, trial) in rows() {
        if wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str())) {
            let trial = trial(runs);
            println!("{}", trial.line());
            if name == "starts" {
                let (early_ms, late_ms) = trial.early_and_late_ms();
                println!("median start in the earlier half {early_ms:.0} ms, in the later {late_ms:.0} ms");
            }
            trial.complaints().iter().for_each(|complaint| println!("VIOLATED: {complaint}"));
        }
    }
}
