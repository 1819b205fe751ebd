//! Commands in the documents that have options or arguments: each is run here as it stands there, with files by the names of its placeholders,
//! or a test is named that runs it.

use crate::documented_commands::{Documented, all_commands};
use crate::support::lidar_player::{LidarPlayer, Played};
use crate::support::{LiveSet, flockslam, of, robot, send, simulated_drive, stderr};
use flockslam::outputs::write_trajectory;
use flockslam_lidars::encoders::rplidar_encoder::RplidarEncoder;
use flockslam_lidars::encoders::sick_tim_encoder::SickTimEncoder;
use flockslam_lidars::encoders::urg_encoder::UrgEncoder;
use flockslam_lidars::encoders::ydlidar_encoder::YdlidarEncoder;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Instant;

/// What is run by other tests: a test, and the commands of which it runs one and the same with other values.
const IN_OTHER_TESTS: [(&str, &[&str]); 8] = [
    (
        "as_it_was_again.rs::the_poses_of_a_recorded_drive_with_killed_stages_are_computed_again_to_the_bit",
        &["map FILE.mcap --as-it-was", "map RECORDING --as-it-was"],
    ),
    (
        "first_set.rs::a_set_that_setup_wrote_and_started_by_options_alone_maps_with_its_lidar",
        &[
            "setup --port /dev/ttyUSB0 --robot r1 --mounting 0.1,0,180 --mode map --map maps/r1 --ros no --out r1.toml --start yes",
        ],
    ),
    (
        "first_set.rs::answers_in_a_terminal_make_the_same_description_after_the_scan_was_shown",
        &["setup --port /dev/ttyAMA0"],
    ),
    ("flock.rs::saved_maps_are_merged", &["store merge A B", "store merge A B --out OUT"]),
    ("metrics.rs::stages_answer_on_their_sockets_and_one_port_has_all_of_them", &["map --metrics-port 9464"]),
    (
        "page.rs::a_live_demo_is_shown_as_well_and_its_page_is_replaced_when_it_is_killed",
        &["demo --live", "demo --rate 1 --robot r1"],
    ),
    (
        "scans_source.rs::the_documented_driver_in_python_drives_a_set",
        &["map --source - --live --robot r1 --out DIR"],
    ),
    (
        "scans_source.rs::producers_that_die_come_back_and_send_garbage_cost_no_more_than_their_frames",
        &["map --source scans --live --robot r1 --out DIR"],
    ),
];
/// Seconds of the drives.
const DRIVE_S: f64 = 24.0;
/// A graph of ROS that no other test has; theirs have numbers up to 100.
const GRAPH: [(&str, &str); 2] = [("ROS_DOMAIN_ID", "101"), ("ROS_LOCALHOST_ONLY", "1")];
const SHORT: [&str; 2] = ["--set", "simulation.duration_s=5"];
/// The set that drives: its pace lets orders come while it does.
const LIVE: &str = "set = [\"page.enabled=false\", \"simulation.duration_s=3000.0\"]\n[source]\nkind = \"simulation\"\nrate = 3.0\n";

/// Runs commands in a directory, and knows which.
struct Reader {
    directory: PathBuf,
    robot: String,
    documented: BTreeMap<String, Documented>,
    ran: BTreeSet<String>,
    since: Instant,
}

/// A command without the name of the executable; what has only a name is a command in a sentence.
fn text(command: &Documented) -> Option<String> {
    let has_more =
        |word: &String| word.starts_with('-') || word.contains(['=', '.', '/']) || is_placeholder(word);
    command.words.iter().any(has_more).then(|| command.words[1..].join(" "))
}

fn is_placeholder(word: &str) -> bool {
    word.chars().all(|letter| letter.is_ascii_uppercase())
}

/// The words of a command, with one word for what may be called by several.
fn kinds(text: &str) -> Vec<String> {
    let kind = |word: &str| match word {
        "LOG" => "RECORDING".to_owned(),
        "set.toml" | "robot.toml" => "SET.toml".to_owned(),
        word => word.to_owned(),
    };
    text.split(' ').map(kind).collect()
}

impl Reader {
    fn new(directory: &Path) -> Self {
        let mut documented = BTreeMap::<_, Documented>::new();
        for (text, command) in
            all_commands("flockslam").into_iter().filter_map(|command| Some((text(&command)?, command)))
        {
            let is_whole = documented.get(&text).is_some_and(|known| known.whole);
            if !is_whole {
                documented.insert(text, command);
            }
        }
        Self {
            directory: directory.to_owned(),
            robot: robot("documented"),
            documented,
            ran: BTreeSet::new(),
            since: Instant::now(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    /// The command as a document has it, with other words in place of some.
    fn command(&mut self, documented: &str, instead: &[(&str, &str)]) -> Command {
        let words = self.documented.get(documented).map(|command| &command.words);
        let words = words.unwrap_or_else(|| panic!("no document has: flockslam {documented}"));
        self.ran.insert(documented.to_owned());
        println!("{:.1} s: flockslam {documented}", self.since.elapsed().as_secs_f64());
        let own = [("r1", self.robot.as_str()), ("NAME", &self.robot), ("N", "2"), ("STAGE", "mapper")];
        let word = |word: &String| {
            let known = instead.iter().chain(&own).find(|(placeholder, _)| placeholder == word);
            known.map_or(word.clone(), |(_, value)| (*value).to_owned())
        };
        let mut command = flockslam();
        command.args(words[1..].iter().map(word)).current_dir(&self.directory).stdin(Stdio::null());
        command
    }

    fn run_with(&mut self, documented: &str, instead: &[(&str, &str)], more: &[&str]) -> Output {
        let output = self.command(documented, instead).args(more).output().unwrap();
        assert!(output.status.success(), "{documented} {more:?}: {}", stderr(&output));
        output
    }

    fn run(&mut self, documented: &str) -> Output {
        self.run_with(documented, &[], &[])
    }

    /// A command to the set that runs.
    fn order(&mut self, documented: &str, instead: &[(&str, &str)]) {
        let robot = self.robot.clone();
        self.run_with(documented, instead, &["--robot", &robot]);
    }

    /// Starts a set that is described by this file.
    fn up(&mut self, documented: &str, description: &str, source: &str, instead: &[(&str, &str)]) -> LiveSet {
        fs::write(self.path(description), format!("robot = \"{}\"\n{source}", self.robot)).unwrap();
        let mut command = self.command(documented, instead);
        command.envs(GRAPH);
        let mut set = LiveSet::of_command(command, self.robot.clone(), &self.directory);
        set.wait_until("all stages", |status| status.stages.iter().all(|stage| stage.pid.is_some()));
        set
    }

    fn down(&self, mut set: LiveSet) {
        set.command_well(&["down"]);
        assert_eq!(set.wait(), Some(0));
    }
}

#[test]
fn every_command_with_options_is_run() {
    let directory = tempfile::tempdir().unwrap();
    let mut reader = Reader::new(directory.path());
    recordings(&mut reader);
    known_maps(&mut reader);
    live(&mut reader);
    lidars(&mut reader);

    let in_other_tests: BTreeSet<_> =
        IN_OTHER_TESTS.iter().flat_map(|(_, commands)| *commands).copied().collect();
    let run: Vec<_> = reader.ran.iter().map(|text| kinds(text)).collect();
    let is_run = |(text, command): &(&String, &Documented)| {
        let words = kinds(text);
        // In a sentence some of it may be left out.
        let has_all = |other: &Vec<String>| words.iter().all(|word| other.contains(word));
        in_other_tests.contains(text.as_str())
            || run.contains(&words)
            || !command.whole && run.iter().any(has_all)
    };
    let not_run: Vec<_> =
        reader.documented.iter().filter(|command| !is_run(command)).map(|(text, _)| text).collect();
    assert!(not_run.is_empty(), "no test runs: {not_run:#?}");
    let gone: Vec<_> = in_other_tests.iter().filter(|text| !reader.documented.contains_key(**text)).collect();
    assert!(gone.is_empty(), "no document has: {gone:#?}");
    for (test, _) in IN_OTHER_TESTS {
        let (file, name) = test.split_once("::").unwrap();
        let source = fs::read_to_string(crate::support::repository().join("tests").join(file)).unwrap();
        assert!(source.contains(&format!("fn {name}(")), "{test}");
    }
}

fn recordings(reader: &mut Reader) {
    let (drive, truth) = simulated_drive(&reader.directory, DRIVE_S);
    for name in ["LOG", "RECORDING", "monday.bag", "tuesday.bag", "drive.mcap"] {
        fs::copy(&drive, reader.path(name)).unwrap();
    }
    write_trajectory(&reader.path("TUM"), &truth).unwrap();
    let [first, last] = [truth.first().unwrap(), truth.last().unwrap()];
    let moved = first.map_from_base.inverse() * last.map_from_base;
    let stamps = [first, last].map(|point| point.stamp_ns as f64 * 1e-9);
    let relation =
        format!("{} {} {} {} 0 0 0 {}\n", stamps[0], stamps[1], moved.x_m, moved.y_m, moved.heading_rad);
    fs::write(reader.path("FILE"), relation).unwrap();
    fs::write(reader.path("robot.toml"), "[mapper]\ncell_size_m = 0.06\n").unwrap();

    reader.run("map LOG --config robot.toml --set correlation_filter.mode=off --out DIR");
    reader.run("map RECORDING --out DIR");
    reader.run(
        "map drive.mcap --set lidar_ingest.lidars=[{x_m=0.2, y_m=0, heading_deg=180, upside_down=true}]",
    );
    reader.run("inspect RECORDING");
    reader.run("evaluate --truth TUM --trajectory DIR/trajectory.tum");
    reader.run("evaluate --relations FILE --trajectory DIR/trajectory.tum --json figures.json");
    reader.run("swarm LOG --robots N");
    reader.run("swarm LOG --robots 3 --out DIR");
    reader.run("swarm LOG --protocol meeting");
    reader.run_with("demo --set simulation.seed=N", &[("simulation.seed=N", "simulation.seed=7")], &SHORT);
    reader.run_with("demo --set simulation.duration_s=28800", &[], &SHORT);
    reader.run_with("demo --out /maps/demo", &[("/maps/demo", "demo")], &SHORT);
    let wrong = "map LOG --set mapper.cel_size_m=0.1";
    let output = reader.command(wrong, &[]).output().unwrap();
    let shown = all_commands("flockslam").into_iter().find(|command| command.words[1..].join(" ") == wrong);
    let shown = shown.unwrap().answer;
    let (begins, ends) = shown.split_once('…').unwrap();
    let said = stderr(&output);
    assert!(said.starts_with(begins) && said.trim_end().ends_with(ends), "{said} is shown as {shown}");
}

fn known_maps(reader: &mut Reader) {
    reader.run("map monday.bag --out building");
    reader.run("map tuesday.bag --localize building --out tuesday");
    for name in ["plan.yaml", "MAP.yaml"] {
        fs::copy(reader.path("building/map.yaml"), reader.path(name)).unwrap();
    }
    fs::copy(reader.path("building/map.pgm"), reader.path("map.pgm")).unwrap();
    reader.run_with("store import MAP.yaml --out DIR", &[("DIR", "MAP")], &[]);
    let set = reader.up("up robot.toml --localize building", "robot.toml", LIVE, &[]);
    reader.order("relocalize --near 4,7,3", &[]);
    reader.order("store load MAP", &[]);
    reader.down(set);
    let set = reader.up("up robot.toml --localize plan.yaml", "robot.toml", LIVE, &[]);
    reader.down(set);
    fs::remove_dir_all(reader.path("building")).unwrap();
    reader.run("store import plan.yaml --out building");
}

fn live(reader: &mut Reader) {
    let mut set = reader.up("up SET.toml --map DIR", "SET.toml", LIVE, &[("DIR", "kept")]);
    set.wait_until_handled(Stage::SyncManager, 5);
    let mut node = reader.command("ros --robot r1 --ros-args", &[]);
    let mut node = node.envs(GRAPH).stderr(Stdio::null()).spawn().unwrap();
    let mut recorders = [("record FILE.mcap --robot NAME", "FILE.mcap"), ("record drive.mcap", "live.mcap")]
        .map(|(documented, file)| {
            let own = ["--robot".to_owned(), reader.robot.clone()];
            let own = if documented.contains("--robot") { &own[..0] } else { &own[..] };
            let mut command = reader.command(documented, &[("drive.mcap", file)]);
            (command.args(own).stdout(Stdio::null()).spawn().unwrap(), file)
        });
    reader.order("status --json", &[]);
    reader.order("restart STAGE", &[]);
    reader.order("scale mapper=2", &[]);
    reader.order("scale STAGE=N", &[("STAGE=N", "mapper=1")]);
    reader.order("log scan-matcher=debug", &[]);
    reader.order("log STAGE=FILTER", &[("STAGE=FILTER", "scan-matcher=")]);
    reader.order("store save DIR", &[("DIR", "saved")]);
    let mut doctors = [
        ("doctor SET.toml --json --bundle FILE.tar.gz", "FILE.tar.gz"),
        ("doctor --robot NAME --json --bundle FILE.tar.gz", "other.tar.gz"),
        ("doctor /etc/flockslam/r1.toml", ""),
    ]
    .map(|(documented, bundle)| {
        let instead = [("FILE.tar.gz", bundle), ("/etc/flockslam/r1.toml", "SET.toml")];
        (reader.command(documented, &instead).stdout(Stdio::null()).spawn().unwrap(), documented)
    });
    for (doctor, documented) in &mut doctors {
        // A set of which a stage was just replaced is not without findings.
        let code = doctor.wait().unwrap().code();
        assert!([Some(0), Some(3), Some(4)].contains(&code), "{documented}: {code:?}");
    }
    assert!(reader.path("FILE.tar.gz").exists() && reader.path("other.tar.gz").exists());
    let handled = of(&set.status().unwrap(), Stage::SyncManager).handled;
    set.wait_until_handled(Stage::SyncManager, handled + 30);
    for (recorder, file) in &mut recorders {
        send(recorder.id(), Signal::INT);
        assert!(recorder.wait().unwrap().success(), "{file}");
    }
    assert_eq!(node.try_wait().unwrap(), None, "the node runs as long as the set");
    set.command_well(&["down"]);
    node.wait().unwrap();
    assert_eq!(set.wait(), Some(0));
    reader.run_with("store check DIR", &[("DIR", "saved")], &[]);
    reader.run_with("store export DIR --out OUT", &[("DIR", "kept")], &[]);
    reader.run("map FILE.mcap");
    fs::rename(reader.path("kept"), reader.path("building-saved")).unwrap();
    let set = reader.up("up robot.toml --map building-saved", "robot.toml", LIVE, &[]);
    reader.down(set);
    let set = reader.up("up set.toml --map map", "set.toml", LIVE, &[]);
    reader.down(set);
    let set = reader.up("up set.toml --ros-args", "set.toml", LIVE, &[]);
    reader.down(set);
    let set = reader.up("up SET.toml", "SET.toml", LIVE, &[]);
    reader.down(set);
}

fn lidars(reader: &mut Reader) {
    let port = reader.path("lidar");
    let named = port.display().to_string();
    let serial = [
        ("ld06", Played::ld06()),
        ("rplidar", Played::Rplidar(RplidarEncoder::new(0x85, 10.0))),
        ("ydlidar", Played::Ydlidar(YdlidarEncoder::new("T-mini Plus", 3, 8.0))),
    ];
    for (kind, lidar) in serial {
        let _player = LidarPlayer::plug(&port, lidar);
        let documented = format!("lidar watch --kind {kind} --port /dev/ttyUSB0");
        reader.run_with(&documented, &[("/dev/ttyUSB0", &named)], &["--turns", "2"]);
    }
    let network = [
        ("urg", "192.168.0.10", Played::Urg(UrgEncoder::new())),
        ("sick-tim", "192.168.0.1", Played::SickTim(SickTimEncoder::new())),
    ];
    for (kind, host, lidar) in network {
        let (_player, address) = LidarPlayer::listen(lidar);
        let documented = format!("lidar watch --kind {kind} --address {host}");
        reader.run_with(&documented, &[(host, &address)], &["--turns", "2"]);
    }
    let (_player, address) = LidarPlayer::listen(Played::Urg(UrgEncoder::new()));
    let answers = ["--robot", "r2", "--mounting", "0,0,0", "--mode", "map", "--map", "new", "--ros", "no"];
    let answers = [&answers[..], &["--out", "r2.toml", "--start", "no"]].concat();
    reader.run_with("setup --address 192.168.0.10", &[("192.168.0.10", &address)], &answers);
}
