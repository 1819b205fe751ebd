//! Records of a ROS 1 bag (version 2.0): a header of fields `name=value`, and data.

use std::io::{self, Read, Seek, SeekFrom};

/// Headers of records are a few short fields; those of connections have the definition of a message in their data.
const HEADER_BYTES_MAX: u32 = 1 << 16;

/// Kinds of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordKind {
    Message,
    Bag,
    Index,
    Chunk,
    ChunkInfo,
    Connection,
}

impl RecordKind {
    fn of(number: u8) -> Option<Self> {
        match number {
            2 => Some(Self::Message),
            3 => Some(Self::Bag),
            4 => Some(Self::Index),
            5 => Some(Self::Chunk),
            6 => Some(Self::ChunkInfo),
            7 => Some(Self::Connection),
            _ => None,
        }
    }
}

/// Fields of a record's header, or of a connection's data.
pub struct FieldList<'a>(pub &'a [u8]);

impl<'a> FieldList<'a> {
    /// The value of a field.
    pub fn get(&self, name: &str) -> Option<&'a [u8]> {
        let mut rest = self.0;
        while let Some((length, behind)) = rest.split_first_chunk::<4>() {
            let field = behind.get(..u32::from_le_bytes(*length) as usize)?;
            let value = field.strip_prefix(name.as_bytes()).and_then(|value| value.strip_prefix(b"="));
            if value.is_some() {
                return value;
            }
            rest = &behind[field.len()..];
        }
        None
    }

    pub fn u32(&self, name: &str) -> Option<u32> {
        Some(u32::from_le_bytes(self.get(name)?.try_into().ok()?))
    }

    pub fn u64(&self, name: &str) -> Option<u64> {
        Some(u64::from_le_bytes(self.get(name)?.try_into().ok()?))
    }

    pub fn text(&self, name: &str) -> Option<String> {
        self.get(name).map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }

    /// A time: seconds and nanoseconds.
    pub fn time_ns(&self, name: &str) -> Option<i64> {
        let (seconds, nanoseconds) = self.get(name)?.split_first_chunk::<4>()?;
        let nanoseconds = u32::from_le_bytes(nanoseconds.try_into().ok()?);
        Some(i64::from(u32::from_le_bytes(*seconds)) * 1_000_000_000 + i64::from(nanoseconds))
    }

    pub fn kind(&self) -> Option<RecordKind> {
        self.get("op").filter(|op| op.len() == 1).and_then(|op| RecordKind::of(op[0]))
    }
}

/// A record in a file: its header, and where its data lie.
pub struct RecordAt {
    pub fields: Vec<u8>,
    pub data_at: u64,
    pub data_bytes: u32,
}

impl RecordAt {
    /// Reads the header of the record at a place. `None` when it does not end before `end`.
    pub fn read(input: &mut (impl Read + Seek), at: u64, end: u64) -> io::Result<Option<Self>> {
        let mut number = [0; 4];
        if at + 8 > end {
            return Ok(None);
        }
        input.seek(SeekFrom::Start(at))?;
        input.read_exact(&mut number)?;
        let header_bytes = u32::from_le_bytes(number);
        if header_bytes > HEADER_BYTES_MAX || at + 8 + u64::from(header_bytes) > end {
            return Ok(None);
        }
        let mut fields = vec![0; header_bytes as usize];
        input.read_exact(&mut fields)?;
        input.read_exact(&mut number)?;
        let data_bytes = u32::from_le_bytes(number);
        let record = Self { fields, data_at: at + 8 + u64::from(header_bytes), data_bytes };
        Ok((record.end() <= end).then_some(record))
    }

    pub fn end(&self) -> u64 {
        self.data_at + u64::from(self.data_bytes)
    }

    pub fn fields(&self) -> FieldList<'_> {
        FieldList(&self.fields)
    }
}

/// The first record of some bytes, its data, and where the next one begins.
pub fn split_record(bytes: &[u8]) -> Option<(FieldList<'_>, &[u8], usize)> {
    let part = |at: usize| {
        let (length, behind) = bytes.get(at..)?.split_first_chunk::<4>()?;
        behind.get(..u32::from_le_bytes(*length) as usize)
    };
    let fields = part(0)?;
    let data = part(4 + fields.len())?;
    Some((FieldList(fields), data, 8 + fields.len() + data.len()))
}
