//! What a decoder met on the way.

/// Counts of a decoder since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes that came.
    pub bytes: u64,
    /// Good packets.
    pub packets: u64,
    /// Packets whose checksum was wrong.
    pub bad_checksums: u64,
    /// Bytes that belong to no packet.
    pub garbage_bytes: u64,
    /// Packets that must have been lost, by the directions that are missing.
    pub missing_packets: u64,
    /// Turns that were given out.
    pub turns: u64,
    /// Turns of which too much is missing: the first one after the start, and torn ones.
    pub partial_turns: u64,
    /// Turns a tenth or more faster or slower than the one before.
    pub speed_changes: u64,
}

impl Counts {
    /// Each count with its name.
    pub fn named(&self) -> [(&'static str, u64); 8] {
        [
            ("bytes", self.bytes),
            ("packets", self.packets),
            ("bad_checksums", self.bad_checksums),
            ("garbage_bytes", self.garbage_bytes),
            ("missing_packets", self.missing_packets),
            ("turns", self.turns),
            ("partial_turns", self.partial_turns),
            ("speed_changes", self.speed_changes),
        ]
    }

    /// The sum of these and others, as of a lidar that was plugged in again.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            packets: self.packets + other.packets,
            bad_checksums: self.bad_checksums + other.bad_checksums,
            garbage_bytes: self.garbage_bytes + other.garbage_bytes,
            missing_packets: self.missing_packets + other.missing_packets,
            turns: self.turns + other.turns,
            partial_turns: self.partial_turns + other.partial_turns,
            speed_changes: self.speed_changes + other.speed_changes,
        }
    }
}
