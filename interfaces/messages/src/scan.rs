//! Scans: a header and a slice of numbers. `ScanView` checks that both fit together and reads them in place;
//! `ScanBuffer` owns its numbers.

use crate::message::message;
use crate::{ScanId, Times};
use flockslam_geometry::{Pose, Twist};
use zerocopy::{FromBytes, IntoBytes};

/// Scans with more beams than this travel on a service of their own, so that ordinary sets stay small.
pub const LARGE_SCAN_BEAMS: usize = 64 * 1024;

/// Of the odometry of a scan only the heading is known.
pub const HEADING_ONLY: u32 = 2;

/// The robot may be anywhere at this scan: time has gone back before it, and a new trajectory begins.
pub const STARTS_DETACHED: u32 = 2;

message! {
    /// The header of a scan. The numbers of its beams follow as a slice of `f32`, see [`ScanView`].
    pub struct ScanHeader = "flockslam/scan/v1" {
        /// The scan's name.
        pub id: ScanId,
        /// When it was taken: the stamp belongs to its first beam.
        pub times: Times,
        /// `base_link_from_laser`: where the lidar is mounted.
        pub base_from_laser: Pose,
        /// `odom_from_base` by odometry at the stamp (dead reckoning); only when `has_odometry` is 1.
        pub odometry: Pose,
        /// Direction of beam 0 in the laser frame, radians; unless the scan has explicit angles.
        pub angle_min_rad: f64,
        /// Step between neighbouring beams, radians (negative: clockwise); unless explicit.
        pub angle_increment_rad: f64,
        /// Ranges below are not valid, metres.
        pub range_min_m: f32,
        /// Ranges above are not valid, metres.
        pub range_max_m: f32,
        /// Seconds between neighbouring beams; 0 when all were taken at once. Unless explicit.
        pub time_increment_s: f32,
        /// 1 when `odometry` is set; [`HEADING_ONLY`] when only its heading is, from a gyroscope.
        pub has_odometry: u32,
        /// Number of beams.
        pub beam_count: u32,
        /// Which sections follow the ranges: bits of [`ScanSections`].
        pub sections: u32,
        /// 1 when the source asks that the scan be given a predicted pose only.
        pub withheld: u32,
        /// 1 when the robot starts in `odom` at the pose of its odometry (an experiment) instead of at the origin;
        /// [`STARTS_DETACHED`] when nothing connects it with the scan before.
        pub starts_at_odometry: u32,
    }
}

/// Optional sections of a scan's numbers, in this order behind the ranges, each `beam_count` long.
pub struct ScanSections;

impl ScanSections {
    /// Explicit direction of each beam, radians in the laser frame.
    pub const ANGLES: u32 = 1;
    /// Strength of each return, as the sensor gives it.
    pub const INTENSITIES: u32 = 2;
    /// Seconds from the stamp to each beam.
    pub const TIMES: u32 = 4;
    /// All sections with a number for each beam.
    pub const ALL: u32 = 7;
    /// Behind all these, the robot's motion by odometry from the stamp to the last beam, in its frame at the stamp: ahead and to the left,
    /// metres, and turned, radians.
    pub const MOTION: u32 = 8;
    const MOTION_NUMBERS: usize = 3;
}

/// Why a scan's header and numbers do not fit together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScanProblem {
    /// The slice has another length than the header gives.
    #[error("a scan of {expected} numbers came with {found}")]
    WrongLength {
        /// Numbers that the header asks for.
        expected: usize,
        /// Numbers that came.
        found: usize,
    },
    /// The header names sections that this build does not know.
    #[error("a scan has unknown sections {0:#x}")]
    UnknownSections(u32),
    /// A pose, angle or limit in the header is not a number.
    #[error("a scan's header has a value that is not a finite number")]
    NotFinite,
}

/// Beams whose ranges differ by less than this, metres, and this many times the distance between them, return from near
/// each other.
const ISOLATED_M: f32 = 0.1;
const ISOLATED_SLOPE: f64 = 5.7;
/// Returns nearer than this are never isolated, metres.
const ISOLATED_FROM_M: f32 = 2.0;

/// A scan read in place: the header and its numbers, wherever they lie.
///
/// ```
/// use flockslam_messages::{ScanHeader, ScanSections, ScanView};
///
/// let sections = ScanSections::INTENSITIES;
/// let header = ScanHeader { beam_count: 2, range_max_m: 30.0, sections, ..ScanHeader::default() };
/// let numbers = [1.5, 2.5, 80.0, 90.0];
/// let scan = ScanView::new(&header, &numbers)?;
/// assert_eq!(scan.ranges(), &[1.5, 2.5]);
/// assert_eq!(scan.intensities(), Some(&[80.0, 90.0][..]));
/// assert!(ScanView::new(&header, &numbers[..3]).is_err());
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct ScanView<'a> {
    header: &'a ScanHeader,
    numbers: &'a [f32],
}

impl<'a> ScanView<'a> {
    /// Joins a header and its numbers: ranges, then the sections named in the header.
    ///
    /// # Errors
    /// When the two do not fit together, or the header's poses and angles are not finite.
    pub fn new(header: &'a ScanHeader, numbers: &'a [f32]) -> Result<Self, ScanProblem> {
        if header.sections & !(ScanSections::ALL | ScanSections::MOTION) != 0 {
            return Err(ScanProblem::UnknownSections(header.sections));
        }
        let lists = 1 + (header.sections & ScanSections::ALL).count_ones() as usize;
        let has_motion = header.sections & ScanSections::MOTION != 0;
        let motion = if has_motion { ScanSections::MOTION_NUMBERS } else { 0 };
        let expected = header.beam_count as usize * lists + motion;
        if numbers.len() != expected {
            return Err(ScanProblem::WrongLength { expected, found: numbers.len() });
        }
        let finite = header.base_from_laser.is_finite()
            && header.odometry.is_finite()
            && header.angle_min_rad.is_finite()
            && header.angle_increment_rad.is_finite()
            && header.time_increment_s.is_finite();
        if finite { Ok(Self { header, numbers }) } else { Err(ScanProblem::NotFinite) }
    }

    /// The header.
    pub fn header(&self) -> &'a ScanHeader {
        self.header
    }

    /// All numbers, ranges first.
    pub fn numbers(&self) -> &'a [f32] {
        self.numbers
    }

    /// Header and numbers as they lie in memory.
    pub fn bytes(&self) -> Vec<u8> {
        [self.header.as_bytes(), self.numbers.as_bytes()].concat()
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.header.beam_count as usize
    }

    /// Whether the scan has no beams.
    pub fn is_empty(&self) -> bool {
        self.header.beam_count == 0
    }

    /// Ranges, metres, as the sensor gave them (REP-117: -Inf too close, +Inf no return, NaN bad).
    pub fn ranges(&self) -> &'a [f32] {
        &self.numbers[..self.len()]
    }

    /// Strengths of the returns, when the sensor gives them.
    pub fn intensities(&self) -> Option<&'a [f32]> {
        self.section(ScanSections::INTENSITIES)
    }

    /// Direction of beam `i` in the laser frame, radians.
    pub fn angle_rad(&self, i: usize) -> f64 {
        match self.section(ScanSections::ANGLES) {
            Some(angles) => f64::from(angles[i]),
            None => self.header.angle_min_rad + i as f64 * self.header.angle_increment_rad,
        }
    }

    /// Seconds from the stamp to beam `i`.
    pub fn time_s(&self, i: usize) -> f64 {
        match self.section(ScanSections::TIMES) {
            Some(times) => f64::from(times[i]),
            None => i as f64 * f64::from(self.header.time_increment_s),
        }
    }

    /// Whether the beams left one after the other, and not all at once.
    pub fn takes_time(&self) -> bool {
        !self.is_empty() && self.time_s(self.len() - 1) != 0.0
    }

    /// The range of beam `i` when it is a real return: finite and within the sensor's limits.
    pub fn valid_range_m(&self, i: usize) -> Option<f64> {
        let range = self.numbers[i];
        // Written this way round, so that NaN fails.
        (self.header.range_min_m <= range && range <= self.header.range_max_m).then_some(f64::from(range))
    }

    /// Whether no beam beside beam `i`, which must be valid, returns from near where it does: rain, dust, a false return –
    /// or something thinner than the beams are apart. Two beams to each side are looked at; a surface seen at up to 80°
    /// from its normal counts as near. Close to the sensor, where even a table's leg matters, nothing is isolated.
    pub fn is_isolated(&self, i: usize) -> bool {
        let range = self.numbers[i];
        if range < ISOLATED_FROM_M {
            return false;
        }
        let step = (ISOLATED_SLOPE * self.header.angle_increment_rad.abs()) as f32;
        let near = |other: usize| {
            let reach = ISOLATED_M + range * step * other.abs_diff(i) as f32;
            (self.numbers[other] - range).abs() <= reach
        };
        let (first, last) = (i.saturating_sub(2), (i + 3).min(self.len()));
        !(first..last).any(|other| other != i && near(other))
    }

    /// Raw dead reckoning at the stamp, when the robot has it.
    pub fn odometry(&self) -> Option<Pose> {
        (self.header.has_odometry == 1).then_some(self.header.odometry)
    }

    /// The robot's velocity during the scan by odometry, when it was known to the last beam.
    pub fn odometry_twist(&self) -> Option<Twist> {
        if self.header.sections & ScanSections::MOTION == 0 || !self.takes_time() {
            return None;
        }
        self.odometry()?;
        let [x_m, y_m, heading_rad] = *self.numbers.last_chunk()?;
        let motion = Pose::new(f64::from(x_m), f64::from(y_m), f64::from(heading_rad));
        let duration_s = self.time_s(self.len() - 1);
        (motion.is_finite() && duration_s > 0.0).then(|| Twist::from_motion(motion, duration_s))
    }

    /// How far the robot has turned by its gyroscope, radians from an arbitrary origin, where odometry is not known.
    pub fn gyro_heading_rad(&self) -> Option<f64> {
        (self.header.has_odometry == HEADING_ONLY).then_some(self.header.odometry.heading_rad)
    }

    fn section(&self, bit: u32) -> Option<&'a [f32]> {
        if self.header.sections & bit == 0 {
            return None;
        }
        let before = 1 + (self.header.sections & (bit - 1)).count_ones() as usize;
        Some(&self.numbers[before * self.len()..(before + 1) * self.len()])
    }
}

/// A scan that owns its numbers: what sources produce and tests hold.
///
/// ```
/// use flockslam_messages::ScanBuffer;
///
/// let mut scan = ScanBuffer::from_ranges(&[1.0, f32::INFINITY, 2.0], -0.5, 0.5);
/// scan.header.range_max_m = 30.0;
/// let view = scan.view()?;
/// assert_eq!((view.len(), view.angle_rad(2)), (3, 0.5));
/// // The second beam has no return.
/// assert_eq!(view.valid_range_m(1), None);
/// assert_eq!(view.valid_range_m(2), Some(2.0));
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanBuffer {
    /// The header.
    pub header: ScanHeader,
    /// Ranges, then the sections named in the header.
    pub numbers: Vec<f32>,
}

impl ScanBuffer {
    /// A scan of these ranges (metres) at even angles; everything else zero, limits 0 … ∞.
    pub fn from_ranges(ranges: &[f32], angle_min_rad: f64, angle_increment_rad: f64) -> Self {
        let header = ScanHeader {
            angle_min_rad,
            angle_increment_rad,
            range_max_m: f32::MAX,
            beam_count: u32::try_from(ranges.len()).expect("a scan has at most 2^32 beams"),
            ..ScanHeader::default()
        };
        Self { header, numbers: ranges.to_vec() }
    }

    /// A scan from its bytes as [`ScanView::bytes`] gives them; `None` when they are none.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (header, numbers) = ScanHeader::read_from_prefix(bytes).ok()?;
        let numbers = numbers.as_chunks::<4>();
        let scan =
            Self { header, numbers: numbers.0.iter().map(|bytes| f32::from_ne_bytes(*bytes)).collect() };
        (numbers.1.is_empty() && scan.view().is_ok()).then_some(scan)
    }

    /// Adds the robot's motion by odometry from the stamp to the last beam.
    pub fn add_motion(&mut self, motion: Pose) {
        debug_assert_eq!(self.header.sections & ScanSections::MOTION, 0, "a scan has one motion");
        self.header.sections |= ScanSections::MOTION;
        self.numbers.extend([motion.x_m as f32, motion.y_m as f32, motion.heading_rad as f32]);
    }

    /// Takes away what [`Self::add_motion`] has added.
    pub fn drop_motion(&mut self) {
        if self.header.sections & ScanSections::MOTION != 0 {
            self.header.sections &= !ScanSections::MOTION;
            self.numbers.truncate(self.numbers.len().saturating_sub(ScanSections::MOTION_NUMBERS));
        }
    }

    /// A view on it.
    ///
    /// # Errors
    /// As [`ScanView::new`].
    pub fn view(&self) -> Result<ScanView<'_>, ScanProblem> {
        ScanView::new(&self.header, &self.numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_lie_behind_the_ranges_in_bit_order() {
        let mut scan = ScanBuffer::from_ranges(&[1.0, 2.0], -1.0, 0.5);
        assert_eq!(scan.view().unwrap().angle_rad(1), -0.5);
        scan.header.sections = ScanSections::ANGLES | ScanSections::TIMES;
        assert_eq!(scan.view().unwrap_err(), ScanProblem::WrongLength { expected: 6, found: 2 });
        scan.numbers.extend([0.25, 0.75, 0.0, 0.125]);
        let view = scan.view().unwrap();
        assert_eq!((view.angle_rad(1), view.time_s(1), view.intensities()), (0.75, 0.125, None));
        scan.header.sections = ScanSections::ANGLES | ScanSections::INTENSITIES;
        assert_eq!(scan.view().unwrap().intensities(), Some(&[0.0, 0.125][..]));
        scan.header.sections = ScanSections::ALL;
        scan.numbers.extend([0.5, 0.625]);
        let view = scan.view().unwrap();
        assert_eq!((view.angle_rad(0), view.time_s(0), view.time_s(1)), (0.25, 0.5, 0.625));
        assert_eq!((view.ranges(), view.intensities()), (&[1.0, 2.0][..], Some(&[0.0, 0.125][..])));
        assert_eq!(view.odometry_twist(), None);
        scan.add_motion(Pose::new(0.25, 0.0, 0.0));
        assert_eq!(scan.view().unwrap().odometry_twist(), None, "a motion of nothing that is known");
        scan.header.has_odometry = 1;
        let view = scan.view().unwrap();
        assert_eq!((view.time_s(1), view.odometry_twist().map(|twist| twist.x_m_s)), (0.625, Some(0.4)));
        scan.drop_motion();
        assert_eq!(scan.view().unwrap().odometry_twist(), None);
        scan.header.sections = 16;
        assert_eq!(scan.view().unwrap_err(), ScanProblem::UnknownSections(16));
    }

    #[test]
    fn a_scan_survives_as_bytes_and_damaged_ones_are_none() {
        let mut scan = ScanBuffer::from_ranges(&[1.0, f32::NAN], -1.0, 0.5);
        scan.header.odometry.x_m = 0.1;
        let bytes = scan.view().unwrap().bytes();
        let found = ScanBuffer::from_bytes(&bytes).unwrap();
        assert_eq!(found.view().unwrap().bytes(), bytes);
        for cut in 0..bytes.len() {
            assert_eq!(ScanBuffer::from_bytes(&bytes[..cut]), None);
        }
    }

    #[test]
    fn only_finite_ranges_within_the_limits_are_valid() {
        let mut scan =
            ScanBuffer::from_ranges(&[0.05, 1.0, 81.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY], 0.0, 0.1);
        (scan.header.range_min_m, scan.header.range_max_m) = (0.1, 80.0);
        let view = scan.view().unwrap();
        let valid: Vec<_> = (0..view.len()).map(|i| view.valid_range_m(i)).collect();
        assert_eq!(valid, [None, Some(1.0), None, None, None, None]);
    }

    #[test]
    fn isolated_returns_have_nothing_near_beside_them() {
        let ranges = [5.0, 5.1, 9.0, 5.2, 5.3, f32::NAN, f32::INFINITY, 7.0, f32::INFINITY, f32::NAN, 1.0];
        let mut scan = ScanBuffer::from_ranges(&ranges, 0.0, 0.01);
        scan.header.range_max_m = 20.0;
        let view = scan.view().unwrap();
        let isolated: Vec<usize> =
            (0..view.len()).filter(|&i| view.valid_range_m(i).is_some() && view.is_isolated(i)).collect();
        assert_eq!(isolated, [2, 7]);
        // A wall seen along its surface: neighbours differ much, but not more than such a wall explains.
        let grazing: Vec<f32> = (0..20).map(|i| 1.0 / (0.2 + 0.01 * i as f32).sin()).collect();
        let scan = ScanBuffer::from_ranges(&grazing, 0.2, 0.01);
        assert!((0..20).all(|i| !scan.view().unwrap().is_isolated(i)));
        let lone = ScanBuffer::from_ranges(&[5.0], 0.0, 0.0);
        assert!(lone.view().unwrap().is_isolated(0));
    }

    #[test]
    fn any_number_of_beams() {
        for beams in [0usize, 1, 180, 65_536, 10_000_000] {
            let scan = ScanBuffer::from_ranges(&vec![1.0; beams], 0.0, 1e-6);
            let view = scan.view().unwrap();
            assert_eq!((view.len(), view.ranges().len(), view.is_empty()), (beams, beams, beams == 0));
        }
    }
}
