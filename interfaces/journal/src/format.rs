//! The bytes of a journal, little-endian: a head (magic, version, CRC-32 of both), then records (length of the
//! payload, kind, CRC-32 over length, kind, position and payload; payload).
//!
//! The position in the file goes into the checksum without being stored: a record that an old life of the disk block
//! left behind, or that was copied elsewhere, is not taken for one of this place.

/// Version of the format, in the head of every journal.
pub const VERSION: u32 = 1;
/// Payload of one record at most, bytes: a scan of ten million beams with all sections fits.
pub const RECORD_BYTES_MAX: usize = 512 * 1024 * 1024;
/// Parts in which a payload may be given.
pub const PARTS_MAX: usize = 15;

pub(crate) const HEAD_BYTES: usize = 16;
pub(crate) const RECORD_HEAD_BYTES: usize = 12;
const MAGIC: [u8; 8] = *b"flockjnl";

/// What the first bytes of a file are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Head {
    Journal,
    OtherVersion(u32),
    Foreign,
}

/// The fields in front of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RecordHead {
    pub length: u32,
    pub kind: u32,
    pub checksum: u32,
}

pub(crate) fn head() -> [u8; HEAD_BYTES] {
    head_of_version(VERSION)
}

fn head_of_version(version: u32) -> [u8; HEAD_BYTES] {
    let mut bytes = [0; HEAD_BYTES];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..12].copy_from_slice(&version.to_le_bytes());
    let checksum = crc32fast::hash(&bytes[..12]);
    bytes[12..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

pub(crate) fn read_head(bytes: &[u8; HEAD_BYTES]) -> Head {
    let version = word(bytes, 8);
    if *bytes != head_of_version(version) {
        Head::Foreign
    } else if version == VERSION {
        Head::Journal
    } else {
        Head::OtherVersion(version)
    }
}

impl RecordHead {
    pub(crate) fn of<'a>(
        length: u32,
        kind: u32,
        offset: u64,
        payload: impl IntoIterator<Item = &'a [u8]>,
    ) -> Self {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&length.to_le_bytes());
        hasher.update(&kind.to_le_bytes());
        hasher.update(&offset.to_le_bytes());
        payload.into_iter().for_each(|part| hasher.update(part));
        Self { length, kind, checksum: hasher.finalize() }
    }

    pub(crate) fn encode(self) -> [u8; RECORD_HEAD_BYTES] {
        let mut bytes = [0; RECORD_HEAD_BYTES];
        bytes[..4].copy_from_slice(&self.length.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.kind.to_le_bytes());
        bytes[8..].copy_from_slice(&self.checksum.to_le_bytes());
        bytes
    }

    pub(crate) fn decode(bytes: &[u8; RECORD_HEAD_BYTES]) -> Self {
        Self { length: word(bytes, 0), kind: word(bytes, 4), checksum: word(bytes, 8) }
    }
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_tell_journals_versions_and_foreign_files_apart() {
        assert_eq!(read_head(&head()), Head::Journal);
        assert_eq!(read_head(&head_of_version(9)), Head::OtherVersion(9));
        assert_eq!(read_head(&[0; HEAD_BYTES]), Head::Foreign);
        for bit in 0..8 * HEAD_BYTES {
            let mut bytes = head();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(read_head(&bytes), Head::Foreign, "bit {bit}");
        }
    }

    #[test]
    fn a_record_of_zeros_is_no_record() {
        let zeros = RecordHead::decode(&[0; RECORD_HEAD_BYTES]);
        for offset in 16..100_000 {
            assert_ne!(RecordHead::of(0, 0, offset, []), zeros);
        }
    }
}
