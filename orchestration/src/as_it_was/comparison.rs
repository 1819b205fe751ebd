//! What running a recording again has shown: which poses are the published ones, and what the recording lacks.

use flockslam_messages::{PoseEstimate, Stage};
use serde::Serialize;
use std::fmt;
use zerocopy::IntoBytes;

/// So many gaps are named; the others are counted.
const NAMED_MAX: usize = 20;

/// Something that the recording lacks, so that a run again cannot be exact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "gap", rename_all = "kebab-case")]
pub enum Gap {
    /// It begins within the drive.
    BeginsLate {
        /// The first scan in it.
        scan: u64,
    },
    /// A saved map is continued in it.
    SavedMap,
    /// A scan is missing.
    Scan {
        /// Which.
        scan: u64,
    },
    /// What a stage has used is missing.
    Inputs {
        /// Which stage.
        stage: &'static str,
        /// The first scan after it.
        scan: u64,
        /// For how many scans.
        missing: u64,
    },
    /// Commits of the mapper are missing.
    Commits {
        /// The scan of the first commit after it.
        scan: u64,
        /// How many.
        missing: u64,
    },
    /// The marks of a scan are missing.
    Marks {
        /// Which.
        scan: u64,
    },
    /// There is no record of how a pose was computed.
    NoInputs {
        /// The scan.
        scan: u64,
    },
    /// A stage had another grid, after a restart or by a tile that came late.
    OtherGrid {
        /// Which stage.
        stage: &'static str,
        /// The scan.
        scan: u64,
    },
    /// One of several mappers was started again: which tiles are of it is not recorded.
    SeveralMappers {
        /// The scan after which all tiles were published once more.
        scan: u64,
    },
    /// Poses of other robots were known; they are not recorded.
    OtherRobots {
        /// The first scan.
        scan: u64,
    },
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BeginsLate { scan } => {
                write!(f, "the recording begins with scan {scan}: what the stages knew by then is not in it")
            }
            Self::SavedMap => write!(f, "a saved map was continued: it is not in the recording"),
            Self::Scan { scan } => write!(f, "scan {scan} is missing"),
            Self::Inputs { stage, scan, missing } => {
                write!(f, "what {stage} used for {missing} scans before scan {scan} is missing")
            }
            Self::Commits { scan, missing } => {
                write!(f, "{missing} commits before that of scan {scan} are missing")
            }
            Self::Marks { scan } => write!(f, "the cleared cells of scan {scan} are missing"),
            Self::NoInputs { scan } => write!(
                f,
                "what the matcher used for scan {scan} is missing; its fallback, which follows odometry alone, says nothing"
            ),
            Self::OtherGrid { stage, scan } => {
                write!(f, "{stage} had another grid at scan {scan}: some of its tiles came later")
            }
            Self::SeveralMappers { scan } => {
                write!(
                    f,
                    "after scan {scan} one of several mappers may have been started again: its tiles are not recorded"
                )
            }
            Self::OtherRobots { scan } => {
                write!(f, "poses of other robots were known from scan {scan} on: they are not recorded")
            }
        }
    }
}

/// The first pose that is another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The scan.
    pub scan: u64,
    /// Between the two poses in the map, metres.
    pub distance_m: f64,
    /// Between the two headings, radians.
    pub turn_rad: f64,
}

/// What a run again has shown.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Published poses in the recording.
    pub poses: u64,
    /// Of them computed again.
    pub computed: u64,
    /// Of these equal to the published ones in every bit.
    pub equal: u64,
    /// Scans of which the cleaner has cleared other cells.
    pub different_marks: u64,
    /// The first that is not.
    pub first_difference: Option<Difference>,
    /// What the recording lacks: the first of it.
    pub gaps: Vec<Gap>,
    /// How much more it lacks.
    pub more_gaps: u64,
    /// Why the recording ends before its end.
    pub cut_short: Option<String>,
    /// Scans whose verdict came too late.
    pub late_verdicts: u64,
    /// Scans that were not matched since the matcher was behind.
    pub overload: u64,
    /// Restarts of scan-matcher, mapper and dynamic-cleaner.
    pub restarts: u64,
}

impl Comparison {
    /// Whether every published pose was computed again, to the bit, and nothing is missing.
    pub fn is_exact(&self) -> bool {
        self.gaps.is_empty() && self.equal == self.poses && self.different_marks == 0
    }

    /// Names a gap.
    pub(super) fn lacks(&mut self, gap: Gap) {
        if self.gaps.len() < NAMED_MAX {
            self.gaps.push(gap);
        } else {
            self.more_gaps += 1;
        }
    }

    /// Names a gap in what a stage has said of its inputs.
    pub(super) fn lacks_inputs(&mut self, stage: Stage, scan: u64, missing: u64) {
        if missing > 0 {
            self.lacks(Gap::Inputs { stage: stage.name(), scan, missing });
        }
    }

    /// Compares a pose with the published one.
    pub(super) fn compare(&mut self, computed: &PoseEstimate, published: &PoseEstimate) {
        self.computed += 1;
        if computed.as_bytes() == published.as_bytes() {
            self.equal += 1;
            return;
        }
        let (pose, other) = (computed.map_from_base(), published.map_from_base());
        self.first_difference.get_or_insert(Difference {
            scan: published.id.sequence,
            distance_m: pose.distance_m(other),
            turn_rad: pose.turn_rad(other),
        });
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { poses, computed, equal, late_verdicts, overload, restarts, .. } = self;
        writeln!(
            f,
            "{poses} poses were published, {computed} computed again, {equal} of them the same to the bit; \
             {late_verdicts} late verdicts, {overload} scans dropped for overload, {restarts} restarts"
        )?;
        if let Some(Difference { scan, distance_m, turn_rad }) = self.first_difference {
            writeln!(
                f,
                "the first that differs is that of scan {scan}, by {distance_m:.6} m and {:.6}°",
                turn_rad.to_degrees()
            )?;
        }
        if self.different_marks > 0 {
            writeln!(f, "other cells were cleared with {} scans", self.different_marks)?;
        }
        self.gaps.iter().try_for_each(|gap| writeln!(f, "gap: {gap}"))?;
        if self.more_gaps > 0 {
            writeln!(f, "and {} more gaps", self.more_gaps)?;
        }
        self.cut_short.iter().try_for_each(|reason| writeln!(f, "the recording ends early: {reason}"))
    }
}
