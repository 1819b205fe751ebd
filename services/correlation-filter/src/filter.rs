//! The logic of the stage: takes scans one by one, gives a verdict with its reason for each.

use crate::description::Description;
use crate::lidar_history::{Decision, Lidar, Limits};
use crate::tally::tally;
use crate::{Mode, Settings};
use flockslam_messages::{DropReason, KeepReason, ScanTally, ScanView, Verdict};

/// Scans of so many lidars are compared; scans of further lidars are all kept.
const LIDARS_MAX: usize = 32;
/// Under overload one scan is filtered after so many that were shed: a robot without odometry must not be lost.
const SHED_IN_A_ROW_MAX: u32 = 3;

/// Judges scans one by one, each lidar against its own past.
///
/// ```
/// use flockslam_correlation_filter::{CorrelationFilter, Settings};
/// use flockslam_messages::{KeepReason, ScanBuffer};
///
/// // Three kept scans are needed to compare with; then equal scans are dropped, and one that differs is kept.
/// let circle = |radius_m: f32| ScanBuffer::from_ranges(&[radius_m; 360], -3.1, 0.01745);
/// let mut filter = CorrelationFilter::new(Settings::default());
/// let mut keep = Vec::new();
/// for radius_m in [2.0, 2.0, 2.0, 2.0, 2.0, 3.0] {
///     let verdict = filter.handle(circle(radius_m).view()?);
///     keep.push((verdict.keep, KeepReason::from_number(verdict.reason)));
/// }
/// assert_eq!(keep[..3], [(1, Some(KeepReason::FirstScans)); 3]);
/// assert_eq!(keep[3..], [(0, None), (0, None), (1, Some(KeepReason::Novel))]);
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Clone, Debug)]
pub struct CorrelationFilter {
    mode: Mode,
    limits: Limits,
    lidars: Vec<Lidar>,
}

impl CorrelationFilter {
    /// A filter that has seen nothing.
    pub fn new(settings: Settings) -> Self {
        Self::with_limits(settings.mode, Limits::default())
    }

    fn with_limits(mode: Mode, limits: Limits) -> Self {
        Self { mode, limits, lidars: Vec::with_capacity(LIDARS_MAX) }
    }

    /// Whether scans are compared by the sums of their beams: a [`ScanTally`].
    pub fn wants_tallies(&self) -> bool {
        self.mode == Mode::Correlation
    }

    /// Keeps or drops a scan. Nothing but earlier scans of the same lidar goes into it.
    pub fn handle(&mut self, scan: ScanView<'_>) -> Verdict {
        let whole = self.wants_tallies().then(|| tally(scan, 0..scan.len()));
        self.classify(scan, whole.as_ref(), false)
    }

    /// The same with the tally of the whole scan, made elsewhere, where one is wanted. While `overloaded`, most scans are
    /// dropped before they are read.
    pub fn classify(&mut self, scan: ScanView<'_>, tally: Option<&ScanTally>, overloaded: bool) -> Verdict {
        let (coefficient, decided) = self.decide(scan, tally, overloaded);
        let header = scan.header();
        Verdict {
            id: header.id,
            times: header.times,
            coefficient,
            keep: u32::from(decided.is_ok()),
            reason: decided.map_or_else(|drop| drop as u32, |keep| keep as u32),
        }
    }

    fn decide(&mut self, scan: ScanView<'_>, tally: Option<&ScanTally>, overloaded: bool) -> Decision {
        if scan.header().withheld != 0 {
            return (0.0, Err(DropReason::Withheld));
        }
        let lidar = self.lidar(scan.header().id.lidar);
        if let Some(lidar) = lidar.map(|place| &mut self.lidars[place]) {
            lidar.shed = if overloaded && lidar.shed < SHED_IN_A_ROW_MAX { lidar.shed + 1 } else { 0 };
            if lidar.shed > 0 {
                return (0.0, Err(DropReason::Overload));
            }
        }
        let empty = match tally {
            Some(tally) => tally.valid() == 0,
            None => (0..scan.len()).all(|beam| scan.valid_range_m(beam).is_none()),
        };
        let (mode, limits, odometry) = (self.mode, &self.limits, scan.odometry());
        match (lidar.map(|place| &mut self.lidars[place]), tally) {
            _ if empty => (0.0, Err(DropReason::Empty)),
            (Some(lidar), Some(tally)) if mode == Mode::Correlation => {
                lidar.by_correlation(Description::of(tally), odometry, limits)
            }
            (Some(lidar), _) if mode == Mode::SeedExact => match lidar.published.classify(scan) {
                None => (0.0, Err(DropReason::Empty)),
                Some((product, Some(keep))) => (product, Ok(keep)),
                Some((product, None)) => (product, Err(DropReason::Correlated)),
            },
            (Some(lidar), _) if mode == Mode::Motion => lidar.by_motion(odometry, limits),
            _ => (0.0, Ok(KeepReason::Unfiltered)),
        }
    }

    fn lidar(&mut self, number: u32) -> Option<usize> {
        let found = self.lidars.iter().position(|lidar| lidar.number == number);
        if found.is_none() && self.lidars.len() < LIDARS_MAX {
            self.lidars.push(Lidar::new(number, &self.limits));
            return Some(self.lidars.len() - 1);
        }
        found
    }
}

#[cfg(test)]
mod tests;
