//! ROS 1 bags (version 2.0), chunk by chunk, plain or packed with bzip2 or LZ4; one that was not closed up to where it ends.
//!
//! The records of a file are looked through before anything of it is unpacked: no length is used that leads out of the file, and
//! no chunk that claims to be huge is unpacked.

use crate::any_recording::{MessageSource, Topic};
use crate::bag_record::{FieldList, RecordAt, RecordKind, split_record};
use crate::{Message, RecordingError, Wire};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// What every bag begins with, whatever its version.
pub const MAGIC: &[u8] = b"#ROSBAG V";
const VERSION: &[u8; 13] = b"#ROSBAG V2.0\n";
/// Unpacked, a chunk takes this much memory at most, bytes; usual ones have 0.75 MiB.
const CHUNK_BYTES_MAX: u32 = 256 << 20;

/// A bag that is read from its start to its end.
pub struct BagFile {
    file: BufReader<File>,
    name: String,
    /// Where the next record begins.
    at: u64,
    /// Where the records end: at the index, or where the file breaks off.
    end: u64,
    chunk: Vec<u8>,
    chunk_at: usize,
    topics: Vec<Topic>,
    wanted: Vec<bool>,
    /// By number of the connection.
    connections: BTreeMap<u32, usize>,
    cut_short: Option<String>,
}

impl BagFile {
    /// Looks a bag through and opens it.
    ///
    /// # Errors
    /// When it is damaged. One that was cut off is not.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let name = path.display().to_string();
        let unreadable = |error| RecordingError::unreadable(&name, error);
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        let length = file.seek(SeekFrom::End(0)).map_err(unreadable)?;
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let mut version = [0; VERSION.len()];
        if file.read_exact(&mut version).is_err() || version != *VERSION {
            return Err(RecordingError::damaged(&name, "byte 0", "not a ROS bag of version 2.0"));
        }
        let begin = VERSION.len() as u64;
        let head = RecordAt::read(&mut file, begin, length).map_err(unreadable)?;
        let head = head.filter(|head| head.fields().kind() == Some(RecordKind::Bag));
        let index = head.as_ref().and_then(|head| Some((head.end(), head.fields().u64("index_pos")?)));
        let Some((first, index)) = index else {
            return Err(RecordingError::damaged(&name, "byte 13", "the record is damaged"));
        };
        let mut bag = Self {
            file,
            name,
            at: first,
            end: index,
            chunk: Vec::new(),
            chunk_at: 0,
            topics: Vec::new(),
            wanted: Vec::new(),
            connections: BTreeMap::new(),
            cut_short: None,
        };
        if (first..=length).contains(&index) {
            bag.check_records()?;
            bag.read_index(length)?;
        } else {
            // It was not closed, or its end is missing.
            bag.end = length;
            bag.cut_short = Some("the bag was not closed or is cut off".to_owned());
            bag.find_end(length)?;
            bag.count(first)?;
        }
        Ok(bag)
    }

    fn record(&mut self, at: u64, end: u64) -> Result<Option<RecordAt>, RecordingError> {
        let record = RecordAt::read(&mut self.file, at, end);
        record.map_err(|error| RecordingError::unreadable(&self.name, error))
    }

    fn damaged(&self, at: u64, problem: impl ToString) -> RecordingError {
        RecordingError::damaged(&self.name, format!("byte {at}"), problem)
    }

    /// Walks over the records up to the index.
    fn check_records(&mut self) -> Result<(), RecordingError> {
        let mut at = self.at;
        while at < self.end {
            let Some(record) = self.record(at, self.end)? else {
                return Err(self.damaged(at, "the bag breaks off in a record, or is damaged: fetch it again, or mend it with `rosbag reindex`"));
            };
            if record.fields().kind().is_none() {
                return Err(self.damaged(at, "the record is damaged"));
            }
            at = record.end();
        }
        Ok(())
    }

    /// Without an index: where the last whole record ends.
    fn find_end(&mut self, length: u64) -> Result<(), RecordingError> {
        let mut at = self.at;
        while let Some(record) = self.record(at, length)?.filter(|record| record.fields().kind().is_some()) {
            at = record.end();
        }
        self.end = at;
        Ok(())
    }

    /// Topics and their numbers of messages, from behind the chunks.
    fn read_index(&mut self, length: u64) -> Result<(), RecordingError> {
        let mut at = self.end;
        while at < length {
            let Some(record) = self.record(at, length)? else {
                return Err(self.damaged(at, "the index is damaged"));
            };
            let data = self.data(&record)?;
            match record.fields().kind() {
                Some(RecordKind::Connection) => self.connect(&record.fields(), &data),
                Some(RecordKind::ChunkInfo) => {
                    for pair in data.chunks_exact(8) {
                        let number =
                            |at: usize| u32::from_le_bytes(pair[at..at + 4].try_into().expect("four"));
                        if let Some(topic) = self.connections.get(&number(0)) {
                            self.topics[*topic].messages += u64::from(number(4));
                        }
                    }
                }
                _ => return Err(self.damaged(at, "the index is damaged")),
            }
            at = record.end();
        }
        Ok(())
    }

    /// Topics and their numbers of messages, by going through all of them.
    fn count(&mut self, first: u64) -> Result<(), RecordingError> {
        self.want(&|_| true);
        loop {
            let mut topic = 0;
            match self.next(&mut |_, message| topic = message.topic) {
                Ok(true) => self.topics[topic].messages += 1,
                Ok(false) => break,
                // What a killed recorder was about to write.
                Err(RecordingError::Damaged { .. }) => {
                    self.end = self.at;
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        (self.at, self.chunk_at) = (first, 0);
        self.chunk.clear();
        Ok(())
    }

    fn data(&mut self, record: &RecordAt) -> Result<Vec<u8>, RecordingError> {
        let mut data = vec![0; record.data_bytes as usize];
        let read =
            self.file.seek(SeekFrom::Start(record.data_at)).and_then(|_| self.file.read_exact(&mut data));
        read.map_err(|error| RecordingError::unreadable(&self.name, error))?;
        Ok(data)
    }

    fn connect(&mut self, fields: &FieldList<'_>, data: &[u8]) {
        let data = FieldList(data);
        let (Some(number), Some(name), Some(type_name)) =
            (fields.u32("conn"), fields.text("topic"), data.text("type"))
        else {
            return;
        };
        let known = self.topics.iter().position(|topic| topic.name == name && topic.type_name == type_name);
        let at = known.unwrap_or_else(|| {
            self.topics.push(Topic { name, type_name, wire: Some(Wire::Ros1), messages: 0 });
            // Before anything is chosen all are wanted.
            self.wanted.push(true);
            self.topics.len() - 1
        });
        self.connections.insert(number, at);
    }

    fn message<'a>(&self, fields: &FieldList<'_>, data: &'a [u8]) -> Option<Message<'a>> {
        let topic = *self.connections.get(&fields.u32("conn")?)?;
        let is_wanted = self.wanted.get(topic).copied().unwrap_or(false);
        let recorded_ns = fields.time_ns("time")?;
        is_wanted.then_some(Message { topic, recorded_ns, bytes: data })
    }

    /// Gives a message, when its topic is wanted.
    fn give(&self, fields: &FieldList<'_>, data: &[u8], give: &mut dyn FnMut(&Topic, Message<'_>)) -> bool {
        let message = self.message(fields, data);
        if let Some(message) = message {
            give(&self.topics[message.topic], message);
        }
        message.is_some()
    }

    fn unpack(&mut self, record: &RecordAt, at: u64) -> Result<(), RecordingError> {
        let fields = record.fields();
        let size = fields.u32("size").ok_or_else(|| self.damaged(at, "the record is damaged"))?;
        if size > CHUNK_BYTES_MAX || record.data_bytes > CHUNK_BYTES_MAX {
            return Err(self.damaged(at, "the chunk is larger than 256 MiB"));
        }
        let packed = self.data(record)?;
        let compression = fields.text("compression").unwrap_or_default();
        self.chunk.clear();
        self.chunk_at = 0;
        // One byte more than it claims to have is seen, and not more.
        let limit = u64::from(size) + 1;
        let unpacked = match compression.as_str() {
            "none" => {
                self.chunk = packed;
                Ok(0)
            }
            "bz2" => bzip2::read::BzDecoder::new(&packed[..]).take(limit).read_to_end(&mut self.chunk),
            "lz4" => lz4::Decoder::new(&packed[..])
                .and_then(|decoder| decoder.take(limit).read_to_end(&mut self.chunk)),
            other => {
                let problem = format!(
                    "the chunk is packed with {other:?}: none, bz2 and lz4 are known; `rosbag decompress` unpacks it"
                );
                return Err(self.damaged(at, problem));
            }
        };
        unpacked.map_err(|error| self.damaged(at, error))?;
        if self.chunk.len() != size as usize {
            let has = self.chunk.len();
            self.chunk.clear();
            return Err(self.damaged(at, format!("the chunk has {has} bytes and not {size}")));
        }
        Ok(())
    }
}

impl MessageSource for BagFile {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn want(&mut self, is_wanted: &dyn Fn(&Topic) -> bool) {
        self.wanted = self.topics.iter().map(is_wanted).collect();
    }

    fn next(&mut self, give: &mut dyn FnMut(&Topic, Message<'_>)) -> Result<bool, RecordingError> {
        loop {
            while self.chunk_at < self.chunk.len() {
                let chunk = std::mem::take(&mut self.chunk);
                let found = match split_record(&chunk[self.chunk_at..]) {
                    Some((fields, data, length)) => {
                        self.chunk_at += length;
                        match fields.kind() {
                            Some(RecordKind::Connection) => {
                                self.connect(&fields, data);
                                Ok(false)
                            }
                            Some(RecordKind::Message) => Ok(self.give(&fields, data, give)),
                            _ => Ok(false),
                        }
                    }
                    None => Err(self.damaged(self.at, "a record in the chunk before breaks off")),
                };
                self.chunk = chunk;
                if found? {
                    return Ok(true);
                }
            }
            if self.at >= self.end {
                return Ok(false);
            }
            let at = self.at;
            let Some(record) = self.record(at, self.end)? else {
                return Err(self.damaged(at, "the bag breaks off in a record, or is damaged: fetch it again, or mend it with `rosbag reindex`"));
            };
            match record.fields().kind() {
                Some(RecordKind::Chunk) => self.unpack(&record, at)?,
                Some(RecordKind::Connection) => {
                    let data = self.data(&record)?;
                    self.connect(&record.fields(), &data);
                }
                // Behind the head of a chunk that a killed recorder did not finish.
                Some(RecordKind::Message) => {
                    let data = self.data(&record)?;
                    self.at = record.end();
                    if self.give(&record.fields(), &data, give) {
                        return Ok(true);
                    }
                }
                _ => {}
            }
            self.at = record.end();
        }
    }

    fn cut_short(&self) -> Option<&str> {
        self.cut_short.as_deref()
    }
}
