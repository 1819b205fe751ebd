//! Recordings that are not usable, by kind: one line with place, reason and cure. What is usable of others is used, and the rest said.

use crate::support;
use crate::support::ros_recording::{RosRecording, in_space};
use crate::support::{Outputs, data_dir, flockslam, stderr, stdout};
use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Writes a recording of some scans, ten a second, on these topics in the frame `laser`, with what else is asked for.
fn recorded(
    place: &Path,
    topics: &[&str],
    scans: std::ops::Range<i64>,
    more: impl Fn(&mut RosRecording),
) -> PathBuf {
    let path = place.join("drive.mcap");
    let mut recording = RosRecording::create(&path);
    more(&mut recording);
    for number in scans {
        for topic in topics {
            // A corner.
            let ranges: Vec<f32> = (0..90)
                .map(|beam| {
                    let angle_rad = (f64::from(beam) - 44.5).to_radians();
                    (3.0 / angle_rad.cos()).min(1.5 / angle_rad.sin().max(0.01)) as f32
                })
                .collect();
            let mut scan = ScanBuffer::from_ranges(&ranges, -44.5f64.to_radians(), 1f64.to_radians());
            scan.header.range_max_m = 20.0;
            scan.header.times.sensor_ns = number * 100_000_000;
            recording.scan(topic, "laser", &scan);
        }
    }
    recording.finish();
    path
}

fn map(place: &Path, recording: &Path) -> Output {
    let args = ["map".to_owned(), recording.display().to_string()];
    support::run("unusable", &place.join("out"), &args)
}

/// It is refused in one line, which has all these parts.
fn refused(place: &Path, recording: &Path, parts: &[&str]) {
    let output = map(place, recording);
    let text = stderr(&output);
    println!("{}", text.trim_end());
    assert_eq!((output.status.code(), text.trim_end().lines().count()), (Some(2), 1), "{text}");
    assert!(text.starts_with(&format!("flockslam: {}", recording.display())), "{text}");
    parts.iter().for_each(|part| assert!(text.contains(part), "{part:?} is expected in: {text}"));
}

/// The line of a run that goes through.
fn warned(place: &Path, recording: &Path, part: &str) {
    let output = map(place, recording);
    let text = stderr(&output);
    println!("{}", text.trim_end());
    assert!(output.status.success(), "{text}");
    assert_eq!(text.lines().filter(|line| line.contains(part)).count(), 1, "{part:?} is expected in: {text}");
}

#[test]
fn a_recording_without_scans_names_its_topics() {
    let directory = tempfile::tempdir().unwrap();
    let file = recorded(directory.path(), &[], 0..0, |recording| recording.odometry(0, Pose::IDENTITY));
    let parts =
        ["no sensor_msgs/LaserScan", "/odom (nav_msgs/msg/Odometry, 1)", "record the topic of the lidar"];
    refused(directory.path(), &file, &parts);
}

#[test]
fn of_two_topics_of_scans_one_is_to_be_chosen() {
    let directory = tempfile::tempdir().unwrap();
    let file = recorded(directory.path(), &["/front", "/rear"], 0..5, |_| {});
    refused(directory.path(), &file, &["/front (5)", "/rear (5)", "--scan TOPIC"]);
}

#[test]
fn a_lidar_that_no_transform_leads_to_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = recorded(directory.path(), &["/scan"], 0..5, |recording| {
        recording.static_transform("base_link", "camera", &in_space(Pose::IDENTITY));
    });
    refused(directory.path(), &file, &["'laser'", "/tf_static", "lidar_ingest.lidars=["]);
}

#[test]
fn messages_that_are_not_what_their_type_says_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = recorded(directory.path(), &[], 0..0, |recording| {
        (0..40).for_each(|at| recording.raw("/scan", "sensor_msgs/msg/LaserScan", at, b"\0\x01\0\0no scan"));
    });
    refused(
        directory.path(),
        &file,
        &["/scan", "the message breaks off", "11 of 11 are bad", "record it again"],
    );
}

#[test]
fn a_packing_that_is_not_known_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let file = recorded(place, &["/scan"], 0..50, |_| {});
    let replaced = |bytes: Vec<u8>, from: &[u8], to: &[u8]| {
        let mut bytes = bytes;
        let at: Vec<usize> =
            (0..bytes.len() - from.len()).filter(|at| bytes[*at..].starts_with(from)).collect();
        assert!(!at.is_empty());
        at.iter().for_each(|at| bytes[*at..*at + to.len()].copy_from_slice(to));
        bytes
    };
    fs::write(&file, replaced(fs::read(&file).unwrap(), b"zstd", b"zzzz")).unwrap();
    refused(place, &file, &["packed with \"zzzz\"", "none, lz4 and zstd are known", "mcap compress"]);
    let Some(data) = data_dir() else { return };
    let bag = place.join("drive.bag");
    fs::write(&bag, replaced(fs::read(data.join("bags/aces.bag")).unwrap(), b"=bz2", b"=zip")).unwrap();
    refused(place, &bag, &["packed with \"zip\"", "none, bz2 and lz4 are known", "rosbag decompress"]);
}

#[test]
fn a_truncated_recording_is_read_up_to_its_end() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let file = recorded(place, &["/scan"], 0..4000, |_| {});
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    warned(place, &file, "the MCAP file was not closed or is cut off: read up to where it ends");
    assert!((500..3500).contains(&Outputs::read(&place.join("out")).report.scans));
    let corpus = support::repository().join("tests/fuzz/corpus/db3/plain.db3");
    let database = place.join("drive.db3");
    let bytes = fs::read(corpus).unwrap();
    fs::write(&database, &bytes[..bytes.len() - 1024]).unwrap();
    refused(place, &database, &["the SQLite file", "cut off or damaged", "sqlite3 FILE .recover"]);
}

#[test]
fn topics_that_end_early_are_named_and_what_that_means() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let odometry = |recording: &mut RosRecording, to_s: i64| {
        (0..10 * to_s).for_each(|at| recording.odometry(at * 100_000_000, Pose::IDENTITY));
    };
    let file = recorded(place, &["/scan"], 0..300, |recording| odometry(recording, 10));
    warned(place, &file, "/odom ends 20.0 s before the recording: from there on scans alone tell");
    let inspected = flockslam().arg("inspect").arg(&file).output().unwrap();
    assert!(stdout(&inspected).contains("lacks: /odom ends 20.0 s"), "{}", stdout(&inspected));
    let file = recorded(place, &["/scan"], 0..100, |recording| odometry(recording, 30));
    warned(place, &file, "/scan ends 20.0 s before the recording: the map ends there");
}

#[test]
fn any_number_of_beams_is_taken() {
    let directory = tempfile::tempdir().unwrap();
    for beams in [60, 100_000] {
        let path = directory.path().join("drive.mcap");
        let mut recording = RosRecording::create(&path);
        for number in 0..20_i64 {
            // It varies from scan to scan.
            let beams = beams + number as u32 % 5;
            let step_rad = std::f64::consts::TAU / f64::from(beams);
            let ranges: Vec<f32> = (0..beams)
                .map(|beam| {
                    let (sin, cos) = (f64::from(beam) * step_rad).sin_cos();
                    (3.0 / cos.abs()).min(2.0 / sin.abs()) as f32
                })
                .collect();
            let mut scan = ScanBuffer::from_ranges(&ranges, 0.0, step_rad);
            scan.header.range_max_m = 20.0;
            scan.header.times.sensor_ns = number * 100_000_000;
            recording.odometry(number * 100_000_000, Pose::IDENTITY);
            recording.scan("/scan", "laser", &scan);
        }
        recording.finish();
        let output = map(directory.path(), &path);
        assert!(output.status.success(), "{}", stderr(&output));
        let outputs = Outputs::read(&directory.path().join("out"));
        assert_eq!(outputs.report.scans, 20);
        let far = outputs
            .trajectory("trajectory.tum")
            .iter()
            .any(|at| at.map_from_base.distance_m(Pose::IDENTITY) > 0.05);
        assert!(!far && outputs.report.map_area_m2 > 5.0, "{beams}: {} m²", outputs.report.map_area_m2);
    }
}
