//! Requests to an RPLIDAR and its answers that are no measurements.
//!
//! Sources: Slamtec, *RPLIDAR Interface Protocol* LR001; `Slamtec/rplidar_sdk`, `sl_lidar_cmd.h` (commands, configuration, answers).

use crate::byte_frames::{Look, u16_at, u32_at};
use crate::rplidar_samples::{Form, xor};
use crate::{Device, Health};

const REQUEST: u8 = 0xA5;
pub(crate) const DESCRIPTOR: [u8; 2] = [0xA5, 0x5A];
pub(crate) const DESCRIPTOR_LENGTH: usize = 7;
/// The bit of a descriptor's length for a continuous response.
pub(crate) const REPEATED: u32 = 1 << 30;
/// Sent instead of a speed by pulses: about ten turns a second.
const PULSE_WIDTH: u16 = 660;
/// Turns a minute.
const SPEED_RPM: u16 = 600;
/// An answer about the configuration is not longer.
const CONFIGURATION_MAX: u32 = 64;

/// A request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Stop,
    Info,
    Health,
    /// Time of a measurement, in the standard and in the express form.
    SampleTime,
    /// A field of the configuration, of this way of measuring.
    Configuration(Field, u16),
    /// Measurements of the standard form.
    Scan,
    /// Measurements in this way.
    Express(u8),
    /// The speed of the motor where an adapter drives it.
    Pulses,
    /// The speed of the motor where the lidar drives it.
    Speed,
}

/// A field of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Field {
    /// Time of a measurement, microseconds with eight binary places.
    SampleTime = 0x71,
    /// The furthest range, metres with eight binary places.
    RangeMax = 0x74,
    /// The answer type of measurements.
    AnswerType = 0x75,
    /// The way of measuring that the maker proposes.
    TypicalMode = 0x7C,
}

impl Request {
    /// The bytes to send.
    pub fn bytes(self) -> Vec<u8> {
        let (command, content): (u8, Vec<u8>) = match self {
            Self::Stop => (0x25, vec![]),
            Self::Scan => (0x20, vec![]),
            Self::Info => (0x50, vec![]),
            Self::Health => (0x52, vec![]),
            Self::SampleTime => (0x59, vec![]),
            Self::Express(mode) => (0x82, vec![mode, 0, 0, 0, 0]),
            Self::Configuration(field @ Field::TypicalMode, _) => (0x84, (field as u32).to_le_bytes().into()),
            Self::Configuration(field, mode) => {
                (0x84, [&(field as u32).to_le_bytes()[..], &mode.to_le_bytes()].concat())
            }
            Self::Pulses => (0xF0, PULSE_WIDTH.to_le_bytes().into()),
            Self::Speed => (0xA8, SPEED_RPM.to_le_bytes().into()),
        };
        let mut bytes = vec![REQUEST, command];
        if !content.is_empty() {
            bytes.push(content.len() as u8);
            bytes.extend(content);
            bytes.push(xor(&bytes));
        }
        bytes
    }
}

/// An answer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Answer {
    /// Who the lidar is: number of its model, version of its firmware.
    Info { model: u8, firmware: (u8, u8) },
    /// How it is.
    Health,
    /// Microseconds of a measurement in the standard and in the express form.
    SampleTimes(f64, f64),
    /// The value of a field.
    Configuration(u32, u32),
    /// Measurements of this form follow.
    Measurements(Form),
}

/// Whether an answer begins here.
pub(crate) fn look(bytes: &[u8]) -> Look {
    if bytes[0] != DESCRIPTOR[0] || bytes.get(1).is_some_and(|byte| *byte != DESCRIPTOR[1]) {
        return Look::No;
    }
    let Some(descriptor) = bytes.get(..DESCRIPTOR_LENGTH) else { return Look::More };
    let (length, kind) = (u32_at(descriptor, 2), descriptor[6]);
    if length & REPEATED != 0 {
        let form = Form::of_answer(kind).filter(|form| (length ^ REPEATED) as usize == form.length());
        return if form.is_some() { Look::Packet(DESCRIPTOR_LENGTH) } else { Look::No };
    }
    let known = match kind {
        0x04 => length == 20,
        0x06 => length == 3,
        0x15 => length == 4,
        0x20 => (4..=CONFIGURATION_MAX).contains(&length),
        _ => false,
    };
    let whole = DESCRIPTOR_LENGTH + length as usize;
    match known {
        true if bytes.len() < whole => Look::More,
        true => Look::Packet(whole),
        false => Look::No,
    }
}

/// Reads an answer that [`look`] found, and stores its data about the device.
pub(crate) fn read(answer: &[u8], device: &mut Device) -> Answer {
    let content = &answer[DESCRIPTOR_LENGTH..];
    match answer[6] {
        0x04 => {
            device.model = Some(model_name(content[0]));
            device.firmware = Some(format!("{}.{:02}", content[2], content[1]));
            device.serial_number = Some(content[4..].iter().map(|byte| format!("{byte:02X}")).collect());
            Answer::Info { model: content[0], firmware: (content[2], content[1]) }
        }
        0x06 => {
            let code = u32::from(u16_at(content, 1));
            device.health = Some(match content[0] {
                0 => Health::Good,
                1 => Health::Warning(code),
                _ => Health::Failed(code),
            });
            Answer::Health
        }
        0x15 => Answer::SampleTimes(f64::from(u16_at(content, 0)), f64::from(u16_at(content, 2))),
        0x20 => {
            let mut value = [0; 4];
            let bytes = &content[4..content.len().min(8)];
            value[..bytes.len()].copy_from_slice(bytes);
            Answer::Configuration(u32_at(content, 0), u32::from_le_bytes(value))
        }
        kind => Answer::Measurements(Form::of_answer(kind).unwrap_or(Form::Standard)),
    }
}

/// The name of a model by its number: the upper half is the series.
fn model_name(number: u8) -> String {
    let series = match number >> 4 {
        1 => "A1",
        2 => "A2",
        3 => "A3",
        4 => "C1",
        6 => "S1",
        7 => "S2",
        8 => "S3",
        _ => return format!("RPLIDAR, model {number:#04x}"),
    };
    format!("RPLIDAR {series}M{}", number & 0xF)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_the_bytes_that_a_public_driver_sends() {
        // A Rust program for an A3, with the answers that its lidar gave, and Slamtec's document.
        let cases: [(Request, &[u8]); 8] = [
            (Request::Stop, &[0xA5, 0x25]),
            (Request::Health, &[0xA5, 0x52]),
            (Request::Info, &[0xA5, 0x50]),
            (Request::Configuration(Field::SampleTime, 3), &[0xA5, 0x84, 6, 0x71, 0, 0, 0, 3, 0, 0x55]),
            (Request::Configuration(Field::RangeMax, 3), &[0xA5, 0x84, 6, 0x74, 0, 0, 0, 3, 0, 0x50]),
            (Request::Configuration(Field::AnswerType, 3), &[0xA5, 0x84, 6, 0x75, 0, 0, 0, 3, 0, 0x51]),
            (Request::Express(3), &[0xA5, 0x82, 5, 3, 0, 0, 0, 0, 0x21]),
            (Request::Express(0), &[0xA5, 0x82, 5, 0, 0, 0, 0, 0, 0x22]),
        ];
        for (request, bytes) in cases {
            assert_eq!(request.bytes(), bytes, "{request:?}");
        }
    }

    #[test]
    fn answers_of_a_real_lidar_are_read() {
        let mut device = Device::default();
        let mut answer = |bytes: &[u8]| {
            assert!(matches!(look(bytes), Look::Packet(length) if length == bytes.len()), "{bytes:x?}");
            (0..bytes.len()).for_each(|cut| assert!(cut == 0 || matches!(look(&bytes[..cut]), Look::More)));
            read(bytes, &mut device)
        };
        let info = [
            0xA5, 0x5A, 0x14, 0, 0, 0, 4, 0x18, 0x1D, 1, 7, 0xD9, 0x8A, 0x99, 0xF6, 0xC9, 0xE5, 0x9A, 0xD2,
            0xC5, 0xE5, 0x9C, 0xF7, 0x25, 0x58, 0x34, 0x12,
        ];
        assert_eq!(answer(&info), Answer::Info { model: 0x18, firmware: (1, 29) });
        assert_eq!(answer(&[0xA5, 0x5A, 3, 0, 0, 0, 6, 0, 0, 0]), Answer::Health);
        // 127 µs, 12 m, the extended form.
        let configuration =
            |field, value: [u8; 4]| [&[0xA5, 0x5A, 8, 0, 0, 0, 0x20, field, 0, 0, 0][..], &value].concat();
        let answered = answer(&configuration(0x71, [0, 0x7F, 0, 0]));
        assert_eq!(answered, Answer::Configuration(0x71, 127 * 256));
        assert_eq!(answer(&configuration(0x74, [0, 12, 0, 0])), Answer::Configuration(0x74, 12 * 256));
        let kind = [0xA5, 0x5A, 5, 0, 0, 0, 0x20, 0x75, 0, 0, 0, 0x84];
        assert_eq!(answer(&kind), Answer::Configuration(0x75, 0x84));
        let scan = [0xA5, 0x5A, 0x84, 0, 0, 0x40, 0x84];
        assert_eq!(answer(&scan), Answer::Measurements(Form::Extended));
        for (bytes, form) in
            [([5, 0, 0, 0x40, 0x81], Form::Standard), ([0x54, 0, 0, 0x40, 0x82], Form::Express)]
        {
            assert_eq!(answer(&[&DESCRIPTOR[..], &bytes].concat()), Answer::Measurements(form));
        }
        let described =
            "RPLIDAR A1M8, firmware 1.29, serial number D98A99F6C9E59AD2C5E59CF725583412, health good";
        assert_eq!(device.to_string(), described);
    }
}
