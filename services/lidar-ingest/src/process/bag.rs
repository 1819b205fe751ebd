//! Reads scans with their odometry from a ROS 1 bag, in the order of the file.

use crate::bag::{BagProblem, MAGIC, MessageProblem, check_bag, laser_scan, odometry};
use crate::carmen::Tally;
use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use rosbag::{ChunkRecord, MessageRecord, RosBag};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// A pose of odometry belongs to a scan that is taken at most this much later, nanoseconds.
const ODOMETRY_AGE_NS: u64 = 100_000_000;

/// Why a bag is not read to its end: one line with place and reason.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The file cannot be opened.
    #[error("{name}: {error}")]
    Unreadable {
        /// The file.
        name: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// It is no bag, or a damaged one.
    #[error("{name}: {problem}")]
    Bag {
        /// The file.
        name: String,
        /// Where and what.
        problem: BagProblem,
    },
    /// What is in a chunk is damaged.
    #[error("{name}: byte {at}: {problem}")]
    Chunk {
        /// The file.
        name: String,
        /// Where the chunk begins.
        at: u64,
        /// The reason.
        problem: rosbag::Error,
    },
    /// A message does not match its type.
    #[error("{name}: byte {at}: message {number} on {topic}: {problem}")]
    Message {
        /// The file.
        name: String,
        /// Where its chunk begins.
        at: u64,
        /// Number of the message in the file, from 1.
        number: u64,
        /// Its topic.
        topic: String,
        /// The reason.
        problem: MessageProblem,
    },
    /// No scan in it.
    #[error("{name}: no sensor_msgs/LaserScan among its {messages} messages")]
    NoScan {
        /// The file.
        name: String,
        /// Messages of all types.
        messages: u64,
    },
}

/// Scans of a ROS 1 bag, in the order of the file: those of the first topic with `sensor_msgs/LaserScan`, with the poses of the
/// first with `nav_msgs/Odometry`. Of the lidar's mounting nothing is known: it sits in the middle of the robot, looking ahead.
pub struct BagReader {
    bag: RosBag,
    name: String,
    /// Places of the chunks that come next.
    chunks: VecDeque<u64>,
    /// By number of the connection: its topic and type.
    connections: BTreeMap<u32, (String, Kind)>,
    odometry: Option<(i64, Pose)>,
    ready: VecDeque<ScanBuffer>,
    last_stamp_ns: Option<i64>,
    tally: Tally,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Scans,
    Odometry,
    Other,
}

/// Whether a file is a bag, by how it begins.
pub fn is_bag(path: &Path) -> bool {
    let mut begins = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut begins)).is_ok() && begins == *MAGIC
}

impl BagReader {
    /// Looks a bag through and opens it.
    ///
    /// # Errors
    /// When it is damaged or cut off.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let name = path.display().to_string();
        let unreadable = |error| BagError::Unreadable { name: name.clone(), error };
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        let chunks = check_bag(&mut file).map_err(|problem| BagError::Bag { name: name.clone(), problem })?;
        Ok(Self {
            bag: RosBag::new(path).map_err(unreadable)?,
            name,
            chunks: chunks.into(),
            connections: BTreeMap::new(),
            odometry: None,
            ready: VecDeque::new(),
            last_stamp_ns: None,
            tally: Tally::default(),
        })
    }

    /// What was met so far; a message is a line.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Reads the next scan into `scan`; `false` at the end.
    ///
    /// # Errors
    /// When a chunk or a message is damaged, or there is no scan at all.
    pub fn next_scan(&mut self, scan: &mut ScanBuffer) -> Result<bool, BagError> {
        while self.ready.is_empty() {
            let Some(at) = self.chunks.pop_front() else {
                return if self.tally.scans > 0 { Ok(false) } else { Err(self.no_scan()) };
            };
            self.take_chunk(at)?;
        }
        let Some(next) = self.ready.pop_front() else { return Ok(false) };
        *scan = next;
        scan.header.id.sequence = self.tally.scans;
        self.tally.scans += 1;
        let stamp_ns = scan.header.times.sensor_ns;
        self.tally.steps_backward += u64::from(self.last_stamp_ns.is_some_and(|last| stamp_ns <= last));
        self.last_stamp_ns = Some(stamp_ns);
        Ok(true)
    }

    fn take_chunk(&mut self, at: u64) -> Result<(), BagError> {
        let name = self.name.clone();
        let damaged = |problem| BagError::Chunk { name: name.clone(), at, problem };
        let mut records = self.bag.chunk_records();
        records.seek(at).map_err(damaged)?;
        let Some(ChunkRecord::Chunk(chunk)) = records.next().transpose().map_err(damaged)? else {
            return Ok(());
        };
        for record in chunk.messages() {
            match record.map_err(damaged)? {
                MessageRecord::Connection(connection) => {
                    let kind = match connection.tp {
                        "sensor_msgs/LaserScan" => Kind::Scans,
                        "nav_msgs/Odometry" => Kind::Odometry,
                        _ => Kind::Other,
                    };
                    let known =
                        self.connections.iter().any(|(id, (_, k))| *k == kind && *id != connection.id);
                    let kind = if known { Kind::Other } else { kind };
                    self.connections.insert(connection.id, (connection.topic.to_owned(), kind));
                }
                MessageRecord::MessageData(message) => {
                    self.tally.lines += 1;
                    let (topic, kind) = match self.connections.get(&message.conn_id) {
                        Some((topic, kind)) => (topic.as_str(), *kind),
                        None => ("?", Kind::Other),
                    };
                    let wrong = |problem| {
                        let (name, number, topic) = (name.clone(), self.tally.lines, topic.to_owned());
                        BagError::Message { name, at, number, topic, problem }
                    };
                    match kind {
                        Kind::Scans => {
                            let mut scan = ScanBuffer::default();
                            laser_scan(message.data, &mut scan).map_err(wrong)?;
                            self.ready.push_back(with_odometry(scan, self.odometry));
                        }
                        Kind::Odometry => {
                            let found = odometry(message.data).map_err(wrong)?;
                            self.odometry = Some((found.stamp_ns, found.pose));
                        }
                        Kind::Other => self.tally.unknown += 1,
                    }
                }
            }
        }
        Ok(())
    }

    fn no_scan(&self) -> BagError {
        BagError::NoScan { name: self.name.clone(), messages: self.tally.lines }
    }
}

/// A scan with the pose of odometry, where that is not too old.
fn with_odometry(mut scan: ScanBuffer, odometry: Option<(i64, Pose)>) -> ScanBuffer {
    if let Some((stamp_ns, pose)) = odometry
        && scan.header.times.sensor_ns.abs_diff(stamp_ns) <= ODOMETRY_AGE_NS
    {
        (scan.header.odometry, scan.header.has_odometry) = (pose, 1);
    }
    scan
}
