//! Recordings as people have them go in as they are, whatever wrote and packed them; one that was cut off goes in as far as it goes.

use crate::support;
use crate::support::public_logs::{LOGS, Log};
use crate::support::tools::{self, tool};
use crate::support::{Outputs, data_dir, repository, stderr};
use flockslam::evaluation::{evaluate_truth, parse_tum};
use std::fs;
use std::path::{Path, PathBuf};

/// Mean error of the drive under motion capture, metres; 0.0115 m was reached, and 0.0107 to 0.0120 m where the grid is at other angles.
const CAPTURED_ERROR_M: f64 = 0.012;

/// Lines of a public log that are enough to close loops in one of them.
const LINES_OF_LOGS: usize = 6000;

fn recording(name: &str) -> Option<PathBuf> {
    Some(data_dir()?.join("robot").join(name))
}

fn mapped(place: &Path, recording: &Path) -> Outputs {
    Log::map(recording, &place.join("out"), &[])
}

/// What the executable says when it refuses a recording.
fn refusal(place: &Path, recording: &Path, more: &[&str]) -> String {
    let mut args = vec!["map".to_owned(), recording.display().to_string()];
    args.extend(more.iter().map(|arg| (*arg).to_owned()));
    let output = support::run("refused", &place.join("out"), &args);
    assert_eq!(output.status.code(), Some(2), "{recording:?}: {}", stderr(&output));
    let text = stderr(&output);
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    text
}

#[test]
fn a_bag_and_the_rosbag2_of_the_same_drive_give_the_same_bytes_and_are_true() {
    let (Some(bag), Some(folder)) = (recording("mocap/drive.bag"), recording("mocap/drive-rosbag2")) else {
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    let outputs = mapped(directory.path(), &bag);
    let truth = fs::read(recording("mocap/drive.truth.tum").unwrap()).unwrap();
    let truth = parse_tum("truth", &truth).unwrap();
    let error = evaluate_truth(&outputs.trajectory("trajectory.tum"), &truth).unwrap();
    let mean_m = error.absolute.translation_m.unwrap().mean;
    println!("{mean_m:.4} m");
    assert!(mean_m < CAPTURED_ERROR_M, "{mean_m} m");
    let of_bag = (outputs.report.map_hash.clone(), outputs.lines("trajectory.tum"));
    let outputs = mapped(directory.path(), &folder);
    assert_eq!(of_bag, (outputs.report.map_hash.clone(), outputs.lines("trajectory.tum")));
}

#[test]
fn real_recordings_of_all_kinds_give_one_map_each() {
    for (name, scans) in [
        ("carried/before.bag", 857),
        ("carried/after.bag", 730),
        ("carried/within-1.bag", 962),
        ("carried/within-2.bag", 920),
        ("transforms/odometry-in-tf.bag", 819),
        ("transforms/tf-out-of-order.bag", 136),
        ("varying-beams/rosbag2", 436),
    ] {
        let Some(file) = recording(name) else { return };
        let directory = tempfile::tempdir().unwrap();
        let report = mapped(directory.path(), &file).report;
        assert_eq!((report.scans, report.detached_scans), (scans, 0), "{name}");
    }
}

/// Packed and unpacked, in SQLite and in MCAP, converted by the public package.
#[test]
fn one_drive_in_eight_formats_gives_one_map() {
    let Some(bag) = recording("carried/after.bag") else { return };
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let Some(python) = tools::RECORDINGS.python() else { return };
    let plain = mapped(place, &bag).report.map_hash;
    for (to, options) in [
        ("sqlite", "--dst-storage sqlite3"),
        ("mcap", "--dst-storage mcap"),
        ("file", "--dst-storage sqlite3 --compress zstd --compress-mode file"),
        ("message", "--dst-storage sqlite3 --compress zstd --compress-mode message"),
        ("chunks", "--dst-storage mcap --compress zstd --compress-mode storage"),
        ("bz2.bag", "--compress bz2"),
        ("lz4.bag", "--compress lz4"),
    ] {
        let mut args = vec!["--src", bag.to_str().unwrap(), "--dst", to];
        args.extend(options.split(' '));
        tool(place, &python.with_file_name("rosbags-convert"), &args).expect("it was installed");
        assert_eq!(mapped(place, &place.join(to)).report.map_hash, plain, "{to}");
    }
    // Whatever is beside the files of a folder, and whether its description is there.
    fs::remove_file(place.join("mcap/metadata.yaml")).unwrap();
    fs::write(place.join("mcap/notes.txt"), "a drive").unwrap();
    assert_eq!(mapped(place, &place.join("mcap")).report.map_hash, plain);
    // Cut off, it is read up to there.
    let bytes = fs::read(place.join("mcap/mcap.mcap")).unwrap();
    fs::write(place.join("cut.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    let scans = mapped(place, &place.join("cut.mcap")).report.scans;
    assert!((300..500).contains(&scans), "{scans} of 730");
}

/// The start of each public log, written as a bag by the public package, and that of the first converted: one map, to the bit.
#[test]
fn logs_written_as_bags_and_these_converted_give_the_maps_of_the_logs() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let Some(logs) = LOGS.map(|log| log.file("clf")).into_iter().collect::<Option<Vec<_>>>() else { return };
    let Some(python) = tools::RECORDINGS.python() else { return };
    let script = repository().join("tests/carmen_to_bag.py").display().to_string();
    for (number, log) in logs.into_iter().enumerate() {
        let name = log.file_stem().unwrap().to_str().unwrap();
        let (begin, bag) = (format!("{name}.clf"), format!("{name}.bag"));
        let text = fs::read_to_string(&log).unwrap();
        let lines: Vec<&str> = text.split_inclusive('\n').take(LINES_OF_LOGS).collect();
        fs::write(place.join(&begin), lines.concat()).unwrap();
        let of_log = mapped(place, &place.join(&begin));
        tool(place, &python, &[&script, &begin, &bag]).expect("it was installed");
        let of_bag = mapped(place, &place.join(&bag));
        let (expected, found) = (of_log.trajectory("trajectory.tum"), of_bag.trajectory("trajectory.tum"));
        assert_eq!(expected.len(), found.len(), "{name}");
        let apart = expected.iter().zip(&found).map(|(a, b)| a.map_from_base.distance_m(b.map_from_base));
        let apart_m = apart.fold(0.0, f64::max);
        println!("{name}: {} scans, {apart_m:.6} m", expected.len());
        assert!(apart_m <= 0.0002, "{name}: {apart_m} m");
        if number > 0 {
            continue;
        }
        for (to, options) in [
            ("sqlite", "--dst-storage sqlite3"),
            ("mcap", "--dst-storage mcap"),
            ("packed", "--dst-storage mcap --compress zstd --compress-mode storage"),
        ] {
            let to = format!("{name}-{to}");
            let args: Vec<&str> =
                ["--src", &bag, "--dst", &to].into_iter().chain(options.split(' ')).collect();
            tool(place, &python.with_file_name("rosbags-convert"), &args).expect("it was installed");
            let report = mapped(place, &place.join(&to)).report;
            assert_eq!(report.map_hash, of_bag.report.map_hash, "{to}");
        }
    }
}

#[test]
fn a_bag_that_was_cut_off_is_read_up_to_there_and_a_damaged_one_is_refused() {
    let Some(bag) = recording("carried/before.bag") else { return };
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let bytes = fs::read(&bag).unwrap();
    let cut = place.join("cut.bag");
    fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let args = ["map".to_owned(), cut.display().to_string()];
    let output = support::run("cut", &place.join("out"), &args);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("cut off: read up to where it ends"), "{}", stderr(&output));
    let scans = Outputs::read(&place.join("out")).report.scans;
    assert!((300..700).contains(&scans), "{scans} of 857");
    let damaged = data_dir().unwrap().join("malformed/ccny_demo_corrupt.bag");
    assert!(
        refusal(place, &damaged, &[]).contains("byte 798265: the bag breaks off in a record, or is damaged")
    );
}

#[test]
fn missing_and_ambiguous_input_is_reported_in_one_line_with_its_cure() {
    let Some(bag) = recording("carried/before.bag") else { return };
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let text = refusal(place, &bag, &["--scan", "/front"]);
    assert!(text.contains("no scans on /front; there are: /scan (857)"), "{text}");
    let text = refusal(place, &bag, &["--odom", "/scan"]);
    assert!(text.contains("no odometry on /scan; there are: /odom (863)"), "{text}");
    fs::create_dir(place.join("empty")).unwrap();
    assert!(refusal(place, &place.join("empty"), &[]).contains("not a recording that can be read"));
    let noise = place.join("noise.mcap");
    fs::write(&noise, [b"\x89MCAP0\r\n".as_slice(), &[0xff; 400]].concat()).unwrap();
    assert!(refusal(place, &noise, &[]).contains("noise.mcap"));
}
