use crate::codec::{Reader, Writer, stored};
use crate::{RecordError, RobotId};
use flockslam_geometry::Pose;

/// Widest window that a constraint can have been found in, metres.
const REACH_MAX_M: f32 = 1e4;
/// Nobody knows how places lie to each other better than 1 cm and 1 cm a metre.
const INFORMATION_MAX: f64 = 1.01e4;

/// A node of somebody's pose graph: the scan with this sequence.
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

impl Constraint {
    pub(crate) fn write(&self, out: &mut Writer) {
        let own = self.from.robot == self.to.robot;
        out.u8(u8::from(!own));
        if !own {
            out.robot(&self.from.robot);
        }
        out.u64(self.from.epoch);
        out.varint(self.from.sequence);
        out.u64(self.to.epoch);
        out.varint(self.to.sequence);
        out.pose(&stored(&self.motion));
        self.information.iter().for_each(|value| out.f32(*value));
        out.f32(self.reach_m);
        out.f32(self.shift_m);
    }

    pub(crate) fn read(input: &mut Reader<'_>, author: &RobotId) -> Result<Self, RecordError> {
        let robot = match input.u8()? {
            0 => author.clone(),
            1 => input.robot()?,
            _ => return Err(RecordError::Malformed("whose node a constraint starts from")),
        };
        let from = NodeName { robot, epoch: input.u64()?, sequence: input.varint()? };
        let to = NodeName { robot: author.clone(), epoch: input.u64()?, sequence: input.varint()? };
        let motion = input.pose()?;
        let mut information = [0.0; 6];
        for value in &mut information {
            *value = input.f32()?;
        }
        let (reach_m, shift_m) = (input.f32()?, input.f32()?);
        let usual = |value: f32| (0.0..=REACH_MAX_M).contains(&value);
        if !usual(reach_m) || !usual(shift_m) || from == to {
            return Err(RecordError::Malformed("where a constraint was looked for"));
        }
        if !is_information(&information, INFORMATION_MAX) {
            return Err(RecordError::Malformed("information of a motion"));
        }
        Ok(Self { from, to, motion, information, reach_m, shift_m })
    }
}

/// Whether this is the upper triangle of a positive definite matrix with no element on its diagonal above `largest`.
pub fn is_information(m: &[f32; 6], largest: f64) -> bool {
    let [a, b, c, d, e, f] = m.map(f64::from);
    let bounded = m.iter().all(|v| v.is_finite()) && [a, d, f].iter().all(|v| (0.0..=largest).contains(v));
    let (first, second) = (a, a * d - b * b);
    let third = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
    bounded && first > 0.0 && second > 0.0 && third > 0.0
}
