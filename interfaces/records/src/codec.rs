//! Reading and writing of values, little-endian. A number has exactly one form, and no length is used before it was
//! compared with its limit and with the bytes that are there.

use crate::{RecordError, RobotId};
use flockslam_geometry::{Pose, wrap_angle};

/// Units of a stored length in a metre: 10 µm each.
const LENGTH_UNITS: f64 = 1e5;
/// Units of a stored angle in a radian: 0.1 µrad each.
const ANGLE_UNITS: f64 = 1e7;
/// Farthest coordinate that can be stored, metres.
pub const LENGTH_MAX_M: f64 = 20_000.0;

/// Appends values, little-endian.
#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }

    pub fn u64(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    /// A number of any size in as few bytes as it needs, seven bits each.
    pub fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    pub fn signed(&mut self, value: i64) {
        self.varint((value << 1 ^ value >> 63) as u64);
    }

    pub fn f32(&mut self, value: f32) {
        self.0.extend(value.to_le_bytes());
    }

    /// A length or an angle in its units.
    fn fixed(&mut self, value: f64, units: f64) {
        self.0.extend(((value * units).round() as i32).to_le_bytes());
    }

    pub fn pose(&mut self, pose: &Pose) {
        self.fixed(pose.x_m, LENGTH_UNITS);
        self.fixed(pose.y_m, LENGTH_UNITS);
        self.fixed(wrap_angle(pose.heading_rad), ANGLE_UNITS);
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend(bytes);
    }

    pub fn robot(&mut self, robot: &RobotId) {
        self.u8(robot.name().len() as u8);
        self.bytes(robot.name().as_bytes());
        self.bytes(robot.public_key());
    }
}

/// Reads values, and never beyond the end.
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], RecordError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(RecordError::Truncated)?;
        self.0 = rest;
        Ok(taken)
    }

    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], RecordError> {
        Ok(self.take(N)?.try_into().expect("as many as were taken"))
    }

    pub fn u8(&mut self) -> Result<u8, RecordError> {
        Ok(self.array::<1>()?[0])
    }

    pub fn u32(&mut self) -> Result<u32, RecordError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub fn u64(&mut self) -> Result<u64, RecordError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub fn varint(&mut self) -> Result<u64, RecordError> {
        let mut value = 0;
        for place in 0..10 {
            let byte = self.u8()?;
            value |= u64::from(byte & 0x7f) << (7 * place);
            if byte & 0x80 == 0 {
                // One way only to write a number: otherwise the same content had many hashes.
                let minimal = place == 0 || byte != 0;
                let fits = place < 9 || byte <= 1;
                return if minimal && fits { Ok(value) } else { Err(RecordError::Malformed("a number")) };
            }
        }
        Err(RecordError::Malformed("a number"))
    }

    pub fn signed(&mut self) -> Result<i64, RecordError> {
        let value = self.varint()?;
        Ok((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    pub fn f32(&mut self) -> Result<f32, RecordError> {
        Ok(f32::from_le_bytes(self.array()?))
    }

    fn fixed(&mut self, units: f64) -> Result<f64, RecordError> {
        Ok(f64::from(i32::from_le_bytes(self.array()?)) / units)
    }

    pub fn pose(&mut self) -> Result<Pose, RecordError> {
        let (x_m, y_m) = (self.fixed(LENGTH_UNITS)?, self.fixed(LENGTH_UNITS)?);
        let heading_rad = self.fixed(ANGLE_UNITS)?;
        let fits = x_m.abs() <= LENGTH_MAX_M && y_m.abs() <= LENGTH_MAX_M && heading_rad.abs() <= 3.15;
        if fits { Ok(Pose { x_m, y_m, heading_rad }) } else { Err(RecordError::Malformed("a pose")) }
    }

    /// How many things follow, each of at least `bytes_each`: checked against the limit and against what is there.
    pub fn count(
        &mut self,
        what: &'static str,
        limit: usize,
        bytes_each: usize,
    ) -> Result<usize, RecordError> {
        let claimed = self.varint()?;
        if claimed > limit as u64 {
            return Err(RecordError::TooMuch { what, claimed, limit: limit as u64 });
        }
        let count = claimed as usize;
        if count * bytes_each > self.0.len() { Err(RecordError::Truncated) } else { Ok(count) }
    }

    pub fn robot(&mut self) -> Result<RobotId, RecordError> {
        let length = usize::from(self.u8()?);
        let name = self.take(length)?;
        let key = self.array()?;
        RobotId::new(name, key)
    }

    pub fn end(self) -> Result<(), RecordError> {
        if self.0.is_empty() { Ok(()) } else { Err(RecordError::Trailing(self.0.len())) }
    }
}

/// A pose as it comes back from being stored.
pub fn stored(pose: &Pose) -> Pose {
    let mut writer = Writer::default();
    writer.pose(pose);
    Reader(&writer.0).pose().unwrap_or(*pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_round_trip_with_one_encoding(value in any::<u64>(), signed in any::<i64>()) {
            let mut writer = Writer::default();
            writer.varint(value);
            writer.signed(signed);
            let mut reader = Reader(&writer.0);
            prop_assert_eq!((reader.varint(), reader.signed()), (Ok(value), Ok(signed)));
            prop_assert!(reader.end().is_ok());
            prop_assert!(Reader(&[0x80, 0]).varint().is_err());
        }

        #[test]
        fn a_stored_pose_stays_as_it_is(x in -900.0..900.0f64, y in -900.0..900.0f64, turn in -9.0..9.0f64) {
            let pose = Pose::new(x, y, turn);
            let once = stored(&pose);
            prop_assert!(once.distance_m(pose) < 1e-5 && once.turn_rad(pose) < 1e-6);
            prop_assert_eq!(stored(&once), once);
        }
    }
}
