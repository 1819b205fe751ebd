//! The past of one lidar, and the decision about its next scan: by correlation with the last kept scans, or by odometry.

use crate::correlation::correlation;
use crate::description::Description;
use flockslam_geometry::Pose;
use flockslam_messages::{DropReason, KeepReason};
use flockslam_published_methods::PublishedFilter;

/// A scan is dropped when its profile by angle, turned by odometry's heading, correlates more than this with that of each kept scan
/// of the window, −1 … 1 …
const PROFILE_THRESHOLD: f64 = 0.6;
/// … and its histogram of ranges correlates more than this. Lower values drop scans that the map needs, higher ones hardly any.
const HISTOGRAM_THRESHOLD: f64 = 0.5;
/// A scan is kept when odometry has moved farther than this since the last kept one, metres: by so little no fit is lost …
const UNSEEN_TRAVEL_M: f64 = 0.12;
/// … or turned more than this, radians.
const UNSEEN_TURN_RAD: f64 = 0.15;
/// A scan with a greater share of corridor pattern (0 … 1) is kept: in a corridor all scans look the same.
const CORRIDOR_MAX: f64 = 0.6;
/// A robot at rest changes four of five sectors by less than this, metres …
const REST_CHANGE_M: f32 = 0.02;
/// … and odometry moves less than this since the last kept scan, metres and radians.
const REST_MOTION: (f64, f64) = (0.01, 0.005);

/// How much is compared, and how many scans may be dropped in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Kept scans to compare with; nothing is dropped before there are so many. Fewer and fuller: more is dropped.
    pub window: usize,
    /// After so many drops in a row a scan is kept whatever it correlates with. This bounds how long the robot moves unseen.
    pub consecutive_drops_max: u32,
    /// The same bound while nothing changes: the robot stands still.
    pub rest_drops_max: u32,
}

impl Default for Limits {
    /// At least every third scan is matched while the robot drives, and one in four seconds at rest (10 Hz).
    fn default() -> Self {
        Self { window: 3, consecutive_drops_max: 2, rest_drops_max: 40 }
    }
}

/// The verdict on a scan, and the coefficient that decided (0 when none was computed).
pub(crate) type Decision = (f64, Result<KeepReason, DropReason>);

/// History of the scans of one lidar.
#[derive(Clone, Debug)]
pub(crate) struct Lidar {
    pub number: u32,
    /// Descriptions of the last kept scans: a ring; `next` is the place of the oldest.
    kept: Vec<Description>,
    next: usize,
    /// Odometry at the last kept scan, when that had odometry.
    odometry: Option<Pose>,
    any_kept: bool,
    drops_in_a_row: u32,
    /// Scans shed in a row.
    pub shed: u32,
    pub published: PublishedFilter,
}

impl Lidar {
    pub fn new(number: u32, limits: &Limits) -> Self {
        Self {
            number,
            kept: Vec::with_capacity(limits.window),
            next: 0,
            odometry: None,
            any_kept: false,
            drops_in_a_row: 0,
            shed: 0,
            published: PublishedFilter::default(),
        }
    }

    /// By correlation. Only kept scans enter the window: a slow drift adds up until it is seen.
    pub fn by_correlation(&mut self, new: Description, odometry: Option<Pose>, limits: &Limits) -> Decision {
        let decision = self.compared(&new, odometry, limits);
        if decision.1.is_ok() {
            self.keep(odometry);
            self.push(new, limits.window);
        } else {
            self.drops_in_a_row += 1;
        }
        decision
    }

    fn compared(&self, new: &Description, odometry: Option<Pose>, limits: &Limits) -> Decision {
        let Some(last) = self.last().filter(|_| self.kept.len() >= limits.window) else {
            return (0.0, Ok(KeepReason::FirstScans));
        };
        let (profile, histogram) = self.smallest_correlations(new);
        let coefficient = profile.min(histogram);
        let moved = self.moved(odometry);
        // Without odometry a corridor hides every motion along it.
        let may_rest = match moved {
            Some((travel_m, turn_rad)) => travel_m < REST_MOTION.0 && turn_rad < REST_MOTION.1,
            None => new.corridor <= CORRIDOR_MAX,
        };
        if may_rest && new.change_m(last) <= REST_CHANGE_M {
            let tires = self.drops_in_a_row >= limits.rest_drops_max;
            return (coefficient, if tires { Ok(KeepReason::InARow) } else { Err(DropReason::Unchanged) });
        }
        let far = |(travel_m, turn_rad)| travel_m > UNSEEN_TRAVEL_M || turn_rad > UNSEEN_TURN_RAD;
        let verdict = if profile <= PROFILE_THRESHOLD || histogram <= HISTOGRAM_THRESHOLD {
            Ok(KeepReason::Novel)
        } else if new.corridor > CORRIDOR_MAX {
            Ok(KeepReason::Corridor)
        } else if moved.is_some_and(far) {
            Ok(KeepReason::Travel)
        } else if self.drops_in_a_row >= limits.consecutive_drops_max {
            Ok(KeepReason::InARow)
        } else {
            Err(DropReason::Correlated)
        };
        (coefficient, verdict)
    }

    /// By odometry alone.
    pub fn by_motion(&mut self, odometry: Option<Pose>, limits: &Limits) -> Decision {
        let verdict = match self.moved(odometry) {
            None if self.any_kept => Ok(KeepReason::Unfiltered),
            None => Ok(KeepReason::FirstScans),
            Some((travel_m, turn_rad)) if travel_m > UNSEEN_TRAVEL_M || turn_rad > UNSEEN_TURN_RAD => {
                Ok(KeepReason::Travel)
            }
            Some(_) if self.drops_in_a_row >= limits.rest_drops_max => Ok(KeepReason::InARow),
            Some(_) => Err(DropReason::Motion),
        };
        if verdict.is_ok() {
            self.keep(odometry);
        } else {
            self.drops_in_a_row += 1;
        }
        (0.0, verdict)
    }

    fn keep(&mut self, odometry: Option<Pose>) {
        (self.odometry, self.any_kept, self.drops_in_a_row) = (odometry, true, 0);
    }

    /// Travel and turn of odometry since the last kept scan, metres and radians.
    fn moved(&self, odometry: Option<Pose>) -> Option<(f64, f64)> {
        let (before, now) = (self.odometry?, odometry?);
        Some((before.distance_m(now), before.turn_rad(now)))
    }

    fn last(&self) -> Option<&Description> {
        let count = self.kept.len();
        self.kept.get((self.next + count).checked_sub(1)? % count.max(1))
    }

    /// The smallest correlation of the profile, and of the histogram, with a kept scan.
    fn smallest_correlations(&self, new: &Description) -> (f64, f64) {
        self.kept.iter().fold((1.0, 1.0), |(profile, histogram): (f64, f64), old| {
            (
                profile.min(correlation(&new.profile_m, &old.profile_m)),
                histogram.min(correlation(&new.histogram, &old.histogram)),
            )
        })
    }

    fn push(&mut self, description: Description, size: usize) {
        if self.kept.len() < size {
            self.kept.push(description);
        } else if size > 0 {
            self.kept[self.next] = description;
            self.next = (self.next + 1) % size;
        }
    }
}
