//! Telegrams of a SICK sensor.

use super::World;

/// A sensor like the TiM561: 811 beams over 270°, 15 turns a second.
#[derive(Default)]
pub struct SickTimEncoder {
    turns: u32,
}

const BEAMS: usize = 811;
/// Ten-thousandths of a degree.
const START: i32 = -450_000;
const STEP: i32 = 3333;

impl SickTimEncoder {
    /// A sensor that has just been switched on.
    pub fn new() -> Self {
        Self::default()
    }

    /// What the sensor answers to a request.
    pub fn answer(&self, request: &[u8]) -> Vec<u8> {
        let answer: &str = match request {
            b"\x02sRN DeviceIdent\x03" => "sRA DeviceIdent 6 TiM561 5 V2.50",
            b"\x02sRN SerialNumber\x03" => "sRA SerialNumber 8 16041234",
            b"\x02sRN SCdevicestate\x03" => "sRA SCdevicestate 1",
            b"\x02sEN LMDscandata 1\x03" => "sEA LMDscandata 1",
            _ => return Vec::new(),
        };
        [&[2][..], answer.as_bytes(), &[3]].concat()
    }

    /// The telegram of the next turn.
    pub fn turn(&mut self, world: World) -> Vec<Vec<u8>> {
        let counter = self.turns & 0xFFFF;
        let head = |content| format!("{content} 3F800000 00000000 {:X} {STEP:X} {BEAMS:X}", START as u32);
        let mut text =
            format!("sSN LMDscandata 1 1 F4BEEF 0 0 {counter:X} {counter:X} 0 0 0 0 1 0 0 5DC A2 0 1 ");
        text += &head("DIST1");
        for beam in 0..BEAMS {
            let angle_deg = (f64::from(START) + beam as f64 * f64::from(STEP)) / 1e4 - 90.0;
            let range_mm = (world(angle_deg.to_radians()) * 1000.0).round().clamp(0.0, 65_535.0);
            text += &format!(" {:X}", range_mm as u32);
        }
        text += &format!(" 1 {}", head("RSSI1"));
        text += &" C8".repeat(BEAMS);
        text += " 0 0 0 0 0";
        self.turns += 1;
        vec![[&[2][..], text.as_bytes(), &[3]].concat()]
    }
}
