//! Kidnapping detection: two scans contradict each other at every relative pose that odometry allows.

use super::ScanPoints;
use flockslam_geometry::elementary::{atan2, hypot};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanView;
use std::f64::consts::TAU;

/// Sectors of the full circle that a view is compared by, 2° each: lidars have beams at least so close together.
const SECTORS: usize = 180;
/// A point is in space that another view has seen to be free when it is nearer than all that this view shows around its direction, by
/// this much, metres and share of the range.
const NEARER: (f64, f64) = (0.3, 0.05);
/// So many points must lie in directions that both views show.
const COMMON_MIN: u32 = 20;
/// Two views contradict each other when these shares of their points lie in the other's free space: both together and the lesser,
/// or both together alone. Compared by raw odometry, 21 of 25 936 pairs of neighbouring scans in three logs reached the sum, where odometry was
/// wrong or people went by; of 24 pairs from before and after a kidnapping, 23.
const CONTRADICTED: (f64, f64) = (0.4, 0.1);
const CONTRADICTED_ALONE: f64 = 0.8;
/// So many scans in a row that fit badly and contradict the last explained one by these shares at the predicted pose, and by this sum wherever
/// else the robot may be, show the same. No three in a row did in three logs.
const CONTRADICTIONS_IN_A_ROW: u32 = 3;
const PARTLY_CONTRADICTED: (f64, f64) = (0.2, 0.03);
const CONTRADICTED_AROUND: f64 = 0.15;
/// Once a view is unexplained, a later one is too with these shares.
const STILL_CONTRADICTED: (f64, f64) = (0.25, 0.08);
/// A kick, or wheels that jump, leave a robot no farther than this from where odometry has it, or from where it was, metres and radians.
const KICKED: (f64, f64) = (0.65, 0.4);
/// Views from places farther apart than this, metres, hide much from each other.
const APART_M: f64 = 1.5;

/// What a scan shows.
#[derive(Debug, Default)]
struct View {
    /// Ends of beams in the robot's frame.
    ends: Vec<Point>,
    /// The lidar in the robot's frame.
    eye: Point,
    odom_from_base: Pose,
}

/// The last scan that the robot's way explains, and the present one.
#[derive(Debug, Default)]
pub(super) struct KidnapDetector {
    explained: View,
    present: View,
    /// Scans in a row that the way does not explain.
    unexplained: u32,
    /// Scans in a row that contradict it a little.
    contradicted: u32,
}

/// How far two views contradict each other: the shares of their points in the other's free space, both together and the lesser.
#[derive(Clone, Copy, Debug)]
struct Contradiction {
    sum: f64,
    lesser: f64,
}

/// The nearest end of a view by direction from the eye, metres; infinite where it shows nothing.
struct Outline {
    eye: Point,
    nearest_m: [f64; SECTORS],
}

impl KidnapDetector {
    /// Takes the points of a scan in, before any is set aside.
    pub(super) fn sees(&mut self, scan: ScanView<'_>, points: &ScanPoints) {
        self.present.ends.clone_from(&points.ends);
        self.present.eye = scan.header().base_from_laser.position();
    }

    /// Whether the present scan cannot have been taken where the robot may have driven to since the last one that its way explains: the pose
    /// predicted by odometry, the pose of before, and the pose of its fit. Asked of scans that fit badly, with odometry.
    pub(super) fn is_unexplained(&mut self, predicted: Pose, fit: Pose) -> bool {
        let before = self.explained.odom_from_base;
        let is_kicked = |from: Pose| fit.distance_m(from) <= KICKED.0 && fit.turn_rad(from) <= KICKED.1;
        let fit = Some(fit).filter(|_| is_kicked(predicted) || is_kicked(before));
        // Views that cannot be compared leave it as it was.
        if before.distance_m(predicted) > APART_M {
            return self.unexplained > 0;
        }
        let outlines = [&self.explained, &self.present].map(Outline::new);
        let found = |place: Pose| self.contradiction(&outlines, before.inverse() * place);
        let (found_there, found_around) =
            (found(predicted), [Some(before), fit].map(|place| place.and_then(found)));
        let candidates = found_there.iter().chain(found_around.iter().flatten());
        if candidates.clone().next().is_none() {
            return self.unexplained > 0;
        }
        let is_contradicted = found_there.is_some_and(|found| found.is_at_least(PARTLY_CONTRADICTED))
            && candidates.clone().all(|found| found.sum >= CONTRADICTED_AROUND);
        self.contradicted = if is_contradicted { self.contradicted + 1 } else { 0 };
        let limit = if self.unexplained > 0 { STILL_CONTRADICTED } else { CONTRADICTED };
        let is_plain = |found: &Contradiction| found.is_at_least(limit) || found.sum >= CONTRADICTED_ALONE;
        let is_unexplained = candidates.clone().all(is_plain) || self.contradicted >= CONTRADICTIONS_IN_A_ROW;
        self.unexplained = if is_unexplained { self.unexplained + 1 } else { 0 };
        is_unexplained
    }

    /// The present scan was taken at this pose.
    pub(super) fn explains(&mut self, odom_from_base: Pose) {
        std::mem::swap(&mut self.explained, &mut self.present);
        self.explained.odom_from_base = odom_from_base;
        (self.unexplained, self.contradicted) = (0, 0);
    }

    /// Whether the last scans, more than one, were not taken where the robot may have driven to.
    pub(super) fn is_likely(&self) -> bool {
        self.unexplained > 1
    }

    /// Drops what was seen.
    pub(super) fn clear(&mut self) {
        self.explained.ends.clear();
        (self.unexplained, self.contradicted) = (0, 0);
    }

    /// How far the two views contradict each other, the present one from `before_from_now`; `None` when they show too little in common.
    /// `outlines` are theirs.
    fn contradiction(&self, [before, now]: &[Outline; 2], before_from_now: Pose) -> Option<Contradiction> {
        let one = before.contradicted(&self.present, before_from_now)?;
        let other = now.contradicted(&self.explained, before_from_now.inverse())?;
        Some(Contradiction { sum: one + other, lesser: one.min(other) })
    }
}

impl Contradiction {
    fn is_at_least(&self, (sum, lesser): (f64, f64)) -> bool {
        self.sum >= sum && self.lesser >= lesser
    }
}

impl Outline {
    fn new(view: &View) -> Self {
        let mut nearest_m = [f64::INFINITY; SECTORS];
        for end in &view.ends {
            let (sector, range_m) = seen(*end, view.eye);
            nearest_m[sector] = nearest_m[sector].min(range_m);
        }
        Self { eye: view.eye, nearest_m }
    }

    /// The share of the ends of another view that lie in free space of this one, of those in directions that it shows.
    fn contradicted(&self, other: &View, view_from_other: Pose) -> Option<f64> {
        let (mut common, mut nearer) = (0u32, 0u32);
        for end in &other.ends {
            let (sector, range_m) = seen(view_from_other.apply(*end), self.eye);
            let around = [sector + SECTORS - 1, sector, sector + 1].map(|at| self.nearest_m[at % SECTORS]);
            if around.iter().all(|range| range.is_finite()) {
                let nearest_m = around.into_iter().fold(f64::INFINITY, f64::min);
                common += 1;
                nearer += u32::from(range_m < nearest_m - (NEARER.0 + NEARER.1 * nearest_m));
            }
        }
        (common >= COMMON_MIN).then(|| f64::from(nearer) / f64::from(common))
    }
}

/// The sector and the distance of a point from the eye, both in the robot's frame.
fn seen(point: Point, eye: Point) -> (usize, f64) {
    let (x, y) = (point.x_m - eye.x_m, point.y_m - eye.y_m);
    let turns = atan2(y, x) / TAU + 0.5;
    (((turns * SECTORS as f64) as usize).min(SECTORS - 1), hypot(x, y))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ends of 360 beams in a rectangle around the origin, seen from a pose in it, in the robot's frame. Beams in `hidden` end at
    /// a person half a metre away.
    fn view(half_x_m: f64, half_y_m: f64, at: Pose, hidden: std::ops::Range<usize>) -> View {
        let end = |beam: usize| {
            let angle = (beam as f64).to_radians();
            let (sin, cos) = (angle + at.heading_rad).sin_cos();
            let to_x = (half_x_m - at.x_m * cos.signum()) / cos.abs();
            let to_y = (half_y_m - at.y_m * sin.signum()) / sin.abs();
            let range = if hidden.contains(&beam) { 0.5 } else { to_x.min(to_y) };
            Point::new(range * angle.cos(), range * angle.sin())
        };
        View { ends: (0..360).map(end).collect(), eye: Point::new(0.0, 0.0), odom_from_base: at }
    }

    fn contradict(explained: View, present: View, before_from_now: Pose) -> Option<bool> {
        let outlines = [&explained, &present].map(Outline::new);
        let detector = KidnapDetector { explained, present, ..KidnapDetector::default() };
        let found = detector.contradiction(&outlines, before_from_now)?;
        Some(found.is_at_least(CONTRADICTED) || found.sum >= CONTRADICTED_ALONE)
    }

    const MIDDLE: Pose = Pose::IDENTITY;
    const NOBODY: std::ops::Range<usize> = 0..0;

    #[test]
    fn views_of_one_room_agree_where_they_were_taken() {
        let on = Pose::new(0.8, -0.5, 0.7);
        let views = || (view(4.0, 3.0, MIDDLE, NOBODY), view(4.0, 3.0, on, NOBODY));
        let (before, now) = views();
        assert_eq!(contradict(before, now, on), Some(false));
        let (before, now) = views();
        assert_eq!(contradict(before, now, Pose::new(0.5, -0.3, 0.7)), Some(false), "0.36 m off");
    }

    #[test]
    fn a_room_and_a_corridor_contradict_each_other() {
        let (room, corridor) = (view(4.0, 3.0, MIDDLE, NOBODY), view(14.0, 1.0, MIDDLE, NOBODY));
        assert_eq!(contradict(room, corridor, MIDDLE), Some(true));
    }

    #[test]
    fn people_around_the_robot_do_not_contradict_what_it_saw_before() {
        let (alone, surrounded) = (view(4.0, 3.0, MIDDLE, NOBODY), view(4.0, 3.0, MIDDLE, 20..260));
        assert_eq!(contradict(alone, surrounded, MIDDLE), Some(false));
    }

    #[test]
    fn views_with_little_in_common_are_not_compared() {
        let mut before = view(4.0, 3.0, MIDDLE, NOBODY);
        before.ends.truncate(180);
        let mut now = view(4.0, 3.0, MIDDLE, NOBODY);
        now.ends.truncate(180);
        assert_eq!(contradict(before, now, Pose::new(0.0, 0.0, 3.0)), None);
    }

    /// Whether four scans in a row are unexplained after one of the middle of a room.
    fn unexplained(mut present: impl FnMut() -> View) -> [bool; 4] {
        let mut detector =
            KidnapDetector { explained: view(4.0, 3.0, MIDDLE, NOBODY), ..KidnapDetector::default() };
        [(); 4].map(|()| {
            detector.present = present();
            detector.is_unexplained(MIDDLE, MIDDLE)
        })
    }

    #[test]
    fn a_slight_contradiction_counts_from_the_third_scan_in_a_row() {
        let near = || view(4.0, 3.0, MIDDLE, 20..70);
        assert_eq!(unexplained(near), [false; 4], "people hide the room");
        let shifted = || view(4.0, 3.0, Pose::new(0.0, 0.48, 0.0), NOBODY);
        assert_eq!(contradict(view(4.0, 3.0, MIDDLE, NOBODY), shifted(), MIDDLE), Some(false), "taken alone");
        assert_eq!(unexplained(shifted), [false, false, true, true]);
    }
}
