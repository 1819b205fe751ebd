//! The readers on real logs and maps.

use crate::support::data_dir;
use flockslam_geometry::Pose;
use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::carmen::{CarmenReader, Tally};
use flockslam_lidar_ingest::stamp::StampText;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{ImageWorld, Settings as SimulationSettings, Simulation, World};
use std::time::Instant;

fn data(name: &str) -> Option<Vec<u8>> {
    Some(std::fs::read(data_dir()?.join(name)).unwrap())
}

fn read(name: &str, mut each: impl FnMut(&ScanBuffer)) -> Option<Tally> {
    let bytes = data(name)?;
    let mut reader = CarmenReader::new(&bytes[..], name, Settings::default());
    let mut scan = ScanBuffer::default();
    while reader.next_scan(&mut scan).unwrap() {
        each(&scan);
    }
    Some(reader.tally().clone())
}

#[test]
fn every_scan_of_the_logs_is_read() {
    for (name, scans, mount) in [
        ("intel/intel.clf", 13631, Pose::IDENTITY),
        ("fr079/fr079.clf", 4934, Pose::new(-0.04, 0.0, 0.0)),
        ("aces/aces.clf", 7374, Pose::IDENTITY),
        ("people/fhw-corrected.log", 488, Pose::IDENTITY),
    ] {
        let started = Instant::now();
        let check = |scan: &ScanBuffer| {
            let found = scan.header.base_from_laser;
            assert!(found.distance_m(mount) < 1e-9 && found.turn_rad(mount) < 1e-9, "{found:?}");
        };
        if let Some(tally) = read(name, check) {
            eprintln!("{name}: {:.0} scans/s, {tally:?}", scans as f64 / started.elapsed().as_secs_f64());
            assert_eq!((tally.scans, tally.rejected_lines()), (scans, 0));
        }
    }
}

#[test]
fn stamps_are_exact_and_may_run_backwards() {
    let Some(bytes) = data("intel/intel.clf") else { return };
    let mut stamps = String::new();
    let tally = read("intel/intel.clf", |scan| {
        stamps += &format!("{}\n", StampText(scan.header.times.sensor_ns));
    });
    let text = String::from_utf8(bytes).unwrap();
    let scan_lines = text.lines().filter(|line| line.starts_with("FLASER"));
    let expected: String = scan_lines.map(|line| format!("{}\n", line.rsplit(' ').nth(2).unwrap())).collect();
    assert!(stamps == expected);
    assert_eq!(tally.unwrap().steps_backward, 631);
}

#[test]
fn no_return_values_are_marked() {
    for (name, least_share) in
        [("intel/intel.clf", 0.02), ("fr079/fr079.clf", 0.01), ("aces/aces.clf", 0.001)]
    {
        let mut beams = 0;
        let longest = |scan: &ScanBuffer| {
            beams += u64::from(scan.header.beam_count);
            assert!(scan.header.range_max_m < 50.0);
        };
        let Some(tally) = read(name, longest) else { continue };
        assert!(tally.invalid_beams as f64 > least_share * beams as f64, "{name}: {}", tally.invalid_beams);
    }
}

#[test]
fn a_bag_is_refused_as_binary() {
    let Some(bytes) = data("malformed/ccny_demo_corrupt.bag") else { return };
    let mut reader = CarmenReader::new(&bytes[..], "ccny.bag", Settings::default());
    let error = reader.next_scan(&mut ScanBuffer::default()).unwrap_err().to_string();
    assert!(error.starts_with("ccny.bag:") && error.contains("not text"), "{error}");
}

#[test]
fn a_real_map_can_be_driven_through() {
    let Some(file) = data("maps/willow-2010-02-18-0.10.pgm") else { return };
    let (size, pixels) = pgm(&file);
    let world = World::Image(ImageWorld::from_grey(size[0], size[1], 0.1, pixels).unwrap());
    let started = Instant::now();
    let scans: Vec<_> = Simulation::new(&SimulationSettings::default(), world).unwrap().collect();
    let driven_m: f64 = scans.windows(2).map(|pair| pair[0].1.distance_m(pair[1].1)).sum();
    let returns = scans.iter().flat_map(|(scan, _)| &scan.numbers).filter(|range| range.is_finite()).count();
    eprintln!(
        "willow: {} scans, {driven_m:.0} m, {returns} returns in {:.2?}",
        scans.len(),
        started.elapsed()
    );
    assert!(driven_m > 100.0 && returns > 300 * scans.len() / 2);
}

/// Size and pixels of a binary PGM picture.
fn pgm(file: &[u8]) -> ([usize; 2], &[u8]) {
    let ends: Vec<usize> = (0..200).filter(|i| file[*i] == b'\n').collect();
    let lines = ends.iter().scan(0, |start, end| Some(&file[std::mem::replace(start, end + 1)..*end]));
    let header: Vec<&str> = lines
        .map_while(|line| std::str::from_utf8(line).ok())
        .filter(|line| !line.starts_with('#'))
        .take(3)
        .collect();
    let size: Vec<usize> = header[1].split(' ').map(|number| number.parse().unwrap()).collect();
    ([size[0], size[1]], &file[file.len() - size[0] * size[1]..])
}
