//! The generator of `docs/benchmarks.md`.

mod accuracy;
mod cost;
mod document;
mod driving;
mod filter_modes;
mod front_end;
mod hop;
mod long_run;
mod machine;
mod moving_bodies;
mod returns;
mod robustness;
mod runs;
mod separation;
mod simulated_worlds;
mod small_computer;
mod strategies;
mod table;

pub use document::{Page, SECTIONS};
pub use hop::echo;

use flockslam_bus::{Bus, Capacity, RuntimeDir};
use runs::{Runs, Subject, set};
use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use table::Table;

/// What is to be measured.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Names of sections; all when empty.
    pub only: Vec<String>,
    /// Start headings of the logs, radians, and as many seeds of the simulation.
    pub headings_rad: Vec<f64>,
    /// Whether minutes may be spent on one figure.
    pub patient: bool,
    /// Where the logs are.
    pub data: Option<PathBuf>,
    /// How long the simulated robot drives, seconds.
    pub simulated_s: f64,
}

/// The three public logs, by the name of their folder and that of the tables.
const LOGS: [(&str, &str); 3] = [("intel", "Intel"), ("fr079", "FR079"), ("aces", "ACES")];
/// Six headings that lie differently on the grid.
const HEADINGS_RAD: [f64; 6] = [0.0, 0.35, 0.7, 1.05, 1.4, 1.75];

impl Plan {
    /// The plan of the whole page, or of a quick look.
    pub fn full(quick: bool) -> Self {
        let headings = if quick { &HEADINGS_RAD[..1] } else { &HEADINGS_RAD[..] };
        Self {
            only: Vec::new(),
            headings_rad: headings.to_vec(),
            patient: !quick,
            data: Some(data_directory()),
            simulated_s: 250.0,
        }
    }

    fn wants(&self, section: &str) -> bool {
        let named = self.only.iter().any(|name| name == section);
        named || self.only.is_empty() && (self.patient || section != "long-run")
    }
}

/// Measures the sections of the plan and puts them into the page; `keep` gets the page after each.
pub fn generate<E>(plan: &Plan, page: &mut Page, keep: impl Fn(&Page) -> Result<(), E>) -> Result<(), E> {
    let mut bench = Bench::new(plan.clone());
    for (name, heading) in SECTIONS.iter().filter(|(name, _)| plan.wants(name)) {
        eprintln!("== {heading}");
        let body = match *name {
            "machine" => machine::section(),
            "accuracy" => accuracy::section(&mut bench),
            "driving" => driving::section(&mut bench),
            "strategies" => strategies::section(&mut bench),
            "filter" => filter_modes::section(&mut bench),
            "robustness" => robustness::section(&mut bench),
            "cost" => cost::section(&mut bench),
            "front-end" => front_end::section(&mut bench),
            "separation" => separation::section(&mut bench),
            "small-computer" => small_computer::section(&mut bench),
            "worlds" => simulated_worlds::section(&mut bench),
            "moving" => moving_bodies::worlds(&mut bench),
            "movers" => moving_bodies::movers(&mut bench),
            "long-run" => long_run::section(),
            other => unreachable!("{other} is not a section"),
        };
        page.set(name, &format!("{}\n\n{}", body.trim_end(), machine::measured_on()));
        keep(page)?;
    }
    Ok(())
}

/// What the sections share.
struct Bench {
    plan: Plan,
    runs: Runs,
    logs: Vec<Subject>,
    /// Names of the logs that are not there.
    absent: Vec<&'static str>,
    building: Subject,
    shared_memory: OnceCell<SharedMemory>,
}

/// This process' own set, for what is measured inside it. A process can belong to one set only.
struct SharedMemory {
    // Ports and services go before the directory that they lie in.
    bus: Bus,
    runtime: RuntimeDir,
}

impl Bench {
    fn new(plan: Plan) -> Self {
        let mut logs = Vec::new();
        let mut absent = Vec::new();
        for (folder, name) in LOGS {
            let file = |extension: &str| {
                let path = plan.data.as_ref()?.join(folder).join(format!("{folder}.{extension}"));
                path.is_file().then_some(path)
            };
            match file("clf").zip(file("relations")) {
                Some(files) => logs.push(Subject {
                    name: name.to_owned(),
                    log: Some(files),
                    options: set(&["correlation_filter.mode=off"]),
                }),
                None => absent.push(name),
            }
        }
        let building =
            simulated("simulated building", &["correlation_filter.mode=off", &duration(plan.simulated_s)]);
        Self { plan, runs: Runs::default(), logs, absent, building, shared_memory: OnceCell::new() }
    }

    /// The logs, then the simulated building.
    fn subjects(&self) -> Vec<Subject> {
        self.logs.iter().chain([&self.building]).cloned().collect()
    }

    /// The first log, or the simulated building: where costs are looked at closely.
    fn main_subject(&self) -> Subject {
        self.logs.first().unwrap_or(&self.building).clone()
    }

    /// A sentence about the logs that are missing.
    fn absence(&self) -> String {
        if self.absent.is_empty() {
            return String::new();
        }
        format!("Left out, for want of the log: {}.\n\n", self.absent.join(", "))
    }

    fn shared_memory(&self) -> &SharedMemory {
        self.shared_memory.get_or_init(|| {
            let runtime = RuntimeDir::create(&format!("bench-{}", std::process::id()))
                .expect("shared memory can be used");
            let bus = Bus::host(&runtime, Capacity::default()).expect("the bus can be created");
            SharedMemory { bus, runtime }
        })
    }
}

/// A run of the simulation with these settings.
fn simulated(name: &str, assignments: &[&str]) -> Subject {
    Subject { name: name.to_owned(), log: None, options: set(assignments) }
}

fn duration(seconds: f64) -> String {
    format!("simulation.duration_s={seconds:?}")
}

/// A figure with so many digits; a dash for what does not exist.
fn figure(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "–".to_owned() }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// NaN for none.
fn greatest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NAN, f64::max)
}

/// Where the logs are expected.
fn data_directory() -> PathBuf {
    std::env::var_os("FLOCKSLAM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from)
}
