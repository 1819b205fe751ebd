//! Identity of a robot, and the Ed25519 key (RFC 8032) that it signs with.

use crate::RecordError;
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use std::fmt;

/// Longest name of a robot, bytes.
const NAME_MAX: usize = 32;

/// Identity of a robot: its name and the key that it signs with. Robots of the same name with different keys are
/// different robots.
///
/// The order – by name, then by key – is the order in which every robot lays out the flock.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotId {
    name: String,
    public_key: [u8; 32],
}

impl RobotId {
    /// The robot of this name and public key.
    ///
    /// # Errors
    /// When the name is empty, too long, or has other characters than letters, digits, `-`, `_` and `.`.
    pub fn new(name: &[u8], public_key: [u8; 32]) -> Result<Self, RecordError> {
        if name.is_empty() || name.len() > NAME_MAX {
            let claimed = name.len() as u64;
            return Err(RecordError::TooMuch { what: "a robot's name", claimed, limit: NAME_MAX as u64 });
        }
        let fits = |c: &u8| c.is_ascii_alphanumeric() || matches!(c, b'-' | b'_' | b'.');
        match std::str::from_utf8(name) {
            Ok(text) if name.iter().all(fits) => Ok(Self { name: text.to_owned(), public_key }),
            _ => Err(RecordError::Malformed("a robot's name")),
        }
    }

    /// The name that people gave it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The key that its signatures are checked with.
    pub fn public_key(&self) -> &[u8; 32] {
        &self.public_key
    }

    /// Whether the signature of `message` is this robot's.
    pub(crate) fn has_signed(&self, message: &[u8], signature: &[u8; 64]) -> bool {
        let Ok(key) = VerifyingKey::from_bytes(&self.public_key) else { return false };
        key.verify_strict(message, &Signature::from_bytes(signature)).is_ok()
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, ..] = self.public_key;
        write!(f, "{}:{a:02x}{b:02x}{c:02x}{d:02x}", self.name)
    }
}

impl fmt::Debug for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A robot's secret: what it signs its records with.
pub struct RobotKey {
    id: RobotId,
    secret: SigningKey,
}

impl RobotKey {
    /// The key of the robot of this name with these secret bytes (RFC 8032).
    ///
    /// # Errors
    /// When the name is not one of a robot.
    pub fn new(name: &str, secret: &[u8; 32]) -> Result<Self, RecordError> {
        let secret = SigningKey::from_bytes(secret);
        Ok(Self { id: RobotId::new(name.as_bytes(), secret.verifying_key().to_bytes())?, secret })
    }

    /// The key of a robot in a replay: it follows from the name, so that a replay gives the same records again. It is no secret.
    ///
    /// # Errors
    /// When the name is not one of a robot.
    pub fn of_replay(name: &str) -> Result<Self, RecordError> {
        Self::new(name, &blake3::derive_key("flockslam: key of a robot in a replay", name.as_bytes()))
    }

    /// Whose key it is.
    pub fn id(&self) -> &RobotId {
        &self.id
    }

    pub(crate) fn sign(&self, message: &[u8]) -> [u8; 64] {
        self.secret.sign(message).to_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_plain_and_a_key_signs_for_its_robot_alone() {
        for bad in [&b""[..], b"r 1", "\u{e9}".as_bytes(), &[b'a'; 33], b"a/b"] {
            assert!(RobotId::new(bad, [0; 32]).is_err());
        }
        let (a, b) = (RobotKey::of_replay("a").unwrap(), RobotKey::of_replay("b").unwrap());
        let signature = a.sign(b"hello");
        assert!(a.id().has_signed(b"hello", &signature));
        assert!(!b.id().has_signed(b"hello", &signature) && !a.id().has_signed(b"hullo", &signature));
        assert!(a.id() < b.id());
        assert_eq!(RobotKey::of_replay("a").unwrap().id(), a.id());
    }
}
