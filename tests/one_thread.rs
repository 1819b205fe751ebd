//! A whole set driven by one thread over the in-memory bus, under a virtual clock: a shell is a step over what is handed to it.

use crate::support::flockslam;
use flockslam::configuration::Configuration;
use flockslam::supervisor::{SetFile, shell_in};
use flockslam_bus::{Bus, RuntimeDir};
use flockslam_lidar_ingest::process::Source;
use flockslam_messages::{Control, ControlKind, PoseEstimate, PoseFlags, Stage};
use flockslam_results::{FINAL_TRAJECTORY, read_map, read_trajectory};
use flockslam_stage::{Actor, Clock, Mode, StageContext, StopFlag};

const DURATION_S: f64 = 20.0;
/// Time passes by so much after each round, nanoseconds.
const ROUND_NS: u64 = 1_000_000;
/// Rounds after which a set that has not ended hangs.
const ROUNDS_MAX: usize = 2_000_000;

struct OneThread {
    runtime: RuntimeDir,
    bus: Bus,
    clock: Clock,
    stages: Vec<(StageContext, Box<dyn Actor>)>,
}

impl OneThread {
    /// All six stages but those of `without`.
    fn start(name: &str, file: &SetFile, without: &[Stage]) -> Self {
        let runtime = RuntimeDir::create(&format!("{name}-{}", std::process::id())).unwrap();
        let (bus, clock) = (Bus::in_memory(), Clock::virtual_at(1_000_000_000));
        let stages = Stage::ALL.into_iter().filter(|stage| !without.contains(stage)).map(|stage| {
            let join = bus.memory_joiner().unwrap();
            let (options, stop) = (&file.options, StopFlag::default());
            let mut context = StageContext::on_bus(stage, 0, join(), &runtime, options, stop).unwrap();
            context.clock = clock.clone();
            let shell = shell_in(&mut context, file.clone()).unwrap();
            (context, shell)
        });
        let stages = stages.collect();
        Self { runtime, bus, clock, stages }
    }

    /// One step of every stage; housekeeping follows ten times a second of the virtual clock.
    fn round(&mut self, number: usize) {
        for (context, shell) in &mut self.stages {
            shell.advance(context).unwrap();
            if number.is_multiple_of(100) {
                shell.refresh(context).unwrap();
            }
        }
        self.clock.advance(ROUND_NS);
    }
}

fn set_file(mode: Mode, rate: Option<f64>) -> SetFile {
    let mut configuration = Configuration::default();
    configuration.simulation.duration_s = DURATION_S;
    SetFile {
        version: flockslam::VERSION.to_owned(),
        options: configuration.stage_options(mode),
        source: Source::Simulation,
        rate,
        world: None,
        configuration,
    }
}

#[test]
fn one_thread_gives_the_same_results_as_six_processes() {
    let mut set = OneThread::start("one-thread", &set_file(Mode::Exact, None), &[]);
    let control = set.bus.subscriber::<Control>().unwrap();
    let finished =
        || std::iter::from_fn(|| control.receive().unwrap()).any(|c| c.kind == ControlKind::Finished as u32);
    let rounds = (0..ROUNDS_MAX).find(|number| {
        set.round(*number);
        finished()
    });
    assert!(rounds.is_some(), "the set has not ended");
    let results = set.runtime.results();
    let own = read_trajectory(&results, FINAL_TRAJECTORY).unwrap();
    assert_eq!(own.len(), 10 * DURATION_S as usize);

    let out = tempfile::tempdir().unwrap();
    let duration = format!("simulation.duration_s={DURATION_S}");
    let demo = flockslam().args(["demo", "--set", &duration, "--out"]).arg(out.path()).output().unwrap();
    assert!(demo.status.success());
    let report = std::fs::read_to_string(out.path().join("report.json")).unwrap();
    let hash = flockslam::outputs::map_hash(&read_map(&results).unwrap());
    assert!(report.contains(&hash), "the map of six processes has another hash than {hash}");
}

/// Poses of a live set without this stage, driven for three seconds of its time.
fn live_poses_without(stage: Stage) -> Vec<PoseEstimate> {
    let mut set = OneThread::start("one-thread-live", &set_file(Mode::Live, Some(1.0)), &[stage]);
    let poses = set.bus.subscriber::<PoseEstimate>().unwrap();
    let mut received = Vec::new();
    for number in 0..3000 {
        set.round(number);
        received.extend(std::iter::from_fn(|| poses.receive().unwrap()).map(|pose| *pose));
    }
    received
}

#[test]
fn a_deadline_passes_when_the_virtual_clock_goes_on() {
    let poses = live_poses_without(Stage::CorrelationFilter);
    assert!((28..=31).contains(&poses.len()), "{} poses in 3 s at 10 Hz", poses.len());
    assert!(poses.iter().skip(1).all(|pose| pose.has(PoseFlags::MATCHED)), "a late verdict means keep");
}
