//! Section `strategies`: error and processor time of each way to match a scan.

use super::accuracy::plain;
use super::runs::{Errors, Measured, Outcome, set};
use super::{Bench, Table, figure, greatest, mean};

/// Strategies of the matcher, and how many seeds are run of each.
const STRATEGIES: [(&str, usize); 5] =
    [("gauss-newton", 1), ("monte-carlo", 3), ("hill-climbing", 1), ("correlative", 1), ("ndt", 1)];

/// Accuracy and cost of each matching strategy.
pub fn section(bench: &mut Bench) -> String {
    let mut table = Table::new([
        "",
        "strategy",
        "all",
        "short",
        "loops",
        "rotation",
        "maximum",
        "online, all",
        "CPU per scan",
    ]);
    for subject in bench.subjects() {
        for (strategy, seeds) in STRATEGIES {
            let seeds = if bench.plan.patient { seeds } else { 1 };
            let runs: Vec<Outcome> = (1..=seeds)
                .map(|seed| match (strategy, seed) {
                    ("gauss-newton", 1) => plain(bench, &subject),
                    _ => bench.runs.of(&subject, &options(strategy, seed)),
                })
                .collect();
            row(&mut table, &subject.name, strategy, &runs);
        }
    }
    format!(
        "`--set scan_matcher.strategy=NAME`, all else as above, one start heading. `monte-carlo` draws random numbers: mean over the seeds 1 … {} (`scan_matcher.seed`), maximum over all of them. \
         Metres, degrees, milliseconds of processor time of the whole set; in the simulated building *all* is the ATE and *short* the error per metre. The back end is the same for all: *online* shows the strategy alone.\n\n{table}",
        if bench.plan.patient { 3 } else { 1 }
    )
}

fn options(strategy: &str, seed: usize) -> Vec<String> {
    set(&[&format!("scan_matcher.strategy={strategy}"), &format!("scan_matcher.seed={seed}")])
}

fn row(table: &mut Table, subject: &str, strategy: &str, runs: &[Outcome]) {
    if let Some(Err(reason)) = runs.iter().find(|run| run.is_err()) {
        return table.row([subject, strategy, &format!("failed: {reason}")]);
    }
    let runs: Vec<&Measured> = runs.iter().flatten().map(|run| &**run).collect();
    let of = |value: fn(&Errors) -> f64| runs.iter().map(|run| value(&run.last)).collect::<Vec<_>>();
    let online: Vec<f64> = runs.iter().map(|run| run.online.translation_m()).collect();
    let cpu: Vec<f64> = runs.iter().map(|run| run.cpu_ms_per_scan()).collect();
    table.row([
        subject.to_owned(),
        strategy.to_owned(),
        figure(mean(&of(Errors::translation_m)), 4),
        figure(mean(&of(Errors::short_m)), 4),
        figure(mean(&of(Errors::loop_m)), 4),
        figure(mean(&of(Errors::rotation_deg)), 3),
        figure(greatest(&of(Errors::max_m)), 2),
        figure(mean(&online), 4),
        figure(mean(&cpu), 2),
    ]);
}
