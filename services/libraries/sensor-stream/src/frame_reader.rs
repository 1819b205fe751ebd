//! Takes the bytes of a stream as they come and gives the frames in them; goes on behind whatever is none.

use crate::FrameProblem;
use crate::binary_frame::{FrameHeader, HEADER_BYTES, MAGIC, read_binary};
use crate::json_line::read_json;
use crate::readings::SensorFrame;

/// Frames and lines beyond this are passed over, bytes.
pub(crate) const FRAME_BYTES_MAX: usize = 64 << 20;
/// What was handed out is dropped once it is so much, bytes: moving the rest costs less than a frame then.
const DROP_BYTES: usize = 1 << 16;

/// Finds binary frames and lines of JSON in the bytes of a stream, in any mixture.
///
/// Where bytes are neither, it goes on with the next frame that it finds: a producer may have died in the middle of one, or printed
/// something else.
#[derive(Debug, Default)]
pub struct FrameReader {
    bytes: Vec<u8>,
    /// What is before was handed out.
    at: usize,
    /// What is before, from `at` on, holds no end of a line.
    searched: usize,
}

impl FrameReader {
    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.at >= DROP_BYTES || self.at == self.bytes.len() {
            self.bytes.drain(..self.at);
            self.searched = self.searched.saturating_sub(self.at);
            self.at = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// The next frame of those bytes, or what is wrong with some of them; `None` where more are needed.
    pub fn next_frame(&mut self) -> Option<Result<SensorFrame, FrameProblem>> {
        let rest = &self.bytes[self.at..];
        let blank = rest.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        self.at += blank;
        match self.bytes.get(self.at)? {
            0xfa => self.binary(),
            b'{' => self.json(),
            _ => self.pass_over(0),
        }
    }

    /// At the end of the stream: whether the bytes end within a frame.
    pub fn ends_within(&self) -> bool {
        self.bytes[self.at..].iter().any(|byte| !byte.is_ascii_whitespace())
    }

    fn binary(&mut self) -> Option<Result<SensorFrame, FrameProblem>> {
        let rest = &self.bytes[self.at..];
        let known = rest.len().min(MAGIC.len());
        if rest[..known] != MAGIC[..known] {
            return self.pass_over(1);
        }
        let header = FrameHeader::read(rest.first_chunk::<HEADER_BYTES>()?);
        if header.length > FRAME_BYTES_MAX {
            self.skip(1);
            return Some(Err(FrameProblem::TooLong));
        }
        let fields = rest[HEADER_BYTES..].get(..header.length)?;
        if crc32fast::hash(fields) != header.checksum {
            // Where a frame follows, this one is whole and damaged. Else another may begin within what was taken for it.
            let next = rest.get(HEADER_BYTES + header.length);
            let is_followed = next.is_some_and(|byte| [MAGIC[0], b'{'].contains(byte));
            self.skip(if is_followed { HEADER_BYTES + header.length } else { 1 });
            return Some(Err(FrameProblem::WrongChecksum));
        }
        let read = read_binary(header.kind, fields);
        self.skip(HEADER_BYTES + header.length);
        Some(read)
    }

    fn json(&mut self) -> Option<Result<SensorFrame, FrameProblem>> {
        let from = self.searched.max(self.at);
        // JSON has no byte like the first of a frame: a line in which one stands was broken off.
        let end =
            self.bytes[from..].iter().position(|byte| matches!(byte, b'\n' | 0xfa)).map(|end| from + end);
        let Some(end) = end else {
            self.searched = self.bytes.len();
            if self.bytes.len() - self.at > FRAME_BYTES_MAX {
                self.skip(self.bytes.len() - self.at);
                return Some(Err(FrameProblem::TooLong));
            }
            return None;
        };
        let read = read_json(&self.bytes[self.at..end]);
        self.skip(end - self.at);
        Some(read)
    }

    /// Passes over bytes that begin nothing, up to the next that may begin something; `from` of them are known to be none.
    fn pass_over(&mut self, from: usize) -> Option<Result<SensorFrame, FrameProblem>> {
        let rest = &self.bytes[self.at..];
        let begins = |(at, byte): (usize, &u8)| {
            let begins_line = *byte == b'{' && (at == 0 || rest[at - 1] == b'\n');
            at >= from && (*byte == MAGIC[0] || begins_line)
        };
        let bytes = rest.iter().enumerate().position(begins).unwrap_or(rest.len());
        self.skip(bytes);
        Some(Err(FrameProblem::NoFrame { bytes }))
    }

    fn skip(&mut self, bytes: usize) {
        self.at += bytes;
        self.searched = self.at;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_frames::every_kind;
    use proptest::prelude::*;

    fn read(reader: &mut FrameReader) -> (Vec<SensorFrame>, Vec<FrameProblem>) {
        let (mut frames, mut problems) = (Vec::new(), Vec::new());
        while let Some(next) = reader.next_frame() {
            match next {
                Ok(frame) => frames.push(frame),
                Err(problem) => problems.push(problem),
            }
        }
        (frames, problems)
    }

    /// All kinds, once as bytes and once as lines.
    fn stream() -> (Vec<u8>, Vec<SensorFrame>) {
        let mut bytes = Vec::new();
        for frame in every_kind() {
            frame.write_binary(&mut bytes);
            frame.write_json(&mut bytes);
        }
        (bytes, every_kind().into_iter().flat_map(|frame| [frame.clone(), frame]).collect())
    }

    #[test]
    fn frames_are_found_however_the_bytes_come() {
        let (bytes, expected) = stream();
        for length in [1, 7, 64, bytes.len()] {
            let (mut reader, mut found) = (FrameReader::default(), Vec::new());
            for part in bytes.chunks(length) {
                reader.push(part);
                let (frames, problems) = read(&mut reader);
                assert_eq!(problems, []);
                found.extend(frames);
            }
            assert!(found == expected, "{length}");
            assert!(!reader.ends_within());
        }
    }

    #[test]
    fn frames_after_garbage_are_found_and_each_garbage_is_reported_once() {
        let (bytes, expected) = stream();
        let mut reader = FrameReader::default();
        reader.push(b"driver 1.2 starts {ok}\n");
        reader.push(&bytes);
        // A producer that ended within a frame, and within a line.
        reader.push(&bytes[..40]);
        reader.push(&bytes);
        reader.push(br#"{"scan":{"stamp_ns":5,"ranges_m":[1,2"#);
        reader.push(&bytes);
        let (frames, problems) = read(&mut reader);
        assert!(frames == [&expected[..], &expected, &expected].concat(), "{} frames", frames.len());
        assert!(matches!(problems[0], FrameProblem::NoFrame { bytes: 23 }), "{problems:?}");
        assert_eq!(problems[1], FrameProblem::WrongChecksum);
        assert!(matches!(problems.last(), Some(FrameProblem::Json(_))), "{problems:?}");
    }

    #[test]
    fn a_changed_byte_costs_its_frame_alone() {
        let (bytes, expected) = stream();
        for at in 20..60 {
            let mut changed = bytes.clone();
            changed[at] ^= 0x40;
            let mut reader = FrameReader::default();
            reader.push(&changed);
            let (frames, problems) = read(&mut reader);
            assert!(frames == expected[1..], "{at}");
            assert!(problems.contains(&FrameProblem::WrongChecksum));
        }
    }

    #[test]
    fn a_frame_with_a_huge_length_allocates_no_memory() {
        let mut reader = FrameReader::default();
        let mut bytes = [&MAGIC[..], &[1, 0, 0, 0]].concat();
        bytes.extend([0xff; 8]);
        reader.push(&bytes);
        let (frames, problems) = read(&mut reader);
        assert_eq!(frames, []);
        assert_eq!(problems[0], FrameProblem::TooLong);
        assert!(reader.bytes.capacity() < 1000);
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..20)) {
            let mut reader = FrameReader::default();
            for part in parts {
                reader.push(&part);
                read(&mut reader);
            }
        }
    }
}
