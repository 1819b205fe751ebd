//! Hokuyo URG and UST: SCIP 2.0, lines of characters that carry six bits each.
//!
//! Source: Hokuyo, *Communication Protocol Specification for SCIP2.0* (C-42-03320): encoding, sums, MD, ME, VV, PP, II.

use crate::byte_frames::{ByteFrames, Look};
use crate::{Act, Counts, Device, Driver, Health, Turn};
use std::f64::consts::TAU;

/// Characters of a value.
const VALUE_LENGTH: usize = 3;
/// Values below are codes of errors, millimetres.
const MM_MIN: u32 = 20;
/// An answer that has not come after this is not waited for.
const ANSWER_NS: i64 = 500_000_000;
/// Answers that begin a block.
const COMMANDS: [&[u8; 2]; 9] = [b"MD", b"ME", b"MS", b"VV", b"PP", b"II", b"QT", b"BM", b"SC"];
/// No block is longer.
const BLOCK_MAX: usize = 16 * 1024;

/// The sum behind these characters.
pub(crate) fn sum(characters: &[u8]) -> u8 {
    (characters.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)) & 0x3F) + 0x30
}

/// The number that these characters carry, six bits each.
pub(crate) fn decode(characters: &[u8]) -> u32 {
    characters.iter().fold(0, |value, byte| value << 6 | u32::from(byte.wrapping_sub(0x30) & 0x3F))
}

/// Parameters of a sensor, as it reports them. Steps are counted against the clock as seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Geometry {
    /// Steps of a whole turn.
    steps: u32,
    /// First and last step that it measures, and the one straight ahead.
    first: u32,
    last: u32,
    ahead: u32,
    /// Turns a minute.
    rpm: f64,
    range_min_m: f32,
    range_max_m: f32,
}

/// Requests to the sensor, in order.
#[derive(Clone, Copy, PartialEq)]
enum Step {
    Begin,
    Protocol,
    Stopping,
    Version,
    Parameters,
    State,
    Laser,
    Running,
}

/// A decoder of this family.
pub(crate) struct Urg {
    frames: ByteFrames,
    turn: Turn,
    geometry: Option<Geometry>,
    values: Vec<u8>,
    step: Step,
    next_ns: i64,
    outbox: Vec<Act>,
    byte_ns: i64,
    device: Device,
    counts: Counts,
    last_stamp_ms: Option<u32>,
}

impl Urg {
    /// A byte takes `byte_ns` on the line.
    pub fn new(byte_ns: i64) -> Self {
        Self {
            frames: ByteFrames::default(),
            turn: Turn::default(),
            geometry: None,
            values: Vec::new(),
            step: Step::Begin,
            next_ns: i64::MIN,
            outbox: Vec::new(),
            byte_ns,
            device: Device::default(),
            counts: Counts::default(),
            last_stamp_ms: None,
        }
    }

    fn ask(&mut self, step: Step, request: &str, now_ns: i64, wait_ns: i64) {
        self.outbox.push(Act::Send(format!("{request}\n").into_bytes()));
        (self.step, self.next_ns) = (step, now_ns + wait_ns);
    }

    /// Takes a block of lines that has been checked.
    fn take_block(&mut self, block: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let mut lines = block.split(|byte| *byte == b'\n');
        let (Some(echo), Some(status)) = (lines.next(), lines.next()) else { return };
        let expected = match self.step {
            Step::Version => &b"VV"[..],
            Step::Parameters => b"PP",
            Step::State => b"II",
            Step::Laser => b"BM",
            Step::Protocol => b"SC",
            Step::Stopping => b"QT",
            Step::Begin | Step::Running => b"--",
        };
        if echo.starts_with(expected) {
            self.next_ns = i64::MIN;
        }
        if echo.starts_with(b"MD") || echo.starts_with(b"ME") {
            if status.starts_with(b"99") {
                self.take_measurements(echo, lines, arrival_ns - self.byte_ns * block.len() as i64, give);
            }
            return;
        }
        let fields: Vec<(&str, &str)> = lines
            .filter_map(|line| {
                std::str::from_utf8(line.get(..line.len().checked_sub(2)?)?).ok()?.split_once(':')
            })
            .collect();
        let field =
            |name: &str| fields.iter().find(|(found, _)| *found == name).map(|(_, value)| value.trim());
        let owned = |name: &str| field(name).map(str::to_owned);
        match &echo[..2] {
            b"VV" => {
                self.device.model = owned("PROD").or(self.device.model.take());
                self.device.firmware = owned("FIRM");
                self.device.serial_number = owned("SERI");
            }
            b"PP" => {
                self.device.model = owned("MODL").or(self.device.model.take());
                let number = |name: &str| field(name)?.parse::<u32>().ok().filter(|number| *number < 1 << 20);
                let read = || {
                    let (steps, first, last) = (number("ARES")?, number("AMIN")?, number("AMAX")?);
                    Some(Geometry {
                        steps: (steps > 0 && first < last).then_some(steps)?,
                        first,
                        last,
                        ahead: number("AFRT")?,
                        rpm: f64::from(number("SCAN").filter(|rpm| *rpm > 0)?),
                        range_min_m: number("DMIN")?.max(MM_MIN) as f32 / 1000.0,
                        range_max_m: number("DMAX")? as f32 / 1000.0,
                    })
                };
                self.geometry = read().or(self.geometry);
            }
            b"II" => {
                let good = |state: &str| state.contains("working normally") || state.contains("Stable");
                let state =
                    field("STAT").map(|state| if good(state) { Health::Good } else { Health::Warning(0) });
                self.device.health = state.or(self.device.health);
            }
            _ => {}
        }
    }

    fn take_measurements<'b>(
        &mut self,
        echo: &[u8],
        mut lines: impl Iterator<Item = &'b [u8]>,
        measured_ns: i64,
        give: &mut dyn FnMut(&Turn),
    ) {
        let number =
            |range: std::ops::Range<usize>| std::str::from_utf8(echo.get(range)?).ok()?.parse::<u32>().ok();
        let (Some(geometry), Some(first), Some(last), Some(cluster)) =
            (self.geometry, number(2..6), number(6..10), number(10..12))
        else {
            return;
        };
        let Some(stamp) = lines.next().filter(|line| line.len() > 1) else { return };
        let stamp_ms = decode(&stamp[..stamp.len() - 1]);
        self.values.clear();
        for line in lines.filter(|line| line.len() > 1) {
            self.values.extend_from_slice(&line[..line.len() - 1]);
        }
        let with_intensities = echo.starts_with(b"ME");
        let length = if with_intensities { 2 * VALUE_LENGTH } else { VALUE_LENGTH };
        let cluster = cluster.max(1);
        let wanted = (last.saturating_sub(first) / cluster + 1) as usize;
        if self.values.len() != wanted * length {
            self.counts.partial_turns += 1;
            return;
        }
        self.note_gap(stamp_ms, geometry);
        let turn = &mut self.turn;
        turn.clear();
        let s_per_step = 60.0 / geometry.rpm / f64::from(geometry.steps);
        for (index, value) in self.values.chunks_exact(length).enumerate() {
            let step = f64::from(first) + (index as u32 * cluster) as f64 + f64::from(cluster - 1) / 2.0;
            let range_mm = decode(&value[..VALUE_LENGTH]);
            turn.ranges_m.push(if range_mm < MM_MIN { 0.0 } else { range_mm as f32 / 1000.0 });
            let ahead_steps = step - f64::from(geometry.ahead);
            turn.angles_rad.push((ahead_steps * TAU / f64::from(geometry.steps)) as f32);
            turn.times_s.push(((step - f64::from(first)) * s_per_step) as f32);
            if with_intensities {
                turn.intensities.push(decode(&value[VALUE_LENGTH..]) as f32);
            }
        }
        turn.speed_hz = geometry.rpm / 60.0;
        let sweep_s = f64::from(turn.times_s.last().copied().unwrap_or(0.0));
        turn.begun_ns = measured_ns - (sweep_s * 1e9) as i64;
        (turn.range_min_m, turn.range_max_m) = (geometry.range_min_m, geometry.range_max_m);
        self.counts.turns += 1;
        give(turn);
    }

    /// Counts turns that have not come, by the clock of the sensor.
    fn note_gap(&mut self, stamp_ms: u32, geometry: Geometry) {
        let turn_ms = 60_000.0 / geometry.rpm;
        if let Some(last) = self.last_stamp_ms.replace(stamp_ms) {
            let passed_ms = f64::from(stamp_ms.wrapping_sub(last) & 0xFF_FFFF);
            let missing = (passed_ms / turn_ms).round() - 1.0;
            // More is a clock that was set anew.
            if (1.0..1000.0).contains(&missing) {
                self.counts.missing_packets += missing as u64;
            }
        }
    }
}

/// Whether each line of a block has its sum.
fn is_whole(block: &[u8]) -> bool {
    let mut lines = block.split(|byte| *byte == b'\n');
    let echo = lines.next().unwrap_or_default();
    if echo.starts_with(b"SC") {
        return true;
    }
    let is_of_words = echo.starts_with(b"VV") || echo.starts_with(b"PP") || echo.starts_with(b"II");
    let status = lines.next().unwrap_or_default();
    let has_sum = |line: &[u8]| line.len() > 1 && sum(&line[..line.len() - 1]) == line[line.len() - 1];
    // Lines of words have a semicolon before the sum, which is not part of it.
    let has_sum_behind_semicolon = |line: &[u8]| match line {
        [words @ .., b';', last] => sum(words) == *last,
        _ => false,
    };
    status.len() == 3
        && has_sum(status)
        && lines.all(|line| if is_of_words { has_sum_behind_semicolon(line) } else { has_sum(line) })
}

fn look(bytes: &[u8]) -> Look {
    let begins =
        |command: &&&[u8; 2]| bytes[0] == command[0] && bytes.get(1).is_none_or(|byte| *byte == command[1]);
    if !COMMANDS.iter().any(|command| begins(&command)) {
        return Look::No;
    }
    let end = bytes.windows(2).take(BLOCK_MAX).position(|pair| pair == b"\n\n");
    match end {
        Some(end) if is_whole(&bytes[..end]) => Look::Packet(end + 2),
        // Another start marker within it may be the true one.
        Some(_) => Look::Bad,
        None if bytes.len() < BLOCK_MAX => Look::More,
        None => Look::No,
    }
}

impl Driver for Urg {
    fn act(&mut self, now_ns: i64) -> Option<Act> {
        if self.outbox.is_empty() && now_ns >= self.next_ns {
            match self.step {
                Step::Begin => self.ask(Step::Protocol, "SCIP2.0", now_ns, ANSWER_NS),
                Step::Protocol => self.ask(Step::Stopping, "QT", now_ns, ANSWER_NS),
                Step::Stopping => self.ask(Step::Version, "VV", now_ns, ANSWER_NS),
                Step::Version => self.ask(Step::Parameters, "PP", now_ns, ANSWER_NS),
                Step::Parameters if self.geometry.is_none() => self.step = Step::Begin,
                Step::Parameters => self.ask(Step::State, "II", now_ns, ANSWER_NS),
                Step::State => self.ask(Step::Laser, "BM", now_ns, ANSWER_NS),
                Step::Laser => {
                    if let Some(Geometry { first, last, .. }) = self.geometry {
                        // Every step, every turn, for ever.
                        let request = format!("MD{first:04}{last:04}01000");
                        self.ask(Step::Running, &request, now_ns, 0);
                    }
                }
                Step::Running => {}
            }
        }
        self.outbox.pop()
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        let mut frames = std::mem::take(&mut self.frames);
        frames.push(bytes, &mut self.counts);
        while let Some(block) = frames.next(&mut self.counts, look) {
            self.take_block(&block[..block.len() - 2], arrival_ns, give);
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
    use crate::encoders::urg_encoder::{UrgEncoder, characters};
    use proptest::prelude::*;

    /// A driver that a sensor has answered until it measures.
    fn started(encoder: &UrgEncoder) -> Urg {
        let mut driver = Urg::new(0);
        let mut now_ns = 0;
        while driver.step != Step::Running && now_ns < 60_000_000_000 {
            while let Some(act) = driver.act(now_ns) {
                if let Act::Send(request) = act {
                    driver.take(&encoder.answer(&request), now_ns, &mut |_| ());
                }
            }
            now_ns += 10_000_000;
        }
        driver
    }

    #[test]
    fn values_are_coded_as_in_the_examples_of_the_specification() {
        // Two, three and four characters: 1234, 5432 and 16000000.
        for (value, text) in [(1234, &b"CB"[..]), (5432, b"1Dh"), (16_000_000, b"m2@0")] {
            assert_eq!((decode(text), characters(value, text.len())), (value, text.to_vec()));
        }
        assert_eq!((sum(b"00"), sum(b"99")), (b'P', b'b'));
    }

    #[test]
    fn the_identification_of_a_real_sensor_is_parsed() {
        // An URG-04LX-UG01, from the notes of a public Matlab program.
        let identification =
            b"VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\n\
            FIRM:3.4.03(17/Dec./2012);T\nPROT:SCIP 2.0;N\nSERI:H1510998;V\n\n";
        let mut driver = Urg::new(0);
        driver.take(identification, 0, &mut |_| ());
        assert_eq!((driver.counts.packets, driver.counts.garbage_bytes), (1, 0));
        let device = driver.device();
        assert_eq!(device.model.as_deref(), Some("SOKUIKI Sensor URG-04LX-UG01(Simple-URG)"));
        assert_eq!(device.firmware.as_deref(), Some("3.4.03(17/Dec./2012)"));
        assert_eq!(device.serial_number.as_deref(), Some("H1510998"));
    }

    #[test]
    fn measurements_of_a_real_sensor_are_read() {
        // Of an URG-04LX, from the test of a public driver (class LSData): step 384, and steps 370 to 450. The stamp of the second
        // has lost a character there; it has that of the first.
        let block = b"MD0384038400001\n00P\n\nMD0384038400000\n99b\nH:6mU\n03nA\n\n\
            MD0370045000001\n00P\n\nMD0370045000000\n99b\nH:6mU\n\
            03T03T03T03Z03Z03\\03\\03\\03[03[03[03\\03\\03\\03\\03\\03_03a03a03e03e0K\n\
            3d03c03c03_03Z03W03Z03Z03Z03]03]03]03c03c03f03f03h03h03m03h03h03@\n\
            h03h03h03h03i03i03h03k03k03k03k03m03o03o04004003o04104003o040041f\n\
            04204404604604204204004003o03o03m03k03k03k03h03h03gd\n\n";
        let mut driver = Urg::new(0);
        driver.geometry = Some(Geometry {
            steps: 1024,
            first: 44,
            last: 725,
            ahead: 384,
            rpm: 600.0,
            range_min_m: 0.02,
            range_max_m: 5.6,
        });
        let mut turns = Vec::new();
        driver.take(block, 0, &mut |turn| turns.push(turn.clone()));
        assert_eq!((turns.len(), driver.counts.bad_checksums), (2, 0));
        assert_eq!((&turns[0].ranges_m[..], &turns[0].angles_rad[..]), (&[0.254][..], &[0.0][..]));
        let turn = &turns[1];
        assert_eq!(turn.len(), 81);
        // "03T" is 3 · 64 + 36.
        assert_eq!((turn.ranges_m[0], turn.ranges_m[80]), (0.228, 0.247));
        assert!((f64::from(turn.angles_rad[14])).abs() < 1e-9, "step 384 is ahead");
        assert!(turn.angles_rad[0] < 0.0 && turn.angles_rad[80] > 0.0);
    }

    #[test]
    fn a_sensor_is_started_and_its_turns_are_the_walls_that_were_sent() {
        let mut encoder = UrgEncoder::new();
        let mut driver = started(&encoder);
        assert_eq!(driver.device().health, Some(Health::Good));
        let wall = |angle_rad: f64| 2.0 + angle_rad.cos();
        let mut turns = Vec::new();
        for lost in [false, false, true, false] {
            let bytes = encoder.turn(&wall).concat();
            if !lost {
                driver.take(&bytes, 0, &mut |turn| turns.push(turn.clone()));
            }
        }
        assert_eq!((turns.len(), driver.counts.missing_packets), (3, 1));
        for (range_m, angle_rad) in turns[1].ranges_m.iter().zip(&turns[1].angles_rad) {
            assert!((f64::from(*range_m) - wall(f64::from(*angle_rad))).abs() < 0.002);
        }
        assert_eq!((turns[1].len(), turns[1].speed_hz), (1081, 40.0));
    }

    proptest! {
        #[test]
        fn every_block_behind_garbage_is_found(garbage in prop::collection::vec(any::<u8>(), 0..500), cut in 1usize..997) {
            let mut encoder = UrgEncoder::new();
            let mut driver = started(&encoder);
            let before = driver.counts.packets;
            let good: Vec<u8> = (0..2).flat_map(|_| encoder.turn(&|_| 3.0)).flatten().collect();
            for bytes in [&garbage[..], &good[..]].concat().chunks(cut) {
                driver.take(bytes, 0, &mut |_| ());
            }
            prop_assert!(driver.counts.packets - before >= 2);
        }
    }
}
