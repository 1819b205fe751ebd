//! `sensor_msgs/PointCloud2`: points in space, as 3-D lidars and depth cameras give them.

use crate::message_fields::{Fields, MessageProblem};
use nalgebra::Point3;

/// Types of fields, by `sensor_msgs/PointField`.
const FLOAT32: u8 = 7;
const FLOAT64: u8 = 8;

/// Points, and the frame that they were taken in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FramedCloud {
    /// When they were taken, nanoseconds.
    pub stamp_ns: i64,
    /// The sensor's frame.
    pub frame: String,
    /// Those that are finite, metres.
    pub points: Vec<Point3<f32>>,
}

/// One of the numbers of a point.
#[derive(Clone, Copy)]
struct Field {
    offset: usize,
    is_double: bool,
}

pub(crate) fn point_cloud(mut fields: Fields<'_>) -> Result<FramedCloud, MessageProblem> {
    let (stamp_ns, frame) = fields.header()?;
    let (height, width) = (fields.u32()? as usize, fields.u32()? as usize);
    let places = places(&mut fields)?;
    let big_endian = fields.flag()?;
    let (point_step, row_step) = (fields.u32()? as usize, fields.u32()? as usize);
    let data = fields.bytes()?;
    let end = places.iter().map(|field| field.offset + if field.is_double { 8 } else { 4 }).max();
    if point_step < end.unwrap_or(usize::MAX)
        || point_step.checked_mul(width).is_none_or(|row| row_step < row)
    {
        return Err(MessageProblem::BreaksOff);
    }
    if height > 0 && width > 0 && row_step.checked_mul(height).is_none_or(|bytes| bytes > data.len()) {
        return Err(MessageProblem::BreaksOff);
    }
    let rows = data.chunks_exact(row_step.max(1)).take(height);
    let points = rows
        .flat_map(|row| row.chunks_exact(point_step).take(width))
        .map(|bytes| Point3::from(places.map(|field| field.read(bytes, big_endian))))
        .filter(|point| point.iter().all(|v| v.is_finite()))
        .collect();
    Ok(FramedCloud { stamp_ns, frame, points })
}

/// Where x, y and z lie in a point.
fn places(fields: &mut Fields<'_>) -> Result<[Field; 3], MessageProblem> {
    let mut found = [None; 3];
    for _ in 0..fields.u32()? {
        let name = fields.text()?;
        let (offset, datatype, _count) = (fields.u32()? as usize, fields.u8()?, fields.u32()?);
        let axis = ["x", "y", "z"].into_iter().position(|axis| axis == name);
        if let (Some(axis), FLOAT32 | FLOAT64) = (axis, datatype) {
            found[axis] = Some(Field { offset, is_double: datatype == FLOAT64 });
        }
    }
    match found {
        [Some(x), Some(y), Some(z)] => Ok([x, y, z]),
        _ => Err(MessageProblem::NoPlaces),
    }
}

impl Field {
    /// Its number in a point, which is long enough.
    fn read(self, point: &[u8], big_endian: bool) -> f32 {
        fn number<const N: usize>(point: &[u8], at: usize, big_endian: bool) -> [u8; N] {
            let mut bytes: [u8; N] = point[at..at + N].try_into().expect("so many were taken");
            if big_endian {
                bytes.reverse();
            }
            bytes
        }
        if self.is_double {
            f64::from_le_bytes(number(point, self.offset, big_endian)) as f32
        } else {
            f32::from_le_bytes(number(point, self.offset, big_endian))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message_fields::Wire;
    use proptest::prelude::*;

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
    }

    fn field(name: &str, offset: u32, datatype: u8) -> Vec<u8> {
        [&text(name)[..], &offset.to_le_bytes(), &[datatype], &1u32.to_le_bytes()].concat()
    }

    /// Two points of 20 bytes in each of two rows; x of 64 bits behind y and z of 32.
    fn cloud() -> Vec<u8> {
        let point = |x: f64, y: f32, z: f32| {
            [&y.to_le_bytes()[..], &z.to_le_bytes(), &x.to_le_bytes(), &[9; 4]].concat()
        };
        let data =
            [point(1.0, 2.0, 3.0), point(f64::NAN, 0.0, 0.0), point(4.0, 5.0, 6.0), point(7.0, 8.0, 9.0)];
        let head = [0u32, 5, 500].map(u32::to_le_bytes).concat();
        let size = [2u32, 2, 3].map(u32::to_le_bytes).concat();
        let fields = [field("y", 0, FLOAT32), field("z", 4, FLOAT32), field("x", 8, FLOAT64)].concat();
        let steps = [20u32, 40, 80].map(u32::to_le_bytes).concat();
        [head, text("velodyne"), size, fields, vec![0], steps, data.concat(), vec![1]].concat()
    }

    #[test]
    fn points_are_read_wherever_their_fields_lie() {
        let found = point_cloud(Fields::new(&cloud(), Wire::Ros1).unwrap()).unwrap();
        assert_eq!((found.stamp_ns, found.frame.as_str()), (5_000_000_500, "velodyne"));
        let expected = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]].map(Point3::from);
        assert_eq!(found.points, expected);
        for cut in 0..cloud().len() - 1 {
            assert!(point_cloud(Fields::new(&cloud()[..cut], Wire::Ros1).unwrap()).is_err(), "{cut}");
        }
    }

    #[test]
    fn a_cloud_without_places_is_refused() {
        let mut bytes = cloud();
        let name = bytes.iter().position(|byte| *byte == b'x').unwrap();
        bytes[name] = b'i';
        let error = point_cloud(Fields::new(&bytes, Wire::Ros1).unwrap()).unwrap_err();
        assert_eq!(error, MessageProblem::NoPlaces);
    }

    proptest! {
        #[test]
        fn any_cloud_is_survived(at in any::<prop::sample::Index>(), value in any::<u8>(), cdr in any::<bool>()) {
            let mut bytes = cloud();
            let place = at.index(bytes.len());
            bytes[place] = value;
            if cdr {
                bytes.splice(0..4, [0, 1, 0, 0]);
            }
            let wire = if cdr { Wire::Cdr } else { Wire::Ros1 };
            if let Ok(found) = point_cloud(Fields::new(&bytes, wire).unwrap()) {
                prop_assert!(found.points.len() <= bytes.len() / 12);
            }
        }
    }
}
