//! The content of a record, by kind, and its payload.

use crate::codec::{Reader, Writer};
use crate::kind::Kind;
use crate::{RecordError, RobotId};

mod clearance;
mod constraint;
mod packed_points;
mod stretch;
mod submap_record;
mod withdrawal;

pub use clearance::Clearance;
pub use constraint::{CONSTRAINTS_MAX, Constraint, NodeName};
pub use packed_points::rounded as rounded_point;
pub use stretch::{Descriptor, RecordedNode, Stretch};
pub use submap_record::SubmapRecord;
pub use withdrawal::Withdrawal;

/// The content of a record.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// The evidence of a closed submap.
    Submap(SubmapRecord),
    /// A stretch of the pose graph with its scans.
    Stretch(Stretch),
    /// Measured motions between nodes, at most [`CONSTRAINTS_MAX`].
    Constraints(Vec<Constraint>),
    /// Cells of a submap that are stale.
    Clearance(Clearance),
    /// A record of the same robot does not hold any more.
    Withdrawal(Withdrawal),
}

impl Content {
    /// Its kind of record.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Submap(_) => Kind::Submap,
            Self::Stretch(_) => Kind::Stretch,
            Self::Constraints(_) => Kind::Constraint,
            Self::Clearance(_) => Kind::Clearance,
            Self::Withdrawal(_) => Kind::Withdrawal,
        }
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = Writer::default();
        match self {
            Self::Submap(submap) => submap.write(&mut out),
            Self::Stretch(stretch) => stretch.write(&mut out),
            Self::Constraints(constraints) => constraint::write(constraints, &mut out),
            Self::Clearance(clearance) => clearance.write(&mut out),
            Self::Withdrawal(withdrawal) => withdrawal.write(&mut out),
        }
        out.0
    }

    /// Reads the content of a record of `author`.
    pub(crate) fn decode(kind: Kind, author: &RobotId, payload: &[u8]) -> Result<Self, RecordError> {
        let mut input = Reader(payload);
        let content = match kind {
            Kind::Submap => Self::Submap(SubmapRecord::read(&mut input)?),
            Kind::Stretch => Self::Stretch(Stretch::read(&mut input)?),
            Kind::Constraint => Self::Constraints(constraint::read(&mut input, author)?),
            Kind::Clearance => Self::Clearance(Clearance::read(&mut input)?),
            Kind::Withdrawal => Self::Withdrawal(Withdrawal::read(&mut input)?),
        };
        input.end()?;
        Ok(content)
    }
}
