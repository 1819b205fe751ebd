//! Measurements of an RPLIDAR in each of the forms in which it may send them, answer types 0x81 to 0x86.
//!
//! Sources: Slamtec, *RPLIDAR Interface Protocol* LR001 (standard, express legacy, extended, dense), and the formulas of
//! `Slamtec/rplidar_sdk`, `dataunpacker/unpacker` (all types; HQ and ultra dense are documented there alone).

use crate::byte_frames::{Look, u16_at, u32_at};

/// One measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sample {
    /// Where the head stood, degrees clockwise.
    pub head_deg: f64,
    /// Where the beam went, degrees clockwise.
    pub direction_deg: f64,
    /// Millimetres; 0 for none.
    pub range_mm: f64,
    /// Strength; 0 where the form has none.
    pub quality: u8,
}

/// A form of measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// One measurement each.
    Standard,
    /// 32 measurements in 16 cabins, with a correction of each direction.
    Express,
    /// 96 measurements with directions of their own, and a checksum of 32 bits.
    HighQuality,
    /// 96 measurements in 32 cabins: one distance and two differences each.
    Extended,
    /// 40 distances.
    Dense,
    /// 64 distances with strengths.
    UltraDense,
}

pub(crate) const NODE_LENGTH: usize = 5;
/// So many measurements of the standard form in a row must make sense before the reader counts as in step: each has only three bits to check.
pub(crate) const NODES_TO_SYNC: usize = 12;
/// Between two measurements the head turns no further than this, degrees.
const STEP_MAX_DEG: f64 = 20.0;
/// It may seem to turn back by so much, degrees.
const STEP_BACK_DEG: f64 = 3.0;
/// The bit of a start angle that marks the first capsule.
pub(crate) const FIRST_CAPSULE: u16 = 0x8000;
pub(crate) const HQ_MARK: u8 = 0xA5;
const HQ_NODE_LENGTH: usize = 8;
const HQ_HEAD_LENGTH: usize = 9;

impl Form {
    /// The form of an answer type.
    pub fn of_answer(kind: u8) -> Option<Self> {
        let forms =
            [Self::Standard, Self::Express, Self::HighQuality, Self::Extended, Self::Dense, Self::UltraDense];
        forms.get(usize::from(kind.wrapping_sub(0x81))).copied()
    }

    /// Bytes of a packet.
    pub fn length(self) -> usize {
        match self {
            Self::Standard => NODE_LENGTH,
            Self::Express | Self::Dense => 84,
            Self::HighQuality => 781,
            Self::Extended => 132,
            Self::UltraDense => 170,
        }
    }

    /// Measurements in a packet.
    pub fn samples(self) -> usize {
        match self {
            Self::Standard => 1,
            Self::Express => 32,
            Self::HighQuality | Self::Extended => 96,
            Self::Dense => 40,
            Self::UltraDense => 64,
        }
    }

    /// Whether measurements have strengths.
    pub fn has_quality(self) -> bool {
        matches!(self, Self::Standard | Self::HighQuality | Self::UltraDense)
    }

    /// Whether a packet begins here. `in_step`: the packet before was a good one.
    pub fn look(self, bytes: &[u8], in_step: bool) -> Look {
        match self {
            Self::Standard => look_for_nodes(bytes, if in_step { 2 } else { NODES_TO_SYNC }),
            Self::HighQuality => self.look_for_hq(bytes),
            _ => self.look_for_capsule(bytes, in_step),
        }
    }

    /// A capsule has sixteen bits to check: behind garbage another one must begin where it ends.
    fn look_for_capsule(self, bytes: &[u8], in_step: bool) -> Look {
        let begins = |bytes: &[u8]| bytes[0] >> 4 == 0xA && bytes.get(1).is_none_or(|byte| byte >> 4 == 0x5);
        if !begins(bytes) {
            return Look::No;
        }
        let Some((capsule, next)) = bytes.split_at_checked(self.length()) else { return Look::More };
        let stated = (capsule[0] & 0xF) | (capsule[1] << 4);
        let plausible = capsule_start_deg(capsule, self) < 360.0;
        match xor(&capsule[2..]) == stated {
            false => Look::Bad,
            true if !plausible => Look::No,
            true if in_step => Look::Packet(self.length()),
            true if !next.is_empty() && !begins(next) => Look::No,
            true if next.len() < 2 => Look::More,
            true => Look::Packet(self.length()),
        }
    }

    fn look_for_hq(self, bytes: &[u8]) -> Look {
        if bytes[0] != HQ_MARK {
            return Look::No;
        }
        let Some(packet) = bytes.get(..self.length()) else { return Look::More };
        let (checked, stated) = packet.split_at(self.length() - 4);
        if hq_checksum(checked) == u32_at(stated, 0) { Look::Packet(self.length()) } else { Look::Bad }
    }

    /// The measurements of a packet. Of capsules the next one is needed, which begins where this one ends.
    pub fn read(self, packet: &[u8], next: &[u8], give: &mut dyn FnMut(Sample)) {
        match self {
            Self::Standard => give(read_node(packet)),
            Self::HighQuality => {
                let nodes = packet[HQ_HEAD_LENGTH..packet.len() - 4].chunks_exact(HQ_NODE_LENGTH);
                nodes.map(read_hq_node).for_each(give);
            }
            _ => self.read_capsule(packet, next, give),
        }
    }

    fn read_capsule(self, capsule: &[u8], next: &[u8], give: &mut dyn FnMut(Sample)) {
        let start_deg = capsule_start_deg(capsule, self);
        let step_deg = self.span_deg(capsule, next) / self.samples() as f64;
        let cabins = &capsule[self.capsule_head_length()..];
        for index in 0..self.samples() {
            let head_deg = start_deg + index as f64 * step_deg;
            let (range_mm, aside_deg, quality) = match self {
                Self::Express => express_sample(cabins, index),
                Self::Extended => {
                    let next_cabins = &next[self.capsule_head_length()..];
                    let range_mm = extended_range_mm(cabins, next_cabins, index);
                    (range_mm, extended_correction_deg(range_mm), 0)
                }
                Self::Dense => (f64::from(u16_at(cabins, 2 * index)), 0.0, 0),
                _ => {
                    let (range_mm, quality) = ultra_dense_sample(cabins, index);
                    (range_mm, 0.0, quality)
                }
            };
            let head_deg = head_deg % 360.0;
            give(Sample { head_deg, direction_deg: head_deg - aside_deg, range_mm, quality });
        }
    }

    /// Degrees from the start of a capsule to that of the next one.
    pub fn span_deg(self, capsule: &[u8], next: &[u8]) -> f64 {
        (capsule_start_deg(next, self) - capsule_start_deg(capsule, self)).rem_euclid(360.0)
    }

    fn capsule_head_length(self) -> usize {
        if self == Self::UltraDense { 10 } else { 4 }
    }

    /// Whether a capsule is the first one after the start: none before it continues into it.
    pub fn is_first(self, packet: &[u8]) -> bool {
        let capsule = !matches!(self, Self::Standard | Self::HighQuality);
        capsule && u16_at(packet, self.capsule_head_length() - 2) & FIRST_CAPSULE != 0
    }
}

/// Angle of the head at the start of a capsule, degrees.
fn capsule_start_deg(capsule: &[u8], form: Form) -> f64 {
    f64::from(u16_at(capsule, form.capsule_head_length() - 2) & !FIRST_CAPSULE) / 64.0
}

/// The checksum of a capsule.
pub(crate) fn xor(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// The checksum of a packet of high quality: CRC-32 of the bytes, filled up with zeros to a multiple of four.
pub(crate) fn hq_checksum(bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(bytes);
    hasher.update(&[0; 3][..(4 - bytes.len() % 4) % 4]);
    hasher.finalize()
}

/// Whether so many measurements of the standard form stand here.
fn look_for_nodes(bytes: &[u8], wanted: usize) -> Look {
    let mut last_deg: Option<f64> = None;
    for node in bytes.chunks(NODE_LENGTH).take(wanted) {
        let marks = (node[0] ^ (node[0] >> 1)) & 1 == 1 && node.get(1).is_none_or(|byte| byte & 1 == 1);
        if !marks {
            return Look::No;
        }
        if node.len() < NODE_LENGTH {
            return Look::More;
        }
        let sample = read_node(node);
        let step = |last: f64| (sample.head_deg - last + STEP_BACK_DEG).rem_euclid(360.0) - STEP_BACK_DEG;
        if sample.head_deg > 361.0 || last_deg.is_some_and(|last| step(last) > STEP_MAX_DEG) {
            return Look::No;
        }
        last_deg = Some(sample.head_deg);
    }
    if bytes.len() < wanted * NODE_LENGTH { Look::More } else { Look::Packet(NODE_LENGTH) }
}

fn read_node(node: &[u8]) -> Sample {
    let head_deg = f64::from(u16_at(node, 1) >> 1) / 64.0;
    let range_mm = f64::from(u16_at(node, 3)) / 4.0;
    Sample { head_deg, direction_deg: head_deg, range_mm, quality: node[0] >> 2 }
}

fn read_hq_node(node: &[u8]) -> Sample {
    let head_deg = f64::from(u16_at(node, 0)) * 90.0 / 16_384.0;
    let range_mm = f64::from(u32_at(node, 2)) / 4.0;
    Sample { head_deg, direction_deg: head_deg, range_mm, quality: node[6] }
}

/// Range and how far the direction is behind the head, of a measurement of the express form.
fn express_sample(cabins: &[u8], index: usize) -> (f64, f64, u8) {
    let cabin = &cabins[5 * (index / 2)..][..5];
    let word = u16_at(cabin, 2 * (index % 2));
    let low = if index.is_multiple_of(2) { cabin[4] & 0xF } else { cabin[4] >> 4 };
    let eighths = u16::from(low) | (word & 3) << 4;
    (f64::from(word & 0xFFFC) / 4.0, f64::from(eighths) / 8.0, 0)
}

/// A distance of the extended form on a scale that grows with it: where each part of the scale begins, in what is sent and in millimetres,
/// and how many bits it leaves out.
const SCALE: [(u32, u32, u32); 5] =
    [(3328, 1 << 14, 4), (1792, 1 << 12, 3), (1280, 1 << 11, 2), (512, 1 << 9, 1), (0, 0, 0)];

/// The distance, millimetres, and the bits that its scale leaves out.
fn unscaled(sent: u32) -> (i32, u32) {
    let part = SCALE.iter().find(|(from, _, _)| sent >= *from);
    part.map_or((0, 0), |(from, mm, bits)| ((mm + ((sent - from) << bits)) as i32, *bits))
}

fn extended_range_mm(cabins: &[u8], next_cabins: &[u8], index: usize) -> f64 {
    let at = index / 3;
    let cabin = u32_at(cabins, 4 * at);
    let following = if at < 31 { u32_at(cabins, 4 * (at + 1)) } else { u32_at(next_cabins, 0) };
    let (major, major_bits) = unscaled(cabin & 0xFFF);
    let (next_major, next_bits) = unscaled(following & 0xFFF);
    let (base, bits) = if major == 0 { (next_major, next_bits) } else { (major, major_bits) };
    // Two differences of ten bits with a sign; their extremes mean that nothing returned.
    let differs = |difference: i32| (-511..511).contains(&difference);
    let range = match index % 3 {
        0 => major,
        1 => match (cabin << 10) as i32 >> 22 {
            difference if differs(difference) => base + (difference << bits),
            _ => 0,
        },
        _ => match cabin as i32 >> 22 {
            difference if differs(difference) => next_major + (difference << next_bits),
            _ => 0,
        },
    };
    f64::from(range.max(0))
}

/// How far the direction of the extended form is behind the head, degrees.
pub(crate) fn extended_correction_deg(range_mm: f64) -> f64 {
    if range_mm < 50.0 {
        return 7.5;
    }
    let k = (98_361.0 / (range_mm * 4.0)).floor();
    8.0 - ((k * 64.0 + k * k * k / 98_304.0) / 65_536.0).to_degrees()
}

/// Range and strength of a measurement of the ultra dense form. Two bits say the scale of the distance, which leaves fewer bits for the strength the
/// further it goes.
fn ultra_dense_sample(cabins: &[u8], index: usize) -> (f64, u8) {
    let cabin = &cabins[5 * (index / 2)..][..5];
    let high = if index.is_multiple_of(2) { cabin[4] & 0xF } else { cabin[4] >> 4 };
    let word = u32::from(u16_at(cabin, 2 * (index % 2))) | u32::from(high) << 16;
    let scale = word & 3;
    let quality = (word >> (12 + scale)) << scale;
    let (factor, from_mm) = [(2, 0), (3, 2046), (4, 8187), (5, 24_567)][scale as usize];
    let count = word & [0xFFC, 0x1FFC, 0x3FFC, 0x7FFC][scale as usize];
    (f64::from(count * factor) / 4.0 + f64::from(from_mm), quality as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_growing_scale_is_that_of_the_maker() {
        // Values from the test of a public driver of the A3.
        for (sent, mm, bits) in [(1000, 1488, 1), (2000, 5760, 3), (1500, 2928, 2), (0, 0, 0)] {
            assert_eq!(unscaled(sent), (mm, bits));
        }
    }

    #[test]
    fn a_standard_measurement_is_read_as_the_protocol_says() {
        // Start bit, quality 15; 90.5°; 1000.25 mm.
        let angle = ((90.5 * 64.0) as u16) << 1 | 1;
        let [low, high] = angle.to_le_bytes();
        let [near, far] = 4001u16.to_le_bytes();
        let sample = read_node(&[15 << 2 | 1, low, high, near, far]);
        assert_eq!((sample.head_deg, sample.range_mm, sample.quality), (90.5, 1000.25, 15));
    }

    #[test]
    fn differences_at_their_extremes_are_no_returns() {
        let cabin = |major: u32, first: i32, second: i32| {
            (major | ((first as u32) & 0x3FF) << 12 | ((second as u32) & 0x3FF) << 22).to_le_bytes()
        };
        let cabins = [cabin(1000, -3, 511), cabin(400, 0, 0)].concat();
        let cabins = [cabins, vec![0; 120]].concat();
        let found: Vec<f64> = (0..4).map(|index| extended_range_mm(&cabins, &cabins, index)).collect();
        assert_eq!(found, [1488.0, 1482.0, 0.0, 400.0]);
        // Without a distance of its own a cabin's differences are to the next one.
        let cabins = [&cabin(0, 5, -512)[..], &cabin(400, 0, 0)[..], &[0; 120][..]].concat();
        let found: Vec<f64> = (0..3).map(|index| extended_range_mm(&cabins, &cabins, index)).collect();
        assert_eq!(found, [0.0, 405.0, 0.0]);
    }

    #[test]
    fn the_correction_of_the_extended_form_grows_to_eight_degrees() {
        assert_eq!(extended_correction_deg(10.0), 7.5);
        assert!(extended_correction_deg(200.0) < extended_correction_deg(2000.0));
        assert!((extended_correction_deg(20_000.0) - 8.0).abs() < 0.06);
    }
}
