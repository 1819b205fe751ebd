//! The envelope of a record: name, payload and signature as bytes. The payload is not looked at here.

use crate::codec::{Reader, Writer};
use crate::kind::Kind;
use crate::{RecordError, RecordName, RobotId, RobotKey};

const MAGIC: [u8; 4] = *b"FLRC";
/// Version of the arrangement of records: builds that do not know it refuse it.
pub const SCHEMA_VERSION: u8 = 3;
/// Longest payload of a record, bytes.
pub const PAYLOAD_BYTES_MAX: usize = 256 * 1024;
/// Longest record, bytes.
pub const RECORD_BYTES_MAX: usize = PAYLOAD_BYTES_MAX + 256;
const SIGNATURE_BYTES: usize = 64;

/// The envelope of a record: author, sequence number, and the payload, which is not decoded yet.
///
/// Little-endian: `FLRC`, schema version, kind, robot (length of its name, name, public key), epoch, number, length of the payload,
/// payload, signature (Ed25519) of the BLAKE3 hash of all before.
pub struct Envelope<'a> {
    pub robot: RobotId,
    pub epoch: u64,
    pub number: u64,
    pub kind: Kind,
    pub payload: &'a [u8],
    pub hash: [u8; 32],
}

impl<'a> Envelope<'a> {
    /// Opens a record; its signature is looked at when it is to be checked.
    pub fn open(bytes: &'a [u8], check: bool) -> Result<Self, RecordError> {
        if bytes.len() > RECORD_BYTES_MAX {
            let (claimed, limit) = (bytes.len() as u64, RECORD_BYTES_MAX as u64);
            return Err(RecordError::TooMuch { what: "bytes of a record", claimed, limit });
        }
        let mut input = Reader(bytes);
        if input.array::<4>()? != MAGIC {
            return Err(RecordError::NotARecord);
        }
        match input.u8()? {
            SCHEMA_VERSION => {}
            other => return Err(RecordError::Version(other)),
        }
        let kind = Kind::from_number(input.u8()?)?;
        let robot = input.robot()?;
        let (epoch, number) = (input.u64()?, input.u64()?);
        let length = input.u32()? as usize;
        if length > PAYLOAD_BYTES_MAX {
            let (claimed, limit) = (length as u64, PAYLOAD_BYTES_MAX as u64);
            return Err(RecordError::TooMuch { what: "bytes of a payload", claimed, limit });
        }
        let payload = input.take(length)?;
        let signed = bytes.len() - input.0.len();
        let signature: [u8; SIGNATURE_BYTES] = input.array()?;
        input.end()?;
        if number >= u64::MAX / 2 {
            return Err(RecordError::Malformed("a record's number"));
        }
        let hash = *blake3::hash(&bytes[..signed]).as_bytes();
        if check && !robot.has_signed(&hash, &signature) {
            return Err(RecordError::Signature(robot.to_string()));
        }
        Ok(Self { robot, epoch, number, kind, payload, hash })
    }

    pub fn name(&self) -> RecordName {
        RecordName { robot: self.robot.clone(), epoch: self.epoch, number: self.number }
    }
}

/// Puts a payload into a signed envelope: the bytes of a record and their hash.
pub fn seal(key: &RobotKey, epoch: u64, number: u64, kind: Kind, payload: &[u8]) -> (Vec<u8>, [u8; 32]) {
    let mut out = Writer(Vec::with_capacity(payload.len() + 256));
    out.bytes(&MAGIC);
    out.u8(SCHEMA_VERSION);
    out.u8(kind as u8);
    out.robot(key.id());
    out.u64(epoch);
    out.u64(number);
    out.u32(payload.len() as u32);
    out.bytes(payload);
    let hash = *blake3::hash(&out.0).as_bytes();
    out.bytes(&key.sign(&hash));
    (out.0, hash)
}
