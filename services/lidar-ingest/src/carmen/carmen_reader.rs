//! Reads a CARMEN log line by line: bytes in, scans out, with bounds on bad lines and on the memory for one.

use super::carmen_line::{Line, begins_a_message, parse_line};
use super::{Rejection, Tally};
use crate::Settings;
use crate::continuity::Continuity;
use flockslam_messages::ScanBuffer;
use std::io::{BufRead, Read};

/// This many bad lines are tolerated however short the log is.
const TOLERATED_BAD_LINES: u64 = 10;

/// Lines longer than this are skipped as bad without being stored, bytes: far more than a line of any lidar has.
const LINE_BYTES_MAX: u64 = 64 << 20;

/// Why a log could not be read to its end.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The bytes could not be had.
    #[error("{source_name}:{line}: {error}")]
    Io {
        /// What was read.
        source_name: String,
        /// The line that was expected, from 1.
        line: u64,
        /// The error of the system.
        error: std::io::Error,
    },
    /// Nothing in it.
    #[error("{source_name}:1: the log is empty")]
    Empty {
        /// What was read.
        source_name: String,
    },
    /// Lines, but no scan among them.
    #[error("{source_name}:{line}: {reason}; no scan (FLASER or ROBOTLASER1 line) in {lines} lines")]
    NoScan {
        /// What was read.
        source_name: String,
        /// The first bad line, or the last one.
        line: u64,
        /// The reason.
        reason: String,
        /// How many lines there are.
        lines: u64,
    },
    /// The last line breaks off.
    #[error(
        "{source_name}:{line}: the log ends in the middle of this line; lidar_ingest.accept_truncated = true takes what \
         comes before"
    )]
    Truncated {
        /// What was read.
        source_name: String,
        /// The last line.
        line: u64,
    },
    /// More bad lines than the settings allow.
    #[error(
        "{source_name}:{line}: {reason}; with this {rejected} of {lines} lines are bad, more than \
         lidar_ingest.max_bad_line_share allows"
    )]
    TooManyBadLines {
        /// What was read.
        source_name: String,
        /// The line that was one too many.
        line: u64,
        /// The reason.
        reason: Rejection,
        /// Bad lines so far.
        rejected: u64,
        /// Lines so far.
        lines: u64,
    },
}

/// Reads scans from a CARMEN log, line by line as the bytes arrive; nothing is looked at ahead of its line.
///
/// ```
/// use flockslam_lidar_ingest::{Settings, carmen::CarmenReader};
/// use flockslam_messages::ScanBuffer;
///
/// let log = "# a comment\nFLASER 3 1.0 2.0 81.9 0 0 0 0 0 0 10.5 host 0.1\n";
/// let mut reader = CarmenReader::new(log.as_bytes(), "a.log", Settings::default());
/// let mut scan = ScanBuffer::default();
/// assert!(reader.next_scan(&mut scan)?);
/// assert_eq!(scan.numbers, [1.0, 2.0, 81.9]);
/// assert_eq!(scan.header.times.sensor_ns, 10_500_000_000);
/// assert!(!reader.next_scan(&mut scan)?, "the log ends");
/// assert_eq!((reader.tally().lines, reader.tally().invalid_beams), (2, 1));
/// # Ok::<(), flockslam_lidar_ingest::carmen::ReadError>(())
/// ```
#[derive(Debug)]
pub struct CarmenReader<R> {
    input: R,
    source_name: String,
    settings: Settings,
    line: Vec<u8>,
    tally: Tally,
    last_stamp_ns: Option<i64>,
    continuity: Continuity,
    line_bytes_max: u64,
}

/// How a line in the reader's memory ended.
enum LineEnd {
    Newline,
    EndOfInput,
    TooLong,
}

impl<R: BufRead> CarmenReader<R> {
    /// A reader of `input`; `source_name` stands for it in errors.
    pub fn new(input: R, source_name: impl Into<String>, settings: Settings) -> Self {
        let source_name = source_name.into();
        Self {
            input,
            source_name,
            settings,
            line: Vec::new(),
            tally: Tally::default(),
            last_stamp_ns: None,
            continuity: Continuity::default(),
            line_bytes_max: LINE_BYTES_MAX,
        }
    }

    /// Counts so far.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Reads the next scan into `scan`, whose memory is used again; `false` at the end of the log.
    ///
    /// The scan has its number in the log as `id.sequence`, the sensor's stamp, mounting pose, odometry, angles and limits.
    /// Epoch, lidar and the other two times are left at zero. Bad lines are counted and skipped.
    ///
    /// # Errors
    /// When the input fails, has no scan, breaks off within a line, or has too many bad lines.
    pub fn next_scan(&mut self, scan: &mut ScanBuffer) -> Result<bool, ReadError> {
        while let Some(end) = self.read_line()? {
            self.tally.lines += 1;
            match self.take_line(&end, scan)? {
                Ok(Line::Scan { .. }) => match self.continuity.refuses(scan) {
                    None => {
                        self.count_scan(scan);
                        return Ok(true);
                    }
                    // The line is sound, the lidar or its driver is not: that is no reason to end.
                    Some(rejection) => self.tally.reject(rejection),
                },
                Ok(Line::Other { .. }) => {}
                Ok(Line::Unknown) => self.tally.unknown += 1,
                Err(rejection) => self.reject(rejection)?,
            }
        }
        if self.tally.scans > 0 { Ok(false) } else { Err(self.no_scan()) }
    }

    /// Reads a line into `self.line`, without its end; a line beyond the limit is passed over.
    fn read_line(&mut self) -> Result<Option<LineEnd>, ReadError> {
        self.line.clear();
        let limit = self.line_bytes_max + 1;
        let read = self.input.by_ref().take(limit).read_until(b'\n', &mut self.line);
        let read = read.map_err(|error| self.io_error(error))? as u64;
        if self.line.last() == Some(&b'\n') {
            self.line.pop();
            return Ok(Some(LineEnd::Newline));
        }
        if read == limit {
            self.input.skip_until(b'\n').map_err(|error| self.io_error(error))?;
            return Ok(Some(LineEnd::TooLong));
        }
        Ok((read > 0).then_some(LineEnd::EndOfInput))
    }

    /// Parses the line at hand; the outer error is the end of the log's reading, the inner one of this line only.
    fn take_line(&self, end: &LineEnd, scan: &mut ScanBuffer) -> Result<Result<Line, Rejection>, ReadError> {
        if matches!(end, LineEnd::TooLong) {
            return Ok(Err(Rejection::TooLong));
        }
        let parsed = parse_line(&self.line, &self.settings, scan);
        let broken_off = matches!(end, LineEnd::EndOfInput) && !is_whole(parsed, &self.line);
        if !broken_off {
            return Ok(parsed);
        }
        if self.settings.accept_truncated || (self.tally.scans == 0 && parsed.is_err()) {
            // Of a file without a scan the reason says more than that its last line is broken.
            return Ok(Err(parsed.err().unwrap_or(Rejection::TooFewFields)));
        }
        Err(ReadError::Truncated { source_name: self.source_name.clone(), line: self.tally.lines })
    }

    fn count_scan(&mut self, scan: &mut ScanBuffer) {
        let header = &mut scan.header;
        header.id.sequence = self.tally.scans;
        self.tally.scans += 1;
        let stamp_ns = header.times.sensor_ns;
        self.tally.steps_backward += u64::from(self.last_stamp_ns.is_some_and(|last| stamp_ns <= last));
        self.last_stamp_ns = Some(stamp_ns);
        let limits = header.range_min_m..=header.range_max_m;
        let ranges = &scan.numbers[..header.beam_count as usize];
        self.tally.invalid_beams += ranges.iter().filter(|range| !limits.contains(*range)).count() as u64;
    }

    fn reject(&mut self, rejection: Rejection) -> Result<(), ReadError> {
        self.tally.reject(rejection);
        let share = self.settings.max_bad_line_share;
        let tolerated = if share > 0.0 { TOLERATED_BAD_LINES } else { 0 };
        let allowed = tolerated.max((share * self.tally.lines as f64) as u64);
        let rejected = self.tally.bad_lines();
        // A log without any scan gets an error of its own at its end.
        if rejected <= allowed {
            return Ok(());
        }
        let (line, source_name) = (self.tally.lines, self.source_name.clone());
        Err(ReadError::TooManyBadLines { source_name, line, reason: rejection, rejected, lines: line })
    }

    fn no_scan(&self) -> ReadError {
        let (source_name, lines) = (self.source_name.clone(), self.tally.lines);
        if lines == 0 {
            return ReadError::Empty { source_name };
        }
        let (line, reason) = match self.tally.first_rejected {
            Some((line, reason)) => (line, reason.to_string()),
            None => (lines, "the log ends here".to_owned()),
        };
        ReadError::NoScan { source_name, line, reason, lines }
    }

    fn io_error(&self, error: std::io::Error) -> ReadError {
        ReadError::Io { source_name: self.source_name.clone(), line: self.tally.lines + 1, error }
    }
}

/// Whether a last line without an end of line is all there.
fn is_whole(parsed: Result<Line, Rejection>, line: &[u8]) -> bool {
    match parsed {
        Ok(Line::Scan { whole } | Line::Other { whole }) => whole,
        Ok(Line::Unknown) => !begins_a_message(line),
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SCAN: &str = "FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 10.5 host 0.1\n";

    fn read(bytes: &[u8], settings: &Settings) -> Result<(Vec<ScanBuffer>, Tally), ReadError> {
        let mut reader = CarmenReader::new(bytes, "x.log", settings.clone());
        let (mut scan, mut scans) = (ScanBuffer::default(), Vec::new());
        while reader.next_scan(&mut scan)? {
            scan.view().expect("a scan that was given out is whole");
            scans.push(scan.clone());
        }
        Ok((scans, reader.tally().clone()))
    }

    fn error(bytes: &[u8]) -> String {
        read(bytes, &Settings::default()).unwrap_err().to_string()
    }

    #[test]
    fn scans_are_numbered_in_the_order_of_the_file() {
        let earlier = SCAN.replace("10.5", "9.5");
        let log = format!(
            "# a comment\nPARAM a b\n{SCAN}\nODOM 1 2 3 0 0 0 1 h 1\nNEFF 3\n{earlier}FLASER 2 x\n{SCAN}"
        );
        let (scans, tally) = read(log.as_bytes(), &Settings::default()).unwrap();
        let stamps: Vec<_> = scans.iter().map(|s| (s.header.id.sequence, s.header.times.sensor_ns)).collect();
        assert_eq!(stamps, [(0, 10_500_000_000), (1, 9_500_000_000), (2, 10_500_000_000)]);
        assert_eq!((tally.steps_backward, tally.unknown, tally.lines), (1, 1, 9));
        assert_eq!(tally.first_rejected, Some((8, Rejection::BadNumber)));
    }

    #[test]
    fn beam_count_and_angles_may_change_inside_a_log() {
        let wide = "ROBOTLASER1 0 -2 4 1 80 0 0 5 1 2 3 4 inf 0 0 0 0 0 0 0 0 0 0 0 0 11 host 1\r\n";
        let (scans, tally) = read(format!("{SCAN}{wide}{SCAN}").as_bytes(), &Settings::default()).unwrap();
        assert_eq!(scans.iter().map(|s| s.header.beam_count).collect::<Vec<_>>(), [3, 5, 3]);
        assert_eq!((scans[1].header.angle_min_rad, tally.invalid_beams), (-2.0, 1));
    }

    #[test]
    fn files_that_are_no_logs_give_one_clear_error() {
        assert_eq!(error(b""), "x.log:1: the log is empty");
        assert!(error(b"# only\nPARAM a b\n").starts_with("x.log:2: the log ends here; no scan"));
        assert!(error(b"\x00\x01\xff\xfe").starts_with("x.log:1: not text"));
        assert!(error(b"# c\nFLASER 3 1 2\n").starts_with("x.log:2: the line has too few fields; no scan"));
        assert!(
            error(b"\x89PNG\r\n\xff\n\xff\n\xff\n\xff\n\xff\n\xff\n\xff\n\xff\n\xff\n\xff\n")
                .contains("not text")
        );
        assert!(error(b"FLASER 3 1 2 3 nan 0 0 0 0 0 1 h 1\n").starts_with("x.log:1: a pose or an angle"));
    }

    #[test]
    fn a_log_that_breaks_off_is_refused_unless_accepted() {
        for cut in 1..SCAN.len() - 1 {
            let log = format!("{SCAN}{}", &SCAN[..cut]);
            let refused = read(log.as_bytes(), &Settings::default());
            // Once the logger's stamp has begun, nothing that matters is missing.
            if cut < SCAN.len() - 3 {
                assert!(
                    refused.unwrap_err().to_string().starts_with("x.log:2: the log ends in the middle"),
                    "{cut}"
                );
            }
            let accepting = Settings { accept_truncated: true, ..Settings::default() };
            assert!(!read(log.as_bytes(), &accepting).unwrap().0.is_empty());
        }
        assert!(error(format!("{SCAN}ODOM 1 2").as_bytes()).contains("in the middle"));
        assert_eq!(read(SCAN.trim_end().as_bytes(), &Settings::default()).unwrap().0.len(), 1);
    }

    /// A reader that takes lines of up to 100 bytes.
    fn short_lines(bytes: &[u8]) -> CarmenReader<&[u8]> {
        CarmenReader { line_bytes_max: 100, ..CarmenReader::new(bytes, "x.log", Settings::default()) }
    }

    #[test]
    fn a_huge_line_is_passed_over_without_being_stored() {
        let log = format!("{SCAN}FLASER 99 {}\n{SCAN}", "1.0 ".repeat(1000));
        let mut reader = short_lines(log.as_bytes());
        let mut scan = ScanBuffer::default();
        while reader.next_scan(&mut scan).unwrap() {}
        assert_eq!((reader.tally().scans, reader.tally().rejected[&Rejection::TooLong]), (2, 1));
        assert!(reader.line.capacity() < 1000);
        let only = "1".repeat(1000);
        let refused = short_lines(only.as_bytes()).next_scan(&mut scan).unwrap_err().to_string();
        assert!(refused.starts_with("x.log:1: the line is longer"), "{refused}");
    }

    #[test]
    fn bad_lines_are_tolerated_up_to_the_share() {
        let bad = "FLASER 2 x\n";
        let with = |good: usize, bad_lines: usize| [SCAN.repeat(good), bad.repeat(bad_lines)].concat();
        let share = |max_bad_line_share| Settings { max_bad_line_share, ..Settings::default() };
        assert!(read(with(5, 10).as_bytes(), &share(0.01)).is_ok());
        let refused = read(with(5, 11).as_bytes(), &share(0.01)).unwrap_err().to_string();
        assert!(refused.starts_with("x.log:16: a field is not a number; with this 11 of 16"), "{refused}");
        assert!(read(with(5, 11).as_bytes(), &share(0.9)).is_ok());
        assert!(read(with(2000, 15).as_bytes(), &share(0.01)).is_ok());
        assert!(read(with(2000, 1).as_bytes(), &share(0.0)).is_err());
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let _ = read(&bytes, &Settings::default());
        }

        #[test]
        fn nearly_right_lines_never_panic(
            line in "(FLASER|ROBOTLASER1|ODOM) ([0-9]{1,10}|-?[0-9.e]{1,6}|nan|inf|x)( (-?[0-9.e]{1,9}|nan|-inf|[a-z])){0,40}\n"
        ) {
            let _ = read(line.as_bytes(), &Settings::default());
            let _ = read(format!("{SCAN}{line}").as_bytes(), &Settings::default());
        }
    }
}
