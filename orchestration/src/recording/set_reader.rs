//! Reads the bus and the log stream of a running set, and gives what it has read as messages of a recording.

use super::{LiveGrid, RecordError, Recorded, bus_scan, log, pose, scan, set_record, tracks, transforms};
use flockslam_bus::{
    Bus, BusError, Capacity, Publisher, RuntimeDir, ScanSubscriber, SliceSubscriber, Subscriber,
};
use flockslam_geometry::Pose;
use flockslam_messages::{
    Commit, Control, ControlKind, MarksHeader, PoseEstimate, Stage, StageInputs, TileMessage, TracksHeader,
    Verdict,
};
use flockslam_recordings::SetRecord;
use flockslam_telemetry::log_stream_file;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// The grid is sent at most this often …
const GRID_PERIOD: Duration = Duration::from_secs(1);
/// … and less often when it is larger than this, bytes.
const GRID_BYTES_A_SECOND: usize = 1 << 20;

/// Reads a running set, as one more reader of its bus.
pub struct SetReader {
    scans: ScanSubscriber,
    poses: Subscriber<PoseEstimate>,
    tiles: Subscriber<TileMessage>,
    commits: Subscriber<Commit>,
    tracks: SliceSubscriber<TracksHeader>,
    verdicts: Subscriber<Verdict>,
    inputs: Subscriber<StageInputs>,
    marks: SliceSubscriber<MarksHeader>,
    /// `set.json`, until the first scan.
    set: Option<Vec<u8>>,
    /// Wall clock of the last scan, nanoseconds.
    utc_ns: i64,
    log: LogTail,
    grid: LiveGrid,
    /// When the next grid may be sent.
    grid_due: Instant,
    base_from_laser: Pose,
    /// Sequences of the next scan and the next pose, when nothing is missed.
    expected: [Option<u64>; 2],
    missed: u64,
    _tile_request: Publisher<Control>,
    // The ports go before the bus.
    _bus: Bus,
}

impl SetReader {
    /// Joins the set in `runtime`; from here on nothing is missed that is read soon.
    ///
    /// # Errors
    /// When it does not run, or too many read it already.
    pub fn join(runtime: &RuntimeDir) -> Result<Self, RecordError> {
        let name = format!("recorder-{}", std::process::id());
        // Sizes matter to publishers only.
        let bus = Bus::join(runtime, &name, Capacity::default())?;
        let reader = Self {
            scans: bus.scan_subscriber()?,
            poses: bus.subscriber()?,
            tiles: bus.subscriber()?,
            commits: bus.subscriber()?,
            tracks: bus.slice_subscriber()?,
            verdicts: bus.subscriber()?,
            inputs: bus.subscriber()?,
            marks: bus.slice_subscriber()?,
            set: std::fs::read(runtime.configuration()).ok(),
            utc_ns: 0,
            log: LogTail::at_the_end(log_stream_file(runtime.path())),
            grid: LiveGrid::default(),
            grid_due: Instant::now(),
            base_from_laser: Pose::IDENTITY,
            expected: [None; 2],
            missed: 0,
            _tile_request: request_tiles(&bus)?,
            _bus: bus,
        };
        Ok(reader)
    }

    /// Hands everything that has arrived to `put`.
    ///
    /// # Errors
    /// What `put` or the bus could not do.
    pub fn read<E: From<BusError>>(
        &mut self,
        put: &mut impl FnMut(Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        // What a pose was made of was sent before it, and is read after it.
        let mut poses = Vec::new();
        while let Some(estimate) = self.poses.receive()? {
            poses.push(*estimate);
        }
        while let Some(sample) = self.scans.receive()? {
            self.note(0, sample.header().id.sequence);
            self.base_from_laser = sample.header().base_from_laser;
            self.utc_ns = sample.header().times.utc_ns;
            if let Ok(view) = sample.view() {
                put(scan(view))?;
                put(bus_scan(view))?;
            }
        }
        for estimate in poses {
            self.note(1, estimate.id.sequence);
            let frames = transforms(&estimate, self.base_from_laser);
            frames.into_iter().chain(pose(&estimate)).try_for_each(&mut *put)?;
            put(set_record(estimate.times.utc_ns, &SetRecord::Pose(estimate)))?;
        }
        while let Some(sample) = self.tracks.receive()? {
            put(tracks(&sample.header().times, sample.elements()))?;
        }
        self.read_inputs(put)?;
        self.read_grid(put)?;
        self.log.read().lines().filter_map(log).try_for_each(put)
    }

    /// What the stages have said and used, besides poses and commits.
    fn read_inputs<E: From<BusError>>(
        &mut self,
        put: &mut impl FnMut(Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        if let Some(set) = self.set.take_if(|_| self.utc_ns > 0) {
            put(set_record(self.utc_ns, &SetRecord::Set(set)))?;
        }
        while let Some(verdict) = self.verdicts.receive()? {
            put(set_record(verdict.times.utc_ns, &SetRecord::Verdict(*verdict)))?;
        }
        while let Some(inputs) = self.inputs.receive()? {
            put(set_record(self.utc_ns, &SetRecord::Inputs(*inputs)))?;
        }
        while let Some(marks) = self.marks.receive()? {
            let header = *marks.header();
            put(set_record(header.times.utc_ns, &SetRecord::Marks(header, marks.elements().to_vec())))?;
        }
        Ok(())
    }

    fn read_grid<E: From<BusError>>(
        &mut self,
        put: &mut impl FnMut(Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut newest = None;
        while let Some(commit) = self.commits.receive()? {
            put(set_record(commit.times.utc_ns, &SetRecord::Commit(*commit)))?;
            newest = Some(*commit);
        }
        while let Some(tile) = self.tiles.receive()? {
            self.grid.take(&tile);
        }
        let due = newest.filter(|_| Instant::now() >= self.grid_due);
        if let Some(message) = due.and_then(|commit| self.grid.message(&commit)) {
            let size = message.data.len() as f64 / GRID_BYTES_A_SECOND as f64;
            self.grid_due = Instant::now() + GRID_PERIOD.max(Duration::from_secs_f64(size));
            put(message)?;
        }
        Ok(())
    }

    /// Takes note of a sequence; a gap is what this reader was too slow for, or was lost before it.
    fn note(&mut self, of: usize, sequence: u64) {
        let expected = self.expected[of].unwrap_or(sequence);
        self.missed += sequence.saturating_sub(expected);
        self.expected[of] = Some(expected.max(sequence + 1));
    }

    /// Scans and poses that never came here.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

/// The mapper sends all its tiles once more; otherwise only those came that change. What is returned has to be kept until they have come:
/// the question goes with its publisher.
///
/// # Errors
/// When the bus refuses.
pub fn request_tiles(bus: &Bus) -> Result<Publisher<Control>, BusError> {
    let control = bus.publisher::<Control>()?;
    control.send(&Control { kind: ControlKind::TilesWanted as u32, run: 0, value: 0 })?;
    bus.notifier(Stage::Mapper.name())?.notify();
    Ok(control)
}

/// What is added to the stream of log lines.
struct LogTail {
    path: PathBuf,
    file: Option<File>,
}

impl LogTail {
    fn at_the_end(path: PathBuf) -> Self {
        let file = File::open(&path).ok().and_then(|mut file| {
            file.seek(SeekFrom::End(0)).ok()?;
            Some(file)
        });
        Self { path, file }
    }

    /// Whole lines since the last look. Lines are written in one piece.
    fn read(&mut self) -> String {
        let mut lines = String::new();
        if let Some(file) = &mut self.file {
            let _ = file.read_to_string(&mut lines);
        }
        let inode = |file: &File| file.metadata().ok().map(|metadata| metadata.ino());
        let now = std::fs::metadata(&self.path).ok().map(|metadata| metadata.ino());
        if now.is_some() && now != self.file.as_ref().and_then(inode) {
            // The stream has begun anew.
            self.file = File::open(&self.path).ok();
            if let Some(file) = &mut self.file {
                let _ = file.read_to_string(&mut lines);
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_is_followed_from_its_end_and_into_its_successor() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.jsonl");
        let mut none = LogTail::at_the_end(path.clone());
        assert_eq!(none.read(), "");
        std::fs::write(&path, "one\n").unwrap();
        let mut tail = LogTail::at_the_end(path.clone());
        assert_eq!((none.read(), tail.read()), ("one\n".to_owned(), String::new()));
        std::fs::write(&path, "one\ntwo\n").unwrap();
        std::fs::rename(&path, directory.path().join("old")).unwrap();
        std::fs::write(&path, "three\n").unwrap();
        assert_eq!(tail.read(), "two\nthree\n");
        assert_eq!(tail.read(), "");
    }
}
