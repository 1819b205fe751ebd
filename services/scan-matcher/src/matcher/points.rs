//! The points of a scan that are matched, and the beams that are not.

use super::BEAMS_MAX;
use crate::settings::Settings;
use flockslam_geometry::elementary::hypot;
use flockslam_geometry::{Point, Twist};
use flockslam_messages::{BeamRange, Deskew, ScanView};
use std::iter::Peekable;
use std::ops::{Range, RangeInclusive};

/// Neighbouring points on a wall are single ones in the grid when they are farther apart, metres: three cells.
const GRAZING_APART_M: f64 = 0.15;
/// A beam grazes a wall at less than 26°: the cosine of that.
const GRAZING_COS: f64 = 0.9;

/// Where the matched beams of a scan end, in the order of the beams. All lists are of the same length.
#[derive(Debug, Default)]
pub(super) struct ScanPoints {
    /// Ends of the beams in the robot's frame at the scan's stamp, metres.
    pub(super) ends: Vec<Point>,
    /// The same in the robot's frame at the moment of each beam: straightening by another velocity begins there.
    then: Vec<Point>,
    /// The beam of each point.
    pub(super) beams: Vec<u32>,
    /// Seconds after the stamp at which each point was measured.
    pub(super) times_s: Vec<f64>,
    /// Beams that each point stands for: of a scan with many beams only every so many-th is matched.
    pub(super) stride: u32,
}

/// Beams of a scan that are not matched.
#[derive(Debug, Default)]
pub(super) struct MoverMask {
    /// Beams on what moves, in order.
    pub(super) moving: Vec<BeamRange>,
    /// Points that were set aside for them, without those on other robots.
    pub(super) aside: usize,
    /// Beams on something narrow that stands free, in order. They are not classified as moving.
    pub(super) bodies: Vec<BeamRange>,
    /// For each point at hand, whether it is to be left out.
    pub(super) marks: Vec<bool>,
    /// Clusters of the points at hand: memory of the search for bodies.
    pub(super) pieces: Vec<Range<usize>>,
}

impl ScanPoints {
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Of a scan of so many beams how many could have become points.
    pub(super) fn of_beams(&self, beams: usize) -> usize {
        beams.div_ceil(self.stride.max(1) as usize)
    }

    /// The points of a scan without those that are masked, straightened by `twist`, in this memory.
    pub(super) fn retaken(
        self,
        scan: ScanView<'_>,
        twist: Twist,
        mask: &MoverMask,
        settings: &Settings,
    ) -> Self {
        let limits = settings.range_min_m..=settings.range_max_m;
        self.taken(scan, twist, mask, (limits, BEAMS_MAX), settings.skip_isolated)
    }

    /// The same of at most so many beams that return from within a range, metres, isolated ones too: far trees are.
    pub(super) fn thinned(
        self,
        scan: ScanView<'_>,
        twist: Twist,
        mask: &MoverMask,
        range_max_m: f64,
        beams_max: usize,
    ) -> Self {
        self.taken(scan, twist, mask, (0.0..=range_max_m, beams_max), false)
    }

    fn taken(
        mut self,
        scan: ScanView<'_>,
        twist: Twist,
        mask: &MoverMask,
        (limits, beams_max): (RangeInclusive<f64>, usize),
        skips_isolated: bool,
    ) -> Self {
        let deskew = Deskew::new(scan, twist);
        let stride = scan.len().div_ceil(beams_max).max(1);
        self.stride = stride as u32;
        self.truncate(0);
        let [mut moving, mut bodies] = [&mask.moving, &mask.bodies].map(|ranges| ranges.iter().peekable());
        for beam in (0..scan.len()).step_by(stride) {
            let number = beam as u32;
            if holds(&mut moving, number) || holds(&mut bodies, number) {
                continue;
            }
            let Some(range) = scan.valid_range_m(beam) else { continue };
            if limits.contains(&range) && !(skips_isolated && scan.is_isolated(beam)) {
                let (then, time_s) = (deskew.end_then(scan, beam, range), scan.time_s(beam));
                self.then.push(then);
                self.ends.push(deskew.at_stamp(then, time_s));
                self.beams.push(number);
                self.times_s.push(time_s);
            }
        }
        self
    }

    /// The same points straightened by another velocity.
    pub(super) fn straightened(mut self, twist: Twist) -> Self {
        for ((end, then), time_s) in self.ends.iter_mut().zip(&self.then).zip(&self.times_s) {
            *end = twist.carried(*then, *time_s);
        }
        self
    }

    /// The points that are not marked.
    pub(super) fn without(self, marks: &[bool]) -> Self {
        self.kept(|i, _| !marks[i])
    }

    /// The points of which this is true, by number and end.
    pub(super) fn kept(mut self, keeps: impl Fn(usize, Point) -> bool) -> Self {
        let mut kept = 0;
        for i in 0..self.len() {
            if keeps(i, self.ends[i]) {
                self.move_to(i, kept);
                kept += 1;
            }
        }
        self.truncate(kept);
        self
    }

    /// The points without single ones on a wall that beams graze.
    pub(super) fn without_grazing(mut self) -> Self {
        let mut kept = 0;
        for i in 0..self.len() {
            // Points are moved only to where earlier ones were: the neighbours are still in their places.
            if !self.is_grazing(i) {
                self.move_to(i, kept);
                kept += 1;
            }
        }
        self.truncate(kept);
        self
    }

    /// Whether the nearer neighbour of a point is apart from it, and lies along its beam.
    fn is_grazing(&self, i: usize) -> bool {
        let end = self.ends[i];
        let neighbours = [i.checked_sub(1), Some(i + 1)].into_iter().flatten();
        let chords =
            neighbours.filter_map(|j| self.ends.get(j)).map(|to| (to.x_m - end.x_m, to.y_m - end.y_m));
        let nearer = chords.map(|(x, y)| (x, y, hypot(x, y))).min_by(|a, b| a.2.total_cmp(&b.2));
        let Some((x, y, apart_m)) = nearer else { return false };
        let along = (x * end.x_m + y * end.y_m).abs();
        apart_m > GRAZING_APART_M && along > GRAZING_COS * apart_m * hypot(end.x_m, end.y_m)
    }

    fn move_to(&mut self, from: usize, to: usize) {
        self.ends[to] = self.ends[from];
        self.then[to] = self.then[from];
        self.beams[to] = self.beams[from];
        self.times_s[to] = self.times_s[from];
    }

    fn truncate(&mut self, count: usize) {
        self.ends.truncate(count);
        self.then.truncate(count);
        self.beams.truncate(count);
        self.times_s.truncate(count);
    }
}

impl MoverMask {
    /// Drops the beams of the scan before.
    pub(super) fn clear(&mut self) {
        self.moving.clear();
        self.bodies.clear();
        self.aside = 0;
    }

    /// Begins to mark `count` points: none is.
    pub(super) fn unmark(&mut self, count: usize) {
        self.marks.clear();
        self.marks.resize(count, false);
    }
}

/// Adds beams to the ranges behind the first `apart`, which stay as they are: what was added can be taken back by cutting it off.
pub(super) fn add_beams(ranges: &mut Vec<BeamRange>, apart: usize, first: u32, count: u32) {
    match ranges[apart..].last_mut().filter(|range| range.end == first) {
        Some(range) => range.end += count,
        None => ranges.push(BeamRange { first, end: first + count }),
    }
}

/// Whether ranges in order, asked for numbers in order, hold this one.
fn holds<'a>(ranges: &mut Peekable<impl Iterator<Item = &'a BeamRange>>, number: u32) -> bool {
    while ranges.next_if(|range| range.end <= number).is_some() {}
    ranges.peek().is_some_and(|range| range.first <= number)
}
