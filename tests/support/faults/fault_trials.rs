//! Faults of processes: stages and supervisors that are killed, stopped or caught in a loop. Each function gives a [`Trial`].

use super::{Evidence, Seeded};
use crate::support::{
    Drive, LiveSet, PoseWatch, building, known_truth_error_m, of, run_well, send, truth_error_m, try_send,
    wait_for,
};
use flockslam::store::SavedMap;
use flockslam::supervisor::{SetStatus, StageState};
use flockslam_messages::Stage;
use flockslam_stage::leader;
use rustix::process::Signal;
use std::path::Path;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

const SCAN_RATE_HZ: f64 = 40.0;
/// What dead processes leave is cleaned up within this.
const CLEAN_LIMIT: Duration = Duration::from_secs(5);
/// A simulated source that is started again simulates all that it has sent before, which no real one does: drives are short.
const KILLS_IN_A_DRIVE: usize = 20;
/// How often a stage that is killed again and again while it starts may get up in between.
const GETTING_UP: usize = 20;
/// Between two faults the set works for at least so many scans.
const CALM_SCANS: usize = 10;
/// Before the first fault so many scans are in the map. A map of one or two scans does not show where a robot is that has driven on
/// without poses, however long it takes on a busy machine until there are poses again.
const MAPPED_SCANS: usize = 8;
/// A drive is so much longer than its faults take: on a busy machine each takes longer, and the drive must not end before them.
const SPARE_S: f64 = 20.0;
/// No wheel slips: what is missing for some seconds are poses by scans, and odometry alone does not see a slip.
const STEADY_WHEELS: &str = "simulation.wheel_slips=0";

/// What was done to sets and what came of it.
#[derive(Default)]
pub struct Trial {
    /// The fault, for people.
    pub fault: String,
    /// How often it was done.
    pub runs: usize,
    /// How long poses of new scans were missing after each, milliseconds.
    pub recoveries_ms: Vec<f64>,
    /// Accepted scans that are not in the map.
    pub lost: u64,
    /// What must not be.
    pub violations: Vec<String>,
    /// Error against the truth, metres, and that of an undisturbed drive.
    pub error_m: Option<(f64, f64)>,
}

impl Trial {
    /// A quantile of the recoveries, milliseconds.
    pub fn recovery_ms(&self, share: f64) -> f64 {
        let mut sorted = self.recoveries_ms.clone();
        sorted.sort_by(f64::total_cmp);
        let place = (share * sorted.len().saturating_sub(1) as f64).ceil() as usize;
        sorted.get(place).copied().unwrap_or(f64::NAN)
    }

    /// Adds another trial of the same fault. Of two errors the worse one counts, beside the undisturbed one.
    fn add(&mut self, other: Self) {
        self.fault = other.fault;
        self.runs += other.runs;
        self.recoveries_ms.extend(other.recoveries_ms);
        self.lost += other.lost;
        self.violations.extend(other.violations);
        let worse = |errors: Option<(f64, f64)>| errors.map_or(-1.0, |(error_m, calm_m)| error_m / calm_m);
        if worse(other.error_m) > worse(self.error_m) {
            self.error_m = other.error_m;
        }
    }

    /// Medians of the earlier and the later half of the recoveries, milliseconds: whether it takes longer and longer.
    pub fn early_and_late_ms(&self) -> (f64, f64) {
        let median = |part: &[f64]| {
            let mut sorted = part.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let (early, late) = self.recoveries_ms.split_at(self.recoveries_ms.len() / 2);
        (median(early), median(late))
    }

    /// Everything that should not be, the error among it.
    pub fn complaints(&self) -> Vec<String> {
        let mut complaints = self.violations.clone();
        if let Some((error_m, calm_m)) =
            self.error_m.filter(|(error_m, calm_m)| *error_m > 1.2 * calm_m + 0.02)
        {
            complaints.push(format!("the error is {error_m:.3} m, undisturbed {calm_m:.3} m"));
        }
        complaints
    }

    /// One line of the table; a dash where there is nothing to tell.
    pub fn line(&self) -> String {
        let some = |digits: usize, value: f64| match value.is_nan() {
            true => "–".to_owned(),
            false => format!("{value:.digits$}"),
        };
        let (error_m, calm_m) = self.error_m.unwrap_or((f64::NAN, f64::NAN));
        let recoveries = [0.5, 0.99].map(|share| some(0, self.recovery_ms(share)));
        let errors = [error_m, calm_m].map(|error_m| some(3, error_m));
        let (recoveries, errors) = (recoveries.join(" | "), errors.join(" | "));
        format!("| {} | {} | {recoveries} | {} | {errors} |", self.fault, self.runs, self.lost)
    }

    /// The head of the table.
    pub const HEAD: &str = "| fault | runs | back after, p50 ms | p99 ms | accepted scans lost | error, m | undisturbed, m |\n\
         |---|---|---|---|---|---|---|";
}

/// A set that drives at 40 Hz, and what is seen of it.
struct Subject {
    set: LiveSet,
    poses: PoseWatch,
    map: SavedMap,
    drive: Drive,
}

impl Subject {
    fn start(test: &str, directory: &Path, duration_s: f64) -> Self {
        Self::start_with_failpoints(test, directory, duration_s, "")
    }

    /// As [`Subject::start`], with protections taken away from it.
    fn start_with_failpoints(test: &str, directory: &Path, duration_s: f64, failpoints: &str) -> Self {
        Self::start_with(test, directory, duration_s, "", &[], failpoints)
    }

    fn start_with(
        test: &str,
        directory: &Path,
        duration_s: f64,
        more: &str,
        arguments: &[String],
        failpoints: &str,
    ) -> Self {
        let drive = Drive { scan_rate_hz: SCAN_RATE_HZ, duration_s: duration_s + SPARE_S, rate: 1.0 };
        let map = directory.join("map");
        let more = format!("map = {map:?}\n{more}");
        let arguments = [arguments, &["--set".to_owned(), STEADY_WHEELS.to_owned()]].concat();
        let mut set = LiveSet::start_with_failpoints(test, directory, drive, &more, &arguments, failpoints);
        set.wait_until("all stages to work", |status| {
            let working = |stage| of(status, stage).handled > 0;
            Stage::ALL.into_iter().all(working)
        });
        let poses = PoseWatch::start(&set.runtime_dir());
        // What is taken away may keep it from mapping so far.
        let mapped_scans = if failpoints.is_empty() { MAPPED_SCANS } else { 1 };
        wait_for("a map", || (poses.inserted() >= mapped_scans).then_some(()));
        Self { set, poses, map: SavedMap::at(&map), drive }
    }

    /// Waits until the set has worked undisturbed for a while and everybody runs.
    fn calm_down(&mut self) -> SetStatus {
        let status = self.set.wait_until("all stages to run", |status| {
            status.stages.iter().all(|stage| stage.state == StageState::Running)
        });
        let enough = self.poses.count() + CALM_SCANS;
        let poses = &self.poses;
        self.set.wait_until("some poses", |_| poses.count() >= enough);
        status
    }

    /// Does something to the process of a stage; how long new scans were without a pose.
    fn disturb(&mut self, stage: Stage, signal: Signal) -> f64 {
        let pid = self.set.pid(stage);
        let since = Instant::now();
        send(pid, signal);
        let back_ms = self.poses.back_after_ms(since);
        self.wait_for_successor(stage, pid);
        back_ms
    }

    /// Waits until a stage has another process than this one.
    fn wait_for_successor(&mut self, stage: Stage, pid: u32) {
        self.set.wait_until("a successor", |status| {
            let found = of(status, stage);
            found.state == StageState::Running && found.pid != Some(pid)
        });
    }

    /// Lets the drive end, and checks the outputs.
    fn conclude(self, trial: &mut Trial) {
        let Self { set, poses, map, drive } = self;
        drop(poses);
        let outputs = set.finish();
        let evidence = Evidence::of(&map);
        trial.lost = evidence.lost();
        trial.violations.extend(evidence.violations());
        match known_truth_error_m(&outputs) {
            Some(error_m) => trial.error_m = Some((error_m, undisturbed_error_m(drive.duration_s))),
            None => trial.violations.push("the trajectory is none".to_owned()),
        }
    }
}

/// Error of the same drive when nothing happens to it.
fn undisturbed_error_m(duration_s: f64) -> f64 {
    static ERRORS: OnceLock<std::sync::Mutex<Vec<(u64, f64)>>> = OnceLock::new();
    let errors = ERRORS.get_or_init(Default::default);
    let mut errors = errors.lock().unwrap();
    if let Some((_, error_m)) = errors.iter().find(|(of, _)| *of == duration_s.to_bits()) {
        return *error_m;
    }
    let directory = tempfile::tempdir().unwrap();
    let mut args = building(duration_s as u32);
    for set in [&format!("simulation.scan_rate_hz={SCAN_RATE_HZ}"), STEADY_WHEELS] {
        args.extend(["--set".to_owned(), set.to_owned()]);
    }
    let error_m = truth_error_m(&run_well("calm", directory.path(), &args));
    errors.push((duration_s.to_bits(), error_m));
    error_m
}

/// SIGKILL of one stage after the other, each so many times; no other stage may be restarted.
pub fn kills_of_each_stage(stages: &[Stage], runs: usize, seed: u64) -> Trial {
    let mut trial = Trial::default();
    for (drive, first) in (0..runs).step_by(KILLS_IN_A_DRIVE).enumerate() {
        let kills = KILLS_IN_A_DRIVE.min(runs - first);
        trial.add(disturb_each("kill", stages, kills, seed + drive as u64, Signal::KILL));
    }
    trial
}

/// SIGSTOP of one stage after the other: a hang, that is found out.
pub fn stops_of_each_stage(stages: &[Stage], runs: usize, seed: u64) -> Trial {
    disturb_each("stop", stages, runs, seed, Signal::STOP)
}

/// How long the drive has to be: a kill and its aftermath take up to 1 s, a stop is found out first; the drive ends some time after
/// the last one.
fn drive_s(signal: Signal, runs: usize) -> f64 {
    let each_s = if signal == Signal::KILL { 1.0 } else { 1.6 };
    (12.0 + each_s * runs as f64).ceil()
}

fn disturb_each(what: &str, stages: &[Stage], runs: usize, seed: u64, signal: Signal) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let names: Vec<_> = stages.iter().map(|stage| stage.name()).collect();
    let mut trial = Trial { fault: format!("{what} {}", names.join(", ")), ..Trial::default() };
    let duration_s = drive_s(signal, runs * stages.len());
    let mut subject = Subject::start(what, directory.path(), duration_s);
    for _ in 0..runs {
        for stage in stages {
            let before = subject.calm_down();
            std::thread::sleep(Duration::from_millis(random.below(25)));
            trial.recoveries_ms.push(subject.disturb(*stage, signal));
            trial.runs += 1;
            let after = subject.set.status().unwrap();
            trial.violations.extend(restarted_beside(*stage, &before, &after));
        }
    }
    subject.conclude(&mut trial);
    trial
}

/// Stages that have another process than before, beside the one that something was done to.
pub fn restarted_beside(stage: Stage, before: &SetStatus, after: &SetStatus) -> Vec<String> {
    let pairs = before.stages.iter().zip(&after.stages);
    let others = pairs.filter(|(before, after)| before.stage != stage.name() && before.pid != after.pid);
    others.map(|(_, after)| format!("{} was restarted with {}", after.stage, stage.name())).collect()
}

/// Kills these stages at once, in a set that protections were taken away from. How that is noticed shows that the checks are some.
pub fn with_failpoint(failpoints: &str, stages: &[Stage], settings: &[&str]) -> Trial {
    let directory = tempfile::tempdir().unwrap();
    let mut trial = Trial { fault: format!("failpoints: {failpoints}"), ..Trial::default() };
    let arguments: Vec<String> = settings.iter().flat_map(|set| ["--set", set]).map(str::to_owned).collect();
    let mut subject = Subject::start_with("failpoints", directory.path(), 20.0, "", &arguments, failpoints);
    let closed = subject.set.runtime_dir().join("spill/submaps/000000.submap");
    wait_for("a closed submap", || closed.exists().then_some(()));
    let before = subject.calm_down();
    let pids: Vec<_> = stages.iter().map(|stage| subject.set.pid(*stage)).collect();
    let since = Instant::now();
    pids.iter().for_each(|pid| send(*pid, Signal::KILL));
    trial.recoveries_ms.push(subject.poses.back_after_ms(since));
    // On a busy machine a scan may have been taken between that instant and the kill: its pose does not show that they are back.
    stages.iter().zip(&pids).for_each(|(stage, pid)| subject.wait_for_successor(*stage, *pid));
    trial.violations.extend(restarted_beside(stages[0], &before, &subject.calm_down()));
    trial.runs = 1;
    subject.conclude(&mut trial);
    trial
}

/// A stage that falls into an endless loop once it has handled some scans.
pub fn endless_loop(stage: Stage) -> Trial {
    let directory = tempfile::tempdir().unwrap();
    let mut trial = Trial { fault: format!("endless loop of {}", stage.name()), ..Trial::default() };
    let failpoints = format!("endless-loop:{}@30", stage.name());
    let mut subject = Subject::start_with_failpoints("loop", directory.path(), 20.0, &failpoints);
    let before = subject.set.status().unwrap();
    let after = subject.set.wait_until("a hang and a successor", |status| {
        of(status, stage).hangs > 0 && of(status, stage).state == StageState::Running
    });
    trial.runs = of(&after, stage).hangs as usize;
    subject.calm_down();
    let seen = subject.poses.seen();
    let gaps_ns = seen.windows(2).map(|pair| pair[1].seen_ns - pair[0].seen_ns);
    trial.recoveries_ms.push(gaps_ns.max().unwrap_or(0) as f64 * 1e-6);
    trial.violations.extend(restarted_beside(stage, &before, &after));
    subject.conclude(&mut trial);
    trial
}

/// The wall clock jumps by two hours every second, to and fro.
pub fn jumping_clock(duration_s: f64) -> Trial {
    let directory = tempfile::tempdir().unwrap();
    let mut trial = Trial { fault: "the wall clock jumps".to_owned(), ..Trial::default() };
    let mut subject = Subject::start_with_failpoints("clock", directory.path(), duration_s, "wall-clock");
    let status = subject.calm_down();
    let restarted = status.stages.iter().filter(|stage| stage.restarts > 0);
    trial.violations.extend(restarted.map(|stage| format!("{} was restarted", stage.stage)));
    let map = subject.map.clone();
    subject.conclude(&mut trial);
    let hour_ns = 3_600_000_000_000_u64;
    let jumps = |pair: &[flockslam_messages::PoseEstimate]| {
        pair[0].times.utc_ns.abs_diff(pair[1].times.utc_ns) > hour_ns
    };
    trial.runs = Evidence::of(&map).poses.windows(2).filter(|pair| jumps(pair)).count();
    assert!(trial.runs > 0, "the clock has jumped");
    trial
}

/// SIGKILL of the process of a stage that acts while another one is on standby, so many times.
pub fn kills_of_the_leader(stage: Stage, runs: usize, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: format!("kill {} beside the fallback", stage.name()), ..Trial::default() };
    let more = format!("stages.{}.replicas = 2", stage.name());
    let duration_s = drive_s(Signal::KILL, runs);
    let mut subject = Subject::start_with("turns", directory.path(), duration_s, &more, &[], "");
    let status_dir = subject.set.runtime_dir().join("status");
    for _ in 0..runs {
        subject.calm_down();
        std::thread::sleep(Duration::from_millis(random.below(25)));
        let active = leader(&status_dir, stage.name()).unwrap();
        let since = Instant::now();
        send(active, Signal::KILL);
        trial.recoveries_ms.push(subject.poses.back_after_ms(since));
        wait_for("a successor", || leader(&status_dir, stage.name()).filter(|pid| *pid != active));
        trial.runs += 1;
    }
    subject.conclude(&mut trial);
    trial
}

/// A random stage every 500 ± 250 ms.
pub fn storm(duration_s: f64, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: format!("storm of kills for {duration_s} s"), ..Trial::default() };
    let mut subject = Subject::start("storm", directory.path(), duration_s + 15.0);
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < duration_s {
        let stage = Stage::ALL[random.below(6) as usize];
        let since = Instant::now();
        if !try_send(subject.set.pid(stage), Signal::KILL) {
            // It was killed a moment ago, and its successor is on its way.
            std::thread::sleep(Duration::from_millis(5));
            continue;
        }
        trial.runs += 1;
        trial.recoveries_ms.push(subject.poses.back_after_ms(since));
        let pause = Duration::from_millis(250 + random.below(501));
        std::thread::sleep(pause.saturating_sub(since.elapsed()));
    }
    subject.conclude(&mut trial);
    trial
}

/// All stages at once, and then the supervisor, so many times.
pub fn everything_at_once(runs: usize) -> Trial {
    let directory = tempfile::tempdir().unwrap();
    let mut trial = Trial { fault: "kill all stages, then the supervisor".to_owned(), ..Trial::default() };
    let mut subject = Subject::start("all", directory.path(), 12.0 + 3.0 * runs as f64);
    for _ in 0..runs {
        let status = subject.calm_down();
        let since = Instant::now();
        status.stages.iter().filter_map(|stage| stage.pid).for_each(|pid| send(pid, Signal::KILL));
        trial.recoveries_ms.push(subject.poses.back_after_ms(since));
        subject.calm_down();
        let since = Instant::now();
        subject.set = subject.set.kill_and_start_again();
        trial.recoveries_ms.push(subject.poses.back_after_ms(since));
        trial.runs += 2;
    }
    subject.conclude(&mut trial);
    trial
}

/// SIGKILL of the supervisor while it saves the map, again and again: the map on disk is whole but for one record that was being
/// written, and never less than it was.
pub fn kills_while_saving(runs: usize, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: "kill while the map is saved".to_owned(), ..Trial::default() };
    let drive = Drive { scan_rate_hz: SCAN_RATE_HZ, duration_s: 3600.0, rate: 1.0 };
    let map = directory.path().join("map");
    let more = format!("map = {map:?}\nsave_every_s = 0.001");
    let mut set = LiveSet::start("saving", directory.path(), drive, &more);
    let map = SavedMap::at(&map);
    let mut saved = 0;
    for _ in 0..runs {
        set.wait_until_handled(Stage::ScanMatcher, 10);
        std::thread::sleep(Duration::from_millis(random.below(50)));
        let since = Instant::now();
        send(set.supervisor_pid(), Signal::KILL);
        set.wait_for_death();
        let found = map.check().unwrap();
        let is_tail = |problem: &&String| problem.starts_with("scans.journal");
        trial.violations.extend(found.problems.iter().filter(|problem| !is_tail(problem)).cloned());
        if found.poses < saved {
            trial.violations.push(format!("{} poses are saved, there were {saved}", found.poses));
        }
        saved = found.poses;
        set = set.start_once_more();
        set.wait_until_handled(Stage::ScanMatcher, 1);
        trial.recoveries_ms.push(since.elapsed().as_secs_f64() * 1e3);
        trial.runs += 1;
    }
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
    let last = map.check().unwrap();
    trial.violations.extend(last.problems);
    // A map that stays empty is whole each time.
    if last.poses < saved.max(1) {
        trial.violations.push(format!("{} poses are saved at the end, there were {saved}", last.poses));
    }
    trial
}

/// What the shared memory of a set consists of: objects, nodes, files.
pub fn left_behind(robot: &str) -> usize {
    let count = |directory: &Path, wanted: &str| {
        let names = std::fs::read_dir(directory).map(|entries| entries.flatten().collect::<Vec<_>>());
        let named = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().contains(wanted);
        names.unwrap_or_default().iter().filter(|entry| named(entry)).count()
    };
    let set = flockslam_bus::RuntimeDir::path_of(robot);
    let inside = ["bus/nodes", "bus/services", "status", "spill/journal"];
    let inside = inside.iter().map(|name| count(&set.join(name), "")).sum::<usize>();
    count(Path::new("/dev/shm"), robot) + inside
}

/// What a set leaves behind and holds more than at first, once it has had the time to clean up.
pub fn too_much_is_left(set: &LiveSet, objects: usize, files: usize) -> Option<String> {
    // 64 reports of dead processes are kept, and what they leave until then is cleaned up once a second.
    let (objects_max, files_max) = (objects + 64 + 60, files + 8);
    let since = Instant::now();
    loop {
        let found = (left_behind(set.robot()), descriptors(set.supervisor_pid()));
        if found.0 <= objects_max && found.1 <= files_max {
            return None;
        }
        if since.elapsed() > CLEAN_LIMIT {
            return Some(format!(
                "{} objects, {} descriptors; at first {objects}, {files}",
                found.0, found.1
            ));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub fn descriptors(pid: u32) -> usize {
    std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count)
}

/// A stage is killed within its first 20 ms, again and again: what that leaves is bounded, and it gets up in the end.
pub fn crashing_starts(stage: Stage, runs: usize, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: format!("kill {} while it starts", stage.name()), ..Trial::default() };
    let drive = Drive { scan_rate_hz: SCAN_RATE_HZ, duration_s: 3600.0, rate: 1.0 };
    // Given up again and again, it is tried again soon.
    let mut set = LiveSet::start("starts", directory.path(), drive, "retry_s = 0.001");
    set.wait_until_handled(stage, 1);
    let (objects, files) = (left_behind(set.robot()), descriptors(set.supervisor_pid()));
    let mut pid = set.pid(stage);
    for run in 0..runs {
        send(pid, Signal::KILL);
        let killed = Some(pid);
        let is_next = |next: Option<u32>| next.is_some() && next != killed;
        let status = set.wait_until("a successor", |status| is_next(of(status, stage).pid));
        pid = of(&status, stage).pid.unwrap();
        trial.runs += 1;
        if (run + 1) % runs.div_ceil(GETTING_UP) == 0 {
            let since = Instant::now();
            set.wait_until("the stage to get up", |status| {
                of(status, stage).handled > 0 && of(status, stage).state == StageState::Running
            });
            trial.recoveries_ms.push(since.elapsed().as_secs_f64() * 1e3);
            pid = set.pid(stage);
        } else {
            std::thread::sleep(Duration::from_millis(random.below(20)));
        }
    }
    trial.violations.extend(too_much_is_left(&set, objects, files));
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
    trial
}
