//! Tests of the tracker with simulated people: followed, hidden, crossing, and with bad stamps.

use super::*;

const STEP_NS: i64 = 100_000_000;
const LASER: Point = Point { x_m: 0.0, y_m: -50.0 };

/// A few points on the near side of a person.
fn seen(x_m: f64, y_m: f64) -> [Point; 3] {
    [-0.1, 0.0, 0.1].map(|side| Point::new(x_m + side, y_m - 0.16))
}

#[test]
fn a_person_is_tracked_through_a_second_of_occlusion() {
    let mut tracker = Tracker::default();
    let mut ids = Vec::new();
    for i in 0..40 {
        let hidden = (20..30).contains(&i);
        let points = if hidden { vec![] } else { seen(0.1 * i as f64, 2.0).to_vec() };
        let tracks = tracker.follow(i * STEP_NS, &points, LASER);
        assert_eq!(tracks.len(), usize::from(i >= 2), "scan {i}");
        ids.extend(tracks.iter().map(|track| track.id));
        if let [track] = tracks {
            assert!(track.position.distance_m(Point::new(0.1 * i as f64, 2.0)) < 0.1);
            assert_eq!(track.unseen_s > 0.0, hidden);
        }
        if let ([track], true) = (tracks, i > 12) {
            assert!((track.velocity_m_s.x_m - 1.0).abs() < 0.1, "{track:?}");
            let ahead = Point::new(0.1 * i as f64 + 3.0, 2.0);
            assert!(track.predicted[2].distance_m(ahead) < 0.4, "{track:?}");
        }
    }
    assert!(ids.iter().all(|id| *id == ids[0]));
    // A track that stays out of sight ends.
    for i in 40..60 {
        tracker.follow(i * STEP_NS, &[], LASER);
    }
    assert!(tracker.follow(60 * STEP_NS, &[], LASER).is_empty());
}

#[test]
fn a_person_who_turns_while_occluded_keeps_the_track() {
    let mut tracker = Tracker::default();
    let mut last = Vec::new();
    for i in 0..40 {
        let x_m = if i < 22 { 0.12 * i as f64 } else { 0.12 * (44 - i) as f64 };
        let hidden = (18..27).contains(&i);
        let points = if hidden { vec![] } else { seen(x_m, 2.0).to_vec() };
        last = tracker.follow(i * STEP_NS, &points, LASER).to_vec();
    }
    assert!(matches!(last[..], [Track { id: 0, .. }]), "{last:?}");
    assert!(last[0].velocity_m_s.x_m < -0.8, "{last:?}");
}

#[test]
fn two_people_who_pass_each_other_keep_their_tracks() {
    let mut tracker = Tracker::default();
    let mut last = Vec::new();
    for i in 0..40 {
        let x_m = 0.12 * i as f64;
        let points: Vec<_> = seen(x_m, 2.0).into_iter().chain(seen(4.5 - x_m, 2.9)).collect();
        last = tracker.follow(i * STEP_NS, &points, LASER).to_vec();
    }
    assert_eq!(last.len(), 2);
    let of = |id: u64| last.iter().find(|track| track.id == id).unwrap();
    assert!(of(0).velocity_m_s.x_m > 1.0 && of(1).velocity_m_s.x_m < -1.0, "{last:?}");
}

#[test]
fn stamps_that_run_backwards_and_pauses_are_survived() {
    let mut tracker = Tracker::default();
    for stamp_ns in [0, STEP_NS, -STEP_NS, 2 * STEP_NS, 100 * STEP_NS, i64::MIN / 4] {
        for track in tracker.follow(stamp_ns, &seen(1.0, 1.0), LASER) {
            assert!(track.position.norm_m().is_finite() && track.velocity_m_s.norm_m() < 3.0);
        }
    }
    assert!(tracker.followed.len() < 4);
}
