//! `cargo bench -p flockslam --bench faults`: the long form of the fault suite, as a table. A word behind `--` runs the rows that
//! have it in their names, a number sets how often each stage is killed (100).

#[path = "../support/mod.rs"]
mod support;

use flockslam_messages::Stage;
use support::faults::{
    Trial, crashing_starts, everything_at_once, kills_of_each_stage, kills_while_saving, stops_of_each_stage,
    storm,
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
    rows.push(("storm".to_owned(), Box::new(|runs| storm(0.6 * runs as f64, 3))));
    rows.push(("all at once".to_owned(), Box::new(|runs| everything_at_once(runs.div_ceil(10)))));
    rows.push(("saving".to_owned(), Box::new(|runs| kills_while_saving(runs, 5))));
    rows.push(("starts".to_owned(), Box::new(|runs| crashing_starts(Stage::DynamicCleaner, 30 * runs, 4))));
    rows
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let runs = words.iter().find_map(|word| word.parse().ok()).unwrap_or(RUNS);
    let wanted: Vec<&String> = words.iter().filter(|word| word.parse::<usize>().is_err()).collect();
    println!("{}", Trial::HEAD);
    for (name, trial) in rows() {
        if wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str())) {
            let trial = trial(runs);
            println!("{}", trial.line());
            trial.violations.iter().for_each(|violation| println!("VIOLATED: {violation}"));
        }
    }
}
