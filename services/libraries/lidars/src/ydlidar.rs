//! YDLIDAR: packets `AA 55` with two or three bytes a point, from lidars that triangulate and lidars that time their light.
//!
//! Sources: `YDLIDAR/YDLidar-SDK`, *Communication Protocol* (packets, angles, check code) and `ydlidar_protocol.h` (requests, answers);
//! bytes of a T-mini Plus.

use crate::assembly::{Assembly, Beam};
use crate::byte_frames::{ByteFrames, Look, u16_at, u32_at};
use crate::ydlidar_models::{Optics, T_MINI, TRIANGLE, by_name, by_number, correction_deg};
use crate::{Act, Counts, Device, Driver, Health, Turn};

pub(crate) const PACKET: [u8; 2] = [0xAA, 0x55];
pub(crate) const ANSWER: [u8; 2] = [0xA5, 0x5A];
/// Length of what stands before the points, and before the content of an answer.
pub(crate) const HEAD_LENGTH: usize = 10;
const ANSWER_HEAD_LENGTH: usize = 7;
const REQUEST: u8 = 0xA5;
const STOP: u8 = 0x65;
const START: u8 = 0x60;
const DEVICE_INFO: u8 = 0x90;
const DEVICE_HEALTH: u8 = 0x92;
/// Types of answers, and the lengths of their contents.
const INFO_ANSWER: (u8, usize) = (0x04, 20);
const HEALTH_ANSWER: (u8, usize) = (0x06, 3);
/// Messages before the first packet.
const SCAN_ANSWER: (u8, usize) = (0x81, 5);
/// Ranges below are no returns, metres.
const RANGE_MIN_M: f32 = 0.05;
/// So many steps between points without a point mean that packets are missing. Packets are a step apart.
const GAP_STEPS: f64 = 3.0;
/// Points of a full packet.
const FULL_PACKET: f64 = 40.0;
/// An answer that has not come after this is not waited for: models with one wire say nothing.
const ANSWER_NS: i64 = 300_000_000;
/// What a lidar that was turning still sends after the request to stop.
const STOP_NS: i64 = 50_000_000;

/// The check code of a packet of two or three bytes a point, by its definition.
pub(crate) fn check_code(packet: &[u8], point_length: usize) -> u16 {
    let head = [0, 2, 4, 6].iter().fold(0, |code, at| code ^ u16_at(packet, *at));
    packet[HEAD_LENGTH..].chunks_exact(point_length).fold(head, |code, point| match point_length {
        2 => code ^ u16_at(point, 0),
        _ => code ^ u16::from(point[0]) ^ u16_at(point, 1),
    })
}

/// Requests to the lidar, in order.
#[derive(Clone, Copy, PartialEq)]
enum Step {
    Begin,
    Stopping,
    Info,
    Health,
    Running,
}

/// A decoder of this family.
pub(crate) struct Ydlidar {
    frames: ByteFrames,
    assembly: Assembly,
    /// Bytes a point, as the last good packet had them.
    point_length: usize,
    /// The model is known: from the description of the set or from the lidar.
    optics: Option<Optics>,
    is_configured: bool,
    step: Step,
    next_ns: i64,
    outbox: Vec<Act>,
    byte_ns: i64,
    device: Device,
    counts: Counts,
}

impl Ydlidar {
    /// A byte takes `byte_ns` on the line. The model's name where it is known.
    pub fn new(model: Option<&str>, byte_ns: i64) -> Self {
        let known = model.and_then(by_name);
        let device = Device { model: known.map(|(name, _)| name.to_owned()), ..Device::default() };
        let range_max_m = known.map_or(TRIANGLE.range_max_m, |(_, optics)| optics.range_max_m);
        Self {
            frames: ByteFrames::default(),
            assembly: Assembly::new(RANGE_MIN_M, range_max_m, false),
            point_length: 2,
            optics: known.map(|(_, optics)| optics),
            is_configured: known.is_some(),
            step: Step::Begin,
            next_ns: i64::MIN,
            outbox: Vec::new(),
            byte_ns,
            device,
            counts: Counts::default(),
        }
    }

    fn ask(&mut self, step: Step, requests: &[u8], now_ns: i64, wait_ns: i64) {
        self.outbox.extend(requests.iter().rev().map(|request| Act::Send(vec![REQUEST, *request])));
        (self.step, self.next_ns) = (step, now_ns + wait_ns);
    }
}

/// Takes an answer that a lidar has given.
fn take_answer(answer: &[u8], device: &mut Device) -> Option<(&'static str, Optics)> {
    let content = &answer[ANSWER_HEAD_LENGTH..];
    if answer[6] == HEALTH_ANSWER.0 {
        let code = u32::from(u16_at(content, 1));
        device.health = Some(match content[0] {
            0 => Health::Good,
            1 => Health::Warning(code),
            _ => Health::Failed(code),
        });
    }
    if answer[6] != INFO_ANSWER.0 {
        return None;
    }
    device.firmware = Some(format!("{}.{}", content[2], content[1]));
    device.serial_number = Some(content[4..].iter().map(|digit| char::from(b'0' + digit % 10)).collect());
    by_number(content[0])
}

fn look(bytes: &[u8], point_length: usize) -> Look {
    let begins = |mark: &[u8; 2]| bytes[0] == mark[0] && bytes.get(1).is_none_or(|byte| *byte == mark[1]);
    if begins(&ANSWER) {
        let Some(head) = bytes.get(..ANSWER_HEAD_LENGTH) else { return Look::More };
        let length = (u32_at(head, 2) & 0x3FFF_FFFF) as usize;
        return match (head[6], length) {
            SCAN_ANSWER => Look::Packet(ANSWER_HEAD_LENGTH),
            INFO_ANSWER | HEALTH_ANSWER if bytes.len() < ANSWER_HEAD_LENGTH + length => Look::More,
            INFO_ANSWER | HEALTH_ANSWER => Look::Packet(ANSWER_HEAD_LENGTH + length),
            _ => Look::No,
        };
    }
    if !begins(&PACKET) {
        return Look::No;
    }
    let Some(head) = bytes.get(..HEAD_LENGTH) else { return Look::More };
    let points = usize::from(head[3]);
    // Angles have a check bit of their own.
    if head[4] & 1 == 0 || head[6] & 1 == 0 || points == 0 {
        return Look::No;
    }
    for point_length in [point_length, 5 - point_length] {
        let Some(packet) = bytes.get(..HEAD_LENGTH + points * point_length) else { return Look::More };
        if check_code(packet, point_length) == u16_at(packet, 8) {
            return Look::Packet(packet.len());
        }
    }
    Look::Bad
}

/// Degrees of an angle with its check bit.
fn angle_deg(packet: &[u8], at: usize) -> f64 {
    f64::from(u16_at(packet, at) >> 1) / 64.0
}

impl Driver for Ydlidar {
    fn act(&mut self, now_ns: i64) -> Option<Act> {
        if self.outbox.is_empty() && now_ns >= self.next_ns {
            match self.step {
                Step::Begin => {
                    self.ask(Step::Stopping, &[STOP], now_ns, STOP_NS);
                    self.outbox.push(Act::SetDtr(true));
                }
                Step::Stopping => self.ask(Step::Info, &[DEVICE_INFO], now_ns, ANSWER_NS),
                Step::Info => self.ask(Step::Health, &[DEVICE_HEALTH], now_ns, ANSWER_NS),
                Step::Health => self.ask(Step::Running, &[START], now_ns, 0),
                Step::Running => {}
            }
        }
        self.outbox.pop()
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let Self { frames, assembly, counts, point_length, optics, device, .. } = self;
        frames.push(bytes, counts);
        loop {
            let expected = *point_length;
            let Some(packet) = frames.next(counts, |bytes| look(bytes, expected)) else { return };
            if packet[0] == ANSWER[0] {
                if packet.len() > ANSWER_HEAD_LENGTH {
                    let model = take_answer(packet, device);
                    if let Some((name, found)) = model.filter(|_| !self.is_configured) {
                        (device.model, *optics) = (Some(name.to_owned()), Some(found));
                    }
                    self.next_ns = i64::MIN;
                }
                continue;
            }
            let points = usize::from(packet[3]);
            *point_length = (packet.len() - HEAD_LENGTH) / points;
            let has_intensities = *point_length == 3;
            let optics = optics.unwrap_or(if has_intensities { T_MINI } else { TRIANGLE });
            assembly.set_range_max(optics.range_max_m);
            assembly.set_intensities(has_intensities);
            assembly.begin_packet(arrival_ns, counts);
            let (first_deg, last_deg) = (angle_deg(packet, 4) % 360.0, angle_deg(packet, 6));
            let step_deg = (last_deg - first_deg).rem_euclid(360.0) / (points - 1).max(1) as f64;
            let gap_deg = assembly.step_deg(first_deg);
            if points > 1 && gap_deg > GAP_STEPS * step_deg.max(0.1) {
                counts.missing_packets += ((gap_deg / step_deg / FULL_PACKET).round() as u64).max(1);
            }
            let begins_turn = packet[2] & 1 == 1;
            if begins_turn || assembly.is_over_full() {
                let tenths = if begins_turn { packet[2] >> 1 } else { 0 };
                assembly.cut((tenths > 0).then(|| f64::from(tenths) / 10.0), counts, give);
            }
            for (index, point) in packet[HEAD_LENGTH..].chunks_exact(*point_length).enumerate() {
                let head_deg = (first_deg + index as f64 * step_deg) % 360.0;
                let (strength, count) = match *point {
                    [strength, low, high] => (u16::from(strength), u16::from_le_bytes([low, high])),
                    _ => (0, u16_at(point, 0)),
                };
                let (flags, count) = match optics.mm_per_count {
                    1.0 => (0, count),
                    _ => (count & 3, count & !3),
                };
                let range_mm = f64::from(count) * optics.mm_per_count;
                let aside_deg = if optics.corrected { correction_deg(range_mm) } else { 0.0 };
                let high = if optics.long_intensity { flags << 8 } else { 0 };
                assembly.push(Beam {
                    head_deg,
                    direction_deg: head_deg + aside_deg,
                    range_m: (range_mm / 1000.0) as f32,
                    intensity: f32::from(strength | high),
                });
            }
            assembly.end_packet(arrival_ns - self.byte_ns * packet.len() as i64);
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
    use crate::encoders::ydlidar_encoder::{YdlidarEncoder, packet};
    use proptest::prelude::*;
    use std::path::Path;

    fn decode(model: Option<&str>, bytes: &[u8]) -> (Vec<Turn>, Counts) {
        let mut driver = Ydlidar::new(model, 0);
        let mut turns = Vec::new();
        for (at, bytes) in bytes.chunks(100).enumerate() {
            driver.take(bytes, at as i64 * 10_000_000, &mut |turn| turns.push(turn.clone()));
        }
        (turns, driver.counts())
    }

    #[test]
    fn the_example_packets_of_the_protocol_document_are_read() {
        // The zero packet, without and with strength: angle (0xAE53 >> 1) / 64 = 348.640625°, no distance.
        for (bytes, point_length) in [
            (&[0xAA, 0x55, 1, 1, 0x53, 0xAE, 0x53, 0xAE, 0xAB, 0x54, 0, 0][..], 2),
            (&[0xAA, 0x55, 1, 1, 0x53, 0xAE, 0x53, 0xAE, 0xAB, 0x54, 0, 0, 0][..], 3),
        ] {
            assert_eq!(check_code(bytes, point_length), 0x54AB);
            let (_, counts) = decode(None, bytes);
            assert_eq!((counts.packets, counts.bad_checksums), (1, 0));
            assert_eq!(angle_deg(bytes, 4), 348.640625);
            assert_eq!(packet(1, 0xAE53, 0xAE53, &[(0, 0)], point_length), bytes);
        }
        // The example of angles: 28 E5 6F BD 79.
        let bytes = [0, 0, 0, 0x28, 0xE5, 0x6F, 0xBD, 0x79];
        assert!((angle_deg(&bytes, 4) - 223.78).abs() < 0.01 && (angle_deg(&bytes, 6) - 243.47).abs() < 0.01);
    }

    /// Bytes of a real lidar, where they are.
    fn recorded() -> Option<Vec<u8>> {
        let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
        let data = std::env::var_os("FLOCKSLAM_DATA").map_or_else(beside, Into::into);
        let text = std::fs::read_to_string(data.join("lidar-bytes/ydlidar-t-mini-plus.hex.txt")).ok()?;
        Some(text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect())
    }

    #[test]
    fn bytes_of_a_real_lidar_are_turns() {
        let Some(bytes) = recorded() else {
            println!("not tested: the bytes of a lidar are not there (FLOCKSLAM_DATA)");
            return;
        };
        let (turns, counts) = decode(None, &bytes);
        assert_eq!((counts.bad_checksums, counts.garbage_bytes), (0, 0));
        assert!(turns.len() >= 7, "{}", turns.len());
        for turn in &turns {
            assert!((580..=680).contains(&turn.len()), "{}", turn.len());
            assert!((4.0..12.0).contains(&turn.speed_hz), "{}", turn.speed_hz);
            let seen = turn.ranges_m.iter().filter(|range| **range > turn.range_min_m).count();
            assert!(seen > turn.len() / 2, "{seen} of {}", turn.len());
            assert!(turn.times_s.windows(2).all(|pair| pair[1] >= pair[0]));
            assert!(turn.ranges_m.iter().all(|range| *range < 12.0));
            assert_eq!(turn.intensities.len(), turn.len());
        }
        // The same room twice.
        let nearest = |turn: &Turn| {
            let seen = turn.ranges_m.iter().copied().filter(|range| *range > 0.05);
            seen.fold(f32::INFINITY, f32::min)
        };
        assert!((nearest(&turns[3]) - nearest(&turns[4])).abs() < 0.03);
    }

    #[test]
    fn each_kind_gives_the_walls_that_were_sent() {
        let wall = |angle_rad: f64| 2.0 + angle_rad.cos();
        for (model, point_length) in
            [("X4", 2), ("G4", 2), ("G4B", 3), ("T-mini Plus", 3), ("TG30", 2), ("G6", 2)]
        {
            let mut encoder = YdlidarEncoder::new(model, point_length, 8.0);
            let bytes: Vec<u8> = (0..3).flat_map(|_| encoder.turn(&wall)).flatten().collect();
            let (turns, counts) = decode(Some(model), &bytes);
            assert_eq!((turns.len(), counts.garbage_bytes, counts.missing_packets), (2, 0, 0), "{model}");
            let turn = &turns[1];
            assert!((turn.speed_hz - 8.0).abs() < 1e-9, "{model}");
            for beam in 0..turn.len() {
                let found_m = f64::from(turn.ranges_m[beam]);
                assert!((found_m - wall(f64::from(turn.angles_rad[beam]))).abs() < 0.02, "{model} {beam}");
            }
            assert_eq!(turn.intensities.is_empty(), point_length == 2);
        }
    }

    #[test]
    fn a_lidar_is_identified_and_started() {
        let mut driver = Ydlidar::new(None, 0);
        assert_eq!(driver.act(0), Some(Act::SetDtr(true)));
        assert_eq!(driver.act(0), Some(Act::Send(vec![0xA5, 0x65])));
        assert_eq!((driver.act(1), driver.act(STOP_NS)), (None, Some(Act::Send(vec![0xA5, 0x90]))));
        let mut info = vec![0xA5, 0x5A, 0x14, 0, 0, 0, 4, 6, 10, 1, 1];
        info.extend([2, 0, 1, 9, 0, 6, 2, 1, 0, 0, 0, 0, 2, 1, 0, 5]);
        driver.take(&info, 0, &mut |_| ());
        assert_eq!(
            driver.act(STOP_NS),
            Some(Act::Send(vec![0xA5, 0x92])),
            "an answer is not waited for longer"
        );
        driver.take(&[0xA5, 0x5A, 3, 0, 0, 0, 6, 1, 5, 0], 0, &mut |_| ());
        assert_eq!(driver.act(STOP_NS), Some(Act::Send(vec![0xA5, 0x60])));
        let described = driver.device().to_string();
        assert_eq!(described, "X4, firmware 1.10, serial number 2019062100002105, health warning 0x5");
        // A model with one wire sends no answer: after a while it is started all the same.
        let mut silent = Ydlidar::new(Some("X2"), 0);
        let sent = (0..20).filter_map(|step| silent.act(step * ANSWER_NS)).last();
        assert_eq!((sent, silent.device().model.as_deref()), (Some(Act::Send(vec![0xA5, 0x60])), Some("X2")));
    }

    proptest! {
        #[test]
        fn every_packet_behind_garbage_is_found(garbage in prop::collection::vec(any::<u8>(), 0..500), cut in 1usize..97) {
            let mut encoder = YdlidarEncoder::new("X4", 2, 8.0);
            let good: Vec<_> = (0..4).flat_map(|_| encoder.turn(&|_| 3.0)).collect();
            let mut driver = Ydlidar::new(Some("X4"), 0);
            for bytes in [&garbage[..], &good.concat()[..]].concat().chunks(cut) {
                driver.take(bytes, 0, &mut |_| ());
            }
            prop_assert!(driver.counts().packets as usize >= good.len());
        }
    }
}
