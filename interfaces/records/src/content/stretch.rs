use super::constraint::is_information;
use crate::RecordError;
use crate::codec::{Reader, Writer, stored};
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
    /// Chain of submaps that it belongs to: how chains lie to each other is known from constraints alone.
    pub chain: u32,
    /// Sequence of the node before the first; `None` where a chain begins.
    pub previous: Option<u64>,
    /// What its surroundings look like, whatever the heading.
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
    pub doubt_m: f32,
    /// Points of its scan in the robot's frame, millimetres.
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
        out.u32(self.chain);
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
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let chain = input.u32()?;
        let previous = match input.u8()? {
            0 => None,
            1 => Some(input.varint()?),
            _ => return Err(RecordError::Malformed("the node before")),
        };
        let descriptor = Descriptor(input.array()?);
        let count = input.count("nodes of a stretch", NODES_MAX, 40)?;
        let mut nodes = Vec::with_capacity(count);
        let mut last = previous.map_or(Some(0), |previous: u64| previous.checked_add(1));
        for _ in 0..count {
            let gap = input.varint()?;
            let sequence = last.and_then(|last| last.checked_add(gap)).filter(|at| *at < u64::MAX / 2);
            let sequence = sequence.ok_or(RecordError::Malformed("sequences of nodes"))?;
            nodes.push(RecordedNode::read(input, sequence)?);
            last = Some(sequence + 1);
        }
        Ok(Self { chain, previous, descriptor, nodes })
    }
}

impl RecordedNode {
    fn write(&self, out: &mut Writer) {
        out.varint(self.submap.into());
        out.pose(&stored(&self.odom_from_base));
        out.pose(&stored(&self.motion));
        self.information.iter().for_each(|value| out.f32(*value));
        out.f32(self.doubt_m);
        out.varint(self.points.len() as u64);
        let mut last = [0i16; 2];
        for point in &self.points {
            // Neighbours in a scan lie side by side: differences take two or three bytes.
            (0..2).for_each(|axis| out.signed(i64::from(point[axis]) - i64::from(last[axis])));
            last = *point;
        }
    }

    fn read(input: &mut Reader<'_>, sequence: u64) -> Result<Self, RecordError> {
        let submap = input.varint()?.try_into().map_err(|_| RecordError::Malformed("a submap's number"))?;
        let (odom_from_base, motion) = (input.pose()?, input.pose()?);
        let mut information = [0.0; 6];
        for value in &mut information {
            *value = input.f32()?;
        }
        let doubt_m = input.f32()?;
        if !is_information(&information, INFORMATION_MAX) || !(0.0..=1e7).contains(&doubt_m) {
            return Err(RecordError::Malformed("information of a motion"));
        }
        let count = input.count("points of a node", POINTS_MAX, 2)?;
        let mut points = Vec::with_capacity(count);
        let mut last = [0i64; 2];
        for _ in 0..count {
            for value in &mut last {
                *value = value.checked_add(input.signed()?).unwrap_or(i64::MAX);
            }
            let fits = |value: i64| i16::try_from(value).map_err(|_| RecordError::Malformed("a point"));
            points.push([fits(last[0])?, fits(last[1])?]);
        }
        Ok(Self { sequence, submap, odom_from_base, motion, information, doubt_m, points })
    }
}
