//! SICK TiM and LMS1xx: telegrams `LMDscandata` of CoLa A, words in hexadecimal between STX and ETX.
//!
//! Source: SICK, *Telegram Listing* for TiM5xx, TiM7xx and LMS1xx (fields of LMDscandata, start, identification).

use crate::byte_frames::{ByteFrames, Look};
use crate::{Act, Counts, Device, Driver, Health, Turn};

const STX: u8 = 0x02;
const ETX: u8 = 0x03;
/// An answer that has not come after this is not waited for.
const ANSWER_NS: i64 = 500_000_000;
/// No telegram is longer.
const TELEGRAM_MAX: usize = 32 * 1024;
/// More beams than any of these sensors has.
const BEAMS_MAX: usize = 4_000;
/// Angles of these sensors are counted from their right; ahead is a quarter turn further.
const AHEAD_DEG: f64 = 90.0;
/// Ranges below are no returns, metres.
const RANGE_MIN_M: f32 = 0.05;
/// All models see no further, metres.
const RANGE_MAX_M: f32 = 50.0;

/// Requests to the sensor, in order.
#[derive(Clone, Copy, PartialEq)]
enum Step {
    Begin,
    Identity,
    SerialNumber,
    State,
    Running,
}

/// A decoder of this family.
pub(crate) struct SickTim {
    frames: ByteFrames,
    turn: Turn,
    step: Step,
    next_ns: i64,
    outbox: Vec<Act>,
    byte_ns: i64,
    device: Device,
    counts: Counts,
    last_scan: Option<u32>,
}

impl SickTim {
    /// A byte takes `byte_ns` on the line.
    pub fn new(byte_ns: i64) -> Self {
        Self {
            frames: ByteFrames::default(),
            turn: Turn { range_min_m: RANGE_MIN_M, range_max_m: RANGE_MAX_M, ..Turn::default() },
            step: Step::Begin,
            next_ns: i64::MIN,
            outbox: Vec::new(),
            byte_ns,
            device: Device::default(),
            counts: Counts::default(),
            last_scan: None,
        }
    }

    fn ask(&mut self, step: Step, request: &str, now_ns: i64, wait_ns: i64) {
        let telegram = [&[STX][..], request.as_bytes(), &[ETX]].concat();
        self.outbox.push(Act::Send(telegram));
        (self.step, self.next_ns) = (step, now_ns + wait_ns);
    }

    fn take_telegram(&mut self, telegram: &str, measured_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let mut words = Words { rest: telegram };
        let (kind, name) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
        match (kind, name) {
            ("sSN" | "sRA", "LMDscandata") => match self.read_scan(&mut words, measured_ns) {
                Some(()) => {
                    self.counts.turns += 1;
                    give(&self.turn);
                }
                None => self.counts.partial_turns += 1,
            },
            ("sRA", "DeviceIdent") => {
                self.device.model = words.text();
                self.device.firmware = words.text();
            }
            ("sRA", "SerialNumber") => self.device.serial_number = words.text(),
            ("sRA", "SCdevicestate") => {
                self.device.health = words.hex().map(|state| match state {
                    1 => Health::Good,
                    2 => Health::Failed(state),
                    _ => Health::Warning(state),
                });
            }
            _ => {}
        }
        if kind == "sRA" && name != "LMDscandata" {
            self.next_ns = i64::MIN;
        }
    }

    fn read_scan(&mut self, words: &mut Words<'_>, measured_ns: i64) -> Option<()> {
        // Version, device, serial number, two of status, counter of telegrams.
        words.skip(6)?;
        let scan = words.hex()?;
        // Times since power-on and of sending, two of inputs, two of outputs, reserved.
        words.skip(7)?;
        let speed_hz = f64::from(words.hex()?) / 100.0;
        words.skip(1)?;
        let encoders = words.hex()?;
        words.skip(2 * usize::try_from(encoders).ok()?.min(BEAMS_MAX))?;
        let turn = &mut self.turn;
        turn.clear();
        for wide in [true, false] {
            for _ in 0..words.hex()?.min(16) {
                let content = words.next()?;
                let (factor, offset) = (f32::from_bits(words.hex()?), f32::from_bits(words.hex()?));
                let start_deg = f64::from(words.hex()? as i32) / 1e4 - AHEAD_DEG;
                let step_deg = f64::from(words.hex()? as i16) / 1e4;
                let beams = usize::try_from(words.hex()?).ok().filter(|beams| *beams <= BEAMS_MAX)?;
                let values = |words: &mut Words<'_>| words.hex().map(|value| value as f32 * factor + offset);
                if content == "DIST1" && wide {
                    for beam in 0..beams {
                        let range_m = values(words)? / 1000.0;
                        turn.ranges_m.push(if range_m.is_finite() { range_m } else { 0.0 });
                        let turned_deg = beam as f64 * step_deg;
                        turn.angles_rad.push((start_deg + turned_deg).to_radians() as f32);
                        turn.times_s.push((turned_deg.abs() / 360.0 / speed_hz.max(1.0)) as f32);
                    }
                } else if content == "RSSI1" && beams == turn.len() {
                    for _ in 0..beams {
                        turn.intensities.push(values(words)?);
                    }
                } else {
                    words.skip(beams)?;
                }
            }
        }
        (!turn.is_empty()).then_some(())?;
        turn.speed_hz = speed_hz;
        let sweep_s = f64::from(turn.times_s.last().copied().unwrap_or(0.0));
        turn.begun_ns = measured_ns - (sweep_s * 1e9) as i64;
        if let Some(last) = self.last_scan.replace(scan) {
            let passed = scan.wrapping_sub(last) & 0xFFFF;
            self.counts.missing_packets += u64::from(passed.saturating_sub(1)) * u64::from(passed < 1000);
        }
        Some(())
    }
}

/// Words of a telegram.
struct Words<'t> {
    rest: &'t str,
}

impl<'t> Words<'t> {
    fn next(&mut self) -> Option<&'t str> {
        let (word, rest) = match self.rest.split_once(' ') {
            Some((word, rest)) => (word, rest),
            None => (self.rest, ""),
        };
        self.rest = rest;
        (!word.is_empty()).then_some(word)
    }

    fn skip(&mut self, words: usize) -> Option<()> {
        (0..words).try_for_each(|_| self.next().map(|_| ()))
    }

    /// A number in hexadecimal; with a sign it is decimal.
    fn hex(&mut self) -> Option<u32> {
        let word = self.next()?;
        match word.as_bytes()[0] {
            b'+' | b'-' => word.parse::<i32>().ok().map(|number| number as u32),
            _ => u32::from_str_radix(word, 16).ok(),
        }
    }

    /// A text with its length before it.
    fn text(&mut self) -> Option<String> {
        let length = usize::try_from(self.hex()?).ok()?;
        let text = self.rest.get(..length)?;
        self.rest = self.rest[length..].trim_start();
        Some(text.to_owned())
    }
}

fn look(bytes: &[u8]) -> Look {
    if bytes[0] != STX {
        return Look::No;
    }
    let end = bytes[1..].iter().take(TELEGRAM_MAX).position(|byte| [STX, ETX].contains(byte));
    match end.map(|end| end + 1) {
        Some(end) if bytes[end] == ETX && bytes[1..end].is_ascii() => Look::Packet(end + 1),
        Some(_) => Look::Bad,
        None if bytes.len() < TELEGRAM_MAX => Look::More,
        None => Look::No,
    }
}

impl Driver for SickTim {
    fn act(&mut self, now_ns: i64) -> Option<Act> {
        if self.outbox.is_empty() && now_ns >= self.next_ns {
            match self.step {
                Step::Begin => self.ask(Step::Identity, "sRN DeviceIdent", now_ns, ANSWER_NS),
                Step::Identity => self.ask(Step::SerialNumber, "sRN SerialNumber", now_ns, ANSWER_NS),
                Step::SerialNumber => self.ask(Step::State, "sRN SCdevicestate", now_ns, ANSWER_NS),
                Step::State => self.ask(Step::Running, "sEN LMDscandata 1", now_ns, 0),
                Step::Running => {}
            }
        }
        self.outbox.pop()
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let mut frames = std::mem::take(&mut self.frames);
        frames.push(bytes, &mut self.counts);
        while let Some(telegram) = frames.next(&mut self.counts, look) {
            let text = std::str::from_utf8(&telegram[1..telegram.len() - 1]).unwrap_or_default();
            self.take_telegram(text, arrival_ns - self.byte_ns * telegram.len() as i64, give);
        }
        self.frames = frames;
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
    use crate::encoders::sick_tim_encoder::SickTimEncoder;
    use proptest::prelude::*;

    /// A telegram of a TiM551, from the test of a public C library; cut to its first beams.
    const TIM551: &str = "sRA LMDscandata 1 1 F510AB 0 0 5932 5933 5B87697D 5B88808C 0 0 1 0 0 5DC 36 0 1 \
        DIST1 3F800000 00000000 FFF92230 2710 5 292 290 28D 0 1724 1 RSSI1 3F800000 00000000 FFF92230 2710 5 \
        E6 E6 C3 0 B0 0 0 0 0 0";

    #[test]
    fn a_telegram_of_a_real_sensor_is_read() {
        let telegram = [&[STX][..], TIM551.as_bytes(), &[ETX]].concat();
        let mut driver = SickTim::new(0);
        let mut turns = Vec::new();
        driver.take(&telegram, 0, &mut |turn| turns.push(turn.clone()));
        assert_eq!((turns.len(), driver.counts.partial_turns), (1, 0));
        let turn = &turns[0];
        assert_eq!(turn.ranges_m, [0.658, 0.656, 0.653, 0.0, 5.924]);
        assert_eq!(turn.intensities, [230.0, 230.0, 195.0, 0.0, 176.0]);
        // From -45° as the sensor counts, in steps of 1°: -135° from ahead.
        assert!((turn.angles_rad[0].to_degrees() + 135.0).abs() < 1e-4);
        assert!((turn.angles_rad[4].to_degrees() + 131.0).abs() < 1e-4);
        assert_eq!(turn.speed_hz, 15.0);
        // Too short, and not a telegram at all.
        let short = [&[STX][..], &TIM551.as_bytes()[..120], &[ETX], b"\x02sSN x\x03"].concat();
        driver.take(&short, 0, &mut |_| panic!("not whole"));
        assert_eq!(driver.counts.partial_turns, 1);
    }

    #[test]
    fn a_sensor_is_asked_and_its_turns_are_the_walls_that_were_sent() {
        let mut encoder = SickTimEncoder::new();
        let mut driver = SickTim::new(0);
        for step in 0..100 {
            while let Some(Act::Send(request)) = driver.act(step * 10_000_000) {
                driver.take(&encoder.answer(&request), 0, &mut |_| ());
            }
        }
        assert!(driver.step == Step::Running);
        assert_eq!(
            driver.device().to_string(),
            "TiM561, firmware V2.50, serial number 16041234, health good"
        );
        let wall = |angle_rad: f64| 2.0 + angle_rad.cos();
        let mut turns = Vec::new();
        for lost in [false, true, false] {
            let bytes = encoder.turn(&wall).concat();
            if !lost {
                driver.take(&bytes, 0, &mut |turn| turns.push(turn.clone()));
            }
        }
        assert_eq!((turns.len(), driver.counts.missing_packets), (2, 1));
        for (range_m, angle_rad) in turns[1].ranges_m.iter().zip(&turns[1].angles_rad) {
            assert!((f64::from(*range_m) - wall(f64::from(*angle_rad))).abs() < 0.002);
        }
    }

    proptest! {
        #[test]
        fn every_telegram_behind_garbage_is_found(garbage in prop::collection::vec(any::<u8>(), 0..500), cut in 1usize..997) {
            let mut encoder = SickTimEncoder::new();
            let mut driver = SickTim::new(0);
            let good: Vec<u8> = (0..2).flat_map(|_| encoder.turn(&|_| 3.0)).flatten().collect();
            let mut turns = 0;
            for bytes in [&garbage[..], &good[..]].concat().chunks(cut) {
                driver.take(bytes, 0, &mut |_| turns += 1);
            }
            prop_assert_eq!(turns, 2);
        }
    }
}
