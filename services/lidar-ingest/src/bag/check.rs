//! Checks the records of a ROS 1 bag before anything else reads it, and gives the places of its chunks.

use std::io::{self, Read, Seek, SeekFrom};

/// The version that can be read.
const VERSION: &[u8; 13] = b"#ROSBAG V2.0\n";
/// Headers of records are a few short fields.
const HEADER_BYTES_MAX: u32 = 1 << 16;
/// Unpacked, a chunk takes this much memory at most, bytes; usual ones have 0.75 MiB.
const CHUNK_BYTES_MAX: u32 = 256 << 20;
/// Nothing in LZ4 unpacks to more than 255 times its size, so this bounds what a false size leads to, bytes.
const LZ4_BYTES_MAX: u32 = 4 << 20;
/// Kinds of records.
const BAG_HEADER: u8 = 3;
const INDEX: u8 = 4;
const CHUNK: u8 = 5;

/// Why a file is not read as a bag.
#[derive(Debug, thiserror::Error)]
pub enum BagProblem {
    /// The bytes could not be had.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It begins otherwise.
    #[error("byte 0: not a ROS bag of version 2.0")]
    NoBag,
    /// A record leads out of the file or of its section.
    #[error("byte {0}: the bag breaks off in a record, or is damaged")]
    BreaksOff(u64),
    /// A record is not what it should be.
    #[error("byte {0}: the record is damaged")]
    Damaged(u64),
    /// It was not closed.
    #[error("byte 13: the bag was not closed and has no index; `rosbag reindex` mends it")]
    NoIndex,
    /// A chunk claims to be huge.
    #[error("byte {0}: the chunk is larger than 256 MiB, or than 4 MiB in LZ4")]
    TooLarge(u64),
}

/// The header of a record, and where its data lie.
struct Record {
    begins: u64,
    fields: Vec<u8>,
    data_bytes: u32,
    ends: u64,
}

/// Looks through the records of a bag, without their data, and gives the places of its chunks, in bytes from the beginning.
///
/// # Errors
/// When a record does not fit into the file or into its section, or claims to unpack to more than is sensible.
pub fn check_bag(input: &mut (impl Read + Seek)) -> Result<Vec<u64>, BagProblem> {
    let length = input.seek(SeekFrom::End(0))?;
    input.seek(SeekFrom::Start(0))?;
    let mut version = [0; VERSION.len()];
    if input.read_exact(&mut version).is_err() || version != *VERSION {
        return Err(BagProblem::NoBag);
    }
    let head = Record::read(input, VERSION.len() as u64, length)?;
    let index = head.field(b"index_pos").and_then(|bytes| Some(u64::from_le_bytes(bytes.try_into().ok()?)));
    let index = index.filter(|_| head.kind() == Some(BAG_HEADER)).ok_or(BagProblem::Damaged(head.begins))?;
    if index == 0 {
        return Err(BagProblem::NoIndex);
    }
    if !(head.ends..=length).contains(&index) {
        return Err(BagProblem::BreaksOff(length));
    }
    let (mut at, mut chunks) = (head.ends, Vec::new());
    while at < index {
        let record = Record::read(input, at, index)?;
        match record.kind() {
            Some(CHUNK) => {
                record.check_chunk()?;
                chunks.push(at);
            }
            Some(INDEX) => {}
            _ => return Err(BagProblem::Damaged(at)),
        }
        at = record.ends;
    }
    Ok(chunks)
}

impl Record {
    /// Reads the header of the record at a place; it must end before `end`.
    fn read(input: &mut (impl Read + Seek), begins: u64, end: u64) -> Result<Self, BagProblem> {
        let mut at = begins;
        let length = |at: &mut u64, input: &mut dyn Read| -> Result<u32, BagProblem> {
            let mut bytes = [0; 4];
            if *at + 4 > end {
                return Err(BagProblem::BreaksOff(begins));
            }
            input.read_exact(&mut bytes)?;
            *at += 4;
            Ok(u32::from_le_bytes(bytes))
        };
        input.seek(SeekFrom::Start(begins))?;
        let header_bytes = length(&mut at, input)?;
        if header_bytes > HEADER_BYTES_MAX || at + u64::from(header_bytes) > end {
            return Err(BagProblem::BreaksOff(begins));
        }
        let mut fields = vec![0; header_bytes as usize];
        input.read_exact(&mut fields)?;
        at += u64::from(header_bytes);
        let data_bytes = length(&mut at, input)?;
        let ends = at + u64::from(data_bytes);
        if ends > end {
            return Err(BagProblem::BreaksOff(begins));
        }
        Ok(Self { begins, fields, data_bytes, ends })
    }

    /// The value of a field `name=value`.
    fn field(&self, name: &[u8]) -> Option<&[u8]> {
        let mut rest = self.fields.as_slice();
        while let Some((length, behind)) = rest.split_first_chunk::<4>() {
            let field = behind.get(..u32::from_le_bytes(*length) as usize)?;
            if let Some(value) = field.strip_prefix(name).and_then(|value| value.strip_prefix(b"=")) {
                return Some(value);
            }
            rest = &behind[field.len()..];
        }
        None
    }

    fn kind(&self) -> Option<u8> {
        self.field(b"op").filter(|op| op.len() == 1).map(|op| op[0])
    }

    fn check_chunk(&self) -> Result<(), BagProblem> {
        let size = self.field(b"size").and_then(|bytes| Some(u32::from_le_bytes(bytes.try_into().ok()?)));
        let size = size.ok_or(BagProblem::Damaged(self.begins))?;
        let bound = if self.field(b"compression") == Some(b"lz4") { LZ4_BYTES_MAX } else { CHUNK_BYTES_MAX };
        if size > CHUNK_BYTES_MAX || self.data_bytes > bound {
            return Err(BagProblem::TooLarge(self.begins));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    fn field(name: &str, value: &[u8]) -> Vec<u8> {
        let text = [name.as_bytes(), b"=", value].concat();
        [&(text.len() as u32).to_le_bytes()[..], &text].concat()
    }

    fn record(fields: &[Vec<u8>], data: &[u8]) -> Vec<u8> {
        let header = fields.concat();
        [&(header.len() as u32).to_le_bytes()[..], &header, &(data.len() as u32).to_le_bytes(), data].concat()
    }

    /// A bag of one chunk.
    fn bag(size: u32) -> Vec<u8> {
        let head = |index: u64| {
            record(&[field("op", &[BAG_HEADER]), field("index_pos", &index.to_le_bytes())], b"    ")
        };
        let chunk = record(
            &[field("op", &[CHUNK]), field("compression", b"none"), field("size", &size.to_le_bytes())],
            b"data",
        );
        let index = VERSION.len() + head(0).len() + chunk.len();
        [VERSION.as_slice(), &head(index as u64), &chunk].concat()
    }

    fn check(bytes: &[u8]) -> Result<Vec<u64>, String> {
        check_bag(&mut Cursor::new(bytes)).map_err(|problem| problem.to_string())
    }

    #[test]
    fn chunks_are_found_and_whatever_leads_astray_is_named() {
        let whole = bag(4);
        let chunks = check(&whole).unwrap();
        assert_eq!(chunks.len(), 1);
        assert!(check(b"#ROSBAG V1.2\n").unwrap_err().contains("not a ROS bag"));
        assert!(check(&whole[..whole.len() - 2]).unwrap_err().contains("breaks off"));
        assert!(check(&bag(1 << 30)).unwrap_err().contains("larger than"));
        let mut lost = whole.clone();
        lost[chunks[0] as usize + 8] ^= 0xff;
        assert!(check(&lost).is_err());
        let mut open = whole;
        let at = open.windows(10).position(|window| window == b"index_pos=").unwrap() + 10;
        open[at..at + 8].fill(0);
        assert!(check(&open).unwrap_err().contains("reindex"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(
            at in 0usize..200, value in any::<u8>(), more in prop::collection::vec(any::<u8>(), 0..60)
        ) {
            let mut bytes = bag(4);
            bytes.extend(more);
            let place = at % bytes.len();
            bytes[place] = value;
            if let Ok(chunks) = check(&bytes) {
                prop_assert!(chunks.is_sorted() && chunks.iter().all(|at| *at < bytes.len() as u64));
            }
        }
    }
}
