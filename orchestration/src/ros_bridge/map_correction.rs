//! The transform map → odom as it is published: where poses of scans and odometry differ, stamped ahead, strictly increasing. Pure.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::{atan2, cos, sin};
use flockslam_transforms::{LookupError, TransformBuffer, planar};
use std::collections::VecDeque;

/// A pose waits for odometry at its time for so long, nanoseconds.
const WAIT_NS: i64 = 500_000_000;
/// Without poses the last correction holds for so long, nanoseconds: a dead lidar must stop the robot.
pub const COAST_NS: i64 = 1_000_000_000;
/// … and as long as odometry has drifted by no more than this, metres …
const COAST_M: f64 = 0.1;
/// … where it drifts by at most this share of its way: wheels that slip are not noticed without scans.
const DRIFT_SHARE: f64 = 0.1;
/// A correction that moves the robot by more than this is said before it is made: metres …
pub const JUMP_M: f64 = 0.1;
/// … and radians.
pub const JUMP_RAD: f64 = 0.035;
/// Larger corrections are made at once also where small ones are made step by step: metres …
const SLEWED_M: f64 = 0.3;
/// … and radians.
const SLEWED_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// A turn counts as the way of a point at this distance, metres.
const LEVER_M: f64 = 1.0;
/// Poses that wait.
const WAITING_MAX: usize = 64;

/// The transform from the frame of odometry to the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// `map_from_odom`.
    pub map_from_odom: Pose,
    /// The stamp to publish it with, nanoseconds.
    pub stamp_ns: i64,
    /// The scan that it is made of, by its stamp; `None` for one that is repeated.
    pub scan_ns: Option<i64>,
    /// How far it moves the robot against the one before, metres and radians.
    pub jump: (f64, f64),
}

/// Makes corrections of poses and odometry.
#[derive(Debug)]
pub struct MapCorrection {
    odom_frame: String,
    base_frame: String,
    waiting: VecDeque<(i64, Pose, i64)>,
    last: Option<Last>,
    last_stamp_ns: i64,
    /// A correction moves the robot by at most this, metres a second; 0 for any.
    pub rate_max_m_s: f64,
    /// Poses at whose time odometry is not known.
    pub without_odometry: u64,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    map_from_odom: Pose,
    /// By odometry at the scan; `None` of a robot without odometry in the graph.
    odom_from_base: Option<Pose>,
    scan_ns: i64,
    /// When it was made, and when it was repeated last, by the clock of the graph.
    made_ns: i64,
    sent_ns: i64,
}

impl MapCorrection {
    /// Of a robot whose odometry has these frames.
    pub fn new(odom_frame: &str, base_frame: &str) -> Self {
        Self {
            odom_frame: odom_frame.to_owned(),
            base_frame: base_frame.to_owned(),
            waiting: VecDeque::new(),
            last: None,
            last_stamp_ns: i64::MIN,
            rate_max_m_s: 0.0,
            without_odometry: 0,
        }
    }

    /// Takes the pose of a scan.
    pub fn push(&mut self, scan_ns: i64, map_from_base: Pose, now_ns: i64) {
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
            self.without_odometry += 1;
        }
        self.waiting.push_back((scan_ns, map_from_base, now_ns));
    }

    /// Takes a correction that is known: for a robot without odometry in the graph.
    pub fn set(&mut self, scan_ns: i64, map_from_odom: Pose, now_ns: i64, ahead_ns: i64) -> Correction {
        self.correct(scan_ns, map_from_odom, None, now_ns, ahead_ns)
    }

    /// The next correction that can be made.
    pub fn next(&mut self, transforms: &TransformBuffer, now_ns: i64, ahead_ns: i64) -> Option<Correction> {
        while let Some((scan_ns, map_from_base, since_ns)) = self.waiting.front().copied() {
            match transforms.lookup(&self.odom_frame, &self.base_frame, scan_ns) {
                Ok(odom_from_base) => {
                    self.waiting.pop_front();
                    let odom_from_base = planar(&odom_from_base);
                    let map_from_odom = map_from_base * odom_from_base.inverse();
                    return Some(self.correct(
                        scan_ns,
                        map_from_odom,
                        Some(odom_from_base),
                        now_ns,
                        ahead_ns,
                    ));
                }
                Err(LookupError::NotYet | LookupError::Unlinked)
                    if (0..WAIT_NS).contains(&now_ns.saturating_sub(since_ns)) =>
                {
                    return None;
                }
                Err(_) => {
                    self.waiting.pop_front();
                    self.without_odometry += 1;
                }
            }
        }
        None
    }

    fn correct(
        &mut self,
        scan_ns: i64,
        map_from_odom: Pose,
        by_odometry: Option<Pose>,
        now_ns: i64,
        ahead_ns: i64,
    ) -> Correction {
        let odom_from_base = by_odometry.unwrap_or(Pose::IDENTITY);
        let map_from_odom = self.last.map_or(map_from_odom, |last| {
            let limit_m = self.rate_max_m_s * scan_ns.saturating_sub(last.scan_ns).max(0) as f64 * 1e-9;
            slewed(last.map_from_odom, map_from_odom, odom_from_base, limit_m)
        });
        let moved = |last: Last| {
            let (before, after) = (last.map_from_odom * odom_from_base, map_from_odom * odom_from_base);
            (before.distance_m(after), before.turn_rad(after).abs())
        };
        let jump = self.last.map_or((0.0, 0.0), moved);
        self.last = Some(Last {
            map_from_odom,
            odom_from_base: by_odometry,
            scan_ns,
            made_ns: now_ns,
            sent_ns: now_ns,
        });
        let stamp_ns = self.stamp(scan_ns.saturating_add(ahead_ns));
        Correction { map_from_odom, stamp_ns, scan_ns: Some(scan_ns), jump }
    }

    /// The last correction once more, when `period_ns` has passed since it was sent; never once it is too old or odometry may have
    /// drifted too far.
    pub fn repeated(
        &mut self,
        transforms: &TransformBuffer,
        now_ns: i64,
        ahead_ns: i64,
        period_ns: i64,
    ) -> Option<Correction> {
        // Asked in each turn of the bridge: what costs least is looked at first.
        let is_due = |last: Last| now_ns.saturating_sub(last.sent_ns) >= period_ns;
        if period_ns <= 0 || !self.last.is_some_and(is_due) || self.is_silent(transforms, now_ns) {
            return None;
        }
        let last = self.last.as_mut()?;
        last.sent_ns = now_ns;
        let (map_from_odom, age_ns) = (last.map_from_odom, now_ns.saturating_sub(last.made_ns));
        let stamp_ns = last.scan_ns.saturating_add(age_ns).saturating_add(ahead_ns);
        let stamp_ns = self.stamp(stamp_ns);
        Some(Correction { map_from_odom, stamp_ns, scan_ns: None, jump: (0.0, 0.0) })
    }

    /// Whether the last correction is not to be published any more, as it is too old or odometry may have drifted too far since; true
    /// also before the first.
    pub fn is_silent(&self, transforms: &TransformBuffer, now_ns: i64) -> bool {
        // A clock that has gone back makes it old, too.
        self.last.is_none_or(|last| {
            !(0..=COAST_NS).contains(&now_ns.saturating_sub(last.made_ns))
                || self.drift_bound_m(transforms, &last) > COAST_M
        })
    }

    /// How far odometry may have drifted since the last correction, metres. A turn counts as the way of a point at [`LEVER_M`].
    fn drift_bound_m(&self, transforms: &TransformBuffer, last: &Last) -> f64 {
        let (odom, base) = (&self.odom_frame, &self.base_frame);
        let now = transforms
            .known_until_ns(odom, base)
            .and_then(|newest_ns| transforms.lookup(odom, base, newest_ns).ok());
        let Some((now, before)) = now.as_ref().map(planar).zip(last.odom_from_base) else { return 0.0 };
        DRIFT_SHARE * (before.distance_m(now) + LEVER_M * before.turn_rad(now).abs())
    }

    /// Clears everything: time has gone back, or another map begins.
    pub fn clear(&mut self) {
        self.waiting.clear();
        (self.last, self.last_stamp_ns) = (None, i64::MIN);
    }

    /// Subscribers reject repeated stamps.
    fn stamp(&mut self, wanted_ns: i64) -> i64 {
        self.last_stamp_ns = wanted_ns.max(self.last_stamp_ns.saturating_add(1));
        self.last_stamp_ns
    }
}

/// The correction on the way from one to another that moves the robot by no more than `limit_m`; the other where that is 0 or it is far.
fn slewed(from: Pose, to: Pose, odom_from_base: Pose, limit_m: f64) -> Pose {
    let (before, after) = (from * odom_from_base, to * odom_from_base);
    let (way_m, turn_rad) = (before.distance_m(after), after.heading_rad - before.heading_rad);
    let turn_rad = atan2(sin(turn_rad), cos(turn_rad));
    let whole_m = way_m.max(turn_rad.abs() * LEVER_M);
    if limit_m <= 0.0 || whole_m <= limit_m || way_m > SLEWED_M || turn_rad.abs() > SLEWED_RAD {
        return to;
    }
    let share = limit_m / whole_m;
    let between = Pose::new(
        before.x_m + share * (after.x_m - before.x_m),
        before.y_m + share * (after.y_m - before.y_m),
        before.heading_rad + share * turn_rad,
    );
    between * odom_from_base.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_transforms::{Isometry3, StampedTransform};

    const MS: i64 = 1_000_000;
    const AHEAD: i64 = 200 * MS;

    fn odometry(buffer: &mut TransformBuffer, stamp_ms: i64, x_m: f64) {
        buffer.insert(
            &StampedTransform {
                stamp_ns: stamp_ms * MS,
                parent: "odom".to_owned(),
                child: "base".to_owned(),
                parent_from_child: Isometry3::translation(x_m, 0.0, 0.0),
            },
            false,
        );
    }

    #[test]
    fn it_is_the_pose_of_the_scan_without_odometry_at_its_time() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        odometry(&mut buffer, 0, 0.0);
        odometry(&mut buffer, 100, 1.0);
        correction.push(50 * MS, Pose::new(0.7, 0.1, 0.0), 0);
        let found = correction.next(&buffer, 60 * MS, AHEAD).unwrap();
        assert!(found.map_from_odom.distance_m(Pose::new(0.2, 0.1, 0.0)) < 1e-9);
        assert_eq!((found.stamp_ns, found.scan_ns), (250 * MS, Some(50 * MS)));
        assert_eq!(correction.next(&buffer, 60 * MS, AHEAD), None);
    }

    #[test]
    fn a_pose_waits_for_odometry_and_not_for_ever() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        odometry(&mut buffer, 0, 0.0);
        correction.push(50 * MS, Pose::IDENTITY, 0);
        assert_eq!(correction.next(&buffer, 60 * MS, AHEAD), None);
        odometry(&mut buffer, 100, 1.0);
        assert!(correction.next(&buffer, 70 * MS, AHEAD).is_some());
        correction.push(150 * MS, Pose::IDENTITY, 150 * MS);
        assert_eq!(correction.next(&buffer, 700 * MS, AHEAD), None);
        odometry(&mut buffer, 200, 1.0);
        assert_eq!((correction.next(&buffer, 700 * MS, AHEAD), correction.without_odometry), (None, 1));
    }

    #[test]
    fn stamps_increase_whatever_comes() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        for stamp_ms in (0..1000).step_by(50) {
            odometry(&mut buffer, stamp_ms, 0.0);
        }
        let mut stamps = Vec::new();
        for (scan_ms, now_ms) in [(100, 120), (200, 230), (200, 240), (150, 250), (300, 400)] {
            correction.push(scan_ms * MS, Pose::IDENTITY, now_ms * MS);
            stamps.push(correction.next(&buffer, now_ms * MS, AHEAD).unwrap().stamp_ns);
            stamps.extend(
                correction.repeated(&buffer, (now_ms + 60) * MS, AHEAD, 50 * MS).map(|found| found.stamp_ns),
            );
        }
        assert_eq!(stamps.len(), 10);
        assert!(stamps.is_sorted_by(|a, b| a < b), "{stamps:?}");
    }

    #[test]
    fn without_poses_the_correction_is_published_for_another_second() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        odometry(&mut buffer, 100, 0.0);
        assert!(correction.is_silent(&buffer, 0));
        correction.push(100 * MS, Pose::IDENTITY, 110 * MS);
        correction.next(&buffer, 110 * MS, AHEAD).unwrap();
        assert_eq!(correction.repeated(&buffer, 130 * MS, AHEAD, 50 * MS), None);
        let repeated = correction.repeated(&buffer, 1000 * MS, AHEAD, 50 * MS).unwrap();
        assert_eq!((repeated.stamp_ns, repeated.scan_ns), ((100 + 890 + 200) * MS, None));
        assert_eq!(correction.repeated(&buffer, 1000 * MS, AHEAD, 0), None);
        assert_eq!(correction.repeated(&buffer, 1200 * MS, AHEAD, 50 * MS), None);
        assert!(correction.is_silent(&buffer, 1200 * MS) && correction.is_silent(&buffer, 50 * MS));
    }

    #[test]
    fn without_poses_it_holds_for_a_metre_of_way() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        odometry(&mut buffer, 100, 0.0);
        correction.push(100 * MS, Pose::IDENTITY, 110 * MS);
        correction.next(&buffer, 110 * MS, AHEAD).unwrap();
        odometry(&mut buffer, 300, 0.9);
        assert!(correction.repeated(&buffer, 300 * MS, AHEAD, 50 * MS).is_some());
        odometry(&mut buffer, 350, 1.1);
        assert_eq!(correction.repeated(&buffer, 360 * MS, AHEAD, 50 * MS), None);
        assert!(correction.is_silent(&buffer, 360 * MS));
    }

    #[test]
    fn a_jump_is_what_the_robot_makes_and_not_the_frame() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        // Far from the origin of odometry a small turn moves the frame by metres.
        odometry(&mut buffer, 0, 100.0);
        odometry(&mut buffer, 1000, 100.0);
        correction.push(100 * MS, Pose::new(100.0, 0.0, 0.0), 0);
        correction.next(&buffer, 0, AHEAD).unwrap();
        correction.push(200 * MS, Pose::new(100.3, 0.0, 0.02), 0);
        let (jump_m, jump_rad) = correction.next(&buffer, 0, AHEAD).unwrap().jump;
        assert!((jump_m - 0.3).abs() < 1e-9 && (jump_rad - 0.02).abs() < 1e-9);
    }

    #[test]
    fn small_corrections_may_be_made_step_by_step_and_large_ones_never_are() {
        let (mut correction, mut buffer) = (MapCorrection::new("odom", "base"), TransformBuffer::default());
        correction.rate_max_m_s = 0.5;
        odometry(&mut buffer, 0, 10.0);
        odometry(&mut buffer, 1000, 10.0);
        let mut robot_at = |stamp_ms: i64, pose: Pose| {
            correction.push(stamp_ms * MS, pose, 0);
            correction.next(&buffer, 0, AHEAD).unwrap().map_from_odom * Pose::new(10.0, 0.0, 0.0)
        };
        robot_at(100, Pose::new(10.0, 0.0, 0.0));
        let aside = Pose::new(10.0, 0.12, 0.0);
        let found = [200, 300, 400].map(|stamp_ms| robot_at(stamp_ms, aside).y_m);
        assert!(
            [0.05, 0.1, 0.12].iter().zip(found).all(|(expected, y)| (expected - y).abs() < 1e-9),
            "{found:?}"
        );
        let turned = robot_at(500, Pose::new(10.0, 0.12, 0.08));
        assert!((turned.heading_rad - 0.05).abs() < 1e-9);
        let far = Pose::new(11.0, 0.0, 0.0);
        assert!(robot_at(600, far).distance_m(far) < 1e-9);
    }
}
