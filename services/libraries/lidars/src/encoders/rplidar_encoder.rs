//! Measurements and answers of an RPLIDAR.

use super::{World, counter_clockwise_rad};
use crate::rplidar_requests::{DESCRIPTOR, REPEATED};
use crate::rplidar_samples::{FIRST_CAPSULE, Form, HQ_MARK, Sample, hq_checksum, xor};

/// A lidar that turns and answers.
pub struct RplidarEncoder {
    form: Form,
    answer_type: u8,
    speed_hz: f64,
    model: u8,
    firmware: (u8, u8),
    /// Measurements since the start.
    at: u64,
    /// No capsule has been sent.
    is_first: bool,
}

impl RplidarEncoder {
    /// Measures in the form of this answer type, 0x81 to 0x86, and turns so often a second.
    ///
    /// # Panics
    /// When there is no such answer type.
    pub fn new(answer_type: u8, speed_hz: f64) -> Self {
        let form = Form::of_answer(answer_type).expect("an answer type from 0x81 to 0x86");
        Self { form, answer_type, speed_hz, model: 0x31, firmware: (1, 29), at: 0, is_first: true }
    }

    /// Is of another model, with another firmware.
    #[must_use]
    pub fn with_firmware(self, model: u8, firmware: (u8, u8)) -> Self {
        Self { model, firmware, ..self }
    }

    /// Microseconds of a measurement.
    pub fn sample_us(&self) -> f64 {
        if self.form == Form::Standard { 500.0 } else { 125.0 }
    }

    /// What the lidar answers to a request.
    pub fn answer(&self, request: &[u8]) -> Vec<u8> {
        let single = |kind: u8, content: &[u8]| {
            let length = (content.len() as u32).to_le_bytes();
            [&DESCRIPTOR[..], &length, &[kind], content].concat()
        };
        let [_, command, content @ ..] = request else { return Vec::new() };
        match command {
            0x20 | 0x82 => {
                let length = (self.form.length() as u32 | REPEATED).to_le_bytes();
                [&DESCRIPTOR[..], &length, &[self.answer_type]].concat()
            }
            0x50 => {
                let head = [self.model, self.firmware.1, self.firmware.0, 5];
                single(4, &[&head[..], &[0x1A; 16]].concat())
            }
            0x52 => single(6, &[0, 0, 0]),
            0x59 => single(0x15, &[self.sample_us() as u16; 2].map(u16::to_le_bytes).concat()),
            0x84 if content.len() > 4 => {
                let value: u32 = match content[1] {
                    0x71 => (self.sample_us() * 256.0) as u32,
                    0x74 => 16 * 256,
                    0x75 => u32::from(self.answer_type),
                    _ => 2,
                };
                single(0x20, &[&content[1..5], &value.to_le_bytes()].concat())
            }
            _ => Vec::new(),
        }
    }

    /// The packets of about one turn: whole packets.
    pub fn turn(&mut self, world: World) -> Vec<Vec<u8>> {
        let samples = 1e6 / self.sample_us() / self.speed_hz;
        let packets = (samples / self.form.samples() as f64).round() as usize;
        (0..packets).map(|_| self.packet(world)).collect()
    }

    fn head_deg(&self, index: usize) -> f64 {
        let turns = (self.at + index as u64) as f64 * self.sample_us() * 1e-6 * self.speed_hz;
        (turns % 1.0) * 360.0
    }

    /// Start angle of a capsule: sixty-fourths of a degree.
    fn start(&self, index: usize) -> u16 {
        (self.head_deg(index) * 64.0) as u16
    }

    fn packet(&mut self, world: World) -> Vec<u8> {
        let number = self.form.samples();
        // What a reader will take for the directions: from the angles as they are sent.
        let start_deg = f64::from(self.start(0)) / 64.0;
        let span_deg = (f64::from(self.start(number)) / 64.0 - start_deg).rem_euclid(360.0);
        let head_deg = |index: usize| match self.form {
            Form::Standard | Form::HighQuality => self.head_deg(index),
            _ => start_deg + index as f64 * span_deg / number as f64,
        };
        let range_mm = |deg: f64| world(counter_clockwise_rad(deg)) * 1000.0;
        let samples: Vec<Sample> = (0..=number)
            .map(|index| {
                let head_deg = head_deg(index);
                Sample { head_deg, direction_deg: head_deg, range_mm: range_mm(head_deg), quality: 47 }
            })
            .collect();
        let first = self.is_first;
        let capsule = |content: Vec<u8>| {
            let start = self.start(0) | if first { FIRST_CAPSULE } else { 0 };
            let stamp = if self.form == Form::UltraDense { &[0; 6][..] } else { &[] };
            let checked = [stamp, &start.to_le_bytes(), &content].concat();
            let sum = xor(&checked);
            [&[0xA0 | sum & 0xF, 0x50 | sum >> 4][..], &checked].concat()
        };
        let packet = match self.form {
            Form::Standard => node(&samples[0], self.at, self.speed_hz * self.sample_us() * 1e-6),
            Form::HighQuality => high_quality(&samples[..number]),
            Form::Express => capsule(samples[..number].chunks(2).flat_map(express_cabin).collect()),
            Form::Dense => {
                let distances = samples[..number].iter().map(|sample| sample.range_mm.round() as u16);
                capsule(distances.flat_map(u16::to_le_bytes).collect())
            }
            Form::UltraDense => capsule(samples[..number].chunks(2).flat_map(ultra_dense_cabin).collect()),
            Form::Extended => {
                let cabins =
                    (0..32).map(|cabin| extended_cabin(&samples[3 * cabin..3 * cabin + 4], &range_mm));
                capsule(cabins.flat_map(u32::to_le_bytes).collect())
            }
        };
        self.at += number as u64;
        self.is_first = false;
        packet
    }
}

fn node(sample: &Sample, at: u64, turns_per_sample: f64) -> Vec<u8> {
    let begins = (at as f64 * turns_per_sample) % 1.0 < turns_per_sample;
    let mark = if begins { 1 } else { 2 };
    let angle = ((sample.head_deg * 64.0) as u16) << 1 | 1;
    let range = (sample.range_mm * 4.0).round().clamp(0.0, 65_535.0) as u16;
    [&[sample.quality << 2 | mark][..], &angle.to_le_bytes(), &range.to_le_bytes()].concat()
}

fn high_quality(samples: &[Sample]) -> Vec<u8> {
    let mut packet = vec![HQ_MARK, 0, 0, 0, 0, 0, 0, 0, 0];
    for sample in samples {
        packet.extend(((sample.head_deg * 16_384.0 / 90.0) as u16).to_le_bytes());
        packet.extend(((sample.range_mm * 4.0) as u32).to_le_bytes());
        packet.extend([sample.quality << 2, 0]);
    }
    let sum = hq_checksum(&packet);
    packet.extend(sum.to_le_bytes());
    packet
}

/// Two measurements, uncorrected.
fn express_cabin(samples: &[Sample]) -> Vec<u8> {
    let word = |sample: &Sample| {
        ((sample.range_mm * 4.0).round().clamp(0.0, 65_535.0) as u16 & 0xFFFC).to_le_bytes()
    };
    [&word(&samples[0])[..], &word(&samples[1]), &[0]].concat()
}

/// Two measurements on the finest scale that reaches them.
fn ultra_dense_cabin(samples: &[Sample]) -> Vec<u8> {
    let word = |sample: &Sample| {
        let mm = sample.range_mm;
        let (scale, from_mm, factor) = match mm {
            mm if mm < 2046.0 => (0, 0.0, 2.0),
            mm if mm < 8187.0 => (1, 2046.0, 3.0),
            mm if mm < 24_567.0 => (2, 8187.0, 4.0),
            _ => (3, 24_567.0, 5.0),
        };
        let count = (((mm - from_mm) * 4.0 / factor) as u32) & !3;
        let quality = (u32::from(sample.quality) >> scale) << (12 + scale);
        quality | count | scale
    };
    let words = [word(&samples[0]), word(&samples[1])];
    let low = words.map(|word| (word as u16).to_le_bytes()).concat();
    [&low[..], &[(words[0] >> 16) as u8 | ((words[1] >> 16) as u8) << 4]].concat()
}

/// One distance on its growing scale, two as differences to it and to the next cabin's. Beams go behind the head by their range.
fn extended_cabin(samples: &[Sample], range_mm: &dyn Fn(f64) -> f64) -> u32 {
    let seen: Vec<f64> = samples.iter().map(|sample| seen_aside_mm(sample.head_deg, range_mm)).collect();
    let (major, base, bits) = scaled(seen[0]);
    let (_, next_base, next_bits) = scaled(seen[3]);
    let difference = |mm: f64, base: i32, bits: u32| {
        let difference = (mm.round() as i32 - base) >> bits;
        (difference.clamp(-511, 510) as u32) & 0x3FF
    };
    major | difference(seen[1], base, bits) << 12 | difference(seen[2], next_base, next_bits) << 22
}

/// What the beam finds that goes behind the head by what it finds.
fn seen_aside_mm(head_deg: f64, range_mm: &dyn Fn(f64) -> f64) -> f64 {
    let mut found_mm = range_mm(head_deg);
    for _ in 0..6 {
        found_mm = range_mm(head_deg - crate::rplidar_samples::extended_correction_deg(found_mm));
    }
    found_mm
}

/// A distance on the growing scale: what is sent, what it means in millimetres, bits left out.
fn scaled(mm: f64) -> (u32, i32, u32) {
    let mm = mm.round() as u32;
    let (from, from_mm, bits) = match mm {
        mm if mm >= 1 << 14 => (3328, 1 << 14, 4),
        mm if mm >= 1 << 12 => (1792, 1 << 12, 3),
        mm if mm >= 1 << 11 => (1280, 1 << 11, 2),
        mm if mm >= 1 << 9 => (512, 1 << 9, 1),
        _ => (0, 0, 0),
    };
    let sent = from + ((mm - from_mm) >> bits);
    (sent, (from_mm + ((sent - from) << bits)) as i32, bits)
}
