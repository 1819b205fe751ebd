//! Writes messages of a recording to an MCAP file, uncompressed and in chunks.

use super::{RecordError, RecordTopic, Recorded};
use flockslam_recordings::{bus_encoding, set_record_encoding};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const CHUNK_BYTES: u64 = 1 << 20;
/// What was recorded reaches the disk's cache this often: a recorder that is killed loses no more.
const FLUSH_PERIOD: Duration = Duration::from_secs(1);

/// An MCAP file that is being written.
pub struct McapFile {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: [u16; RecordTopic::COUNT],
    counts: [u32; RecordTopic::COUNT],
    flushed: Instant,
}

impl McapFile {
    /// Begins a file that is not there yet.
    ///
    /// # Errors
    /// When it is there, or cannot be written.
    pub fn create(path: &Path) -> Result<Self, RecordError> {
        let failed = |problem: &dyn std::fmt::Display| failed(path, problem);
        let file = File::create_new(path).map_err(|error| failed(&error))?;
        let mut writer = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .library(format!("flockslam {}", crate::VERSION))
            .create(BufWriter::new(file))
            .map_err(|error| failed(&error))?;
        let mut channels = [0; RecordTopic::COUNT];
        for topic in RecordTopic::all() {
            let (schema_encoding, encoding) = match topic {
                RecordTopic::BusScan => ("", bus_encoding()),
                RecordTopic::SetRecord => ("", set_record_encoding()),
                _ => ("jsonschema", "json".to_owned()),
            };
            let schema = writer
                .add_schema(topic.schema_name(), schema_encoding, topic.schema().as_bytes())
                .map_err(|error| failed(&error))?;
            channels[topic.place()] = writer
                .add_channel(schema, topic.name(), &encoding, &BTreeMap::new())
                .map_err(|error| failed(&error))?;
        }
        let mut file = Self {
            path: path.to_owned(),
            writer,
            channels,
            counts: [0; RecordTopic::COUNT],
            flushed: Instant::now(),
        };
        file.flush()?;
        Ok(file)
    }

    /// Adds a message.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn put(&mut self, message: &Recorded) -> Result<(), RecordError> {
        let place = message.topic.place();
        let header = MessageHeader {
            channel_id: self.channels[place],
            sequence: self.counts[place],
            log_time: message.utc_ns,
            publish_time: message.utc_ns,
        };
        self.counts[place] = self.counts[place].wrapping_add(1);
        let written = self.writer.write_to_known_channel(&header, &message.data);
        written.map_err(|error| failed(&self.path, &error))
    }

    /// Hands what was added so far to the system when that was not done for a while.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn flush_sometimes(&mut self) -> Result<(), RecordError> {
        if self.flushed.elapsed() >= FLUSH_PERIOD { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        self.flushed = Instant::now();
        self.writer.flush().map_err(|error| failed(&self.path, &error))
    }

    /// Messages of each topic so far, in the order of [`RecordTopic::all`].
    pub fn counts(&self) -> [u32; RecordTopic::COUNT] {
        self.counts
    }

    /// Writes the index at the end.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn finish(mut self) -> Result<(), RecordError> {
        self.writer.finish().map(drop).map_err(|error| failed(&self.path, &error))
    }
}

fn failed(path: &Path, problem: &dyn std::fmt::Display) -> RecordError {
    RecordError::File { path: path.to_owned(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcap::read::{MessageStream, Options};

    fn message(utc_ns: u64) -> Recorded {
        Recorded { topic: RecordTopic::Log, utc_ns, data: format!("{{\"line\":{utc_ns}}}").into_bytes() }
    }

    #[test]
    fn what_was_flushed_is_readable_without_an_end() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let mut file = McapFile::create(&path).unwrap();
        (0..100).for_each(|k| file.put(&message(k)).unwrap());
        file.flush().unwrap();
        let begun = std::fs::read(&path).unwrap();
        let stream = MessageStream::new_with_options(&begun, Options::IgnoreEndMagic.into()).unwrap();
        let times: Vec<u64> = stream.map_while(Result::ok).map(|message| message.log_time).collect();
        assert_eq!(times, (0..100).collect::<Vec<u64>>());
        file.put(&message(100)).unwrap();
        assert_eq!(file.counts()[RecordTopic::Log.place()], 101);
        file.finish().unwrap();
        let whole = std::fs::read(&path).unwrap();
        let last = MessageStream::new(&whole).unwrap().last().unwrap().unwrap();
        assert_eq!((last.channel.topic.as_str(), last.log_time), ("/log", 100));
        assert_eq!(last.channel.schema.as_ref().unwrap().name, "foxglove.Log");
        assert!(matches!(McapFile::create(&path), Err(RecordError::File { .. })));
    }
}
