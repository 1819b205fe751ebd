//! MCAP files, a record at a time; one that was not closed up to where it ends.

use crate::any_recording::{MessageSource, Topic};
use crate::set_record::{bus_encoding, set_record_encoding};
use crate::{Message, RecordingError, Wire};
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader};
use mcap::{McapError, parse_record};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// What every MCAP file begins with.
pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Records that are larger are refused, bytes.
const RECORD_BYTES_MAX: usize = 256 << 20;
/// Read at once. A record that claims to be longer than the file then costs no memory.
const BUFFER_BYTES: usize = 1 << 18;

/// An MCAP file that is read from its beginning to its end.
pub struct McapFile {
    file: BufReader<File>,
    name: String,
    reader: LinearReader,
    schemas: BTreeMap<u16, String>,
    /// By number of the channel.
    channels: BTreeMap<u16, usize>,
    topics: Vec<Topic>,
    wanted: Vec<bool>,
    cut_short: Option<String>,
}

fn linear_reader() -> LinearReader {
    let options = LinearReaderOptions::default();
    LinearReader::new_with_options(options.with_record_length_limit(RECORD_BYTES_MAX))
}

fn wire(encoding: &str) -> Option<Wire> {
    match encoding {
        "cdr" => Some(Wire::Cdr),
        "ros1" => Some(Wire::Ros1),
        bus if bus == bus_encoding() || bus == set_record_encoding() => Some(Wire::Bus),
        _ => None,
    }
}

impl McapFile {
    /// Opens a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| RecordingError::unreadable(&name, error))?;
        let mut found = Self {
            file: BufReader::with_capacity(BUFFER_BYTES, file),
            name,
            reader: linear_reader(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            topics: Vec::new(),
            wanted: Vec::new(),
            cut_short: None,
        };
        if !found.read_summary() {
            found.topics.clear();
            found.rewind()?;
            found.want(&|_| true);
            while let Some(message) = found.next()? {
                found.topics[message.topic].messages += 1;
            }
        }
        found.channels.clear();
        found.rewind()?;
        Ok(found)
    }

    fn rewind(&mut self) -> Result<(), RecordingError> {
        self.reader = linear_reader();
        self.file
            .seek(SeekFrom::Start(0))
            .map(drop)
            .map_err(|error| RecordingError::unreadable(&self.name, error))
    }

    /// Topics and their numbers of messages from the end of the file; false when it says nothing of them.
    fn read_summary(&mut self) -> bool {
        let mut reader = SummaryReader::new();
        while let Some(event) = reader.next_event() {
            let done = match event {
                Ok(SummaryReadEvent::SeekRequest(to)) => {
                    self.file.seek(to).map(|position| reader.notify_seeked(position))
                }
                Ok(SummaryReadEvent::ReadRequest(bytes)) if bytes <= RECORD_BYTES_MAX => {
                    let bytes = bytes.min(BUFFER_BYTES);
                    self.file.read(reader.insert(bytes)).map(|read| reader.notify_read(read))
                }
                _ => return false,
            };
            if done.is_err() {
                return false;
            }
        }
        let Some((summary, counts)) = reader.finish().and_then(|summary| {
            let counts = summary.stats.as_ref()?.channel_message_counts.clone();
            Some((summary, counts))
        }) else {
            return false;
        };
        let channels: BTreeMap<u16, _> = summary.channels.into_iter().collect();
        if channels.is_empty() {
            return false;
        }
        for (number, channel) in channels {
            let type_name = channel.schema.as_ref().map_or(String::new(), |schema| schema.name.clone());
            let at = self.topic(&channel.topic, type_name, &channel.message_encoding);
            self.topics[at].messages += counts.get(&number).copied().unwrap_or(0);
        }
        true
    }

    fn topic(&mut self, name: &str, type_name: String, encoding: &str) -> usize {
        let wire = wire(encoding);
        let same = |topic: &Topic| topic.name == name && topic.type_name == type_name && topic.wire == wire;
        self.topics.iter().position(same).unwrap_or_else(|| {
            self.topics.push(Topic { name: name.to_owned(), type_name, wire, messages: 0 });
            self.wanted.push(true);
            self.topics.len() - 1
        })
    }

    fn take(&mut self, record: Record<'_>) -> Option<Message> {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let type_name = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let at = self.topic(&channel.topic, type_name, &channel.message_encoding);
                self.channels.insert(channel.id, at);
            }
            Record::Message { header, data } => {
                let topic = *self.channels.get(&header.channel_id)?;
                let is_wanted = self.wanted.get(topic).copied().unwrap_or(false);
                let recorded_ns = header.log_time as i64;
                return is_wanted.then(|| Message { topic, recorded_ns, bytes: data.into_owned() });
            }
            _ => {}
        }
        None
    }

    fn damaged(&self, error: McapError) -> RecordingError {
        let problem = match error {
            McapError::UnsupportedCompression(packing) => {
                format!(
                    "it is packed with {packing:?}: none, lz4 and zstd are known; `mcap compress` packs it anew"
                )
            }
            other => format!("{other}; `mcap recover` saves what is left"),
        };
        RecordingError::damaged(&self.name, "the MCAP file", problem)
    }
}

/// Whether the file ends where it should go on.
fn breaks_off(error: &McapError) -> bool {
    match error {
        McapError::UnexpectedEof | McapError::UnexpectedEoc | McapError::BadFooter => true,
        McapError::Io(error) => error.kind() == std::io::ErrorKind::UnexpectedEof,
        _ => false,
    }
}

/// What the reader wants next.
enum Step {
    Read(usize),
    Taken(Option<Message>),
    CutShort,
}

impl MessageSource for McapFile {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn want(&mut self, is_wanted: &dyn Fn(&Topic) -> bool) {
        self.wanted = self.topics.iter().map(is_wanted).collect();
    }

    fn next(&mut self) -> Result<Option<Message>, RecordingError> {
        let mut reader = std::mem::take(&mut self.reader);
        let found = self.next_of(&mut reader);
        self.reader = reader;
        found
    }

    fn cut_short(&self) -> Option<&str> {
        self.cut_short.as_deref()
    }
}

impl McapFile {
    fn next_of(&mut self, reader: &mut LinearReader) -> Result<Option<Message>, RecordingError> {
        loop {
            let step = match reader.next_event() {
                None => return Ok(None),
                Some(Ok(LinearReadEvent::ReadRequest(bytes))) => Step::Read(bytes),
                Some(Ok(LinearReadEvent::Record { opcode, data })) => match parse_record(opcode, data) {
                    Ok(record) => Step::Taken(self.take(record)),
                    Err(error) if breaks_off(&error) => Step::CutShort,
                    Err(error) => return Err(self.damaged(error)),
                },
                Some(Err(error)) if breaks_off(&error) => Step::CutShort,
                Some(Err(error)) => return Err(self.damaged(error)),
            };
            match step {
                Step::Read(bytes) => {
                    let read = self.file.read(reader.insert(bytes.min(BUFFER_BYTES)));
                    let read = read.map_err(|error| RecordingError::unreadable(&self.name, error))?;
                    reader.notify_read(read);
                }
                Step::Taken(Some(message)) => return Ok(Some(message)),
                Step::Taken(None) => {}
                Step::CutShort => {
                    self.cut_short = Some("the MCAP file was not closed or is cut off".to_owned());
                    return Ok(None);
                }
            }
        }
    }
}
