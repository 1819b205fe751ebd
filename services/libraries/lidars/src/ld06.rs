//! LDROBOT LD06, LD19, STL-19P and LDS-02 (LD08): one-way packets of twelve points.
//!
//! Source: LDROBOT, *LD06/LD19 Development Manual* (packet, CRC-8 with polynomial 0x4D, example packet); the limits of what a packet
//! may span follow `ldrobotSensorTeam/ldlidar_stl_ros2`.

use crate::assembly::{Assembly, Beam};
use crate::byte_frames::{ByteFrames, Look, u16_at};
use crate::{Act, Counts, Device, Driver, Turn};

pub(crate) const HEADER: [u8; 2] = [0x54, 0x2C];
pub(crate) const POINTS: usize = 12;
pub(crate) const LENGTH: usize = 47;
/// Begin of the points; each is a distance in millimetres and a strength.
pub(crate) const POINTS_AT: usize = 6;
pub(crate) const POINT_LENGTH: usize = 3;
const END_ANGLE_AT: usize = POINTS_AT + POINTS * POINT_LENGTH;
/// Hundredths of a degree in a turn.
const TURN_CDEG: u16 = 36_000;
/// No packet spans more, hundredths of a degree: twelve points of the slowest model at its highest speed are a third of it.
const SPAN_MAX_CDEG: u16 = 4_000;
/// Ranges below are no returns, metres.
const RANGE_MIN_M: f32 = 0.02;
/// All models see as far, metres.
const RANGE_MAX_M: f32 = 12.0;
/// So many steps between points without a point mean that packets are missing.
const GAP_STEPS: f64 = 3.0;

/// The checksum of these bytes.
pub(crate) fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| CRC8[usize::from(crc ^ byte)])
}

const CRC8: [u8; 256] = {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let (mut crc, mut bit) = (index as u8, 0);
        while bit < 8 {
            crc = if crc & 0x80 != 0 { (crc << 1) ^ 0x4D } else { crc << 1 };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};

/// A decoder of this family.
pub(crate) struct Ld06 {
    frames: ByteFrames,
    assembly: Assembly,
    /// Sum and number of the speeds that the packets of this turn tell, degrees a second.
    speeds_deg_s: (f64, u32),
    /// Time that a packet takes on the line, nanoseconds.
    packet_ns: i64,
    device: Device,
    counts: Counts,
}

impl Ld06 {
    /// A byte takes `byte_ns` on the line.
    pub fn new(model: Option<&str>, byte_ns: i64) -> Self {
        Self {
            frames: ByteFrames::default(),
            assembly: Assembly::new(RANGE_MIN_M, RANGE_MAX_M, true),
            speeds_deg_s: (0.0, 0),
            packet_ns: byte_ns * LENGTH as i64,
            device: Device { model: Some(model.unwrap_or("LD06 or alike").to_owned()), ..Device::default() },
            counts: Counts::default(),
        }
    }
}

fn look(bytes: &[u8]) -> Look {
    if bytes[0] != HEADER[0] || bytes.get(1).is_some_and(|byte| *byte != HEADER[1]) {
        return Look::No;
    }
    let Some(packet) = bytes.get(..LENGTH) else { return Look::More };
    if crc8(&packet[..LENGTH - 1]) != packet[LENGTH - 1] {
        return Look::Bad;
    }
    let (start, end) = (u16_at(packet, 4), u16_at(packet, END_ANGLE_AT));
    let plausible = start < TURN_CDEG && end < TURN_CDEG && span_cdeg(start, end) <= SPAN_MAX_CDEG;
    if plausible { Look::Packet(LENGTH) } else { Look::No }
}

fn span_cdeg(start: u16, end: u16) -> u16 {
    if end >= start { end - start } else { TURN_CDEG - (start - end) }
}

impl Driver for Ld06 {
    fn act(&mut self, _now_ns: i64) -> Option<Act> {
        None
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let Self { frames, assembly, speeds_deg_s, counts, .. } = self;
        frames.push(bytes, counts);
        while let Some(packet) = frames.next(counts, look) {
            let start = u16_at(packet, 4);
            let start_deg = f64::from(start) / 100.0;
            let span_deg = f64::from(span_cdeg(start, u16_at(packet, END_ANGLE_AT))) / 100.0;
            let step_deg = span_deg / (POINTS - 1) as f64;
            assembly.begin_packet(arrival_ns, counts);
            let gap_deg = assembly.step_deg(start_deg);
            if step_deg > 0.0 && gap_deg > GAP_STEPS * step_deg {
                counts.missing_packets += ((gap_deg / step_deg / POINTS as f64).round() as u64).max(1);
            }
            let mut cut = |assembly: &mut Assembly, speeds_deg_s: &mut (f64, u32)| {
                let (sum, number) = std::mem::take(speeds_deg_s);
                let speed_hz = (number > 0).then(|| sum / f64::from(number) / 360.0);
                assembly.cut(speed_hz, counts, give);
            };
            for point in 0..POINTS {
                let head_deg = (start_deg + point as f64 * step_deg) % 360.0;
                if assembly.is_around(head_deg) {
                    cut(assembly, speeds_deg_s);
                }
                let at = POINTS_AT + point * POINT_LENGTH;
                assembly.push(Beam {
                    head_deg,
                    direction_deg: head_deg,
                    range_m: f32::from(u16_at(packet, at)) / 1000.0,
                    intensity: f32::from(packet[at + 2]),
                });
            }
            speeds_deg_s.0 += f64::from(u16_at(packet, 2));
            speeds_deg_s.1 += 1;
            assembly.end_packet(arrival_ns - self.packet_ns);
            // The next packet would come only after twelve more measurements.
            let next_deg = start_deg + POINTS as f64 * step_deg;
            if next_deg >= 360.0 && next_deg - step_deg < 360.0 {
                cut(assembly, speeds_deg_s);
            }
        }
    }

    fn device(&self) -> &Device {
        &self.device
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoders::ld06_encoder::{Ld06Encoder, packet};
    use proptest::prelude::*;

    /// The example packet of the development manual.
    const EXAMPLE: [u8; LENGTH] = [
        0x54, 0x2C, 0x68, 0x08, 0xAB, 0x7E, 0xE0, 0x00, 0xE4, 0xDC, 0x00, 0xE2, 0xD9, 0x00, 0xE5, 0xD5, 0x00,
        0xE3, 0xD3, 0x00, 0xE4, 0xD0, 0x00, 0xE9, 0xCD, 0x00, 0xE4, 0xCA, 0x00, 0xE2, 0xC7, 0x00, 0xE9, 0xC5,
        0x00, 0xE5, 0xC2, 0x00, 0xE5, 0xC0, 0x00, 0xE5, 0xBE, 0x82, 0x3A, 0x1A, 0x50,
    ];

    fn decode(bytes: &[u8]) -> (Vec<Turn>, Counts) {
        let mut driver = Ld06::new(None, 0);
        let mut turns = Vec::new();
        driver.take(bytes, 1_000_000_000, &mut |turn| turns.push(turn.clone()));
        (turns, driver.counts())
    }

    #[test]
    fn the_example_packet_of_the_manual_decodes_as_documented() {
        let mut driver = Ld06::new(None, 0);
        driver.take(&EXAMPLE, 0, &mut |_| panic!("one packet is no turn"));
        assert_eq!(driver.counts(), Counts { bytes: 47, packets: 1, ..Counts::default() });
        // The manual: 2152 degrees a second, from 324.27° to 334.7°, first distance 224 mm with strength 228.
        assert_eq!(driver.speeds_deg_s, (2152.0, 1));
        driver.assembly.cut(None, &mut Counts::default(), &mut |_| panic!("too few degrees"));
        let points = [224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192];
        let strengths = [228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229];
        let points: Vec<(u16, u8)> = points.into_iter().zip(strengths).collect();
        assert_eq!(packet(2152, 32427, 33470, &points.try_into().unwrap(), 6714), EXAMPLE);
    }

    /// Its directions are more than half a turn apart, and their sum does not fit into 16 bits.
    #[test]
    fn a_packet_that_ends_before_it_begins_is_garbage() {
        let packet = packet(3600, 35_999, 35_998, &[(1000, 200); POINTS], 0);
        let (turns, counts) = decode(&packet);
        assert_eq!((turns.len(), counts.packets, counts.garbage_bytes), (0, 0, LENGTH as u64));
    }

    #[test]
    fn a_turn_has_the_directions_times_and_ranges_that_were_sent() {
        let mut encoder = Ld06Encoder::new(10.0);
        let wall = |angle_rad: f64| 2.0 + angle_rad.cos();
        let bytes: Vec<u8> = (0..3).flat_map(|_| encoder.turn(&wall)).flatten().collect();
        let (turns, counts) = decode(&bytes);
        // The last packet of a turn has beams of the next one.
        assert_eq!((turns.len(), counts.garbage_bytes, counts.missing_packets), (3, 0, 0));
        let turn = &turns[1];
        assert!((440..=460).contains(&turn.len()), "{}", turn.len());
        assert!((turn.speed_hz - 10.0).abs() < 0.01);
        for beam in 0..turn.len() {
            let angle_rad = f64::from(turn.angles_rad[beam]);
            assert!((f64::from(turn.ranges_m[beam]) - wall(angle_rad)).abs() < 0.01);
            let share = -angle_rad / std::f64::consts::TAU;
            assert!((f64::from(turn.times_s[beam]) - share * 0.1).abs() < 0.003, "{beam}");
        }
    }

    #[test]
    fn a_turn_is_given_with_the_packet_of_its_last_beam() {
        let mut encoder = Ld06Encoder::new(10.0);
        let mut driver = Ld06::new(None, 0);
        for turn in 1..=4 {
            let mut whole = 0;
            // Every other turn ends where a packet ends.
            for packet in encoder.turn(&|_| 3.0) {
                driver.take(&packet, 0, &mut |turn| whole += usize::from((449..=451).contains(&turn.len())));
            }
            assert_eq!((whole, driver.counts().turns), (1, turn));
        }
    }

    #[test]
    fn lost_packets_and_a_changed_speed_are_counted() {
        let mut encoder = Ld06Encoder::new(10.0);
        let mut packets: Vec<_> = (0..3).flat_map(|_| encoder.turn(&|_| 3.0)).collect();
        encoder.set_speed(7.0);
        packets.extend((0..3).flat_map(|_| encoder.turn(&|_| 3.0)));
        packets.drain(50..53);
        packets[10][20] ^= 1;
        let (turns, counts) = decode(&packets.concat());
        assert_eq!((turns.len(), counts.missing_packets, counts.bad_checksums), (6, 4, 1));
        assert_eq!(counts.speed_changes, 1);
        assert!((turns[4].speed_hz - 7.0).abs() < 0.1);
    }

    proptest! {
        #[test]
        fn every_packet_behind_garbage_is_found(garbage in prop::collection::vec(any::<u8>(), 0..500), cut in 1usize..97) {
            let mut encoder = Ld06Encoder::new(10.0);
            let good: Vec<u8> = (0..2).flat_map(|_| encoder.turn(&|_| 3.0)).flatten().collect();
            let mut driver = Ld06::new(None, 0);
            for bytes in [&garbage[..], &good[..]].concat().chunks(cut) {
                driver.take(bytes, 0, &mut |_| ());
            }
            prop_assert_eq!(driver.counts().packets as usize, good.len() / LENGTH);
        }
    }
}
