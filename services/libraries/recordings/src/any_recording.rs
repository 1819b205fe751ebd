//! Recordings of any kind, by what is in them: a file, or a folder of files that follow each other.

use crate::bag_file::{self, BagFile};
use crate::db3_file::{self, Db3File, ZSTD_MAGIC};
use crate::mcap_messages::{self, McapFile};
use crate::ros_messages::Spares;
use crate::{Message, MessageProblem, Reading, ReadingKind, RecordingError, Wire};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// The type of its messages, as the recording names it.
    pub type_name: String,
    /// How its messages are serialized; `None`: in a way that is not known.
    pub wire: Option<Wire>,
    /// Number of its messages.
    pub messages: u64,
}

impl Topic {
    /// What its messages say, where that is understood.
    pub fn kind(&self) -> Option<ReadingKind> {
        self.wire.and_then(|_| ReadingKind::of_type(&self.type_name))
    }
}

/// A message of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicReading {
    /// Which of the recording's topics.
    pub topic: usize,
    /// When it was recorded, nanoseconds.
    pub recorded_ns: i64,
    /// Its content, unless it does not match its type.
    pub reading: Result<Reading, MessageProblem>,
}

/// Messages of one file.
pub(crate) trait MessageSource: Send {
    /// All topics, with their numbers of messages.
    fn topics(&self) -> &[Topic];
    /// From now on only messages of these topics are given.
    fn want(&mut self, is_wanted: &dyn Fn(&Topic) -> bool);
    /// Gives the next message of a wanted topic where it was read, and its topic; false at the end.
    fn next(&mut self, give: &mut dyn FnMut(&Topic, Message<'_>)) -> Result<bool, RecordingError>;
    /// Why it does not go on, when it ends before its end.
    fn cut_short(&self) -> Option<&str>;
}

/// A recording that is read from its start to its end.
pub struct Recording {
    name: String,
    files: Vec<PathBuf>,
    next_file: usize,
    source: Option<OpenFile>,
    topics: Vec<Topic>,
    wanted: Vec<bool>,
    cut_short: Option<String>,
    spares: Spares,
}

/// A topic of a file whose messages are understood.
#[derive(Clone, Copy)]
struct Understood {
    /// Which of the recording's topics it is.
    topic: usize,
    kind: ReadingKind,
    wire: Wire,
}

struct OpenFile {
    messages: Box<dyn MessageSource>,
    /// By the number of a topic of the file, once a message of it was met; `Some(None)`: it is not understood.
    understood: Vec<Option<Option<Understood>>>,
    /// What was unpacked, for as long as it is read.
    _unpacked: Option<NamedTempFile>,
}

/// Whether a path is a recording: a folder, or a file that begins like one.
pub fn is_recording(path: &Path) -> bool {
    path.is_dir() || kind_of(path).is_ok_and(|kind| kind.is_some())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileKind {
    Bag,
    Mcap,
    Db3,
    Zstd,
}

fn kind_of(path: &Path) -> io::Result<Option<FileKind>> {
    let mut begins = Vec::new();
    File::open(path)?.take(16).read_to_end(&mut begins)?;
    let kinds = [
        (bag_file::MAGIC, FileKind::Bag),
        (mcap_messages::MAGIC, FileKind::Mcap),
        (db3_file::MAGIC, FileKind::Db3),
        (ZSTD_MAGIC, FileKind::Zstd),
    ];
    Ok(kinds.into_iter().find(|(magic, _)| begins.starts_with(magic)).map(|(_, kind)| kind))
}

impl Recording {
    /// Opens a file, or a folder of `.db3` and `.mcap` files in the order of the numbers that their names end with.
    ///
    /// # Errors
    /// When its format is unknown, or its start is damaged. A recording that was cut off is not.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let name = path.display().to_string();
        let unreadable = |error| RecordingError::unreadable(&name, error);
        let files = if path.is_dir() { files_of(path).map_err(unreadable)? } else { vec![path.to_owned()] };
        if files.is_empty() {
            return Err(RecordingError::Unknown { name });
        }
        let mut recording = Self {
            name,
            files,
            next_file: 0,
            source: None,
            topics: Vec::new(),
            wanted: Vec::new(),
            cut_short: None,
            spares: Spares::default(),
        };
        for file in recording.files.clone() {
            for topic in open(&file)?.messages.topics() {
                match recording.topics.iter_mut().find(|known| known.is_same(topic)) {
                    Some(known) => known.messages += topic.messages,
                    None => recording.topics.push(topic.clone()),
                }
            }
        }
        recording.wanted = vec![false; recording.topics.len()];
        Ok(recording)
    }

    /// Its files, in the order in which they are read.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The file or folder.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What is in it.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// From now on messages of these topics are given; only those that are understood can be.
    pub fn want(&mut self, topics: &[usize]) {
        let wanted = |(at, topic): (usize, &Topic)| topics.contains(&at) && topic.kind().is_some();
        self.wanted = self.topics.iter().enumerate().map(wanted).collect();
    }

    /// The next message of a wanted topic; `None` at the end.
    ///
    /// # Errors
    /// When the recording is damaged.
    pub fn next_reading(&mut self) -> Result<Option<TopicReading>, RecordingError> {
        loop {
            let Some(source) = &mut self.source else {
                let Some(file) = self.files.get(self.next_file) else { return Ok(None) };
                let mut next = open(file)?;
                let is_wanted = |topic: &Topic| {
                    self.topics
                        .iter()
                        .zip(&self.wanted)
                        .any(|(known, wanted)| *wanted && known.is_same(topic))
                };
                next.messages.want(&is_wanted);
                self.source = Some(next);
                self.next_file += 1;
                continue;
            };
            let (OpenFile { messages, understood, .. }, topics) = (source, &self.topics);
            let (spares, mut found) = (&mut self.spares, None);
            let goes_on = messages.next(&mut |topic, message| {
                if understood.len() <= message.topic {
                    understood.resize(message.topic + 1, None);
                }
                let known = understood[message.topic].get_or_insert_with(|| topic.understood(topics));
                found = known.map(|Understood { topic, kind, wire }| TopicReading {
                    topic,
                    recorded_ns: message.recorded_ns,
                    reading: Reading::decode_with(kind, message.bytes, wire, spares),
                });
            })?;
            if found.is_some() {
                return Ok(found);
            }
            if !goes_on {
                let reason = messages.cut_short().map(str::to_owned);
                self.cut_short = self.cut_short.take().or(reason);
                self.source = None;
            }
        }
    }

    /// Takes back the numbers of a scan that is no longer needed: their memory is used again.
    pub fn take_back(&mut self, numbers: Vec<f32>) {
        self.spares.numbers = numbers;
    }

    /// Why it ends before its end, once that was met: it was not closed, or is cut off.
    pub fn cut_short(&self) -> Option<&str> {
        self.cut_short.as_deref()
    }
}

impl Topic {
    fn is_same(&self, other: &Topic) -> bool {
        self.name == other.name && self.type_name == other.type_name && self.wire == other.wire
    }

    /// What its messages are among those of the recording's topics.
    fn understood(&self, topics: &[Self]) -> Option<Understood> {
        let topic = topics.iter().position(|known| known.is_same(self))?;
        Some(Understood { topic, kind: self.kind()?, wire: self.wire? })
    }
}

/// Opens a file by how it begins.
fn open(path: &Path) -> Result<OpenFile, RecordingError> {
    let name = path.display().to_string();
    let unreadable = |error| RecordingError::unreadable(&name, error);
    let unknown = || RecordingError::Unknown { name: name.clone() };
    let messages: Box<dyn MessageSource> = match kind_of(path).map_err(unreadable)?.ok_or_else(unknown)? {
        FileKind::Bag => Box::new(BagFile::open(path)?),
        FileKind::Mcap => Box::new(McapFile::open(path)?),
        FileKind::Db3 => Box::new(Db3File::open(path)?),
        FileKind::Zstd => {
            let mut unpacked = NamedTempFile::new().map_err(unreadable)?;
            let packed = File::open(path).map_err(unreadable)?;
            zstd::stream::copy_decode(packed, &mut unpacked)
                .map_err(|error| RecordingError::damaged(&name, "the zstd file", error))?;
            if kind_of(unpacked.path()).map_err(unreadable)? == Some(FileKind::Zstd) {
                return Err(unknown());
            }
            let inner = open(unpacked.path())?;
            return Ok(OpenFile { _unpacked: Some(unpacked), ..inner });
        }
    };
    Ok(OpenFile { messages, understood: Vec::new(), _unpacked: None })
}

/// Files of a folder, in the order in which they were written.
fn files_of(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let plain = name.trim_end_matches(".zstd");
        let Some(stem) = plain.strip_suffix(".db3").or_else(|| plain.strip_suffix(".mcap")) else { continue };
        let digits = stem.len() - stem.trim_end_matches(|letter: char| letter.is_ascii_digit()).len();
        let number: u64 = stem[stem.len() - digits..].parse().unwrap_or(0);
        files.push((stem[..stem.len() - digits].to_owned(), number, path));
    }
    files.sort();
    Ok(files.into_iter().map(|(_, _, path)| path).collect())
}
