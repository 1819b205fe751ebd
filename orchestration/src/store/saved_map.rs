//! A saved map: it is checked byte by byte, restored into the directory of a set, and its damaged parts are set aside.

use super::{MapHead, StoreError};
use flockslam_bus::RuntimeDir;
use flockslam_journal::{Durability, Ending, RecordReader, RecordWriter, replace_file};
use flockslam_results::SubmapStore;
use flockslam_results::flock_files::records_file;
use flockslam_stage::{JournalReader, journal_file};
use std::fs;
use std::path::{Path, PathBuf};

/// A map on disk.
#[derive(Clone, Debug)]
pub struct SavedMap {
    directory: PathBuf,
}

/// Result of the verification of a whole saved map.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// Good poses in the journal.
    pub poses: u64,
    /// Of those, with a scan that is in the map.
    pub accepted: u64,
    /// Good submaps, from the first on.
    pub submaps: u32,
    /// Sequence after that of the last pose.
    pub next_sequence: u64,
    /// What is damaged: one line each.
    pub problems: Vec<String>,
}

impl SavedMap {
    /// The map in this directory, which need not exist.
    pub fn at(directory: &Path) -> Self {
        Self { directory: directory.to_owned() }
    }

    /// Whether there is one.
    pub fn exists(&self) -> bool {
        !matches!(MapHead::read(&self.directory), Err(StoreError::Absent(_)))
    }

    /// Where it is.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Its submaps.
    pub fn submaps(&self) -> SubmapStore {
        SubmapStore::new(&self.directory.join("submaps"))
    }

    /// Looks at every byte.
    ///
    /// # Errors
    /// When there is no map, its head is damaged, or a file cannot be read.
    pub fn check(&self) -> Result<Findings, StoreError> {
        MapHead::read(&self.directory)?;
        let mut findings = self.check_journal()?;
        self.check_submaps(&mut findings);
        Ok(findings)
    }

    fn check_journal(&self) -> Result<Findings, StoreError> {
        let mut findings = Findings::default();
        let mut journal = JournalReader::open(&self.directory)?;
        while let Some(record) = journal.read_next()? {
            findings.poses += 1;
            findings.accepted += u64::from(record.scan.is_some());
            findings.next_sequence = record.pose.id.sequence + 1;
        }
        if let Ending::Torn { offset, bytes } = journal.ending() {
            let text = format!("scans.journal: {bytes} bytes behind byte {offset} are damaged or incomplete");
            findings.problems.push(text);
        }
        Ok(findings)
    }

    /// The submaps that are good from the first on and do not know more than the journal.
    fn check_submaps(&self, findings: &mut Findings) {
        let (store, mut last) = (self.submaps(), None);
        for number in 0..store.count() {
            let problem = match store.load(number) {
                Err(error) => Some(error.to_string()),
                Ok(submap) if submap.number != number || Some(submap.first) <= last => {
                    Some(format!("submap {number} is not the one of its place"))
                }
                Ok(submap) if submap.last >= findings.next_sequence => {
                    Some(format!("submap {number} is of scans that the journal has lost"))
                }
                Ok(submap) => {
                    last = Some(submap.last);
                    None
                }
            };
            match problem {
                Some(problem) => {
                    findings.problems.push(problem);
                    return;
                }
                None => findings.submaps = number + 1,
            }
        }
    }

    /// Puts what is good of it into the directory of a set that is about to start, and says what that is; the map itself is left as
    /// it is. The scans of the session that begins now are numbered from `next_sequence` on.
    ///
    /// # Errors
    /// When there is no map, it does not fit `wanted`, or a file cannot be read or written.
    pub fn restore(&self, runtime: &RuntimeDir, wanted: &MapHead) -> Result<Findings, StoreError> {
        MapHead::read(&self.directory)?.fits(&self.directory, wanted)?;
        let findings = self.check()?;
        let (from, to) = (journal_file(&self.directory), journal_file(&runtime.journal()));
        if from.exists() {
            copy_records(&from, &to)?;
        }
        let (from, to) = (records_file(&self.directory), records_file(&runtime.results()));
        if from.exists() && findings.problems.is_empty() {
            copy_records(&from, &to)?;
        }
        let (from, to) = (self.submaps(), SubmapStore::new(&runtime.submaps()));
        for number in 0..findings.submaps {
            let bytes = fs::read(from.file(number)).map_err(StoreError::io(from.file(number)))?;
            replace_file(&to.file(number), &bytes, Durability::Process)?;
        }
        Ok(findings)
    }

    /// Before what is good of a damaged map is continued in its own directory: keeps the damaged journal beside the one that goes on,
    /// and sets the submaps aside that were made of what is lost, or are made again.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn set_damage_aside(&self, findings: &Findings) -> Result<(), StoreError> {
        if findings.problems.is_empty() {
            return Ok(());
        }
        let (journal, submaps) = (journal_file(&self.directory), self.submaps());
        let kept = journal.with_extension("damaged");
        if journal.exists() {
            fs::copy(&journal, &kept).map_err(StoreError::io(kept))?;
        }
        // Published records of lost scans cannot be withdrawn: the robot begins a new log.
        let records = records_file(&self.directory);
        if records.exists() {
            let kept = records.with_extension("damaged");
            fs::rename(&records, &kept).map_err(StoreError::io(kept))?;
        }
        (findings.submaps..submaps.count()).try_for_each(|number| {
            let file = submaps.file(number);
            fs::rename(&file, file.with_extension("damaged")).map_err(StoreError::io(file))
        })
    }
}

/// Copies the good records of a journal.
fn copy_records(from: &Path, to: &Path) -> Result<(), StoreError> {
    let (mut records, mut writer) = (RecordReader::open(from)?, RecordWriter::create(to)?);
    while let Some(record) = records.next_record()? {
        writer.append(record.kind, &[record.payload])?;
    }
    Ok(())
}
