//! A pose in the plane whose type differs from release to release of a package: `geometry_msgs/Pose2D`, or `geometry_msgs/Pose`.

use super::Quaternion;
use serde::de::{SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// Numbers of a `geometry_msgs/Pose2D`.
const IN_PLANE: usize = 3;
/// Numbers of a `geometry_msgs/Pose`.
const IN_SPACE: usize = 7;

/// The last field of a request: how many numbers follow says of which type it is. It is written as a `geometry_msgs/Pose2D`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InitialPose {
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Heading, radians.
    pub theta: f64,
}

impl Serialize for InitialPose {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(IN_PLANE)?;
        [self.x, self.y, self.theta].iter().try_for_each(|number| tuple.serialize_element(number))?;
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for InitialPose {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(IN_SPACE, Numbers)
    }
}

struct Numbers;

impl<'de> Visitor<'de> for Numbers {
    type Value = InitialPose;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the numbers of a pose")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut numbers: A) -> Result<InitialPose, A::Error> {
        let mut found = [0.0; IN_SPACE];
        let mut count = 0;
        // The bytes end where there is no further number.
        while let Some(Ok(Some(number))) = (count < IN_SPACE).then(|| numbers.next_element::<f64>()) {
            found[count] = number;
            count += 1;
        }
        match (count, found) {
            (IN_SPACE, [x, y, _, qx, qy, qz, qw]) => {
                let theta = Quaternion { x: qx, y: qy, z: qz, w: qw }.heading_rad();
                Ok(InitialPose { x, y, theta })
            }
            (IN_PLANE.., [x, y, theta, ..]) => Ok(InitialPose { x, y, theta }),
            (0, _) => Ok(InitialPose::default()),
            _ => Err(serde::de::Error::invalid_length(count, &self)),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::messages::DeserializePoseGraphRequest;
    use byteorder::LittleEndian;

    /// A request as it is on the wire, with these numbers at its end.
    fn request(numbers: &[f64]) -> DeserializePoseGraphRequest {
        let mut bytes = Vec::from(4_u32.to_le_bytes());
        bytes.extend(b"map\0");
        bytes.push(2);
        bytes.resize(16, 0);
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        cdr_encoding::from_bytes::<DeserializePoseGraphRequest, LittleEndian>(&bytes).unwrap().0
    }

    #[test]
    fn the_pose_is_read_as_each_release_writes_it() {
        let pose = |numbers: &[f64]| {
            let request = request(numbers);
            assert_eq!((request.filename.as_str(), request.match_type), ("map", 2));
            [request.initial_pose.x, request.initial_pose.y, request.initial_pose.theta]
        };
        assert_eq!(pose(&[1.0, 2.0, 0.5]), [1.0, 2.0, 0.5]);
        let half = 0.25_f64;
        let found = pose(&[1.0, 2.0, 0.0, 0.0, 0.0, half.sin(), half.cos()]);
        assert!(found[..2] == [1.0, 2.0] && (found[2] - 0.5).abs() < 1e-12, "{found:?}");
        assert_eq!(pose(&[]), [0.0; 3]);
    }
}
