//! Section `separation`: the same stages over the same scans as six processes and as threads of one process.

use super::runs::{Subject, execute};
use super::{Bench, Table, hop};
use flockslam::configuration::Configuration;
use flockslam::outputs::Report;
use flockslam::supervisor::{SetFile, run_in};
use flockslam_bus::{Bus, RuntimeDir};
use flockslam_lidar_ingest::process::Source;
use flockslam_messages::{Control, ControlKind, Stage};
use flockslam_stage::{Mode, StageContext, StopFlag};
use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// One run of the same stages over the same scans.
struct Run {
    scans: u64,
    wall_s: f64,
    cpu_s: f64,
}

/// What it costs that stages are processes: against the same stages as threads of one process.
pub fn section(bench: &mut Bench) -> String {
    let mut table = Table::new(["", "stages as", "scans", "wall s", "scans/s", "CPU per scan ms"]);
    let repetitions = if bench.plan.patient { 3 } else { 1 };
    for subject in
        [bench.main_subject(), bench.building.clone()].iter().take(if bench.logs.is_empty() { 1 } else { 2 })
    {
        let file = set_file(subject, bench.plan.simulated_s);
        let threads = median(repetitions, || Ok(one_process(&file)));
        let processes = median(repetitions, || six_processes(subject));
        for (how, run) in [("six threads of one process", threads), ("six processes", processes)] {
            match run {
                Ok(run) => table.row([
                    subject.name.clone(),
                    how.to_owned(),
                    run.scans.to_string(),
                    format!("{:.2}", run.wall_s),
                    format!("{:.0}", run.scans as f64 / run.wall_s),
                    format!("{:.3}", run.cpu_s * 1e3 / run.scans.max(1) as f64),
                ]),
                Err(reason) => table.row([&subject.name, how, &format!("failed: {reason}")]),
            }
        }
    }
    let mut text = format!(
        "The same stages, filter off, over the in-memory bus in one process, and as six processes with a supervisor, started, ended, and with all outputs \
         written (which the threads do not do); median of {repetitions} by wall time.\n\n{table}"
    );
    if bench.plan.patient {
        let hops = hop::table(bench.shared_memory());
        text += &format!(
            "\nOne hop: from the sending of a scan to its reader in another process, which sleeps until its event is notified:\n\n{hops}"
        );
    }
    text
}

fn set_file(subject: &Subject, simulated_s: f64) -> SetFile {
    let mut configuration = Configuration::default();
    configuration.correlation_filter.mode = flockslam_correlation_filter::Mode::Off;
    configuration.simulation.duration_s = simulated_s;
    SetFile {
        version: flockslam::VERSION.to_owned(),
        options: configuration.stage_options(Mode::Exact),
        source: subject.log.as_ref().map_or(Source::Simulation, |(log, _)| Source::Log(log.clone())),
        rate: None,
        world: None,
        configuration,
    }
}

fn median(repetitions: usize, run: impl Fn() -> Result<Run, String>) -> Result<Run, String> {
    let mut runs = (0..repetitions).map(|_| run()).collect::<Result<Vec<_>, _>>()?;
    runs.sort_by(|a, b| a.wall_s.total_cmp(&b.wall_s));
    Ok(runs.swap_remove(repetitions / 2))
}

fn own_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn one_process(file: &SetFile) -> Run {
    let runtime =
        RuntimeDir::create(&format!("bench-threads-{}", std::process::id())).expect("tmpfs can be used");
    let bus = Bus::in_memory();
    let control = bus.subscriber::<Control>().expect("memory has every topic");
    let stop = StopFlag::default();
    let (started, cpu_s) = (Instant::now(), own_cpu_s());
    let scans = std::thread::scope(|scope| {
        for stage in Stage::ALL {
            let join = bus.memory_joiner().expect("it is in memory");
            let (stop, file, runtime) = (stop.clone(), file.clone(), &runtime);
            scope.spawn(move || {
                let mut context = StageContext::on_bus(stage, 0, join(), runtime, &file.options, stop)
                    .expect("it can start");
                run_in(&mut context, file).expect("the stage works");
            });
            // Consumers listen before the source speaks.
            let beat = flockslam_stage::heartbeat_file(&runtime.status(), &format!("{}-0", stage.name()));
            while !matches!(flockslam_telemetry::read_heartbeat(&beat), Ok(Some(_))) {
                std::thread::sleep(Duration::from_micros(100));
            }
        }
        let scans = loop {
            match control.receive().expect("memory works") {
                Some(message) if message.kind == ControlKind::Finished as u32 => break message.value,
                Some(_) => {}
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        };
        stop.stop();
        scans
    });
    Run { scans, wall_s: started.elapsed().as_secs_f64(), cpu_s: own_cpu_s() - cpu_s }
}

/// The set as a user runs it: a process belongs to one set only, so it is not this one.
fn six_processes(subject: &Subject) -> Result<Run, String> {
    let out = tempfile::tempdir().map_err(|error| error.to_string())?;
    execute(&subject.arguments(&[]), out.path())?;
    let json = std::fs::read(out.path().join("report.json")).map_err(|error| error.to_string())?;
    let report: Report = serde_json::from_slice(&json).map_err(|error| error.to_string())?;
    Ok(Run { scans: report.scans, wall_s: report.wall_s, cpu_s: report.cpu_s })
}
