//! The present pose of a robot: a signed message that is not kept.

use crate::codec::{Reader, Writer};
use crate::{RecordError, RobotId, RobotKey};
use flockslam_geometry::Pose;

/// What a signature of a presence begins with, so that it is none of a record.
const PURPOSE: &[u8] = b"flockslam: presence";

/// The present pose of a robot. It is no record: it is not kept, and only the newest counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Presence {
    /// The robot.
    pub robot: RobotId,
    /// The log that its records go to, …
    pub epoch: u64,
    /// … and the sequence of the scan that it is of: a presence is newer than another of the same robot when (epoch, sequence) is greater.
    pub sequence: u64,
    /// The submap that the scan enters.
    pub submap: u32,
    /// Where it is, in the coordinates that its submaps' evidence is in.
    pub odom_from_base: Pose,
    signature: [u8; 64],
}

impl Presence {
    /// Signs a pose with this key. The pose is rounded to the transmitted form.
    pub fn sign(key: &RobotKey, epoch: u64, sequence: u64, submap: u32, odom_from_base: Pose) -> Self {
        let robot = key.id().clone();
        let mut presence = Self { robot, epoch, sequence, submap, odom_from_base, signature: [0; 64] };
        let body = presence.body();
        let mut sent = Reader(&body[body.len() - 12..]);
        presence.odom_from_base = sent.pose().unwrap_or(odom_from_base);
        presence.signature = key.sign(&digest(&body));
        presence
    }

    fn body(&self) -> Vec<u8> {
        let mut out = Writer::default();
        out.robot(&self.robot);
        out.u64(self.epoch);
        out.u64(self.sequence);
        out.u32(self.submap);
        out.pose(&self.odom_from_base);
        out.0
    }

    pub(crate) fn write(&self, out: &mut Writer) {
        out.bytes(&self.body());
        out.bytes(&self.signature);
    }

    /// Reads one, and verifies its signature.
    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let presence = Self {
            robot: input.robot()?,
            epoch: input.u64()?,
            sequence: input.u64()?,
            submap: input.u32()?,
            odom_from_base: input.pose()?,
            signature: input.array()?,
        };
        if !presence.robot.has_signed(&digest(&presence.body()), &presence.signature) {
            return Err(RecordError::Signature(presence.robot.to_string()));
        }
        Ok(presence)
    }

    /// Whether it is newer than another of the same robot.
    pub fn is_newer_than(&self, other: &Self) -> bool {
        (self.epoch, self.sequence) > (other.epoch, other.sequence)
    }
}

fn digest(body: &[u8]) -> [u8; 32] {
    *blake3::Hasher::new().update(PURPOSE).update(body).finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Message;

    #[test]
    fn a_presence_round_trips_and_cannot_be_forged() {
        let key = RobotKey::of_replay("a").unwrap();
        let presence = Presence::sign(&key, 2, 70, 3, Pose::new(1.5, -2.25, 0.5));
        assert!((presence.odom_from_base.x_m - 1.5).abs() < 1e-4);
        let bytes = Message::Here(presence.clone()).encode();
        assert!(bytes.len() < 160, "{}", bytes.len());
        assert_eq!(Message::decode(&bytes).unwrap(), Message::Here(presence.clone()));
        for place in 0..bytes.len() {
            let mut bent = bytes.clone();
            bent[place] ^= 1;
            assert!(Message::decode(&bent).is_err(), "byte {place} was changed");
        }
        let mut forged = presence.clone();
        forged.signature = RobotKey::of_replay("b").unwrap().sign(&digest(&forged.body()));
        let refused = Message::decode(&Message::Here(forged).encode());
        assert_eq!(refused, Err(RecordError::Signature(key.id().to_string())));
        let later = Presence::sign(&key, 2, 71, 3, Pose::IDENTITY);
        assert!(
            later.is_newer_than(&presence)
                && !presence.is_newer_than(&later)
                && !presence.is_newer_than(&presence)
        );
    }
}
