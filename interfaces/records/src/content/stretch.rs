//! The content of a stretch of a pose graph: nodes with motions, their information and points, and a descriptor of the place.

use super::constraint::is_information;
use super::packed_points;
use crate::RecordError;
use crate::codec::{Reader, Writer, stored};
use crate::sealed::PAYLOAD_BYTES_MAX;
use flockslam_geometry::Pose;

/// Most nodes of a stretch.
const NODES_MAX: usize = 128;
/// Most points of a node.
const POINTS_MAX: usize = 720;
/// A motion between nodes is known to a millimetre at best, and its turn by points 20 m away.
const INFORMATION_MAX: f64 = 1e8;
/// Bins of a descriptor: ranges up to 16 m, half a metre each.
const BINS: usize = 32;
const BIN_M: f64 = 0.5;

/// A stretch of a robot's pose graph: nodes with the points of their scans, as they follow each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Trajectory that it belongs to: relative poses of trajectories are known from constraints alone.
    pub trajectory: u32,
    /// Sequence of the node before the first; `None` where a trajectory begins.
    pub previous: Option<u64>,
    /// Descriptor of its surroundings, independent of the heading.
    pub descriptor: Descriptor,
    /// The nodes in the order of their sequences.
    pub nodes: Vec<RecordedNode>,
}

/// A node of a pose graph as others see it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedNode {
    /// Sequence of its scan.
    pub sequence: u64,
    /// Number of the submap that its scan entered.
    pub submap: u32,
    /// The front end's pose, in the frame that evidence of submaps is in.
    pub odom_from_base: Pose,
    /// Its pose seen from the node before it, as measured.
    pub motion: Pose,
    /// Information of that motion in the axes of the node before.
    pub information: [f32; 6],
    /// How doubtful the motion is beyond its length, metres.
    pub drift_bound_m: f32,
    /// Points of its scan in the robot's frame, millimetres; they are sent as [`rounded_point`](crate::rounded_point) has them.
    pub points: Vec<[i16; 2]>,
}

/// How many points lie at which distance from where they were seen, of 255: the same at any heading. It orders the work of
/// matching, agreement decides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Descriptor(pub [u8; BINS]);

impl Descriptor {
    /// The descriptor of points as (x, y) from where they were seen, metres.
    pub fn of(points: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut counts = [0u32; BINS];
        for (x, y) in points {
            counts[(((x * x + y * y).sqrt() / BIN_M) as usize).min(BINS - 1)] += 1;
        }
        let most = counts.iter().copied().max().unwrap_or(0).max(1);
        Self(counts.map(|count| (count * 255 / most) as u8))
    }

    /// How different two are: 0 for the same.
    pub fn distance(&self, other: &Self) -> u32 {
        self.0.iter().zip(other.0).map(|(a, b)| u32::from(a.abs_diff(b))).sum()
    }
}

impl Stretch {
    pub(crate) fn write(&self, out: &mut Writer) {
        out.u32(self.trajectory);
        out.u8(u8::from(self.previous.is_some()));
        self.previous.iter().for_each(|previous| out.varint(*previous));
        out.bytes(&self.descriptor.0);
        out.varint(self.nodes.len() as u64);
        let mut last = self.previous.map_or(0, |previous| previous + 1);
        for node in &self.nodes {
            out.varint(node.sequence - last);
            last = node.sequence + 1;
            node.write(out);
        }
        let coded = packed_points::encode(self.nodes.iter().map(|node| node.points.as_slice()));
        out.varint(coded.len() as u64);
        out.bytes(&coded);
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let trajectory = input.u32()?;
        let previous = match input.u8()? {
            0 => None,
            1 => Some(input.varint()?),
            _ => return Err(RecordError::Malformed("the node before")),
        };
        let descriptor = Descriptor(input.array()?);
        let count = input.count("nodes of a stretch", NODES_MAX, 40)?;
        let (mut nodes, mut counts) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut last = previous.map_or(Some(0), |previous: u64| previous.checked_add(1));
        for _ in 0..count {
            let gap = input.varint()?;
            let sequence = last.and_then(|last| last.checked_add(gap)).filter(|at| *at < u64::MAX / 2);
            let sequence = sequence.ok_or(RecordError::Malformed("sequences of nodes"))?;
            let (node, points) = RecordedNode::read(input, sequence)?;
            nodes.push(node);
            counts.push(points);
            last = Some(sequence + 1);
        }
        let length = input.count("bytes of points", PAYLOAD_BYTES_MAX, 1)?;
        for (node, points) in nodes.iter_mut().zip(packed_points::decode(input.take(length)?, &counts)?) {
            node.points = points;
        }
        Ok(Self { trajectory, previous, descriptor, nodes })
    }
}

impl RecordedNode {
    fn write(&self, out: &mut Writer) {
        out.varint(self.submap.into());
        out.pose(&stored(&self.odom_from_base));
        out.pose(&stored(&self.motion));
        self.information.iter().for_each(|value| out.f32(*value));
        out.f32(self.drift_bound_m);
        out.varint(self.points.len() as u64);
    }

    /// A node without its points, and how many it has.
    fn read(input: &mut Reader<'_>, sequence: u64) -> Result<(Self, usize), RecordError> {
        let submap = input.varint()?.try_into().map_err(|_| RecordError::Malformed("a submap's number"))?;
        let (odom_from_base, motion) = (input.pose()?, input.pose()?);
        let mut information = [0.0; 6];
        for value in &mut information {
            *value = input.f32()?;
        }
        let drift_bound_m = input.f32()?;
        if !is_information(&information, INFORMATION_MAX) {
            return Err(RecordError::Malformed("information of a motion"));
        }
        if !(0.0..=1e7).contains(&drift_bound_m) {
            return Err(RecordError::Malformed("drift of a motion"));
        }
        // Points that are foreseen take next to no bytes: the limit alone bounds them.
        let count = input.count("points of a node", POINTS_MAX, 0)?;
        Ok((
            Self { sequence, submap, odom_from_base, motion, information, drift_bound_m, points: Vec::new() },
            count,
        ))
    }
}
