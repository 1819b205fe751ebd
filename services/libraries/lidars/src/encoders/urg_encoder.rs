//! Blocks of a Hokuyo sensor.

use super::World;
use crate::urg::sum;
use std::f64::consts::TAU;

/// A value as this many characters.
pub fn characters(value: u32, length: usize) -> Vec<u8> {
    (0..length).rev().map(|place| (value >> (6 * place) & 0x3F) as u8 + 0x30).collect()
}

/// A sensor like the UST-10LX: 1081 steps of a quarter of a degree, 40 turns a second.
#[derive(Default)]
pub struct UrgEncoder {
    turns: u32,
}

const STEPS: u32 = 1440;
const LAST: u32 = 1080;
const AHEAD: u32 = 540;

impl UrgEncoder {
    /// A sensor that has just been switched on.
    pub fn new() -> Self {
        Self::default()
    }

    /// What the sensor answers to a request.
    pub fn answer(&self, request: &[u8]) -> Vec<u8> {
        let words: &[&str] = match request {
            b"VV\n" => {
                &["VEND:Hokuyo Automatic Co., Ltd.", "PROD:UST-10LX", "FIRM:2.23.0000", "SERI:H1614934"]
            }
            b"PP\n" => &[
                "MODL:UST-10LX",
                "DMIN:20",
                "DMAX:30000",
                "ARES:1440",
                "AMIN:0",
                "AMAX:1080",
                "AFRT:540",
                "SCAN:2400",
            ],
            b"II\n" => &["MODL:UST-10LX", "STAT:sensor is working normally"],
            b"QT\n" | b"BM\n" | b"MD0000108001000\n" => &[],
            b"SCIP2.0\n" => return b"SCIP2.0\n\n".to_vec(),
            _ => return Vec::new(),
        };
        let mut answer = [request, b"00P\n"].concat();
        for word in words {
            answer.extend_from_slice(word.as_bytes());
            answer.extend([b';', sum(word.as_bytes()), b'\n']);
        }
        answer.push(b'\n');
        answer
    }

    /// The block of the next turn.
    pub fn turn(&mut self, world: World) -> Vec<Vec<u8>> {
        let mut block = b"MD0000108001000\n99b\n".to_vec();
        let mut line = |characters: &[u8]| {
            block.extend_from_slice(characters);
            block.extend([sum(characters), b'\n']);
        };
        line(&characters(self.turns * 25, 4));
        let range_mm = |step: u32| {
            let angle_rad = (f64::from(step) - f64::from(AHEAD)) * TAU / f64::from(STEPS);
            (world(angle_rad) * 1000.0).round().clamp(0.0, 262_143.0) as u32
        };
        let values: Vec<u8> = (0..=LAST).flat_map(|step| characters(range_mm(step), 3)).collect();
        values.chunks(64).for_each(line);
        block.push(b'\n');
        self.turns += 1;
        vec![block]
    }
}
