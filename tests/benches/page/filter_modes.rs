//! Section `filter`: takes runs of each mode of the filter, gives what is dropped, the error, and the processor time that is saved.

use super::accuracy::start;
use super::runs::{Errors, Measured, Outcome, Subject, set};
use super::{Bench, Table, duration, figure, mean, simulated};
use flockslam_correlation_filter::process::tally_part;
use flockslam_correlation_filter::{CorrelationFilter, Settings};
use flockslam_messages::{ScanBuffer, Stage};
use std::rc::Rc;
use std::time::Instant;

/// Start headings that are run at most.
const HEADINGS_MAX: usize = 2;
/// Runs of which the one with the least processor time counts, where that is the question.
const REPETITIONS: usize = 2;
const MODES: [&str; 4] = ["off", "correlation", "seed-exact", "motion"];
/// Strategies of the matcher beside the default, and how many seeds are run of each: more than one where it draws random numbers.
const STRATEGIES: [(&str, u64); 4] =
    [("correlative", 1), ("ndt", 1), ("hill-climbing", 1), ("monte-carlo", SEEDS)];
const SEEDS: u64 = 3;
/// The stages that a dropped scan spares.
const SPARED: [Stage; 3] = [Stage::ScanMatcher, Stage::Mapper, Stage::DynamicCleaner];
const LARGE_BEAMS: usize = 10_000_000;

/// What the filter drops, what that costs in accuracy, and what it saves.
pub fn section(bench: &mut Bench) -> String {
    let mut table = table();
    let headings: Vec<f64> = bench.plan.headings_rad.iter().copied().take(HEADINGS_MAX).collect();
    for log in bench.logs.clone() {
        let runs = |bench: &mut Bench, mode: &str| -> Vec<Outcome> {
            let options = |heading: f64| [start(heading), vec_of_mode(mode)].concat();
            headings.iter().map(|heading| bench.runs.of(&log, &options(*heading))).collect()
        };
        rows(bench, &mut table, (&log.name, "gauss-newton"), &MODES, runs);
    }
    for log in bench.logs.clone() {
        for (strategy, seeds) in STRATEGIES {
            let seeds = if bench.plan.patient { seeds } else { 1 };
            let runs = |bench: &mut Bench, mode: &str| -> Vec<Outcome> {
                let strategy = format!("scan_matcher.strategy={strategy}");
                let seed = |seed| set(&[&strategy, &format!("scan_matcher.seed={seed}")]);
                (1..=seeds).map(|n| bench.runs.of(&log, &[seed(n), vec_of_mode(mode)].concat())).collect()
            };
            rows(bench, &mut table, (&log.name, strategy), &MODES[..3], runs);
        }
    }
    format!(
        "{}Mean error over all relations with and without the filter, the same settings for all logs; means over {} start headings with `gauss-newton` (the default), over {} seeds \
         with `monte-carlo`, which draws random numbers. *CPU* is the processor time of matcher, mapper and cleaner for each scan of the log, \
         and what it is less than without the filter. `seed-exact` is the program published with the source work (An. Filatov 2021), defects included, `motion` asks odometry alone.\n\n{table}\n{}\n{}\n{}",
        bench.absence(),
        headings.len(),
        if bench.plan.patient { SEEDS } else { 1 },
        published_costs(bench),
        simulations(bench),
        speeds(),
    )
}

fn table() -> Table {
    Table::new([
        "",
        "strategy",
        "filter",
        "all",
        "against off",
        "rotation",
        "dropped",
        "overridden",
        "CPU",
        "saved",
    ])
}

fn vec_of_mode(mode: &str) -> Vec<String> {
    set(&[&format!("correlation_filter.mode={mode}")])
}

fn rows(
    bench: &mut Bench,
    table: &mut Table,
    (name, strategy): (&str, &str),
    modes: &[&str],
    mut runs: impl FnMut(&mut Bench, &str) -> Vec<Outcome>,
) {
    let mut off = None;
    for &mode in modes {
        let outcomes = runs(bench, mode);
        if let Some(Err(reason)) = outcomes.iter().find(|run| run.is_err()) {
            table.row([name, strategy, mode, &format!("failed: {reason}")]);
            continue;
        }
        let runs: Vec<Rc<Measured>> = outcomes.into_iter().flatten().collect();
        let of =
            |value: &dyn Fn(&Measured) -> f64| mean(&runs.iter().map(|run| value(run)).collect::<Vec<_>>());
        let (error_m, cpu_ms) = (of(&|run| run.last.translation_m()), of(&spared_cpu_ms));
        let (off_error_m, off_cpu_ms) = *off.get_or_insert((error_m, cpu_ms));
        table.row([
            name.to_owned(),
            strategy.to_owned(),
            mode.to_owned(),
            figure(error_m, 4),
            format!("{:+.1} mm", 1e3 * (error_m - off_error_m)),
            figure(of(&|run| Errors::rotation_deg(&run.last)), 3),
            percent(of(&dropped_share)),
            percent(of(&|run| run.report.overridden as f64 / run.report.scans.max(1) as f64)),
            format!("{} ms", figure(cpu_ms, 3)),
            percent(1.0 - cpu_ms / off_cpu_ms),
        ]);
    }
}

fn percent(share: f64) -> String {
    format!("{} %", figure(100.0 * share, 1))
}

fn dropped_share(run: &Measured) -> f64 {
    run.report.dropped.values().sum::<u64>() as f64 / run.report.scans.max(1) as f64
}

/// Processor time of the stages that a dropped scan spares, for each scan, milliseconds.
fn spared_cpu_ms(run: &Measured) -> f64 {
    let stages = SPARED.iter().filter_map(|stage| run.report.stages.get(stage.name()));
    1e3 * stages.map(|stage| stage.cpu_s).sum::<f64>() / run.report.scans.max(1) as f64
}

/// The cost of the source work's own program with and without the filter.
fn published_costs(bench: &mut Bench) -> String {
    let mut table = Table::new(["", "filter", "all", "dropped", "CPU", "saved"]);
    let repetitions = if bench.plan.patient { REPETITIONS } else { 1 };
    let mut sums_ms = [0.0; 3];
    for log in bench.logs.clone() {
        let mut off_ms = None;
        for (mode, sum_ms) in MODES[..3].iter().zip(&mut sums_ms) {
            let options = [vec!["--profile".to_owned(), "vinyslam".to_owned()], vec_of_mode(mode)].concat();
            let runs = (0..repetitions).filter_map(|_| bench.runs.again(&log, &options).ok());
            let Some(run) = runs.min_by(|a, b| spared_cpu_ms(a).total_cmp(&spared_cpu_ms(b))) else {
                continue;
            };
            let cpu_ms = spared_cpu_ms(&run);
            *sum_ms += cpu_ms * run.report.scans as f64;
            table.row([
                log.name.clone(),
                (*mode).to_owned(),
                figure(run.last.translation_m(), 4),
                percent(dropped_share(&run)),
                format!("{} ms", figure(cpu_ms, 3)),
                percent(1.0 - cpu_ms / *off_ms.get_or_insert(cpu_ms)),
            ]);
        }
    }
    let [off_ms, ours_ms, published_ms] = sums_ms;
    format!(
        "With the costs of the published program (`--profile vinyslam`), the cheapest of {repetitions} runs of each. Over all logs together the filter saves {} of the processor time of \
         matcher, mapper and cleaner, the published one {}. This profile has no back end: its errors are those of hill climbing alone, and the relations of the loops decide the mean.\n\n{table}",
        percent(1.0 - ours_ms / off_ms),
        percent(1.0 - published_ms / off_ms),
    )
}

fn simulations(bench: &mut Bench) -> String {
    let mut table = Table::new(["", "filter", "ATE", "error per metre", "dropped"]);
    let seconds = duration(bench.plan.simulated_s);
    let fast = simulated("40 scans per second", &[&seconds, "simulation.scan_rate_hz=40"]);
    for subject in [bench.building.clone(), fast] {
        for mode in MODES {
            table.row(simulation_row(bench, &subject, mode));
        }
    }
    format!("In the simulated building, against exact truth:\n\n{table}")
}

fn simulation_row(bench: &mut Bench, subject: &Subject, mode: &str) -> Vec<String> {
    let head = vec![subject.name.clone(), mode.to_owned()];
    let rest = match bench.runs.of(subject, &vec_of_mode(mode)) {
        Ok(run) => vec![
            figure(run.last.translation_m(), 4),
            figure(run.last.short_m(), 4),
            percent(dropped_share(&run)),
        ],
        Err(reason) => vec![format!("failed: {reason}")],
    };
    [head, rest].concat()
}

/// A scan of a room with a wavy wall.
fn look(beams: usize, moved_m: f64) -> ScanBuffer {
    let step = std::f64::consts::TAU / beams as f64;
    let range = |i: usize| (4.0 + moved_m + (i as f64 * step * 3.0).sin()) as f32;
    ScanBuffer::from_ranges(&(0..beams).map(range).collect::<Vec<_>>(), -std::f64::consts::PI, step)
}

fn speeds() -> String {
    let mut table = Table::new(["beams", "median", "p99", "p99.9"]);
    for beams in [180, 360, 720, 1000] {
        let scans: Vec<ScanBuffer> = (0..64).map(|i| look(beams, f64::from(i) * 0.01)).collect();
        let mut filter = CorrelationFilter::new(Settings::default());
        let mut times_us: Vec<f64> = (0..50_000)
            .map(|i| {
                let started = Instant::now();
                let view = scans[i % scans.len()].view().expect("a scan that fits its header");
                std::hint::black_box(filter.handle(view));
                started.elapsed().as_secs_f64() * 1e6
            })
            .collect();
        times_us.sort_by(f64::total_cmp);
        let at = |share: f64| format!("{} µs", figure(times_us[(share * times_us.len() as f64) as usize], 1));
        table.row([beams.to_string(), at(0.5), at(0.99), at(0.999)]);
    }
    format!("From a scan to its verdict, in one process, 50 000 scans each:\n\n{table}\n{}", large_scans())
}

/// Median seconds of nine.
fn median_s(mut what: impl FnMut()) -> f64 {
    let time_s = |_| {
        let started = Instant::now();
        what();
        started.elapsed().as_secs_f64()
    };
    let mut times_s: Vec<f64> = (0..9).map(time_s).collect();
    times_s.sort_by(f64::total_cmp);
    times_s[4]
}

fn large_scans() -> String {
    let mut table =
        Table::new(["threads", "described", "points per second", "plain pass", "times the plain pass"]);
    let scan = look(LARGE_BEAMS, 0.0);
    let view = scan.view().expect("a scan that fits its header");
    let mut first_s = None;
    let mut gain = 1.0;
    for threads in [1, 2] {
        let described_s = median_s(|| {
            std::hint::black_box(tally_part(view, 0, 1, threads));
        });
        let plain_s = median_s(|| {
            std::hint::black_box(plain_pass(view.ranges(), threads));
        });
        gain = *first_s.get_or_insert(described_s) / described_s;
        table.row([
            threads.to_string(),
            format!("{} ms", figure(1e3 * described_s, 2)),
            format!("{} million", figure(LARGE_BEAMS as f64 / described_s * 1e-6, 0)),
            format!("{} ms", figure(1e3 * plain_s, 2)),
            figure(described_s / plain_s, 2),
        ]);
    }
    format!(
        "A scan of {} million points, read in place; beside it a plain pass over the same memory, which adds up its numbers, with as many threads. Two threads describe {} times what one does.\n\n{table}",
        LARGE_BEAMS / 1_000_000,
        figure(gain, 2)
    )
}

/// Adds up the numbers as integers.
fn plain_pass(numbers: &[f32], threads: usize) -> u32 {
    let sum = |part: &[f32]| part.iter().fold(0_u32, |sum, number| sum.wrapping_add(number.to_bits()));
    let (own, other) = numbers.split_at(numbers.len() / threads);
    std::thread::scope(|scope| {
        let other = scope.spawn(move || sum(other));
        sum(own).wrapping_add(other.join().expect("adding does not panic"))
    })
}
