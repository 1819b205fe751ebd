//! Files of rosbag2's SQLite storage: tables of topics and of messages.

use crate::any_recording::{MessageSource, Topic};
use crate::{Message, RecordingError, Wire};
use rusqlite::{Connection, ErrorCode, OpenFlags, params};
use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What every SQLite file begins with.
pub const MAGIC: &[u8] = b"SQLite format 3\0";
/// What is packed with zstd begins so: a message in CDR never does.
pub const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// A message is not larger, unpacked, bytes.
const MESSAGE_BYTES_MAX: u64 = 256 << 20;
/// Tables of a damaged file may lead in circles: a query is given up after so many steps of SQLite's machine, and so many more for each
/// byte of the file, which holds at most a row in a few bytes.
const STEPS_MAX: u64 = 10_000_000;
const STEPS_PER_BYTE: u64 = 8;
/// Steps that are counted at once.
const STEPS: u16 = 1000;
const DAMAGED: &str = "the SQLite file is cut off or damaged";
/// Messages that are fetched at once.
const FETCHED: usize = 32;

/// A file of messages in order of the time at which they were recorded.
pub struct Db3File {
    database: Connection,
    /// Steps of the present query.
    steps: Arc<AtomicU64>,
    name: String,
    topics: Vec<Topic>,
    /// By their number in the database.
    numbers: BTreeMap<i64, usize>,
    wanted: Vec<bool>,
    /// The numbers of the wanted topics, as a list of SQL.
    wanted_numbers: String,
    /// Time and number of the last message that was fetched.
    last: Option<(i64, i64)>,
    fetched: VecDeque<Fetched>,
    cut_short: Option<String>,
}

/// A message that was copied out of the database.
struct Fetched {
    topic: usize,
    recorded_ns: i64,
    bytes: Vec<u8>,
}

impl Db3File {
    /// Opens a file. What is in its write-ahead log belongs to it.
    ///
    /// # Errors
    /// When it is no such file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let name = path.display().to_string();
        let damaged = |error: rusqlite::Error| {
            let cure =
                "it is cut off or damaged; `sqlite3 FILE .recover | sqlite3 MENDED` saves what is left";
            let problem = if is_damage(&error) { cure.to_owned() } else { error.to_string() };
            RecordingError::damaged(&name, "the SQLite file", problem)
        };
        let steps = Arc::new(AtomicU64::new(0));
        let database = connect(path, &steps).map_err(damaged)?;
        let mut found = Self {
            database,
            steps,
            name: name.clone(),
            topics: Vec::new(),
            numbers: BTreeMap::new(),
            wanted: Vec::new(),
            wanted_numbers: String::new(),
            last: None,
            fetched: VecDeque::new(),
            cut_short: None,
        };
        found.read_topics().map_err(damaged)?;
        found.want(&|_| true);
        Ok(found)
    }

    fn read_topics(&mut self) -> rusqlite::Result<()> {
        let mut topics = self.database.prepare("SELECT id, name, type, serialization_format FROM topics")?;
        let mut rows = topics.query([])?;
        while let Some(row) = rows.next()? {
            let format: String = row.get(3)?;
            let wire = (format == "cdr").then_some(Wire::Cdr);
            let topic = Topic { name: row.get(1)?, type_name: row.get(2)?, wire, messages: 0 };
            self.numbers.insert(row.get(0)?, self.topics.len());
            self.topics.push(topic);
        }
        self.steps.store(0, Ordering::Relaxed);
        let counts = "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id";
        // A file that was cut off may not be counted to its end.
        let Ok(mut counts) = self.database.prepare(counts) else { return Ok(()) };
        let Ok(mut rows) = counts.query([]) else { return Ok(()) };
        while let Ok(Some(row)) = rows.next() {
            if let Some(topic) = self.numbers.get(&row.get::<_, i64>(0)?) {
                self.topics[*topic].messages = row.get::<_, i64>(1)?.try_into().unwrap_or(0);
            }
        }
        Ok(())
    }

    fn fetch(&mut self) -> rusqlite::Result<()> {
        self.steps.store(0, Ordering::Relaxed);
        // With the first time left out every message comes after.
        let (time, number) = self.last.unwrap_or((i64::MIN, i64::MIN));
        let query = format!(
            "SELECT id, topic_id, timestamp, data FROM messages \
             WHERE timestamp >= ?1 AND (timestamp > ?1 OR id > ?2) AND topic_id IN ({}) \
             ORDER BY timestamp, id LIMIT {FETCHED}",
            self.wanted_numbers
        );
        let mut messages = self.database.prepare_cached(&query)?;
        let mut rows = messages.query(params![time, number])?;
        while let Some(row) = rows.next()? {
            let (number, topic, recorded_ns): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
            // An index that does not belong to its table would give the same messages again and again.
            if self.last.is_some_and(|last| last >= (recorded_ns, number)) {
                self.cut_short = Some(DAMAGED.to_owned());
                break;
            }
            self.last = Some((recorded_ns, number));
            if let Some(topic) = self.numbers.get(&topic) {
                let bytes = row.get_ref(3)?.as_blob().map(<[u8]>::to_vec).unwrap_or_default();
                self.fetched.push_back(Fetched { topic: *topic, recorded_ns, bytes });
            }
        }
        Ok(())
    }
}

/// A connection that changes nothing beside the file: where nothing waits in a write-ahead log, not even a lock. `steps` counts those of
/// the present query.
fn connect(path: &Path, steps: &Arc<AtomicU64>) -> rusqlite::Result<Connection> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let waits = std::fs::metadata(&log).is_ok_and(|log| log.len() > 0);
    let mut name = String::from("file:");
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => name.push(*byte as char),
            _ => name.push_str(&format!("%{byte:02X}")),
        }
    }
    let steps_max = STEPS_MAX + STEPS_PER_BYTE * std::fs::metadata(path).map_or(0, |file| file.len());
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
    let open = |name: &str| {
        let database = Connection::open_with_flags(name, flags)?;
        let counted = steps.clone();
        let passes = move || counted.fetch_add(u64::from(STEPS), Ordering::Relaxed) > steps_max;
        database.progress_handler(STEPS.into(), Some(passes));
        // What is no database is found out by the first query.
        database.query_row("SELECT COUNT(*) FROM sqlite_master", [], |row| row.get::<_, i64>(0))?;
        Ok(database)
    };
    let immutable = format!("{name}?immutable=1");
    if waits { open(&name).or_else(|_| open(&immutable)) } else { open(&immutable) }
}

impl MessageSource for Db3File {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn want(&mut self, is_wanted: &dyn Fn(&Topic) -> bool) {
        self.wanted = self.topics.iter().map(is_wanted).collect();
        let wanted = self.numbers.iter().filter(|(_, topic)| self.wanted[**topic]);
        self.wanted_numbers = wanted.map(|(number, _)| number.to_string()).collect::<Vec<_>>().join(",");
    }

    fn next(&mut self, give: &mut dyn FnMut(&Topic, Message<'_>)) -> Result<bool, RecordingError> {
        if self.fetched.is_empty() && self.cut_short.is_none() {
            match self.fetch() {
                Ok(()) => {}
                Err(error) if is_damage(&error) => {
                    self.cut_short = Some(DAMAGED.to_owned());
                }
                Err(error) => return Err(RecordingError::damaged(&self.name, "the SQLite file", error)),
            }
        }
        let Some(mut message) = self.fetched.pop_front() else { return Ok(false) };
        if message.bytes.starts_with(ZSTD_MAGIC) {
            message.bytes = unpacked(&message.bytes)
                .map_err(|error| RecordingError::damaged(&self.name, "a message packed with zstd", error))?;
        }
        let Fetched { topic, recorded_ns, bytes } = &message;
        give(&self.topics[*topic], Message { topic: *topic, recorded_ns: *recorded_ns, bytes });
        Ok(true)
    }

    fn cut_short(&self) -> Option<&str> {
        self.cut_short.as_deref()
    }
}

fn is_damage(error: &rusqlite::Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::OperationInterrupted))
}

fn unpacked(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut found = Vec::new();
    zstd::Decoder::new(bytes)?.take(MESSAGE_BYTES_MAX).read_to_end(&mut found)?;
    Ok(found)
}
