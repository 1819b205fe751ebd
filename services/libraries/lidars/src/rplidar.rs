//! RPLIDAR A1, A2, A3, S1, S2, S3, C1: identified, spun up, started in the scan mode that its manufacturer recommends.

use crate::assembly::{Assembly, Beam};
use crate::byte_frames::{ByteFrames, Look};
use crate::rplidar_requests::{Answer, Field, Request, look, read};
use crate::rplidar_samples::{Form, Sample};
use crate::{Act, Counts, Device, Driver, Turn};
use std::cell::Cell;

/// Ranges below are no returns, metres.
const RANGE_MIN_M: f32 = 0.05;
/// What the A1 and the A2 see, metres; later models say it.
const RANGE_MAX_M: f32 = 12.0;
/// An answer that has not come after this is not waited for.
const ANSWER_NS: i64 = 300_000_000;
/// What a lidar that was measuring still sends after the request to stop.
const STOP_NS: i64 = 50_000_000;
/// A lidar that has not identified itself is queried again after this.
const AGAIN_NS: i64 = 1_000_000_000;
/// Models that triangulate have no configuration before this version of their firmware.
const CONFIGURATION_SINCE: (u8, u8) = (1, 24);
/// Nor the express form before this one.
const EXPRESS_SINCE: (u8, u8) = (1, 17);
/// A capsule that spans so many times what the last one did, is followed by a gap.
const GAP: f64 = 1.6;

/// Requests to the lidar, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Step {
    Begin,
    Stopping,
    Info,
    Health,
    SampleTimes,
    TypicalMode,
    AnswerType,
    ModeSampleTime,
    RangeMax,
    Motor,
    Running,
}

/// A decoder of this family.
pub(crate) struct Rplidar {
    frames: ByteFrames,
    assembly: Assembly,
    /// The format of measurements, once the lidar has reported it.
    form: Option<Form>,
    /// The packet before was good, and nothing was between it and the next one.
    in_step: Cell<bool>,
    /// The capsule whose measurements end where the next one begins, and when it came.
    waiting: (Vec<u8>, i64),
    /// The packet that is read.
    packet: Vec<u8>,
    /// Degrees of the last whole capsule.
    last_span_deg: f64,
    /// Something of this turn is missing: the number of its measurements is no measure of time.
    torn: bool,
    /// Microseconds of a measurement, where the lidar reports it.
    sample_us: Option<f64>,
    mode: u16,
    answer_type: u8,
    /// Model number and firmware, once the lidar has reported them.
    identity: Option<(u8, (u8, u8))>,
    step: Step,
    next_ns: i64,
    outbox: Vec<Act>,
    byte_ns: i64,
    device: Device,
    counts: Counts,
}

impl Rplidar {
    /// A byte takes `byte_ns` on the line.
    pub fn new(byte_ns: i64) -> Self {
        Self {
            frames: ByteFrames::default(),
            assembly: Assembly::new(RANGE_MIN_M, RANGE_MAX_M, false),
            form: None,
            in_step: Cell::new(false),
            waiting: (Vec::new(), 0),
            packet: Vec::new(),
            last_span_deg: 0.0,
            torn: false,
            sample_us: None,
            mode: 0,
            answer_type: 0x81,
            identity: None,
            step: Step::Begin,
            next_ns: i64::MIN,
            outbox: Vec::new(),
            byte_ns,
            device: Device::default(),
            counts: Counts::default(),
        }
    }

    fn ask(&mut self, step: Step, request: Request, now_ns: i64, wait_ns: i64) {
        self.outbox.push(Act::Send(request.bytes()));
        (self.step, self.next_ns) = (step, now_ns + wait_ns);
    }

    fn has_configuration(&self) -> bool {
        self.identity.is_some_and(|(model, firmware)| model >> 4 > 3 || firmware >= CONFIGURATION_SINCE)
    }

    /// The next step of the start.
    fn go_on(&mut self, now_ns: i64) {
        let mode = self.mode;
        let configuration = |field| Request::Configuration(field, mode);
        match self.step {
            Step::Begin => {
                self.form = None;
                self.ask(Step::Stopping, Request::Stop, now_ns, STOP_NS);
                // Of an A1 this line switches the motor: off means that it turns.
                self.outbox.push(Act::SetDtr(false));
            }
            Step::Stopping => self.ask(Step::Info, Request::Info, now_ns, ANSWER_NS),
            Step::Info if self.identity.is_none() => {
                (self.step, self.next_ns) = (Step::Begin, now_ns + AGAIN_NS);
            }
            Step::Info => self.ask(Step::Health, Request::Health, now_ns, ANSWER_NS),
            Step::Health if self.has_configuration() => {
                self.ask(Step::TypicalMode, configuration(Field::TypicalMode), now_ns, ANSWER_NS);
            }
            Step::Health => self.ask(Step::SampleTimes, Request::SampleTime, now_ns, ANSWER_NS),
            Step::TypicalMode => {
                self.ask(Step::AnswerType, configuration(Field::AnswerType), now_ns, ANSWER_NS);
            }
            Step::AnswerType => {
                self.ask(Step::ModeSampleTime, configuration(Field::SampleTime), now_ns, ANSWER_NS);
            }
            Step::ModeSampleTime => {
                self.ask(Step::RangeMax, configuration(Field::RangeMax), now_ns, ANSWER_NS);
            }
            Step::RangeMax | Step::SampleTimes => {
                let lidar_drives = self.identity.is_some_and(|(model, _)| model >> 4 > 3);
                let motor = if lidar_drives { Request::Speed } else { Request::Pulses };
                self.ask(Step::Motor, motor, now_ns, 0);
            }
            Step::Motor => {
                let start = match self.answer_type {
                    0x81 => Request::Scan,
                    _ => Request::Express(self.mode as u8),
                };
                self.ask(Step::Running, start, now_ns, 0);
            }
            Step::Running => {}
        }
    }

    fn take_answer(&mut self, answer: Answer) {
        match answer {
            Answer::Info { model, firmware } => self.identity = Some((model, firmware)),
            Answer::Health => {}
            Answer::SampleTimes(standard, express) => {
                let has_express = self.identity.is_some_and(|(_, firmware)| firmware >= EXPRESS_SINCE);
                self.answer_type = if has_express { 0x82 } else { 0x81 };
                self.sample_us = Some(if has_express { express } else { standard });
            }
            Answer::Configuration(field, value) => match field {
                0x7C => self.mode = value as u16,
                0x75 => self.answer_type = value as u8,
                0x71 => self.sample_us = Some(f64::from(value) / 256.0),
                0x74 => self.assembly.set_range_max((value as f32 / 256.0).clamp(1.0, 200.0)),
                _ => {}
            },
            Answer::Measurements(form) => {
                self.form = Some(form);
                self.in_step.set(true);
                self.waiting.0.clear();
                self.assembly.set_intensities(form.has_quality());
            }
        }
        // Nothing more is waited for, but for the answer to the start.
        self.next_ns = i64::MIN;
    }

    fn take_packet(
        &mut self,
        form: Form,
        packet: &mut Vec<u8>,
        arrival_ns: i64,
        give: &mut dyn FnMut(&Turn),
    ) {
        if matches!(form, Form::Standard | Form::HighQuality) {
            self.take_samples(form, packet, &[], arrival_ns, give);
            return;
        }
        std::mem::swap(packet, &mut self.waiting.0);
        let came_ns = std::mem::replace(&mut self.waiting.1, arrival_ns);
        let next = std::mem::take(&mut self.waiting.0);
        if !packet.is_empty() && !form.is_first(&next) {
            let span_deg = form.span_deg(packet, &next);
            if self.last_span_deg > 0.0 && span_deg > GAP * self.last_span_deg {
                self.counts.missing_packets += ((span_deg / self.last_span_deg).round() as u64 - 1).max(1);
                self.torn = true;
                // After a gap the rotation may be another one.
                self.last_span_deg = 0.0;
            } else {
                self.last_span_deg = span_deg;
                self.take_samples(form, packet, &next, came_ns, give);
            }
        }
        self.waiting.0 = next;
    }

    fn take_samples(
        &mut self,
        form: Form,
        packet: &[u8],
        next: &[u8],
        came_ns: i64,
        give: &mut dyn FnMut(&Turn),
    ) {
        let Self { assembly, counts, torn, sample_us, .. } = self;
        assembly.begin_packet(came_ns, counts);
        form.read(packet, next, &mut |sample: Sample| {
            if assembly.is_around(sample.head_deg) {
                let whole = !std::mem::take(torn);
                let speed_hz =
                    sample_us.filter(|_| whole).and_then(|us| assembly.speed_by_samples_hz(us * 1e-6));
                assembly.cut(speed_hz, counts, give);
            }
            assembly.push(Beam {
                head_deg: sample.head_deg,
                direction_deg: sample.direction_deg,
                range_m: (sample.range_mm / 1000.0) as f32,
                intensity: f32::from(sample.quality),
            });
        });
        assembly.end_packet(came_ns - self.byte_ns * packet.len() as i64);
    }
}

impl Driver for Rplidar {
    fn act(&mut self, now_ns: i64) -> Option<Act> {
        if self.outbox.is_empty() && self.step != Step::Running && now_ns >= self.next_ns {
            self.go_on(now_ns);
        }
        self.outbox.pop()
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: i64, give: &mut dyn FnMut(&Turn)) {
        self.frames.push(bytes, &mut self.counts);
        loop {
            let Some(form) = self.form else {
                let Some(answer) = self.frames.next(&mut self.counts, look) else { return };
                let answer = read(answer, &mut self.device);
                self.take_answer(answer);
                continue;
            };
            let (in_step, garbage) = (&self.in_step, self.counts.garbage_bytes);
            let found = self.frames.next(&mut self.counts, |bytes| {
                let seen = form.look(bytes, in_step.get());
                let good = matches!(seen, Look::Packet(_)) || (matches!(seen, Look::More) && in_step.get());
                in_step.set(good);
                seen
            });
            let Some(found) = found else { return };
            let mut packet = std::mem::take(&mut self.packet);
            packet.clear();
            packet.extend_from_slice(found);
            if self.counts.garbage_bytes != garbage {
                self.counts.missing_packets += u64::from(form != Form::Standard);
                self.torn = true;
                self.waiting.0.clear();
            }
            self.take_packet(form, &mut packet, arrival_ns, give);
            self.packet = packet;
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
    use crate::encoders::rplidar_encoder::RplidarEncoder;
    use proptest::prelude::*;

    const FORMS: [u8; 6] = [0x81, 0x82, 0x83, 0x84, 0x85, 0x86];

    /// A driver that a lidar has answered until it measures.
    fn started(encoder: &RplidarEncoder) -> Rplidar {
        let mut driver = Rplidar::new(0);
        let mut now_ns = 0;
        while driver.form.is_none() && now_ns < 60_000_000_000 {
            while let Some(act) = driver.act(now_ns) {
                if let Act::Send(request) = act {
                    driver.take(&encoder.answer(&request), now_ns, &mut |_| ());
                }
            }
            now_ns += 10_000_000;
        }
        driver
    }

    fn decode(driver: &mut Rplidar, packets: &[Vec<u8>]) -> Vec<Turn> {
        let mut turns = Vec::new();
        for (at, packet) in packets.iter().enumerate() {
            driver.take(packet, 60_000_000_000 + at as i64 * 1_000_000, &mut |turn| turns.push(turn.clone()));
        }
        turns
    }

    #[test]
    fn a_lidar_reports_its_model_and_scans_in_its_recommended_mode() {
        let encoder = RplidarEncoder::new(0x84, 10.0);
        let driver = started(&encoder);
        assert_eq!(driver.form, Some(Form::Extended));
        assert_eq!(driver.step, Step::Running);
        let described = driver.device().to_string();
        assert!(
            described.starts_with("RPLIDAR A3M1, firmware 1.29, serial number ")
                && described.ends_with("health good"),
            "{described}"
        );
        assert!((driver.sample_us.unwrap() - encoder.sample_us()).abs() < 0.01);
        // Its firmware from before there was a configuration: the express form, and from before that one: the standard form.
        for (firmware, form) in [((1, 20), Form::Express), ((1, 16), Form::Standard)] {
            let answer_type = if form == Form::Express { 0x82 } else { 0x81 };
            let driver = started(&RplidarEncoder::new(answer_type, 10.0).with_firmware(0x18, firmware));
            assert_eq!(driver.form, Some(form));
        }
    }

    #[test]
    fn each_form_gives_the_walls_that_were_sent() {
        let wall = |angle_rad: f64| 2.0 + angle_rad.cos();
        for answer_type in FORMS {
            let mut encoder = RplidarEncoder::new(answer_type, 8.0);
            let mut driver = started(&encoder);
            let packets: Vec<_> = (0..4).flat_map(|_| encoder.turn(&wall)).collect();
            let turns = decode(&mut driver, &packets);
            let counts = driver.counts();
            assert!(turns.len() >= 2, "{answer_type:#x}: {counts:?}");
            assert_eq!((counts.garbage_bytes, counts.missing_packets), (0, 0), "{answer_type:#x}");
            let turn = &turns[1];
            assert!((turn.speed_hz - 8.0).abs() < 0.1, "{answer_type:#x}: {}", turn.speed_hz);
            assert!(turn.len() > 200);
            for beam in 0..turn.len() {
                let found_m = f64::from(turn.ranges_m[beam]);
                let right_m = wall(f64::from(turn.angles_rad[beam]));
                assert!((found_m - right_m).abs() < 0.03, "{answer_type:#x} {beam}: {found_m} {right_m}");
            }
            assert_eq!(turn.intensities.is_empty(), matches!(answer_type, 0x82 | 0x84 | 0x85));
        }
    }

    #[test]
    fn a_lost_and_a_damaged_packet_are_counted_and_what_follows_is_read() {
        for answer_type in FORMS {
            let mut encoder = RplidarEncoder::new(answer_type, 8.0);
            let mut driver = started(&encoder);
            let mut packets: Vec<_> = (0..6).flat_map(|_| encoder.turn(&|_| 3.0)).collect();
            let (lost, damaged) = (packets.len() / 4, packets.len() / 2);
            packets.remove(lost);
            packets[damaged][1] ^= 0xFF;
            let turns = decode(&mut driver, &packets);
            assert!(turns.len() >= 4, "{answer_type:#x}: {} {:?}", turns.len(), driver.counts());
            let found =
                turns.iter().flat_map(|turn| &turn.ranges_m).filter(|range| (**range - 3.0).abs() < 0.02);
            let all: usize = turns.iter().map(Turn::len).sum();
            assert!(found.count() >= all - 4, "{answer_type:#x}");
        }
    }

    proptest! {
        #[test]
        fn every_packet_behind_garbage_is_found(
            form in 0..FORMS.len(), garbage in prop::collection::vec(any::<u8>(), 0..500), cut in 1usize..97,
        ) {
            let mut encoder = RplidarEncoder::new(FORMS[form], 8.0);
            let mut driver = started(&encoder);
            let before = driver.counts().packets;
            let good: Vec<_> = (0..3).flat_map(|_| encoder.turn(&|_| 3.0)).collect();
            for bytes in [&garbage[..], &good.concat()[..]].concat().chunks(cut) {
                driver.take(bytes, 0, &mut |_| ());
            }
            // The last measurement of the standard form waits for one more.
            prop_assert!((driver.counts().packets - before) as usize + 1 >= good.len());
        }
    }
}
