//! Tests of the filter with simulated rooms: what each mode keeps and drops, and why.

use super::*;
use flockslam_geometry::Pose;
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

/// The same with odometry that knows where the robot is.
fn driven(x: f64, y: f64, heading_rad: f64) -> ScanBuffer {
    let mut scan = room(x, y, heading_rad);
    (scan.header.odometry, scan.header.has_odometry) = (Pose::new(x, y, heading_rad), 1);
    scan
}

fn corridor() -> ScanBuffer {
    let step = std::f64::consts::PI / 180.0;
    let range = |i: i32| (1.2 / (f64::from(i - 90) * step).sin().abs()).min(50.0) as f32;
    ScanBuffer::from_ranges(&(0..180).map(range).collect::<Vec<_>>(), -std::f64::consts::FRAC_PI_2, step)
}

fn filter(mode: Mode) -> CorrelationFilter {
    CorrelationFilter::new(Settings { mode, ..Settings::default() })
}

fn reasons(filter: &mut CorrelationFilter, scans: impl IntoIterator<Item = ScanBuffer>) -> Vec<u32> {
    scans.into_iter().map(|scan| filter.handle(scan.view().unwrap()).reason).collect()
}

fn share(reasons: &[u32], wanted: u32) -> f64 {
    reasons.iter().filter(|reason| **reason == wanted).count() as f64 / reasons.len() as f64
}

#[test]
fn the_first_scans_are_kept_then_unchanged_ones_are_dropped_up_to_the_bound() {
    let limits = Limits { rest_drops_max: 3, ..Limits::default() };
    let mut filter = CorrelationFilter::with_limits(Mode::Correlation, limits);
    let found = reasons(&mut filter, (0..9).map(|_| room(3.0, 2.0, 0.3)));
    let (first, row, same) =
        (KeepReason::FirstScans as u32, KeepReason::InARow as u32, DropReason::Unchanged as u32);
    assert_eq!(found, [first, first, first, same, same, same, row, same, same]);
}

#[test]
fn at_rest_nearly_all_scans_are_dropped_also_with_noise() {
    for seed in [1, 12_345, 98_765_432] {
        let mut noise: u32 = seed;
        let scans = (0..1000).map(|_| {
            let mut scan = driven(3.0, 2.0, 0.3);
            for range in &mut scan.numbers {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *range += (noise >> 16) as f32 / 65536.0 * 0.06 - 0.03;
            }
            scan
        });
        let found = reasons(&mut filter(Mode::Correlation), scans);
        // All but the first ones and one in 41.
        assert!(share(&found, DropReason::Unchanged as u32) > 0.97, "seed {seed}");
    }
}

#[test]
fn slow_drift_is_seen_since_dropped_scans_do_not_enter_the_window() {
    let limits = Limits { consecutive_drops_max: u32::MAX, ..Limits::default() };
    let mut filter = CorrelationFilter::with_limits(Mode::Correlation, limits);
    let found = reasons(&mut filter, (0..600).map(|i| room(1.0 + f64::from(i) * 0.01, 2.0, 0.3)));
    let kept = found[3..].iter().filter(|reason| **reason == KeepReason::Novel as u32).count();
    assert!((2..200).contains(&kept), "{kept}");
}

#[test]
fn a_turn_on_the_spot_is_no_news_but_no_long_one_goes_unseen() {
    let scans = (0..100).map(|i| driven(3.0, 2.0, f64::from(i) * 0.03));
    let found = reasons(&mut filter(Mode::Correlation), scans);
    assert!(share(&found, DropReason::Correlated as u32) > 0.5);
    let mut unseen = 0;
    for reason in &found {
        unseen = if DropReason::from_number(*reason).is_some() { unseen + 1 } else { 0 };
        assert!(unseen <= 2);
    }
}

#[test]
fn travel_ends_a_row_of_drops() {
    let found =
        reasons(&mut filter(Mode::Correlation), (0..60).map(|i| driven(2.0 + f64::from(i) * 0.07, 2.0, 0.3)));
    assert!(share(&found, KeepReason::Travel as u32) > 0.3, "{found:?}");
    // Every second one, since two steps are more than may go unseen.
    assert!(found[4..].windows(2).all(|pair| pair.iter().any(|r| KeepReason::from_number(*r).is_some())));
}

#[test]
fn motion_uses_only_odometry() {
    let mut motion = filter(Mode::Motion);
    let found = reasons(&mut motion, (0..10).map(|i| driven(2.0 + f64::from(i) * 0.05, 2.0, 0.3)));
    let (first, drop, travel) =
        (KeepReason::FirstScans as u32, DropReason::Motion as u32, KeepReason::Travel as u32);
    assert_eq!(found, [first, drop, drop, travel, drop, drop, travel, drop, drop, travel]);
    let all_kept = reasons(&mut filter(Mode::Motion), (0..3).map(|_| room(2.0, 2.0, 0.3)));
    assert_eq!(all_kept, [first, KeepReason::Unfiltered as u32, KeepReason::Unfiltered as u32]);
    let rest = reasons(&mut filter(Mode::Motion), (0..100).map(|_| driven(2.0, 2.0, 0.3)));
    assert!(share(&rest, drop) > 0.95);
}

#[test]
fn empty_and_withheld_scans_are_dropped_in_every_mode_and_leave_no_trace() {
    for mode in [Mode::Correlation, Mode::SeedExact, Mode::Motion, Mode::Off] {
        let mut withheld = room(3.0, 2.0, 0.3);
        withheld.header.withheld = 1;
        let nothing = ScanBuffer::from_ranges(&[f32::NAN, f32::INFINITY], 0.0, 0.1);
        let scans = [withheld, nothing, ScanBuffer::default()];
        let empty = DropReason::Empty as u32;
        let mut used = filter(mode);
        assert_eq!(reasons(&mut used, scans), [DropReason::Withheld as u32, empty, empty]);
        let drive = || (0..8).map(|i| driven(2.0 + f64::from(i) * 0.03, 2.0, 0.3));
        assert_eq!(reasons(&mut used, drive()), reasons(&mut filter(mode), drive()), "{mode:?}");
    }
}

#[test]
fn a_corridor_keeps_its_scans() {
    let found = reasons(&mut filter(Mode::Correlation), (0..12).map(|_| corridor()));
    assert_eq!(found[4..], [KeepReason::Corridor as u32; 8]);
}

#[test]
fn a_constant_scan_that_stays_is_unchanged_and_one_that_grows_is_novel() {
    let circle = |radius_m: f32| ScanBuffer::from_ranges(&[radius_m; 360], -3.1, 0.01745);
    let found = reasons(&mut filter(Mode::Correlation), (0..6).map(|_| circle(2.0)).chain([circle(3.0)]));
    assert_eq!(
        found[4..],
        [DropReason::Unchanged as u32, DropReason::Unchanged as u32, KeepReason::Novel as u32]
    );
}

#[test]
fn overload_is_shed_but_for_one_in_four_and_ends_when_it_ends() {
    for mode in [Mode::Correlation, Mode::Off] {
        let mut filter = filter(mode);
        let mut classify = |overloaded| {
            let scan = room(3.0, 2.0, 0.3);
            let whole = tally(scan.view().unwrap(), 0..usize::MAX);
            filter.classify(scan.view().unwrap(), Some(&whole), overloaded).keep
        };
        let kept: Vec<u32> = (0..8).map(|_| classify(true)).collect();
        assert_eq!(kept, [0, 0, 0, 1, 0, 0, 0, 1]);
        assert_eq!([classify(false), classify(true)], [1, 0]);
    }
}

#[test]
fn each_lidar_has_its_own_past() {
    let of_lidar = |lidar| {
        let mut scan = room(3.0, 2.0, 0.3);
        scan.header.id.lidar = lidar;
        scan
    };
    let mut filter = filter(Mode::Correlation);
    let (first, same) = (KeepReason::FirstScans as u32, DropReason::Unchanged as u32);
    assert_eq!(reasons(&mut filter, (0..3).map(|_| of_lidar(0))), [first; 3]);
    assert_eq!(reasons(&mut filter, (0..4).map(|_| of_lidar(7))), [first, first, first, same]);
    assert_eq!(reasons(&mut filter, [of_lidar(0)]), [same]);
}

#[test]
fn settings_have_their_names_and_no_others() {
    let text = r#"{"mode": "seed-exact", "replicas": 2}"#;
    let read: Settings = serde_json::from_str(text).unwrap();
    assert_eq!(read, Settings { mode: Mode::SeedExact, replicas: 2 });
    assert!(serde_json::from_str::<Settings>(r#"{"treshold": 1}"#).is_err());
}

fn any_mode() -> impl Strategy<Value = Mode> {
    prop_oneof![Just(Mode::Correlation), Just(Mode::SeedExact), Just(Mode::Motion), Just(Mode::Off)]
}

/// Ranges of all kinds: anything, constants, nothing valid.
fn any_ranges() -> impl Strategy<Value = Vec<f32>> {
    prop_oneof![
        prop::collection::vec(any::<f32>(), 0..50),
        (any::<f32>(), 0_usize..50).prop_map(|(range, count)| vec![range; count]),
        prop::collection::vec(0.0_f32..20.0, 0..200),
        (0_usize..50).prop_map(|count| vec![f32::NAN; count]),
    ]
}

proptest! {
    #[test]
    fn any_ranges_get_a_defined_verdict(
        scans in prop::collection::vec((any_ranges(), any::<bool>(), -1e3_f64..1e3), 1..20),
        window in 0_usize..6, mode in any_mode(),
    ) {
        let mut filter = CorrelationFilter::with_limits(mode, Limits { window, ..Limits::default() });
        for (ranges, has_odometry, x_m) in scans {
            let mut scan = ScanBuffer::from_ranges(&ranges, -1.0, 0.1);
            (scan.header.odometry.x_m, scan.header.has_odometry) = (x_m, u32::from(has_odometry));
            let verdict = filter.handle(scan.view().unwrap());
            let named = match verdict.keep {
                0 => DropReason::from_number(verdict.reason).map(DropReason::name),
                _ => KeepReason::from_number(verdict.reason).map(KeepReason::name),
            };
            prop_assert!(named.is_some());
            prop_assert!((-1.0..=1.0).contains(&verdict.coefficient));
        }
    }
}
