//! One function for each reader of bytes from outside: whatever the bytes, it returns. The fuzz targets beside this and the bounded
//! run in `tests/fuzzing.rs` share them.

use flockslam::configuration::Configuration;
use flockslam::evaluation::parse_tum;
use flockslam::store::{MapHead, SavedMap};
use flockslam::supervisor::{Request, SetDescription};
use flockslam_evidence::Submap;
use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::carmen::CarmenReader;
use flockslam_lidar_ingest::process::RecordingReader;
use flockslam_lidars::Family;
use flockslam_messages::ScanBuffer;
use flockslam_recordings::{Reading, ReadingKind, Wire};
use flockslam_sensor_stream::{FrameReader, FramedScan, SensorFrame};
use flockslam_stage::JournalReader;
use std::fs;
use std::path::{Path, PathBuf};

/// A reader under test, by the name of its corpus.
pub type Entry = (&'static str, fn(&[u8]));

/// All of them.
pub const ENTRIES: [Entry; 12] = [
    ("bag", bag),
    ("carmen", carmen),
    ("configuration", configuration),
    ("db3", db3),
    ("journal", journal),
    ("lidars", lidars),
    ("mcap", mcap),
    ("message", message),
    ("submap", submap),
    ("saved_map", saved_map),
    ("sensor_stream", sensor_stream),
    ("trajectory", trajectory),
];

/// A CARMEN log, or what comes through a pipe.
pub fn carmen(bytes: &[u8]) {
    // As a log is read when much of it may be wrong: the reader goes on behind bad lines.
    let settings = Settings { max_bad_line_share: 1.0, ..Settings::default() };
    let mut reader = CarmenReader::new(bytes, "fuzz", settings);
    let mut scan = ScanBuffer::default();
    while let Ok(true) = reader.next_scan(&mut scan) {
        let view = scan.view().expect("a scan that is given out is whole");
        assert!((0..view.len()).filter_map(|beam| view.valid_range_m(beam)).all(f64::is_finite));
    }
}

/// A ROS 1 bag.
pub fn bag(bytes: &[u8]) {
    recording(bytes, "bag");
}

/// A file of rosbag2's SQLite storage.
pub fn db3(bytes: &[u8]) {
    recording(bytes, "db3");
}

/// An MCAP file.
pub fn mcap(bytes: &[u8]) {
    recording(bytes, "mcap");
}

/// A message of ROS: the first byte says of which kind, the second how it is serialized.
pub fn message(bytes: &[u8]) {
    use ReadingKind::{BusScan, Cloud, Imu, MultiEchoScan, Odometry, Scan, SetRecord, Transforms};
    const KINDS: [ReadingKind; 8] =
        [Scan, MultiEchoScan, Cloud, Odometry, Imu, Transforms, BusScan, SetRecord];
    let [kind, wire, message @ ..] = bytes else { return };
    let kind = KINDS[usize::from(*kind) % KINDS.len()];
    let wire = [Wire::Cdr, Wire::Ros1, Wire::Bus][usize::from(*wire) % 3];
    if let Ok(Reading::Scan(FramedScan { scan, .. }) | Reading::BusScan(scan)) =
        Reading::decode(kind, message, wire)
    {
        scan.view().expect("a scan that is given out is whole");
    }
}

/// Scans of a recording, whatever kind of file the bytes are.
fn recording(bytes: &[u8], kind: &str) {
    let path = scratch(kind).join("recording");
    fs::write(&path, bytes).expect("tmpfs can be written");
    let Ok(mut reader) = RecordingReader::open(&path, &Settings::default()) else { return };
    let mut scan = ScanBuffer::default();
    while let Ok(true) = reader.next_scan(&mut scan) {
        scan.view().expect("a scan that is given out is whole");
    }
}

/// A configuration, a description of a set, an order to a running set.
pub fn configuration(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let _ = toml::from_str::<Configuration>(text);
    let _ = toml::from_str::<SetDescription>(text);
    let _ = serde_json::from_str::<Request>(text);
    if let Some(line) = text.lines().next() {
        let _ = Configuration::load(flockslam::configuration::Profile::Default, None, &[line.to_owned()]);
    }
}

/// What lidars send; the first byte says which family is to read the rest, and in which pieces.
pub fn lidars(bytes: &[u8]) {
    let Some((first, bytes)) = bytes.split_first() else { return };
    let family = Family::ALL[usize::from(*first) % Family::ALL.len()];
    let mut driver = family.driver(None, Some(115_200));
    let mut now_ns = 0;
    for piece in bytes.chunks(1 + usize::from(first >> 3)) {
        while driver.act(now_ns).is_some() {}
        driver.take(piece, now_ns, &mut |turn| {
            let mut scan = ScanBuffer::default();
            turn.write_scan(&mut scan);
            let view = scan.view().expect("a turn that is given out is a whole scan");
            assert!(
                (0..view.len()).all(|beam| view.angle_rad(beam).is_finite() && view.time_s(beam).is_finite())
            );
        });
        now_ns += 10_000_000;
    }
    assert_eq!(driver.counts().bytes, bytes.len() as u64);
}

/// A journal of scans and poses.
pub fn journal(bytes: &[u8]) {
    let directory = scratch("journal");
    fs::write(directory.join("scans.journal"), bytes).expect("tmpfs can be written");
    if let Ok(mut journal) = JournalReader::open(&directory) {
        while let Ok(Some(record)) = journal.read_next() {
            assert!(record.scan.is_none_or(|scan| scan.view().is_ok()));
        }
    }
}

/// A stored submap, as it is and with its checksum put right, so that what is behind it is reached.
pub fn submap(bytes: &[u8]) {
    let _ = Submap::decode(bytes);
    let mut sealed = bytes.to_vec();
    if let Some((head, checked)) = sealed.split_at_mut_checked(9) {
        head[5..9].copy_from_slice(&crc32fast::hash(checked).to_le_bytes());
    }
    if let Ok(submap) = Submap::decode(&sealed) {
        let again = Submap::decode(&submap.encode()).expect("what was decoded can be stored");
        assert_eq!(again.encode(), submap.encode());
    }
}

/// The head of a saved map beside a journal of the same bytes.
pub fn saved_map(bytes: &[u8]) {
    let directory = scratch("saved-map");
    fs::write(directory.join("map.head"), bytes).expect("tmpfs can be written");
    fs::write(directory.join("scans.journal"), bytes).expect("tmpfs can be written");
    let _ = MapHead::read(&directory);
    let _ = SavedMap::at(&directory).check();
}

/// What comes from a socket of sensors, in two pieces; as it is, and with the checksum of its first frame put right.
pub fn sensor_stream(bytes: &[u8]) {
    read_frames(bytes);
    let mut sealed = bytes.to_vec();
    if let Some((header, fields)) = sealed.split_at_mut_checked(16) {
        header[8..12].copy_from_slice(&(fields.len() as u32).to_le_bytes());
        header[12..].copy_from_slice(&crc32fast::hash(fields).to_le_bytes());
        read_frames(&sealed);
    }
}

fn read_frames(bytes: &[u8]) {
    let mut reader = FrameReader::default();
    let (first, second) = bytes.split_at(bytes.len() / 2);
    for piece in [first, second] {
        reader.push(piece);
        while let Some(frame) = reader.next_frame() {
            let Ok(frame) = frame else { continue };
            if let SensorFrame::Scan(scan) = &frame {
                scan.scan.scan.view().expect("a scan that is given out is whole");
            }
            let mut again = Vec::new();
            frame.write_binary(&mut again);
            let mut reader = FrameReader::default();
            reader.push(&again);
            assert!(matches!(reader.next_frame(), Some(Ok(_))), "what was read can be sent on");
        }
    }
}

/// A trajectory that is to be evaluated.
pub fn trajectory(bytes: &[u8]) {
    let _ = parse_tum("fuzz", bytes);
}

/// A directory for files that a reader wants, of this process and thread alone.
fn scratch(reader: &str) -> PathBuf {
    let name = format!("flockslam-fuzz-{reader}-{}", std::process::id());
    let directory = Path::new("/dev/shm").join(name);
    fs::create_dir_all(&directory).expect("tmpfs can be written");
    directory
}

/// Removes what the entries of this process have left.
pub fn clean_up() {
    for reader in ["bag", "db3", "journal", "mcap", "saved-map"] {
        let _ = fs::remove_dir_all(scratch(reader));
    }
}
