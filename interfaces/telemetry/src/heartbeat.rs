//! Heartbeats: a small file that a stage writes and the supervisor reads, with a check word against torn writes.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// A heartbeat is written at most this often.
const PERIOD_NS: u64 = 100_000_000;
/// Pid, readiness and whether it works, time, count, and a check word that tells a torn or foreign file.
const BYTES: usize = 32;
const CHECK: u64 = u64::from_le_bytes(*b"flkbeat3");

/// A sign of life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// Process that gave it.
    pub pid: u32,
    /// Whether the process has recovered what its predecessor knew and works.
    pub ready: bool,
    /// CLOCK_MONOTONIC when it was given, nanoseconds.
    pub monotonic_ns: u64,
    /// Scans handled by the process until then.
    pub handled: u64,
    /// Whether the process has met a scan: it handled one, or there was nothing to do for it.
    pub works: bool,
    /// Whether all that the process has to keep is in its files.
    pub durable: bool,
}

/// Why a heartbeat could not be opened, written or read.
#[derive(Debug, thiserror::Error)]
#[error("heartbeat {}: {source}", path.display())]
pub struct HeartbeatError {
    path: PathBuf,
    source: io::Error,
}

/// The stage's side of a heartbeat: a small file on tmpfs that a supervisor reads. It survives the death of the stage.
#[derive(Debug)]
pub struct Heartbeat {
    file: File,
    path: PathBuf,
    last_ns: Option<u64>,
    ready: bool,
    works: bool,
    durable: bool,
}

impl Heartbeat {
    /// Opens or makes the file.
    ///
    /// # Errors
    /// When that is not possible.
    pub fn open(path: &Path) -> Result<Self, HeartbeatError> {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|source| HeartbeatError { path: path.to_owned(), source })?;
        Ok(Self { file, path: path.to_owned(), last_ns: None, ready: false, works: false, durable: true })
    }

    /// From now on the process is ready: the next heartbeat reports it at once.
    pub fn set_ready(&mut self) {
        self.ready = true;
        self.last_ns = None;
    }

    /// Whether all that the process has to keep is in its files; true when that has changed, which the next heartbeat reports at once.
    pub fn set_durable(&mut self, durable: bool) -> bool {
        let changes = self.durable != durable;
        if changes {
            (self.durable, self.last_ns) = (durable, None);
        }
        changes
    }

    /// The process has met a scan; true when it is the first, which the next heartbeat reports at once.
    pub fn set_works(&mut self) -> bool {
        let begins = !self.works;
        if begins {
            (self.works, self.last_ns) = (true, None);
        }
        begins
    }

    /// Gives a sign of life at CLOCK_MONOTONIC `now_ns`; cheap, since only one in 100 ms is written, and that of the first scan:
    /// whether a process that died had ever worked decides how it is restarted.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn beat(&mut self, now_ns: u64, handled: u64) -> Result<(), HeartbeatError> {
        if handled > 0 {
            self.set_works();
        }
        if self.last_ns.is_some_and(|last| now_ns.saturating_sub(last) < PERIOD_NS) {
            return Ok(());
        }
        self.last_ns = Some(now_ns);
        let (pid, works, durable) = (std::process::id(), self.works, self.durable);
        let beat = Beat { pid, ready: self.ready, monotonic_ns: now_ns, handled, works, durable };
        self.file
            .write_all_at(&encode(beat), 0)
            .map_err(|source| HeartbeatError { path: self.path.clone(), source })
    }
}

/// The last sign of life in the file; `None` when there is none yet.
///
/// # Errors
/// When the file is there but cannot be read.
pub fn read_heartbeat(path: &Path) -> Result<Option<Beat>, HeartbeatError> {
    // A reader may meet a writer half way; a second look settles it.
    for _ in 0..3 {
        let mut bytes = [0; BYTES];
        match File::open(path).and_then(|file| file.read_exact_at(&mut bytes, 0)) {
            Ok(()) => match decode(&bytes) {
                Some(beat) => return Ok(Some(beat)),
                None => continue,
            },
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof) => break,
            Err(source) => return Err(HeartbeatError { path: path.to_owned(), source }),
        }
    }
    Ok(None)
}

fn encode(beat: Beat) -> [u8; BYTES] {
    let flags = u64::from(beat.ready) << 32 | u64::from(beat.works) << 33 | u64::from(beat.durable) << 34;
    let words = [u64::from(beat.pid) | flags, beat.monotonic_ns, beat.handled];
    let check = words.iter().fold(CHECK, |check, word| check.rotate_left(7) ^ word);
    let mut bytes = [0; BYTES];
    for (to, word) in bytes.chunks_exact_mut(8).zip(words.into_iter().chain([check])) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

fn decode(bytes: &[u8; BYTES]) -> Option<Beat> {
    let word = |i: usize| u64::from_le_bytes(bytes[8 * i..8 * i + 8].try_into().expect("eight bytes"));
    let flag = |bit: u32| word(0) >> bit & 1 != 0;
    let (pid, ready, works, durable) = (word(0) as u32, flag(32), flag(33), flag(34));
    let beat = Beat { pid, ready, monotonic_ns: word(1), handled: word(2), works, durable };
    (encode(beat) == *bytes).then_some(beat)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn beats_are_written_at_most_every_100_ms_and_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mapper.beat");
        assert_eq!(read_heartbeat(&path).unwrap(), None);
        let mut heart = Heartbeat::open(&path).unwrap();
        assert_eq!(read_heartbeat(&path).unwrap(), None);
        let pid = std::process::id();
        for (now_ns, handled, read_ns, read_handled) in [
            (5, 1, 5, 1),
            (99_999_999, 2, 5, 1),
            (100_000_005, 3, 100_000_005, 3),
            (100_000_006, 4, 100_000_005, 3),
        ] {
            heart.beat(now_ns, handled).unwrap();
            let (ready, works, durable) = (false, true, true);
            let expected = Beat { pid, ready, monotonic_ns: read_ns, handled: read_handled, works, durable };
            assert_eq!(read_heartbeat(&path).unwrap(), Some(expected));
        }
    }

    #[test]
    fn readiness_and_the_first_scan_are_written_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mapper.beat");
        let mut heart = Heartbeat::open(&path).unwrap();
        let state = |path: &Path| read_heartbeat(path).unwrap().map(|beat| (beat.ready, beat.handled));
        heart.beat(5, 0).unwrap();
        assert_eq!(state(&path), Some((false, 0)));
        heart.set_ready();
        heart.beat(6, 0).unwrap();
        assert_eq!(state(&path), Some((true, 0)));
        heart.beat(7, 1).unwrap();
        assert_eq!(state(&path), Some((true, 1)));
        heart.beat(8, 2).unwrap();
        assert_eq!(state(&path), Some((true, 1)));
    }

    #[test]
    fn a_process_that_has_met_a_scan_works_though_it_handled_none() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mapper.beat");
        let mut heart = Heartbeat::open(&path).unwrap();
        let works = |path: &Path| read_heartbeat(path).unwrap().map(|beat| (beat.works, beat.handled));
        heart.beat(5, 0).unwrap();
        assert_eq!(works(&path), Some((false, 0)));
        heart.set_works();
        heart.beat(6, 0).unwrap();
        assert_eq!(works(&path), Some((true, 0)));
        assert!(heart.set_durable(false) && !heart.set_durable(false));
        heart.beat(7, 0).unwrap();
        assert_eq!(read_heartbeat(&path).unwrap().map(|beat| beat.durable), Some(false));
    }

    proptest! {
        #[test]
        fn a_damaged_beat_is_no_beat(
            pid: u32, ready: bool, monotonic_ns: u64, handled: u64, works: bool, durable: bool, bit in 0..8 * BYTES
        ) {
            let beat = Beat { pid, ready, monotonic_ns, handled, works, durable };
            let mut bytes = encode(beat);
            prop_assert_eq!(decode(&bytes), Some(beat));
            bytes[bit / 8] ^= 1 << (bit % 8);
            prop_assert_eq!(decode(&bytes), None);
        }
    }
}
