//! Transforms between named frames over time, as tf2 keeps them.

use crate::TimeWatch;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::collections::{BTreeMap, VecDeque};

/// A transform is kept until one of the same frame is so much later, nanoseconds.
const KEPT_NS: i64 = 30_000_000_000;
/// Between transforms that are further apart nothing is interpolated, nanoseconds.
const GAP_MAX_NS: i64 = 1_000_000_000;
/// Quaternions of other lengths are no rotations.
const LENGTHS: std::ops::Range<f64> = 1e-6..1e6;
/// So many of the last poses are looked through one by one.
const LAST_FEW: usize = 4;
/// A chain of frames is not longer: one that is goes round in a circle.
const CHAIN_MAX: usize = 64;

/// A transform as a message has it.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedTransform {
    /// When it held, nanoseconds.
    pub stamp_ns: i64,
    /// The frame that the pose is in.
    pub parent: String,
    /// The frame whose pose it is.
    pub child: String,
    /// `parent_from_child`.
    pub parent_from_child: Isometry3<f64>,
}

/// Why there is no transform between two frames at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LookupError {
    /// No chain of frames connects the two.
    #[error("nothing connects the frames")]
    Unlinked,
    /// The time is behind the last transform: one may still come.
    #[error("no transform is that new")]
    NotYet,
    /// The time is before the first transform, or in a gap of more than a second.
    #[error("no transform near that time")]
    Missing,
}

/// Frames and their poses over time.
#[derive(Debug, Default)]
pub struct TransformBuffer {
    /// By child frame.
    links: BTreeMap<String, Link>,
    /// The transforms of a frame are dropped when its time goes back.
    follows_time: bool,
    /// How often a frame has got a parent, or another one.
    links_version: u64,
}

#[derive(Debug)]
struct Link {
    parent: String,
    /// It holds at all times.
    is_static: bool,
    /// In order of time; one where it is static.
    poses: VecDeque<(i64, Isometry3<f64>)>,
    time: TimeWatch,
}

/// A pose in space from a position and the numbers x, y, z, w of a quaternion, which need not be of length 1; `None` when they are none.
pub fn pose_in_space(position: [f64; 3], quaternion: [f64; 4]) -> Option<Isometry3<f64>> {
    let [i, j, k, w] = quaternion;
    let rotation = Quaternion::new(w, i, j, k);
    let is_sound = position.iter().all(|number| number.is_finite()) && LENGTHS.contains(&rotation.norm());
    is_sound.then(|| {
        Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_quaternion(rotation))
    })
}

/// A frame's name without the slash that tf put in front of it.
pub fn frame_name(name: &str) -> &str {
    name.trim_start_matches('/')
}

impl TransformBuffer {
    /// Of present publishers: when the stamps of a frame go back and go on from there, its poses up to then are dropped.
    pub fn live() -> Self {
        Self { follows_time: true, ..Self::default() }
    }

    /// Drops the poses of frames that move: time has gone back. Which frames there are, and what holds at all times, is kept.
    pub fn clear_moving(&mut self) {
        for link in self.links.values_mut().filter(|link| !link.is_static) {
            link.poses.clear();
            link.time = TimeWatch::default();
        }
    }

    /// Takes a transform. Those of one frame may come in any order; of equal stamps the last counts. One with numbers that are not
    /// finite, or from a frame to itself, is left out.
    pub fn insert(&mut self, transform: &StampedTransform, is_static: bool) {
        let StampedTransform { stamp_ns, parent, child, parent_from_child } = transform;
        self.insert_pose((parent, child), *stamp_ns, parent_from_child, is_static);
    }

    /// As [`TransformBuffer::insert`], of a parent and a child and the pose of one in the other.
    pub fn insert_pose(
        &mut self,
        (parent, child): (&str, &str),
        stamp_ns: i64,
        pose: &Isometry3<f64>,
        is_static: bool,
    ) {
        let (parent, child) = (frame_name(parent), frame_name(child));
        let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
        if parent == child || !finite {
            return;
        }
        let fresh = || Link {
            parent: parent.to_owned(),
            is_static,
            poses: VecDeque::new(),
            time: TimeWatch::default(),
        };
        if !self.links.contains_key(child) {
            self.links.insert(child.to_owned(), fresh());
            self.links_version += 1;
        }
        let Some(link) = self.links.get_mut(child) else { return };
        self.links_version += u64::from(link.parent != parent);
        if link.parent != parent || link.is_static != is_static || is_static {
            *link = fresh();
        }
        if link.time.goes_back(stamp_ns) && self.follows_time {
            link.poses.clear();
        }
        let at = link.first_from(stamp_ns);
        match link.poses.get_mut(at) {
            Some(same) if same.0 == stamp_ns => same.1 = *pose,
            _ => link.poses.insert(at, (stamp_ns, *pose)),
        }
        let newest_ns = link.poses.back().map_or(i64::MIN, |(stamp_ns, _)| *stamp_ns);
        while link.poses.front().is_some_and(|(stamp_ns, _)| newest_ns.saturating_sub(*stamp_ns) > KEPT_NS) {
            link.poses.pop_front();
        }
    }

    /// Changes when a frame gets a parent, or another one: until then, frames that nothing connects stay so.
    pub fn links_version(&self) -> u64 {
        self.links_version
    }

    /// Whether no transform has come.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// Whether a frame has a parent or a child.
    pub fn knows(&self, frame: &str) -> bool {
        let frame = frame_name(frame);
        self.links.contains_key(frame) || self.links.values().any(|link| link.parent == frame)
    }

    /// The frames above a frame, the nearest first, up to the root.
    pub fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        self.above(frame_name(frame)).skip(1).collect()
    }

    /// A frame, and those above it.
    fn above<'a>(&'a self, frame: &'a str) -> impl Iterator<Item = &'a str> {
        let parent = |at: &&'a str| self.links.get(*at).map(|link| link.parent.as_str());
        std::iter::successors(Some(frame), parent).take(CHAIN_MAX + 1)
    }

    /// `target_from_source` at a time, interpolated.
    ///
    /// # Errors
    /// When the frames are not linked, or a transform between them is not known for that time.
    pub fn lookup(&self, target: &str, source: &str, at_ns: i64) -> Result<Isometry3<f64>, LookupError> {
        let (target, source) = (frame_name(target), frame_name(source));
        if let Some(pose) = self.straight_up(target, source, at_ns) {
            return pose.map(|pose| Isometry3::identity().inv_mul(&pose));
        }
        let common = self.common(target, source).ok_or(LookupError::Unlinked)?;
        Ok(self.up_to(common, target, at_ns)?.inv_mul(&self.up_to(common, source, at_ns)?))
    }

    /// Whether a chain of frames connects two.
    pub fn links(&self, target: &str, source: &str) -> bool {
        self.common(frame_name(target), frame_name(source)).is_some()
    }

    /// Until when the chain between two frames is known, nanoseconds; `None` where it holds at all times or there is none.
    pub fn known_until_ns(&self, target: &str, source: &str) -> Option<i64> {
        let (target, source) = (frame_name(target), frame_name(source));
        let common = self.common(target, source)?;
        let up = |frame| self.above(frame).take_while(move |at| *at != common);
        let links = up(target).chain(up(source)).filter_map(|frame| self.links.get(frame));
        links.filter(|link| !link.is_static).filter_map(|link| link.poses.back()).map(|(at, _)| *at).min()
    }

    /// The nearest frame that both are, or lie below.
    fn common<'a>(&'a self, target: &'a str, source: &'a str) -> Option<&'a str> {
        self.above(target).find(|frame| self.above(source).any(|other| other == *frame))
    }

    /// `ancestor_from_frame` at a time; `None` where one does not lie above the other.
    fn straight_up(
        &self,
        ancestor: &str,
        frame: &str,
        at_ns: i64,
    ) -> Option<Result<Isometry3<f64>, LookupError>> {
        let (mut at, mut pose) = (frame, Ok(Isometry3::identity()));
        for _ in 0..=CHAIN_MAX {
            if at == ancestor {
                return Some(pose);
            }
            let link = self.links.get(at)?;
            pose = pose.and_then(|pose| Ok(link.pose_at(at_ns)? * pose));
            at = &link.parent;
        }
        None
    }

    /// `ancestor_from_frame` at a time.
    fn up_to(&self, ancestor: &str, frame: &str, at_ns: i64) -> Result<Isometry3<f64>, LookupError> {
        let (mut at, mut pose) = (frame, Isometry3::identity());
        while at != ancestor {
            let link = self.links.get(at).ok_or(LookupError::Unlinked)?;
            pose = link.pose_at(at_ns)? * pose;
            at = &link.parent;
        }
        Ok(pose)
    }
}

impl Link {
    /// Which pose is the first that is not older. Most questions are about the last few.
    fn first_from(&self, at_ns: i64) -> usize {
        let is_older = |(stamp_ns, _): &(i64, Isometry3<f64>)| *stamp_ns < at_ns;
        let later = self.poses.iter().rev().take(LAST_FEW).take_while(|pose| !is_older(pose)).count();
        if later < LAST_FEW { self.poses.len() - later } else { self.poses.partition_point(is_older) }
    }

    fn pose_at(&self, at_ns: i64) -> Result<Isometry3<f64>, LookupError> {
        if self.poses.is_empty() {
            // Its time has gone back, and no transform was received since.
            return Err(LookupError::NotYet);
        }
        let after = self.first_from(at_ns);
        let next = self.poses.get(after);
        if let Some((stamp_ns, pose)) = next
            && (*stamp_ns == at_ns || self.is_static)
        {
            return Ok(*pose);
        }
        let Some(before) = after.checked_sub(1).and_then(|before| self.poses.get(before)) else {
            return Err(LookupError::Missing);
        };
        if self.is_static {
            return Ok(before.1);
        }
        let Some(next) = next else { return Err(LookupError::NotYet) };
        let gap_ns = next.0.saturating_sub(before.0);
        if gap_ns > GAP_MAX_NS {
            return Err(LookupError::Missing);
        }
        Ok(interpolated(&before.1, &next.1, (at_ns - before.0) as f64 / gap_ns as f64))
    }
}

/// A share of the way from one pose to another: the position along a line, the rotation by the normalised mean of the quaternions,
/// which is within a thousandth of the arc for turns of less than 20°.
fn interpolated(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let position = from.translation.vector.lerp(&to.translation.vector, share);
    let (a, b) = (from.rotation.coords, to.rotation.coords);
    let b = if a.dot(&b) < 0.0 { -b } else { b };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from(a.lerp(&b, share)));
    Isometry3::from_parts(Translation3::from(position), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transform(stamp_ns: i64, parent: &str, child: &str, x_m: f64, yaw_rad: f64) -> StampedTransform {
        StampedTransform {
            stamp_ns,
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Isometry3::from_parts(
                Translation3::new(x_m, 0.0, 0.0),
                UnitQuaternion::from_euler_angles(0.0, 0.0, yaw_rad),
            ),
        }
    }

    #[test]
    fn poses_along_a_chain_are_composed_up_and_down() {
        let mut buffer = TransformBuffer::default();
        buffer.insert(&transform(0, "base_footprint", "base_link", 0.1, 0.0), true);
        buffer.insert(&transform(0, "/base_link", "/laser", 0.3, 0.0), true);
        buffer.insert(&transform(0, "base_footprint", "wheel", 1.0, 0.0), true);
        let laser = buffer.lookup("wheel", "laser", 5).unwrap();
        assert!((laser.translation.x + 0.6).abs() < 1e-12);
        assert_eq!(buffer.ancestors("laser"), ["base_link", "base_footprint"]);
        assert!(buffer.links("wheel", "/laser") && !buffer.links("wheel", "camera"));
        assert_eq!(buffer.lookup("base_link", "camera", 5), Err(LookupError::Unlinked));
        assert!(buffer.knows("wheel") && buffer.knows("base_footprint") && !buffer.knows("camera"));
        let version = buffer.links_version();
        buffer.insert(&transform(1, "base_footprint", "wheel", 2.0, 0.0), true);
        assert_eq!(buffer.links_version(), version);
        buffer.insert(&transform(1, "base_link", "wheel", 2.0, 0.0), true);
        assert_ne!(buffer.links_version(), version);
    }

    #[test]
    fn poses_out_of_order_are_interpolated_and_gaps_are_not() {
        let mut buffer = TransformBuffer::default();
        for (stamp_ns, x_m) in
            [(300_000_000, 3.0), (100_000_000, 1.0), (200_000_000, 2.0), (5_000_000_000, 9.0)]
        {
            buffer.insert(&transform(stamp_ns, "odom", "base_link", x_m, 0.1 * x_m), false);
        }
        let at = |at_ns: i64| buffer.lookup("odom", "base_link", at_ns);
        let between = at(150_000_000).unwrap();
        assert!((between.translation.x - 1.5).abs() < 1e-12);
        assert!((between.rotation.euler_angles().2 - 0.15).abs() < 1e-9);
        assert_eq!(at(300_000_000).unwrap().translation.x, 3.0);
        assert_eq!(at(50_000_000), Err(LookupError::Missing));
        assert_eq!(at(2_000_000_000), Err(LookupError::Missing));
        assert_eq!(at(6_000_000_000), Err(LookupError::NotYet));
        assert_eq!(buffer.known_until_ns("odom", "base_link"), Some(5_000_000_000));
    }

    #[test]
    fn when_time_goes_back_followers_drop_the_history_of_a_frame() {
        let second = 1_000_000_000;
        for mut buffer in [TransformBuffer::live(), TransformBuffer::default()] {
            buffer.insert(&transform(0, "base_link", "laser", 0.3, 0.0), true);
            for (tenth, x_m) in [(200, 7.0), (201, 7.0), (0, 1.0), (1, 1.1), (2, 1.2)] {
                buffer.insert(&transform(tenth * second / 10, "odom", "base_link", x_m, 0.0), false);
            }
            let until_ns = buffer.known_until_ns("odom", "base_link");
            assert_eq!(until_ns, Some(if buffer.follows_time { second / 5 } else { 201 * second / 10 }));
            assert!(
                (buffer.lookup("odom", "base_link", second / 10).unwrap().translation.x - 1.1).abs() < 1e-12
            );
            buffer.clear_moving();
            assert_eq!(buffer.lookup("odom", "laser", second), Err(LookupError::NotYet));
            assert!(buffer.links("odom", "laser") && buffer.lookup("base_link", "laser", 0).is_ok());
        }
    }

    #[test]
    fn a_circle_and_numbers_that_are_none_are_survived() {
        let mut buffer = TransformBuffer::default();
        buffer.insert(&transform(0, "a", "b", 0.0, 0.0), true);
        buffer.insert(&transform(0, "b", "a", 0.0, 0.0), true);
        buffer.insert(&transform(0, "a", "c", f64::NAN, 0.0), true);
        assert_eq!(buffer.lookup("c", "a", 0), Err(LookupError::Unlinked));
        assert!(buffer.ancestors("a").len() <= CHAIN_MAX);
    }
}
