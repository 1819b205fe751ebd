//! Packs what a bug report needs into one file, without secrets.

use super::bundled_picture::picture_of;
use super::finding::Finding;
use super::machine_readings::Machine;
use super::redaction::Redaction;
use super::set_under_examination::SetReading;
use crate::supervisor::{SetDescription, SetFile, set_metrics_socket};
use flate2::Compression;
use flate2::write::GzEncoder;
use flockslam_bus::RuntimeDir;
use flockslam_journal::{Durability, replace_file};
use flockslam_messages::PoseFlags;
use flockslam_stage::{JournalReader, JournalWriter, Journaled, journal_file};
use flockslam_telemetry::{log_stream_file, scrape};
use std::collections::VecDeque;
use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Of the journal the records of so long are packed, by the stamps of their scans, nanoseconds …
const JOURNAL_NS: i64 = 180_000_000_000;
/// … and no more than so many numbers of beams in all.
const JOURNAL_NUMBERS_MAX: usize = 8 << 20;
/// Of the log so many bytes are packed: its end.
const LOG_BYTES_MAX: usize = 8 << 20;
const METRICS: Duration = Duration::from_secs(2);

/// Why nothing was packed.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// The archive could not be put together.
    #[error("cannot pack: {0}")]
    Pack(#[from] io::Error),
    /// The disk refused.
    #[error(transparent)]
    Write(#[from] flockslam_journal::JournalError),
}

/// Files of a report; texts go in without secrets.
#[derive(Default)]
pub struct Bundle {
    redaction: Redaction,
    files: Vec<(String, Vec<u8>)>,
    /// What is not in it, and why.
    missing: String,
}

impl Bundle {
    /// What is known of a machine, and of sets on it.
    pub fn of(machine: &Machine, sets: &[SetReading], findings: &[Finding]) -> Self {
        let mut bundle = Self::default();
        for set in sets {
            bundle.note_secrets(set);
        }
        let lines: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
        bundle.add_text("findings.txt", &lines);
        bundle.add_json("machine.json", machine);
        for set in sets {
            bundle.add_set(set);
        }
        let missing = std::mem::take(&mut bundle.missing);
        bundle.add_text("missing.txt", &missing);
        bundle
    }

    /// Adds a text, without secrets.
    pub fn add_text(&mut self, name: &str, text: &str) {
        self.files.push((name.to_owned(), self.redaction.clean(text).into_bytes()));
    }

    /// Writes the archive: tar, gzip.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, path: &Path) -> Result<(), BundleError> {
        let root = path.file_name().unwrap_or_default().to_string_lossy();
        let root = root.split('.').next().unwrap_or("flockslam").to_owned();
        let mut archive = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::default()));
        for (name, bytes) in &self.files {
            let mut header = tar::Header::new_gnu();
            header.set_size(bytes.len() as u64);
            header.set_mode(0o644);
            archive.append_data(&mut header, Path::new(&root).join(name), bytes.as_slice())?;
        }
        let bytes = archive.into_inner()?.finish()?;
        Ok(replace_file(path, &bytes, Durability::Process)?)
    }

    fn add_json(&mut self, name: &str, value: &impl serde::Serialize) {
        match serde_json::to_string_pretty(value) {
            Ok(json) => self.add_text(name, &json),
            Err(error) => self.lack(name, error),
        }
    }

    fn lack(&mut self, name: &str, why: impl std::fmt::Display) {
        let _ = writeln!(self.missing, "{name}: {why}");
    }

    /// Nothing of these files is packed, but a log line or a metric may repeat them.
    fn note_secrets(&mut self, set: &SetReading) {
        let described = set.description.as_ref().and_then(|path| SetDescription::read(path).ok());
        let described = described.and_then(|description| description.configuration(&[]).ok());
        let runtime = RuntimeDir::open(&RuntimeDir::path_of(&set.robot)).ok();
        let file = runtime.and_then(|runtime| SetFile::read(&runtime.configuration()).ok());
        for configuration in described.into_iter().chain(file.map(|file| file.configuration)) {
            let flock = &configuration.sync_manager.flock;
            [&flock.key_file, &flock.tls_key].into_iter().for_each(|path| self.redaction.add_file(path));
            configuration.page.token_file.iter().for_each(|path| self.redaction.add_file(path));
        }
        set.map.iter().for_each(|map| self.redaction.add_file(&map.join("flock.key")));
    }

    fn add_set(&mut self, set: &SetReading) {
        let robot = if set.robot.is_empty() { "set" } else { &set.robot };
        let name = |file: &str| format!("{robot}/{file}");
        self.add_json(&name("readings.json"), set);
        if let Some(path) = &set.description {
            self.add_file(&name("set.toml"), path);
            if let Some(config) = SetDescription::read(path).ok().and_then(|set| set.config) {
                self.add_file(&name("config.toml"), &config);
            }
        }
        let path = RuntimeDir::path_of(&set.robot);
        let Ok(runtime) = RuntimeDir::open(&path) else {
            return self.lack(robot, "the set does not run: no log, metrics, journal and map");
        };
        self.add_file(&name("set.json"), &runtime.configuration());
        let stream = log_stream_file(&path);
        for (file, path) in [("log.old.jsonl", stream.with_extension("old.jsonl")), ("log.jsonl", stream)] {
            self.add_file(&name(file), &path);
        }
        match scrape(&set_metrics_socket(&path), METRICS) {
            Ok(page) => self.add_text(&name("metrics.txt"), &page),
            Err(error) => self.lack(&name("metrics.txt"), error),
        }
        self.add_journal(&name("journal/scans.journal"), &runtime.journal());
        match picture_of(&runtime) {
            Ok(png) => self.files.push((name("map.png"), png)),
            Err(why) => self.lack(&name("map.png"), why),
        }
    }

    /// Adds a text file, or the end of a long one.
    fn add_file(&mut self, name: &str, path: &Path) {
        match std::fs::read(path) {
            Ok(bytes) => {
                let end = &bytes[bytes.len().saturating_sub(LOG_BYTES_MAX)..];
                self.add_text(name, &String::from_utf8_lossy(end));
            }
            Err(error) => self.lack(name, error),
        }
    }

    /// Scans and poses hold no secrets.
    fn add_journal(&mut self, name: &str, directory: &Path) {
        match last_minutes(directory) {
            Ok(bytes) => self.files.push((name.to_owned(), bytes)),
            Err(why) => self.lack(name, why),
        }
    }
}

/// The last minutes of a journal, as a journal.
fn last_minutes(directory: &Path) -> Result<Vec<u8>, String> {
    let wrong = |error: &dyn std::fmt::Display| error.to_string();
    let mut reader = JournalReader::open(directory).map_err(|error| wrong(&error))?;
    let (mut kept, mut numbers): (VecDeque<Journaled>, usize) = (VecDeque::new(), 0);
    let size = |record: &Journaled| record.scan.as_ref().map_or(0, |scan| scan.numbers.len());
    while let Some(record) = reader.read_next().map_err(|error| wrong(&error))? {
        let now_ns = record.pose.times.sensor_ns;
        numbers += size(&record);
        kept.push_back(record);
        let is_old = |record: &Journaled| now_ns.saturating_sub(record.pose.times.sensor_ns) > JOURNAL_NS;
        while numbers > JOURNAL_NUMBERS_MAX || kept.front().is_some_and(is_old) {
            numbers -= kept.pop_front().as_ref().map_or(0, size);
        }
    }
    let scratch = Scratch::new().map_err(|error| wrong(&error))?;
    let mut writer = JournalWriter::open(&scratch.0).map_err(|error| wrong(&error))?;
    for record in &kept {
        let mut pose = record.pose;
        let scan = record.scan.clone().unwrap_or_default();
        if record.scan.is_none() {
            pose.flags &= !PoseFlags::INSERT;
        }
        let view = scan.view().map_err(|error| wrong(&error))?;
        writer.append(&pose, view).map_err(|error| wrong(&error))?;
    }
    std::fs::read(journal_file(&scratch.0)).map_err(|error| wrong(&error))
}

/// A directory that goes when it is dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> io::Result<Self> {
        let path = std::env::temp_dir().join(format!("flockslam-doctor-{}", std::process::id()));
        std::fs::create_dir_all(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
