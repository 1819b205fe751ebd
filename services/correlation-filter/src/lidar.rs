//! The past of one lidar, and the decision about its next scan: by correlation with the last kept scans, or by the wheels.

use crate::Settings;
use crate::correlation::correlation;
use crate::description::Description;
use flockslam_geometry::Pose;
use flockslam_messages::{DropReason, KeepReason};
use flockslam_published_methods::PublishedFilter;

/// A robot at rest changes four of five sectors by less than this, metres …
const REST_CHANGE_M: f32 = 0.02;
/// … and its wheels move less than this since the last kept scan, metres and radians.
const REST_MOTION: (f64, f64) = (0.01, 0.005);

/// What became of a scan, and the coefficient that decided (0 when none was computed).
pub(crate) type Judgement = (f64, Result<KeepReason, DropReason>);

/// What is remembered of the scans of one lidar.
#[derive(Clone, Debug)]
pub(crate) struct Lidar {
    pub number: u32,
    /// Descriptions of the last kept scans: a ring; `next` is the place of the oldest.
    kept: Vec<Description>,
    next: usize,
    /// The wheels at the last kept scan, when it carried them.
    wheels: Option<Pose>,
    any_kept: bool,
    drops_in_a_row: u32,
    /// Scans shed in a row.
    pub shed: u32,
    pub published: PublishedFilter,
}

impl Lidar {
    pub fn new(number: u32, settings: &Settings) -> Self {
        Self {
            number,
            kept: Vec::with_capacity(settings.window),
            next: 0,
            wheels: None,
            any_kept: false,
            drops_in_a_row: 0,
            shed: 0,
            published: PublishedFilter::default(),
        }
    }

    /// By correlation. Only kept scans enter the window: a slow drift adds up until it is seen.
    pub fn by_correlation(
        &mut self,
        new: Description,
        wheels: Option<Pose>,
        settings: &Settings,
    ) -> Judgement {
        let judgement = self.compared(&new, wheels, settings);
        if judgement.1.is_ok() {
            self.keep(wheels);
            self.remember(new, settings.window);
        } else {
            self.drops_in_a_row += 1;
        }
        judgement
    }

    fn compared(&self, new: &Description, wheels: Option<Pose>, settings: &Settings) -> Judgement {
        let Some(last) = self.last().filter(|_| self.kept.len() >= settings.window) else {
            return (0.0, Ok(KeepReason::FirstScans));
        };
        let (profile, histogram) = self.smallest_correlations(new);
        let coefficient = profile.min(histogram);
        let moved = self.moved(wheels);
        // Without wheels a corridor hides every motion along it.
        let may_rest = match moved {
            Some((travel_m, turn_rad)) => travel_m < REST_MOTION.0 && turn_rad < REST_MOTION.1,
            None => new.corridor <= settings.corridor_max,
        };
        if may_rest && new.change_m(last) <= REST_CHANGE_M {
            let tires = self.drops_in_a_row >= settings.rest_drops_max;
            return (coefficient, if tires { Ok(KeepReason::InARow) } else { Err(DropReason::Unchanged) });
        }
        let far =
            |(travel_m, turn_rad)| travel_m > settings.unseen_travel_m || turn_rad > settings.unseen_turn_rad;
        let verdict = if profile <= settings.profile_threshold || histogram <= settings.histogram_threshold {
            Ok(KeepReason::Novel)
        } else if new.corridor > settings.corridor_max {
            Ok(KeepReason::Corridor)
        } else if moved.is_some_and(far) {
            Ok(KeepReason::Travel)
        } else if self.drops_in_a_row >= settings.consecutive_drops_max {
            Ok(KeepReason::InARow)
        } else {
            Err(DropReason::Correlated)
        };
        (coefficient, verdict)
    }

    /// By the wheels alone.
    pub fn by_motion(&mut self, wheels: Option<Pose>, settings: &Settings) -> Judgement {
        let verdict = match self.moved(wheels) {
            None if self.any_kept => Ok(KeepReason::Unfiltered),
            None => Ok(KeepReason::FirstScans),
            Some((travel_m, turn_rad))
                if travel_m > settings.unseen_travel_m || turn_rad > settings.unseen_turn_rad =>
            {
                Ok(KeepReason::Travel)
            }
            Some(_) if self.drops_in_a_row >= settings.rest_drops_max => Ok(KeepReason::InARow),
            Some(_) => Err(DropReason::Motion),
        };
        if verdict.is_ok() {
            self.keep(wheels);
        } else {
            self.drops_in_a_row += 1;
        }
        (0.0, verdict)
    }

    fn keep(&mut self, wheels: Option<Pose>) {
        (self.wheels, self.any_kept, self.drops_in_a_row) = (wheels, true, 0);
    }

    /// Travel and turn of the wheels since the last kept scan, metres and radians.
    fn moved(&self, wheels: Option<Pose>) -> Option<(f64, f64)> {
        let (before, now) = (self.wheels?, wheels?);
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

    fn remember(&mut self, description: Description, size: usize) {
        if self.kept.len() < size {
            self.kept.push(description);
        } else if size > 0 {
            self.kept[self.next] = description;
            self.next = (self.next + 1) % size;
        }
    }
}
