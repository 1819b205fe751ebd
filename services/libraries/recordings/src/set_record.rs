//! Records of a running set beside its scans: what its stages have published and used, as it was on the bus.

use flockslam_messages::{
    ClearedCell, Commit, Layout, MarksHeader, Message, PoseEstimate, ScanHeader, StageInputs, Verdict,
};
use zerocopy::{FromBytes, Immutable, IntoBytes};

/// How a recording names the type of these records.
pub const SET_RECORD_TYPE: &str = "flockslam/set-record/v1";

/// A record of a running set.
#[derive(Clone, Debug, PartialEq)]
pub enum SetRecord {
    /// The file `set.json` of the set: options, source and configuration.
    Set(Vec<u8>),
    /// The filter's verdict.
    Verdict(Verdict),
    /// A published pose.
    Pose(PoseEstimate),
    /// What a stage has used for a scan.
    Inputs(StageInputs),
    /// A generation of the grid.
    Commit(Commit),
    /// Cells that the cleaner has cleared.
    Marks(MarksHeader, Vec<ClearedCell>),
}

impl SetRecord {
    /// One byte for the kind, and the message as it is in memory.
    pub fn bytes(&self) -> Vec<u8> {
        fn of(kind: u8, message: &(impl IntoBytes + Immutable)) -> Vec<u8> {
            [&[kind], message.as_bytes()].concat()
        }
        match self {
            Self::Set(json) => [&[0], json.as_slice()].concat(),
            Self::Verdict(verdict) => of(1, verdict),
            Self::Pose(pose) => of(2, pose),
            Self::Inputs(inputs) => of(3, inputs),
            Self::Commit(commit) => of(4, commit),
            Self::Marks(header, cells) => {
                let mut bytes = of(5, header);
                bytes.extend_from_slice(cells.as_bytes());
                bytes
            }
        }
    }

    /// A record from its bytes; `None` when they are none.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        fn whole<T: FromBytes>(bytes: &[u8]) -> Option<T> {
            T::read_from_bytes(bytes).ok()
        }
        let (kind, message) = bytes.split_first()?;
        match kind {
            0 => Some(Self::Set(message.to_vec())),
            1 => whole(message).map(Self::Verdict),
            2 => whole(message).map(Self::Pose),
            3 => whole(message).map(Self::Inputs),
            4 => whole(message).map(Self::Commit),
            5 => {
                let (header, cells) = MarksHeader::read_from_prefix(message).ok()?;
                let cells = cells.chunks(size_of::<ClearedCell>()).map(whole).collect::<Option<_>>()?;
                Some(Self::Marks(header, cells))
            }
            _ => None,
        }
    }
}

/// How a recording names the encoding of scans as they lie on the bus of this build.
pub fn bus_encoding() -> String {
    format!("flockslam-{:016x}", ScanHeader::HASH)
}

/// How a recording names the encoding of the records of this build.
pub fn set_record_encoding() -> String {
    let layouts = [
        Verdict::HASH,
        PoseEstimate::HASH,
        StageInputs::HASH,
        Commit::HASH,
        MarksHeader::HASH,
        ClearedCell::HASH,
    ];
    let names = [Verdict::TYPE_NAME, PoseEstimate::TYPE_NAME, StageInputs::TYPE_NAME, Commit::TYPE_NAME];
    // FNV-1a.
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let of_names = names.iter().flat_map(|name| name.bytes());
    for byte in layouts.iter().flat_map(|layout| layout.to_le_bytes()).chain(of_names) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    format!("flockslam-{hash:016x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_survive_as_bytes_and_damaged_ones_are_none() {
        let cells = vec![ClearedCell { x: 1, y: -2 }, ClearedCell { x: 3, y: 4 }];
        let records = [
            SetRecord::Set(b"{}".to_vec()),
            SetRecord::Verdict(Verdict { coefficient: 0.5, keep: 1, ..Verdict::default() }),
            SetRecord::Pose(PoseEstimate { generation: 7, ..PoseEstimate::default() }),
            SetRecord::Inputs(StageInputs { tiles: 3, ..StageInputs::default() }),
            SetRecord::Commit(Commit { cleared: 2, ..Commit::default() }),
            SetRecord::Marks(MarksHeader { cleared: 2, ..MarksHeader::default() }, cells),
        ];
        for record in records {
            let bytes = record.bytes();
            assert_eq!(SetRecord::from_bytes(&bytes), Some(record.clone()));
            if !matches!(record, SetRecord::Set(_)) {
                assert_eq!(SetRecord::from_bytes(&bytes[..bytes.len() - 1]), None, "{record:?}");
            }
        }
        assert_eq!(SetRecord::from_bytes(&[]), None);
        assert_eq!(SetRecord::from_bytes(&[9, 9]), None);
        assert_ne!(bus_encoding(), set_record_encoding());
    }
}
