use crate::correlation::correlation;
use crate::corridor::corridor_share;
use crate::description::Description;
use crate::{Mode, Settings};
use flockslam_messages::{DropReason, ScanView, Verdict};

/// Scans of so many lidars are told apart; those of further ones are all kept.
const LIDARS_MAX: usize = 32;

/// Judges scans one by one, each lidar against its own past.
///
/// Only kept scans enter the window: a slow drift adds up until it is seen.
#[derive(Clone, Debug)]
pub struct CorrelationFilter {
    settings: Settings,
    lidars: Vec<Window>,
}

/// The last kept scans of one lidar.
#[derive(Clone, Debug)]
struct Window {
    lidar: u32,
    /// A ring; `next` is the place of the oldest.
    kept: Vec<Description>,
    next: usize,
    drops_in_a_row: u32,
}

impl CorrelationFilter {
    /// A filter that has seen nothing.
    pub fn new(settings: Settings) -> Self {
        Self { settings, lidars: Vec::with_capacity(LIDARS_MAX) }
    }

    /// Keeps or drops a scan. Nothing but earlier scans of the same lidar goes into it.
    pub fn handle(&mut self, scan: ScanView<'_>) -> Verdict {
        if scan.header().withheld != 0 {
            return verdict(scan, f64::NAN, Some(DropReason::Withheld));
        }
        if self.settings.mode == Mode::Off {
            let empty = (0..scan.len()).all(|beam| scan.valid_range_m(beam).is_none());
            return verdict(scan, f64::NAN, empty.then_some(DropReason::Empty));
        }
        let description = Description::of(scan);
        if description.valid == 0 {
            return verdict(scan, f64::NAN, Some(DropReason::Empty));
        }
        self.judge(scan, description)
    }

    fn judge(&mut self, scan: ScanView<'_>, description: Description) -> Verdict {
        let Some(place) = self.window_of(scan.header().id.lidar) else {
            return verdict(scan, f64::NAN, None);
        };
        let (settings, window) = (&self.settings, &mut self.lidars[place]);
        let (profile, histogram) = window.smallest_correlations(&description);
        let redundant = settings.window > 0
            && window.kept.len() >= settings.window
            && window.drops_in_a_row < settings.consecutive_drops_max
            && profile > settings.profile_threshold
            && histogram > settings.histogram_threshold
            && corridor_share(scan) <= settings.corridor_max;
        if redundant {
            window.drops_in_a_row += 1;
        } else {
            window.keep(description, settings.window);
        }
        verdict(scan, profile.min(histogram), redundant.then_some(DropReason::Correlated))
    }

    fn window_of(&mut self, lidar: u32) -> Option<usize> {
        let found = self.lidars.iter().position(|window| window.lidar == lidar);
        if found.is_none() && self.lidars.len() < LIDARS_MAX {
            let kept = Vec::with_capacity(self.settings.window);
            self.lidars.push(Window { lidar, kept, next: 0, drops_in_a_row: 0 });
            return Some(self.lidars.len() - 1);
        }
        found
    }
}

impl Window {
    /// The smallest correlation of the profile, and of the histogram, with a kept scan; NaN when there is none.
    fn smallest_correlations(&self, new: &Description) -> (f64, f64) {
        self.kept.iter().fold((f64::NAN, f64::NAN), |(profile, histogram), old| {
            (
                profile.min(correlation(&new.profile_m, &old.profile_m)),
                histogram.min(correlation(&new.histogram, &old.histogram)),
            )
        })
    }

    fn keep(&mut self, description: Description, size: usize) {
        self.drops_in_a_row = 0;
        if self.kept.len() < size {
            self.kept.push(description);
        } else if size > 0 {
            self.kept[self.next] = description;
            self.next = (self.next + 1) % size;
        }
    }
}

fn verdict(scan: ScanView<'_>, coefficient: f64, dropped: Option<DropReason>) -> Verdict {
    let header = scan.header();
    Verdict {
        id: header.id,
        times: header.times,
        coefficient,
        keep: u32::from(dropped.is_none()),
        reason: dropped.map_or(0, |reason| reason as u32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;
    use proptest::prelude::*;

    /// A rectangular room of 8 m × 5 m, seen from (x, y) with 360 beams over the circle.
    fn room(x: f64, y: f64, heading_rad: f64) -> ScanBuffer {
        let step = std::f64::consts::TAU / 360.0;
        let range = |i: i32| {
            let (sin, cos) = (f64::from(i) * step - std::f64::consts::PI + heading_rad).sin_cos();
            let along_x = if cos > 0.0 { (8.0 - x) / cos } else { -x / cos };
            let along_y = if sin > 0.0 { (5.0 - y) / sin } else { -y / sin };
            along_x.min(along_y) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), -std::f64::consts::PI, step)
    }

    fn reasons(filter: &mut CorrelationFilter, scans: impl IntoIterator<Item = ScanBuffer>) -> Vec<u32> {
        scans.into_iter().map(|scan| filter.handle(scan.view().unwrap()).reason).collect()
    }

    #[test]
    fn the_first_scans_are_kept_then_equal_ones_are_dropped_up_to_the_bound() {
        let mut filter =
            CorrelationFilter::new(Settings { window: 3, consecutive_drops_max: 3, ..Settings::default() });
        let found = reasons(&mut filter, (0..12).map(|_| room(3.0, 2.0, 0.3)));
        assert_eq!(found, [0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 0, 1]);
    }

    #[test]
    fn slow_drift_is_seen_since_dropped_scans_do_not_enter_the_window() {
        let settings = Settings { consecutive_drops_max: u32::MAX, ..Settings::default() };
        let mut filter = CorrelationFilter::new(settings);
        let found = reasons(&mut filter, (0..600).map(|i| room(1.0 + f64::from(i) * 0.01, 2.0, 0.3)));
        let kept = found[3..].iter().filter(|reason| **reason == 0).count();
        assert!((2..200).contains(&kept), "{kept}");
    }

    #[test]
    fn empty_and_withheld_scans_are_dropped_in_every_mode_and_leave_no_trace() {
        for mode in [Mode::Correlation, Mode::Off] {
            let mut filter = CorrelationFilter::new(Settings { mode, ..Settings::default() });
            let mut withheld = room(3.0, 2.0, 0.3);
            withheld.header.withheld = 1;
            let nothing = ScanBuffer::from_ranges(&[f32::NAN, f32::INFINITY], 0.0, 0.1);
            let scans = [withheld, nothing, ScanBuffer::default(), room(3.0, 2.0, 0.3)];
            let empty = DropReason::Empty as u32;
            assert_eq!(reasons(&mut filter, scans), [DropReason::Withheld as u32, empty, empty, 0]);
        }
    }

    #[test]
    fn a_corridor_keeps_its_scans() {
        let corridor = || {
            let step = std::f64::consts::PI / 180.0;
            let range = |i: i32| (1.2 / (f64::from(i - 90) * step).sin().abs()).min(50.0) as f32;
            ScanBuffer::from_ranges(
                &(0..180).map(range).collect::<Vec<_>>(),
                -std::f64::consts::FRAC_PI_2,
                step,
            )
        };
        let mut filter = CorrelationFilter::new(Settings::default());
        assert_eq!(reasons(&mut filter, (0..12).map(|_| corridor())), [0; 12]);
    }

    #[test]
    fn each_lidar_has_its_own_past() {
        let of_lidar = |lidar| {
            let mut scan = room(3.0, 2.0, 0.3);
            scan.header.id.lidar = lidar;
            scan
        };
        let mut filter = CorrelationFilter::new(Settings { window: 3, ..Settings::default() });
        assert_eq!(reasons(&mut filter, (0..3).map(|_| of_lidar(0))), [0; 3]);
        assert_eq!(reasons(&mut filter, (0..4).map(|_| of_lidar(7))), [0, 0, 0, 1]);
        assert_eq!(reasons(&mut filter, [of_lidar(0)]), [1]);
    }

    #[test]
    fn settings_have_their_names_and_no_others() {
        let text = r#"{"mode": "off", "window": 2}"#;
        let read: Settings = serde_json::from_str(text).unwrap();
        assert_eq!(read, Settings { mode: Mode::Off, window: 2, ..Settings::default() });
        assert!(serde_json::from_str::<Settings>(r#"{"treshold": 1}"#).is_err());
    }

    #[test]
    fn judging_a_scan_takes_microseconds() {
        let scan = room(3.0, 2.0, 0.3);
        let mut filter = CorrelationFilter::new(Settings::default());
        let start = std::time::Instant::now();
        let kept: u32 = (0..10_000).map(|_| filter.handle(scan.view().unwrap()).keep).sum();
        println!("one of 360 beams: {:.2} µs, {kept} kept", start.elapsed().as_secs_f64() * 1e6 / 10_000.0);
    }

    proptest! {
        #[test]
        fn any_ranges_get_a_defined_verdict(
            scans in prop::collection::vec(prop::collection::vec(any::<f32>(), 0..50), 1..20), window in 0_usize..6,
        ) {
            let mut filter = CorrelationFilter::new(Settings { window, ..Settings::default() });
            for ranges in scans {
                let verdict = filter.handle(ScanBuffer::from_ranges(&ranges, -1.0, 0.1).view().unwrap());
                prop_assert_eq!(verdict.keep == 1, verdict.reason == 0);
                prop_assert!(verdict.coefficient.is_nan() || (-1.0..=1.0).contains(&verdict.coefficient));
            }
        }
    }
}
