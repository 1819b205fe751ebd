//! Records: content and a key go in, signed and named bytes come out, and back.

use crate::content::Content;
use crate::kind::Kind;
use crate::sealed::{Envelope, PAYLOAD_BYTES_MAX, seal};
use crate::{RecordError, RobotId, RobotKey};
use std::sync::Arc;

/// The name of a record: number `number` of `robot` in `epoch`.
///
/// A robot that has lost its log begins a new epoch, so that no name is ever used twice.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RecordName {
    /// Whose record it is.
    pub robot: RobotId,
    /// Which of its logs.
    pub epoch: u64,
    /// Which record of the log, from 0.
    pub number: u64,
}

/// A record that is whole: its signature holds and its content is well formed.
///
/// ```
/// use flockslam_records::{Content, Record, RobotKey, Withdrawal};
///
/// let key = RobotKey::of_replay("robot-1")?;
/// let content = Content::Withdrawal(Withdrawal { epoch: 1, number: 0 });
/// let record = Record::new(&key, 1, 7, &content)?;
/// let read = Record::read(record.bytes())?;
/// assert_eq!((read.name.number, &read.content), (7, &content));
/// // No other robot can change a record.
/// let mut forged = record.bytes().to_vec();
/// forged[60] ^= 1;
/// assert!(Record::read(&forged).is_err());
/// # Ok::<(), flockslam_records::RecordError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Its name.
    pub name: RecordName,
    /// BLAKE3 hash of all of it but the signature.
    pub hash: [u8; 32],
    /// Its content.
    pub content: Content,
    bytes: Arc<[u8]>,
}

impl Record {
    /// Writes and signs a record. Its content is rounded to the stored form, for the author as for all robots.
    ///
    /// # Errors
    /// When the content is too large for a record, or not well formed.
    pub fn new(key: &RobotKey, epoch: u64, number: u64, content: &Content) -> Result<Self, RecordError> {
        let payload = content.encode();
        if payload.len() > PAYLOAD_BYTES_MAX {
            let (claimed, limit) = (payload.len() as u64, PAYLOAD_BYTES_MAX as u64);
            return Err(RecordError::TooMuch { what: "bytes of a payload", claimed, limit });
        }
        let (bytes, hash) = seal(key, epoch, number, content.kind(), &payload);
        let content = Content::decode(content.kind(), key.id(), &payload)?;
        let name = RecordName { robot: key.id().clone(), epoch, number };
        Ok(Self { name, hash, content, bytes: bytes.into() })
    }

    /// Reads a record from anybody.
    ///
    /// # Errors
    /// When the bytes are not exactly one well-formed record, signed by the robot that it names.
    pub fn read(bytes: &[u8]) -> Result<Self, RecordError> {
        let envelope = Envelope::open(bytes, true)?;
        let content = Content::decode(envelope.kind, &envelope.robot, envelope.payload)?;
        Ok(Self { name: envelope.name(), hash: envelope.hash, content, bytes: bytes.into() })
    }

    /// What bytes say that they are, without looking at signature and content.
    pub(crate) fn peek(bytes: &[u8]) -> Result<(RecordName, [u8; 32]), RecordError> {
        let envelope = Envelope::open(bytes, false)?;
        Ok((envelope.name(), envelope.hash))
    }

    /// Its bytes, as they travel.
    pub fn bytes(&self) -> &Arc<[u8]> {
        &self.bytes
    }

    /// Kind of the record.
    pub fn kind(&self) -> Kind {
        self.content.kind()
    }
}
