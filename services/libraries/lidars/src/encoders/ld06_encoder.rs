//! Packets of an LD06.

use super::{World, counter_clockwise_rad};
use crate::ld06::{HEADER, LENGTH, POINT_LENGTH, POINTS, POINTS_AT, crc8};

/// Points a second.
const POINTS_HZ: f64 = 4500.0;

/// A packet: degrees a second, first and last direction in hundredths of a degree, points as millimetres and strength, milliseconds.
pub fn packet(
    speed_deg_s: u16,
    start_cdeg: u16,
    end_cdeg: u16,
    points: &[(u16, u8); POINTS],
    stamp_ms: u16,
) -> [u8; LENGTH] {
    let mut packet = [0; LENGTH];
    packet[..2].copy_from_slice(&HEADER);
    packet[2..4].copy_from_slice(&speed_deg_s.to_le_bytes());
    packet[4..6].copy_from_slice(&start_cdeg.to_le_bytes());
    for (bytes, (range_mm, strength)) in packet[POINTS_AT..].chunks_exact_mut(POINT_LENGTH).zip(points) {
        bytes[..2].copy_from_slice(&range_mm.to_le_bytes());
        bytes[2] = *strength;
    }
    packet[42..44].copy_from_slice(&end_cdeg.to_le_bytes());
    packet[44..46].copy_from_slice(&stamp_ms.to_le_bytes());
    packet[46] = crc8(&packet[..LENGTH - 1]);
    packet
}

/// A lidar that turns.
pub struct Ld06Encoder {
    speed_hz: f64,
    at_deg: f64,
    at_s: f64,
}

impl Ld06Encoder {
    /// Turns so often a second.
    pub fn new(speed_hz: f64) -> Self {
        Self { speed_hz, at_deg: 0.0, at_s: 0.0 }
    }

    /// Turns so often a second from now on.
    pub fn set_speed(&mut self, speed_hz: f64) {
        self.speed_hz = speed_hz;
    }

    /// The packets of the next turn: whole packets, so that a turn begins where the last one ended.
    pub fn turn(&mut self, world: World) -> Vec<Vec<u8>> {
        let step_deg = 360.0 * self.speed_hz / POINTS_HZ;
        let packets = ((360.0 - self.at_deg) / (step_deg * POINTS as f64)).ceil() as usize;
        let mut sent = Vec::with_capacity(packets);
        for _ in 0..packets {
            let cdeg = |deg: f64| ((deg * 100.0).round() as u32 % 36_000) as u16;
            let mut points = [(0, 0); POINTS];
            for (index, point) in points.iter_mut().enumerate() {
                let range_m = world(counter_clockwise_rad(self.at_deg + index as f64 * step_deg));
                *point = ((range_m * 1000.0).round().clamp(0.0, 65_535.0) as u16, 200);
            }
            let end_deg = self.at_deg + (POINTS - 1) as f64 * step_deg;
            let speed = (self.speed_hz * 360.0).round() as u16;
            let stamp_ms = (self.at_s * 1000.0) as u64 % 30_000;
            sent.push(packet(speed, cdeg(self.at_deg), cdeg(end_deg), &points, stamp_ms as u16).to_vec());
            self.at_deg += step_deg * POINTS as f64;
            self.at_s += POINTS as f64 / POINTS_HZ;
        }
        self.at_deg %= 360.0;
        sent
    }
}
