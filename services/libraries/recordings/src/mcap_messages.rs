//! MCAP files, a record at a time; one that was not closed up to where it ends.

use crate::any_recording::{MessageSource, Topic};
use crate::set_record::{bus_encoding, set_record_encoding};
use crate::{Message, RecordingError, Wire};
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader};
use mcap::{McapError, McapResult, parse_record};
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

/// A message's channel, number, and the times at which it was recorded and sent lie before its fields, bytes.
const MESSAGE_HEAD: usize = 2 + 4 + 8 + 8;

/// An MCAP file that is read from its start to its end.
pub struct McapFile {
    file: File,
    name: String,
    reader: LinearReader,
    contents: Contents,
    cut_short: Option<String>,
}

/// What is known of the topics of a file.
#[derive(Default)]
struct Contents {
    schemas: BTreeMap<u16, String>,
    /// By number of the channel.
    channels: BTreeMap<u16, usize>,
    topics: Vec<Topic>,
    wanted: Vec<bool>,
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
        let (reader, contents) = (linear_reader(), Contents::default());
        let mut found = Self { file, name, reader, contents, cut_short: None };
        if !found.read_summary() {
            found.contents.topics.clear();
            found.rewind()?;
            found.want(&|_| true);
            let mut topic = 0;
            while found.next(&mut |_, message| topic = message.topic)? {
                found.contents.topics[topic].messages += 1;
            }
        }
        found.contents.channels.clear();
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
        // Its records are many and small.
        let mut file = BufReader::with_capacity(BUFFER_BYTES, &mut self.file);
        while let Some(event) = reader.next_event() {
            let done = match event {
                Ok(SummaryReadEvent::SeekRequest(to)) => {
                    file.seek(to).map(|position| reader.notify_seeked(position))
                }
                Ok(SummaryReadEvent::ReadRequest(bytes)) if bytes <= RECORD_BYTES_MAX => {
                    let bytes = bytes.min(BUFFER_BYTES);
                    file.read(reader.insert(bytes)).map(|read| reader.notify_read(read))
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
            let at = self.contents.topic(&channel.topic, type_name, &channel.message_encoding);
            self.contents.topics[at].messages += counts.get(&number).copied().unwrap_or(0);
        }
        true
    }
}

impl Contents {
    fn topic(&mut self, name: &str, type_name: String, encoding: &str) -> usize {
        let wire = wire(encoding);
        let same = |topic: &Topic| topic.name == name && topic.type_name == type_name && topic.wire == wire;
        self.topics.iter().position(same).unwrap_or_else(|| {
            self.topics.push(Topic { name: name.to_owned(), type_name, wire, messages: 0 });
            self.wanted.push(true);
            self.topics.len() - 1
        })
    }

    /// A message of a wanted topic; what else a record says is kept.
    fn take<'a>(&mut self, opcode: u8, data: &'a [u8]) -> McapResult<Option<Message<'a>>> {
        match (opcode, data.split_first_chunk::<MESSAGE_HEAD>()) {
            (op::MESSAGE, Some((head, bytes))) => return Ok(self.message(head, bytes)),
            // A reader of all messages does not need their positions.
            (op::MESSAGE_INDEX, _) => return Ok(None),
            _ => {}
        }
        match parse_record(opcode, data)? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let type_name = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let at = self.topic(&channel.topic, type_name, &channel.message_encoding);
                self.channels.insert(channel.id, at);
            }
            _ => {}
        }
        Ok(None)
    }

    fn message<'a>(&self, head: &[u8; MESSAGE_HEAD], bytes: &'a [u8]) -> Option<Message<'a>> {
        let channel = u16::from_le_bytes([head[0], head[1]]);
        let topic = *self.channels.get(&channel)?;
        let recorded_ns = i64::from_le_bytes(*head[6..].first_chunk().expect("eight are there"));
        let is_wanted = self.wanted.get(topic).copied().unwrap_or(false);
        is_wanted.then_some(Message { topic, recorded_ns, bytes })
    }
}

/// Message for a damaged file.
fn damaged(name: &str, error: McapError) -> RecordingError {
    let problem = match error {
        McapError::UnsupportedCompression(packing) => {
            format!(
                "it is packed with {packing:?}: none, lz4 and zstd are known; `mcap compress` packs it anew"
            )
        }
        other => format!("{other}; `mcap recover` saves what is left"),
    };
    RecordingError::damaged(name, "the MCAP file", problem)
}

/// Whether the file ends where it should go on.
fn breaks_off(error: &McapError) -> bool {
    match error {
        McapError::UnexpectedEof | McapError::UnexpectedEoc | McapError::BadFooter => true,
        McapError::Io(error) => error.kind() == std::io::ErrorKind::UnexpectedEof,
        _ => false,
    }
}

impl MessageSource for McapFile {
    fn topics(&self) -> &[Topic] {
        &self.contents.topics
    }

    fn want(&mut self, is_wanted: &dyn Fn(&Topic) -> bool) {
        self.contents.wanted = self.contents.topics.iter().map(is_wanted).collect();
    }

    fn next(&mut self, give: &mut dyn FnMut(&Topic, Message<'_>)) -> Result<bool, RecordingError> {
        let Self { file, name, reader, contents, cut_short } = self;
        while let Some(event) = reader.next_event() {
            let taken = match event {
                Ok(LinearReadEvent::ReadRequest(_)) => {
                    // As much as fits, not only the record that is wanted next.
                    let read = file.read(reader.insert(BUFFER_BYTES));
                    reader.notify_read(read.map_err(|error| RecordingError::unreadable(name, error))?);
                    continue;
                }
                Ok(LinearReadEvent::Record { opcode, data }) => contents.take(opcode, data),
                Err(error) => Err(error),
            };
            match taken {
                Ok(Some(message)) => {
                    give(&contents.topics[message.topic], message);
                    return Ok(true);
                }
                Ok(None) => {}
                Err(error) if breaks_off(&error) => {
                    *cut_short = Some("the MCAP file was not closed or is cut off".to_owned());
                    return Ok(false);
                }
                Err(error) => return Err(damaged(name, error)),
            }
        }
        Ok(false)
    }

    fn cut_short(&self) -> Option<&str> {
        self.cut_short.as_deref()
    }
}
