//! Messages between robots: vectors, records, hashes of disputed logs, and poses.

use crate::codec::{Reader, Writer};
use crate::sealed::RECORD_BYTES_MAX;
use crate::{Presence, RecordError, RobotId, SCHEMA_VERSION, Vector};
use std::sync::Arc;

const MAGIC: [u8; 4] = *b"FLMS";
/// Longest message, bytes: longer ones are not even looked at.
pub const MESSAGE_BYTES_MAX: usize = 1024 * 1024;
/// Most records in a message.
const RECORDS_MAX: usize = 4096;
/// Most hashes in a message.
const HASHES_MAX: usize = 8192;

/// A message from one robot to another that synchronises their collections.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// The version vector of the sender.
    Have(Vector),
    /// Records, as bytes: each is checked by itself.
    Records(Vec<Arc<[u8]>>),
    /// The hashes of a log of which sender and receiver have the same numbers, but not the same records.
    Hashes {
        /// Whose log.
        robot: RobotId,
        /// Which of its logs.
        epoch: u64,
        /// Number and hash of each record.
        hashes: Vec<(u64, [u8; 32])>,
    },
    /// Where the sender is.
    Here(Presence),
}

impl Message {
    /// Its bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Writer::default();
        out.bytes(&MAGIC);
        out.u8(SCHEMA_VERSION);
        match self {
            Self::Have(vector) => {
                out.u8(1);
                vector.write(&mut out);
            }
            Self::Records(records) => {
                out.u8(2);
                out.varint(records.len() as u64);
                for record in records {
                    out.varint(record.len() as u64);
                    out.bytes(record);
                }
            }
            Self::Hashes { robot, epoch, hashes } => {
                out.u8(3);
                out.robot(robot);
                out.u64(*epoch);
                let sent = &hashes[..hashes.len().min(HASHES_MAX)];
                out.varint(sent.len() as u64);
                for (number, hash) in sent {
                    out.varint(*number);
                    out.bytes(hash);
                }
            }
            Self::Here(presence) => {
                out.u8(4);
                presence.write(&mut out);
            }
        }
        out.0
    }

    /// Reads a message from anybody.
    ///
    /// # Errors
    /// When the bytes are not exactly one well-formed message. Records in it are not looked at yet.
    pub fn decode(bytes: &[u8]) -> Result<Self, RecordError> {
        if bytes.len() > MESSAGE_BYTES_MAX {
            let (claimed, limit) = (bytes.len() as u64, MESSAGE_BYTES_MAX as u64);
            return Err(RecordError::TooMuch { what: "bytes of a message", claimed, limit });
        }
        let mut input = Reader(bytes);
        if input.array::<4>()? != MAGIC {
            return Err(RecordError::NotARecord);
        }
        match input.u8()? {
            SCHEMA_VERSION => {}
            other => return Err(RecordError::Version(other)),
        }
        let message = match input.u8()? {
            1 => Self::Have(Vector::read(&mut input)?),
            2 => Self::Records(read_records(&mut input)?),
            3 => {
                let (robot, epoch) = (input.robot()?, input.u64()?);
                let count = input.count("hashes", HASHES_MAX, 33)?;
                let mut hashes = Vec::with_capacity(count);
                for _ in 0..count {
                    hashes.push((input.varint()?, input.array()?));
                }
                Self::Hashes { robot, epoch, hashes }
            }
            4 => Self::Here(Presence::read(&mut input)?),
            other => return Err(RecordError::Kind(other)),
        };
        input.end()?;
        Ok(message)
    }
}

fn read_records(input: &mut Reader<'_>) -> Result<Vec<Arc<[u8]>>, RecordError> {
    let count = input.count("records", RECORDS_MAX, 1)?;
    let mut records = Vec::with_capacity(count);
    for _ in 0..count {
        let length = input.count("bytes of a record", RECORD_BYTES_MAX, 1)?;
        records.push(input.take(length)?.into());
    }
    Ok(records)
}
