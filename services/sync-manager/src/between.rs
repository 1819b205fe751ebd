//! Poses of scans between known poses, by odometry or by a smooth curve (Catmull and Rom 1974); which of them is better is measured on known poses that are
//! left out.

use crate::pose_record::PoseRecord;
use flockslam_registration::cloud::Placement;

/// A curve spans at most so many scans from one known pose to the next; over more only odometry knows what happened.
const SPAN_MAX: u64 = 5;
/// A held-out test leaves one known pose out, so it spans about twice as many.
const HELD_OUT_SPAN_MAX: u64 = 2 * SPAN_MAX;
/// Motion below this is not used to choose an interpolation, metres (a radian counts as a metre).
const HELD_OUT_WAY_M: f64 = 0.02;
/// In use a stretch is half as long as in a held-out test. Of a curve that leaves at most this share of the error, more than of
/// odometry.
const CURVE_SHARE: f64 = 0.5;
/// Greatest error that one trial counts with: a single slip must not decide for all.
const HELD_OUT_ERROR_MAX_M: f64 = 0.1;
/// A step between stamps counts as this many times the usual one at least and at most.
const STEP: (f64, f64) = (0.3, 3.0);

/// How poses between two known ones are found.
///
/// Dead reckoning is not always the best account over a few scans: its stamps may lag behind the lidar's. A curve
/// through the known poses needs to know when a scan was taken, and of that either the stamps or the bare order of the
/// scans can be the better account. Which of the three it is, the known poses themselves tell: see [`Way::chosen`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// Along odometry.
    Odometry,
    /// A smooth curve; scans are evenly spaced.
    Evenly,
    /// A smooth curve; scans are spaced as their stamps say.
    ByStamps,
}

/// The records in time, as one [`Way`] sees it.
#[derive(Debug)]
pub(crate) struct Curve<'a> {
    records: &'a [PoseRecord],
    known: &'a [(usize, Placement)],
    /// When each record was taken, in scans or seconds.
    times: Vec<f64>,
}

impl Way {
    /// The interpolation that predicts known poses best from the known ones around them.
    pub fn chosen(
        records: &[PoseRecord],
        known: &[(usize, Placement)],
        by_odometry: impl Fn(usize) -> Placement,
    ) -> Self {
        let curves = [Self::Evenly, Self::ByStamps].map(|way| (way, Curve::new(records, known, way)));
        let mut errors_m = [0.0; 3];
        for middle in (1..known.len().saturating_sub(1)).filter(|m| is_held_out(records, known, *m)) {
            let error_m = |pose: Placement| {
                let (_, truth) = known[middle];
                (pose.distance_m(&truth) + pose.turn_rad(&truth)).min(HELD_OUT_ERROR_MAX_M)
            };
            errors_m[0] += error_m(by_odometry(middle));
            errors_m[1] += CURVE_SHARE * error_m(curves[0].1.held_out(middle));
            errors_m[2] += CURVE_SHARE * error_m(curves[1].1.held_out(middle));
        }
        let ways = [Self::Odometry, Self::Evenly, Self::ByStamps];
        let best = (0..3).min_by(|a, b| errors_m[*a].total_cmp(&errors_m[*b]));
        ways[best.expect("there are three")]
    }
}

impl<'a> Curve<'a> {
    /// The curve through the known poses, in the time base of an interpolation.
    pub fn new(records: &'a [PoseRecord], known: &'a [(usize, Placement)], way: Way) -> Self {
        let times = match way {
            Way::ByStamps => stamps(records),
            _ => records.iter().map(|record| record.id.sequence as f64).collect(),
        };
        Self { records, known, times }
    }

    /// Whether the stretch behind known pose `k` is short enough.
    pub fn spans(&self, k: usize) -> bool {
        spans(self.records, self.known[k].0, self.known[k + 1].0, SPAN_MAX)
    }

    /// The pose of a record between known poses `k` and `k + 1`.
    pub fn at(&self, k: usize, record: usize) -> Placement {
        self.bent([k.checked_sub(1), Some(k), Some(k + 1), Some(k + 2)], record)
    }

    /// Known pose `middle` from those around it.
    fn held_out(&self, middle: usize) -> Placement {
        let around = [middle.checked_sub(2), Some(middle - 1), Some(middle + 1), Some(middle + 2)];
        self.bent(around, self.known[middle].0)
    }

    /// A cubic between the two known poses in the middle whose tangents come from parabolas through three neighbours
    /// (Catmull and Rom 1974, for uneven times), in the frame of the first.
    fn bent(&self, around: [Option<usize>; 4], record: usize) -> Placement {
        let [before, Some(from), Some(to), after] = around else { unreachable!("both ends are known") };
        let trajectory = |k: usize| self.records[self.known[k].0].trajectory;
        let (start, origin) = self.known[from];
        let end = self.known[to].0;
        let span = self.times[end] - self.times[start];
        let motion = coordinates(origin.to(self.known[to].1));
        let share = ((self.times[record] - self.times[start]) / span).clamp(0.0, 1.0);
        // Slopes over the stretches before and after, and how long those are.
        let beside = |k: Option<usize>, forward: bool| {
            let k = k.filter(|k| *k < self.known.len() && trajectory(*k) == trajectory(from))?;
            let (other, pose) = self.known[k];
            let length = if forward {
                self.times[other] - self.times[end]
            } else {
                self.times[start] - self.times[other]
            };
            Some((length, coordinates(origin.to(pose))))
        };
        let (earlier, later) = (beside(before, false), beside(after, true));
        let mut bent = [0.0; 3];
        for (axis, value) in bent.iter_mut().enumerate() {
            let slope = motion[axis] / span;
            let tangent = |length: f64, other: f64| (other * span + slope * length) / (span + length);
            let left = earlier.map_or(slope, |(length, at)| tangent(length, -at[axis] / length));
            let right =
                later.map_or(slope, |(length, at)| tangent(length, (at[axis] - motion[axis]) / length));
            *value = hermite(share, motion[axis], span * left, span * right);
        }
        origin.compose(Placement::new(bent[0], bent[1], bent[2]))
    }
}

/// The cubic from 0 to `end` with these tangents (Hermite's form), at share `s` of the way.
fn hermite(s: f64, end: f64, left: f64, right: f64) -> f64 {
    let (squared, cubed) = (s * s, s * s * s);
    (cubed - 2.0 * squared + s) * left + (3.0 * squared - 2.0 * cubed) * end + (cubed - squared) * right
}

fn coordinates(pose: Placement) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.heading_rad]
}

fn spans(records: &[PoseRecord], from: usize, to: usize, most: u64) -> bool {
    records[from].trajectory == records[to].trajectory
        && records[to].id.sequence - records[from].id.sequence <= most
}

/// Whether known pose `middle` can be found from its neighbours and the robot moved there.
fn is_held_out(records: &[PoseRecord], known: &[(usize, Placement)], middle: usize) -> bool {
    let (before, after) = (known[middle - 1], known[middle + 1]);
    spans(records, before.0, after.0, HELD_OUT_SPAN_MAX)
        && before.1.distance_m(&after.1) + before.1.turn_rad(&after.1) >= HELD_OUT_WAY_M
}

/// Seconds from the first record on, always forward: a step that no robot's lidar makes counts as a usual one.
fn stamps(records: &[PoseRecord]) -> Vec<f64> {
    let step_s = |pair: &[PoseRecord]| pair[1].stamp_ns.saturating_sub(pair[0].stamp_ns) as f64 * 1e-9;
    let mut steps_s: Vec<f64> = records.windows(2).map(step_s).collect();
    steps_s.sort_by(f64::total_cmp);
    let usual_s = steps_s.get(steps_s.len() / 2).copied().filter(|s| *s > 0.0).unwrap_or(1.0);
    let mut times = Vec::with_capacity(records.len());
    let mut now_s = 0.0;
    for (i, _) in records.iter().enumerate() {
        if i > 0 {
            let step_s = step_s(&records[i - 1..=i]);
            let assumed_s = if step_s > 0.0 { step_s } else { usual_s };
            now_s += assumed_s.clamp(STEP.0 * usual_s, STEP.1 * usual_s);
        }
        times.push(now_s);
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filled_trajectory::{Between, filled};
    use flockslam_messages::ScanId;
    use proptest::prelude::*;

    /// Where a robot is that drives an arc at a speed that swings.
    fn truth(time_s: f64) -> Placement {
        let way_m = time_s - 0.3 * (0.8 * time_s).cos();
        Placement::new(5.0 * (0.2 * way_m).sin(), 5.0 * (1.0 - (0.2 * way_m).cos()), 0.2 * way_m)
    }

    /// Records of scans at these times, stamped so, whose odometry is so late.
    fn records(times_s: &[f64], stamps_s: &[f64], late_s: f64) -> Vec<PoseRecord> {
        let record = |(i, (time_s, stamp_s)): (usize, (&f64, &f64))| PoseRecord {
            id: ScanId { sequence: i as u64, ..ScanId::default() },
            stamp_ns: (stamp_s * 1e9) as i64,
            odom: truth(*time_s),
            odometry: Some(truth(time_s - late_s)),
            submap: 0,
            trajectory: 0,
            is_given: false,
            lost: false,
            continues: false,
        };
        times_s.iter().zip(stamps_s).enumerate().map(record).collect()
    }

    /// The interpolation chosen when every second record is known, and the greatest error of the others, metres.
    fn measured(records: &[PoseRecord]) -> (Way, f64) {
        let known: Vec<_> = records.iter().enumerate().step_by(2).map(|(i, r)| (i, r.odom)).collect();
        let by_odometry = |middle: usize| {
            let (before, after, i) = (known[middle - 1], known[middle + 1], known[middle].0);
            let carried = |(from, pose): (usize, Placement)| {
                pose.compose(records[from].odometry.unwrap().to(records[i].odometry.unwrap()))
            };
            carried(before).interpolate(&carried(after), 0.5)
        };
        let poses = filled(records, &known, Between::Measured);
        let inner = 3..records.len() - 3;
        let errors_m = inner.map(|i| poses[i].distance_m(&records[i].odom));
        (Way::chosen(records, &known, by_odometry), errors_m.fold(0.0, f64::max))
    }

    /// Steps of 0.1 s, and some of them twice or three times as long.
    fn uneven() -> Vec<f64> {
        let step_s = |i: usize| [0.1, 0.1, 0.3, 0.1, 0.2, 0.1, 0.1][i % 7];
        (0..120)
            .scan(0.0, |now_s, i| {
                *now_s += step_s(i);
                Some(*now_s)
            })
            .collect()
    }

    #[test]
    fn odometry_that_is_right_is_used() {
        let times_s = uneven();
        let even_s: Vec<f64> = (0..120).map(|i| f64::from(i) * 0.1).collect();
        let (way, error_m) = measured(&records(&times_s, &even_s, 0.0));
        assert_eq!(way, Way::Odometry);
        assert!(error_m < 1e-6, "{error_m}");
    }

    #[test]
    fn stamps_are_used_where_odometry_is_late() {
        let times_s = uneven();
        let (way, error_m) = measured(&records(&times_s, &times_s, 0.15));
        assert_eq!(way, Way::ByStamps);
        assert!(error_m < 0.01, "{error_m}");
    }

    #[test]
    fn the_order_is_used_where_odometry_and_stamps_are_bad() {
        let times_s: Vec<f64> = (0..120).map(|i| f64::from(i) * 0.1).collect();
        let stamps_s: Vec<f64> =
            (0..120_u32).map(|i| f64::from(i) * 0.1 + f64::from(i * i * 5 % 11) * 0.03).collect();
        let (way, error_m) = measured(&records(&times_s, &stamps_s, 0.25));
        assert_eq!(way, Way::Evenly);
        assert!(error_m < 0.005, "{error_m}");
    }

    #[test]
    fn a_long_stretch_is_left_to_odometry() {
        let times_s: Vec<f64> = (0..60).map(|i| f64::from(i) * 0.1).collect();
        let records = records(&times_s, &times_s, 0.0);
        let known: Vec<_> = (0..60).step_by(10).map(|i| (i, records[i].odom)).collect();
        let curve = Curve::new(&records, &known, Way::Evenly);
        assert!((0..5).all(|k| !curve.spans(k)));
        assert!(filled(&records, &known, Between::Measured)[35].distance_m(&records[35].odom) < 1e-6);
    }

    #[test]
    fn a_stamp_that_runs_back_or_leaps_steps_forward_by_at_most_three_usual_steps() {
        let times_s = [0.0, 0.1, 0.2, 0.15, 0.4, 90.0, 90.1];
        let steps = stamps(&records(&times_s, &times_s, 0.0));
        assert_eq!(steps.len(), times_s.len());
        let step_max_s = 0.3 + 1e-9;
        assert!(
            steps.windows(2).all(|pair| pair[1] > pair[0] && pair[1] - pair[0] <= step_max_s),
            "{steps:?}"
        );
    }

    proptest! {
        #[test]
        fn stamps_always_step_forward(stamps_s in prop::collection::vec(-1e3..1e3f64, 2..40)) {
            let times_s = stamps(&records(&stamps_s, &stamps_s, 0.0));
            let steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let (low, high) = steps_s.iter().fold((f64::MAX, 0.0f64), |(l, h), s| (l.min(*s), h.max(*s)));
            prop_assert!(low > 0.0 && high <= 1.001 * STEP.1 / STEP.0 * low, "{steps_s:?}");
        }
    }
}
