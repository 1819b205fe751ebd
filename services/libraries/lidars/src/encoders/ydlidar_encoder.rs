//! Packets of a YDLIDAR.

use super::{World, counter_clockwise_rad};
use crate::ydlidar::{HEAD_LENGTH, PACKET, check_code};
use crate::ydlidar_models::{Optics, T_MINI, by_name, correction_deg};

/// Points of a full packet.
const POINTS: usize = 40;
/// Points a second.
const POINTS_HZ: f64 = 4000.0;

/// A packet: its type, its first and last angle with their check bits, its points as strength and distance, bytes a point.
pub fn packet(kind: u8, first: u16, last: u16, points: &[(u8, u16)], point_length: usize) -> Vec<u8> {
    let mut packet = PACKET.to_vec();
    packet.extend([kind, points.len() as u8]);
    packet.extend(first.to_le_bytes());
    packet.extend(last.to_le_bytes());
    packet.extend([0, 0]);
    for (strength, count) in points {
        if point_length == 3 {
            packet.push(*strength);
        }
        packet.extend(count.to_le_bytes());
    }
    let code = check_code(&packet, point_length);
    packet[8..HEAD_LENGTH].copy_from_slice(&code.to_le_bytes());
    packet
}

/// A lidar that turns.
pub struct YdlidarEncoder {
    optics: Optics,
    point_length: usize,
    speed_hz: f64,
}

impl YdlidarEncoder {
    /// A model by its name, with two or three bytes a point, that turns so often a second.
    pub fn new(model: &str, point_length: usize, speed_hz: f64) -> Self {
        Self { optics: by_name(model).map_or(T_MINI, |(_, optics)| optics), point_length, speed_hz }
    }

    /// The packets of a turn; the first is the zero packet, which ends the turn before it.
    pub fn turn(&mut self, world: World) -> Vec<Vec<u8>> {
        let number = (POINTS_HZ / self.speed_hz) as usize;
        let step_deg = 360.0 / number as f64;
        let counts: Vec<_> = (0..number).map(|index| self.point(index as f64 * step_deg, world)).collect();
        let angle = |index: usize| (((index as f64 * step_deg * 64.0).round() as u16) << 1) | 1;
        let kind = ((self.speed_hz * 10.0).round() as u8) << 1 | 1;
        let mut sent = vec![packet(kind, angle(0), angle(0), &counts[..1], self.point_length)];
        let mut at = 1;
        for points in counts[1..].chunks(POINTS) {
            sent.push(packet(0, angle(at), angle(at + points.len() - 1), points, self.point_length));
            at += points.len();
        }
        sent
    }

    /// What is seen with the head here: the beam may go beside it, by the range that it finds.
    fn point(&self, head_deg: f64, world: World) -> (u8, u16) {
        let range_mm = |deg: f64| world(counter_clockwise_rad(deg)) * 1000.0;
        let mut found_mm = range_mm(head_deg);
        for _ in 0..if self.optics.corrected { 6 } else { 0 } {
            found_mm = range_mm(head_deg + correction_deg(found_mm));
        }
        let count = (found_mm / self.optics.mm_per_count).round().clamp(0.0, 65_535.0) as u16;
        (120, if self.optics.mm_per_count == 1.0 { count } else { count & !3 })
    }
}
