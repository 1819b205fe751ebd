//! The content of measured motions between nodes, and the check that an information matrix is one.

use crate::codec::{Reader, Writer, stored};
use crate::{RecordError, RobotId};
use flockslam_geometry::Pose;
use std::collections::BTreeSet;

/// Most constraints that one record holds.
pub const CONSTRAINTS_MAX: usize = 64;
/// The least bytes of a robot's name and key, and of a constraint.
const ROBOT_BYTES_MIN: usize = 34;
const CONSTRAINT_BYTES_MIN: usize = 43;
/// Lengths are stored in units of 2 mm.
const UNITS_PER_M: f32 = 500.0;
/// Widest window that a constraint can have been found in, metres.
const REACH_MAX_M: f32 = 1e4;
/// No relative pose is known better than 5 mm and 5 mm a metre; what is measured in the open is known so well when both scans look the same way.
const INFORMATION_MAX: f64 = 4.04e4;

/// A node of a robot's pose graph: the scan with this sequence.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeName {
    /// Whose node it is.
    pub robot: RobotId,
    /// Which of its epochs.
    pub epoch: u64,
    /// Sequence of its scan.
    pub sequence: u64,
}

/// A motion that a robot measured between two nodes: of its own both, or one of them of another robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// Node that it starts from.
    pub from: NodeName,
    /// Node that it leads to: one of its author's.
    pub to: NodeName,
    /// Pose of `to` seen from `from`.
    pub motion: Pose,
    /// Information of the motion in the axes of `from`, upper triangle: xx, xy, xθ, yy, yθ, θθ.
    pub information: [f32; 6],
    /// Reach of the window in which it was found, metres.
    pub reach_m: f32,
    /// How far from where it was expected it was found, metres; 0 when nothing was known.
    pub shift_m: f32,
}

/// Writes constraints that one robot measured: first the other robots whose nodes they start from, then each constraint.
pub(super) fn write(constraints: &[Constraint], out: &mut Writer) {
    let others: BTreeSet<&RobotId> =
        constraints.iter().filter(|c| c.from.robot != c.to.robot).map(|c| &c.from.robot).collect();
    let others: Vec<&RobotId> = others.into_iter().collect();
    out.varint(others.len() as u64);
    others.iter().for_each(|robot| out.robot(robot));
    out.varint(constraints.len() as u64);
    for constraint in constraints {
        let place = others.binary_search(&&constraint.from.robot).map_or(0, |place| place + 1);
        out.varint(place as u64);
        out.varint(constraint.from.epoch);
        out.varint(constraint.from.sequence);
        out.varint(constraint.to.epoch);
        out.varint(constraint.to.sequence);
        out.pose(&stored(&constraint.motion));
        constraint.information.iter().for_each(|value| out.f32(*value));
        [constraint.reach_m, constraint.shift_m].into_iter().for_each(|length_m| out.varint(units(length_m)));
    }
}

/// Reads the constraints that `author` measured.
pub(super) fn read(input: &mut Reader<'_>, author: &RobotId) -> Result<Vec<Constraint>, RecordError> {
    let mut others: Vec<RobotId> = Vec::new();
    for _ in 0..input.count("robots of constraints", CONSTRAINTS_MAX, ROBOT_BYTES_MIN)? {
        let robot = input.robot()?;
        if others.last().is_some_and(|last| *last >= robot) || robot == *author {
            return Err(RecordError::Malformed("the order of robots"));
        }
        others.push(robot);
    }
    let count = input.count("constraints", CONSTRAINTS_MAX, CONSTRAINT_BYTES_MIN)?;
    let mut used = vec![false; others.len()];
    let mut constraints = Vec::with_capacity(count);
    for _ in 0..count {
        let place = input.varint()? as usize;
        let robot = match place.checked_sub(1) {
            None => author,
            Some(place) => {
                let robot =
                    others.get(place).ok_or(RecordError::Malformed("whose node a constraint starts from"))?;
                used[place] = true;
                robot
            }
        };
        constraints.push(read_one(input, robot, author)?);
    }
    // One way only to write the same.
    if count == 0 || used.contains(&false) {
        return Err(RecordError::Malformed("constraints"));
    }
    Ok(constraints)
}

fn read_one(input: &mut Reader<'_>, from: &RobotId, author: &RobotId) -> Result<Constraint, RecordError> {
    let from = NodeName { robot: from.clone(), epoch: input.varint()?, sequence: input.varint()? };
    let to = NodeName { robot: author.clone(), epoch: input.varint()?, sequence: input.varint()? };
    let motion = input.pose()?;
    let mut information = [0.0; 6];
    for value in &mut information {
        *value = input.f32()?;
    }
    let (reach, shift) = (input.varint()?, input.varint()?);
    if reach.max(shift) > units(REACH_MAX_M) || from == to {
        return Err(RecordError::Malformed("where a constraint was looked for"));
    }
    if !is_information(&information, INFORMATION_MAX) {
        return Err(RecordError::Malformed("information of a motion"));
    }
    let length_m = |units: u64| units as f32 / UNITS_PER_M;
    Ok(Constraint { from, to, motion, information, reach_m: length_m(reach), shift_m: length_m(shift) })
}

/// A length in the units in which it is stored.
fn units(length_m: f32) -> u64 {
    (length_m.clamp(0.0, REACH_MAX_M) * UNITS_PER_M).round() as u64
}

/// Whether this is the upper triangle of a positive definite matrix with no element on its diagonal above `largest`.
pub fn is_information(m: &[f32; 6], largest: f64) -> bool {
    let [a, b, c, d, e, f] = m.map(f64::from);
    let bounded = m.iter().all(|v| v.is_finite()) && [a, d, f].iter().all(|v| (0.0..=largest).contains(v));
    let (first, second) = (a, a * d - b * b);
    let third = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
    bounded && first > 0.0 && second > 0.0 && third > 0.0
}
