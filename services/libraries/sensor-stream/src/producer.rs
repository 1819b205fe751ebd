//! Sends frames to a process set, and comes back to it when it was away: what drivers and bridges use.

use crate::readings::{SensorFrame, TransformsReading};
use flockslam_transforms::StampedTransform;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// After a failure the next try comes after so long …
const RETRY_FIRST: Duration = Duration::from_millis(50);
/// … and twice as long each time, up to this.
const RETRY_LAST: Duration = Duration::from_secs(2);

/// Why a frame was not sent. It is lost, and counted; the next may arrive.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// Nobody listens, or the next try is not due yet.
    #[error("nobody listens at {path}")]
    NobodyListens {
        /// The socket.
        path: PathBuf,
    },
    /// The connection broke, or its reader did not take the frame in time.
    #[error("{path}: {error}")]
    Broken {
        /// The socket.
        path: PathBuf,
        /// Message of the system.
        error: io::Error,
    },
}

/// A producer of frames: connects to the socket of a set, sends frames, and connects again with a growing pause when the set, or its
/// lidar-ingest, was restarted. Static transforms are sent again on each connection, since a restarted receiver has lost them.
///
/// ```no_run
/// # use flockslam_sensor_stream::{Producer, SensorFrame};
/// # use std::{path::Path, time::Duration};
/// # fn send_all(frames: impl Iterator<Item = SensorFrame>) {
/// let mut producer = Producer::new(Path::new("/dev/shm/flockslam-r1/scans"), Some(Duration::from_millis(100)));
/// for frame in frames {
///     if let Err(problem) = producer.send(&frame) {
///         eprintln!("{problem}; {} frames lost so far", producer.lost());
///     }
/// }
/// # }
/// ```
#[derive(Debug)]
pub struct Producer {
    path: PathBuf,
    timeout: Option<Duration>,
    stream: Option<UnixStream>,
    /// By child frame.
    statics: BTreeMap<String, StampedTransform>,
    retry_at: Option<Instant>,
    pause: Duration,
    lost: u64,
    bytes: Vec<u8>,
}

impl Producer {
    /// A producer for the socket at `path`. A frame that is not taken within `timeout` is lost, with the connection; without one a frame
    /// waits for as long as it takes, which is for replays.
    pub fn new(path: &Path, timeout: Option<Duration>) -> Self {
        Self {
            path: path.to_owned(),
            timeout,
            stream: None,
            statics: BTreeMap::new(),
            retry_at: None,
            pause: RETRY_FIRST,
            lost: 0,
            bytes: Vec::new(),
        }
    }

    /// Frames that were not sent so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Whether a connection is there, as far as is known.
    pub fn is_connected(&self) -> bool {
        self.stream.is_some()
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// Without a receiver, or when the connection breaks. The frame is lost; static transforms are sent with the next connection.
    pub fn send(&mut self, frame: &SensorFrame) -> Result<(), SendError> {
        if let SensorFrame::Transforms(TransformsReading { is_static: true, transforms }) = frame {
            let known = transforms.iter().map(|transform| (transform.child.clone(), transform.clone()));
            self.statics.extend(known);
        }
        let sent = self.connect().and_then(|()| self.write(frame));
        self.lost += u64::from(sent.is_err());
        sent
    }

    /// Connects, when there is no connection and a try is due.
    ///
    /// # Errors
    /// Without a receiver.
    pub fn connect(&mut self) -> Result<(), SendError> {
        if self.stream.is_some() {
            return Ok(());
        }
        let nobody = || SendError::NobodyListens { path: self.path.clone() };
        if self.retry_at.is_some_and(|at| Instant::now() < at) {
            return Err(nobody());
        }
        let Ok(stream) = UnixStream::connect(&self.path) else {
            self.retry_at = Some(Instant::now() + self.pause);
            self.pause = (2 * self.pause).min(RETRY_LAST);
            return Err(nobody());
        };
        if let Err(error) = stream.set_write_timeout(self.timeout) {
            return Err(SendError::Broken { path: self.path.clone(), error });
        }
        (self.stream, self.retry_at, self.pause) = (Some(stream), None, RETRY_FIRST);
        if self.statics.is_empty() {
            return Ok(());
        }
        let transforms = self.statics.values().cloned().collect();
        self.write(&SensorFrame::Transforms(TransformsReading { is_static: true, transforms }))
    }

    fn write(&mut self, frame: &SensorFrame) -> Result<(), SendError> {
        self.bytes.clear();
        frame.write_binary(&mut self.bytes);
        let Some(stream) = &mut self.stream else {
            return Err(SendError::NobodyListens { path: self.path.clone() });
        };
        stream.write_all(&self.bytes).map_err(|error| {
            // A part of the frame may be on its way: what follows on this connection could be taken for its rest.
            self.stream = None;
            SendError::Broken { path: self.path.clone(), error }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameReader;
    use crate::test_frames::every_kind;
    use std::io::Read;
    use std::os::unix::net::UnixListener;

    /// Takes one connection and reads so many frames of it.
    fn frames(listener: &UnixListener, count: usize) -> Vec<SensorFrame> {
        let (mut stream, _) = listener.accept().unwrap();
        let (mut reader, mut found, mut bytes) = (FrameReader::default(), Vec::new(), [0; 4096]);
        while found.len() < count {
            let length = stream.read(&mut bytes).unwrap();
            reader.push(&bytes[..length]);
            found.extend(std::iter::from_fn(|| reader.next_frame()).map(Result::unwrap));
        }
        found
    }

    /// Sends until it arrives.
    fn send(producer: &mut Producer, frame: &SensorFrame) {
        while producer.send(frame).is_err() {
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_producer_outlives_its_listeners_and_resends_static_transforms() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("scans");
        let [scan, odometry, statics, _] = every_kind();
        let mut producer = Producer::new(&path, Some(Duration::from_secs(10)));
        assert!(matches!(producer.send(&statics), Err(SendError::NobodyListens { .. })));
        assert_eq!((producer.lost(), producer.is_connected()), (1, false));
        for _ in 0..2 {
            let _ = std::fs::remove_file(&path);
            let listener = UnixListener::bind(&path).unwrap();
            let received = std::thread::spawn(move || frames(&listener, 3));
            // The end of the one before may be noticed only now.
            send(&mut producer, &scan);
            send(&mut producer, &odometry);
            let received = received.join().unwrap();
            assert_eq!(received.last(), Some(&odometry));
            assert!(received.contains(&scan) && received[0] != scan, "{received:?}");
            let SensorFrame::Transforms(first) = &received[0] else { panic!("{received:?}") };
            assert!(first.is_static && first.transforms.len() == 2);
        }
    }

    #[test]
    fn a_stalled_reader_delays_a_producer_by_its_timeout_only() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("scans");
        let _listener = UnixListener::bind(&path).unwrap();
        let [scan, ..] = every_kind();
        let mut producer = Producer::new(&path, Some(Duration::from_millis(20)));
        while producer.send(&scan).is_ok() {}
        assert_eq!((producer.lost(), producer.is_connected()), (1, false));
    }
}
