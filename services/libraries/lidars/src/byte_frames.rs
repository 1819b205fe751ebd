//! Finds packets in a stream of bytes, also behind garbage.

use crate::Counts;

/// Result of parsing the start of some bytes.
pub(crate) enum Look {
    /// A packet of this length.
    Packet(usize),
    /// A packet may begin here; more bytes are needed to tell.
    More,
    /// No packet begins here.
    No,
    /// A packet whose checksum is wrong.
    Bad,
}

/// Bytes that wait to become packets. After a look that found none the next one begins one byte later, so a packet behind
/// garbage, or within what looked like a packet, is found.
#[derive(Default)]
pub(crate) struct ByteFrames {
    bytes: Vec<u8>,
    at: usize,
}

/// No packet of any family is longer. What needs more bytes than this to tell is none.
const PACKET_MAX: usize = 64 * 1024;

impl ByteFrames {
    /// Takes bytes.
    pub fn push(&mut self, bytes: &[u8], counts: &mut Counts) {
        counts.bytes += bytes.len() as u64;
        self.bytes.drain(..self.at);
        self.at = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next packet.
    pub fn next(&mut self, counts: &mut Counts, look: impl Fn(&[u8]) -> Look) -> Option<&[u8]> {
        while self.at < self.bytes.len() {
            let rest = &self.bytes[self.at..];
            match look(rest) {
                Look::Packet(length) => {
                    let from = self.at;
                    self.at += length;
                    counts.packets += 1;
                    return Some(&self.bytes[from..from + length]);
                }
                Look::More if rest.len() < PACKET_MAX => return None,
                Look::More | Look::No => {}
                Look::Bad => counts.bad_checksums += 1,
            }
            self.at += 1;
            counts.garbage_bytes += 1;
        }
        None
    }
}

/// A little-endian 16-bit number at an offset.
pub(crate) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// A little-endian 32-bit number at an offset.
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}
