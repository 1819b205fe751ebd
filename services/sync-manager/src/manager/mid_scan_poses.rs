//! Poses at the stamps of scans that take time, from where the robot was in the middle of each: that its points show best.

use crate::pose_record::PoseRecord;
use flockslam_geometry::Twist;
use flockslam_messages::ScanView;
use flockslam_registration::cloud::Placement;

/// The scans before and after must be so near, in times that the scan takes: then the robot does much the same during all three.
const NEAR: f64 = 2.5;
/// A pose that this would move farther stays, metres and radians: one of the three is wrong.
const MOVE_MAX: (f64, f64) = (0.06, 0.06);

/// The middle of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MidScan {
    /// Seconds after the stamp; 0 where all beams are taken at once.
    after_s: f32,
    /// The motion until then by the velocity that has straightened the scan: metres, metres, radians.
    motion: [f32; 3],
}

/// A scan at its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Its record.
    pub(super) record: usize,
    /// The pose at its stamp.
    pub(super) pose: Placement,
    pub(super) middle: MidScan,
}

impl MidScan {
    /// Of a scan that was straightened by this velocity.
    pub(super) fn of(scan: ScanView<'_>, twist: Twist) -> Self {
        if !scan.takes_time() || scan.is_empty() {
            return Self::default();
        }
        let after_s = 0.5 * scan.time_s(scan.len() - 1);
        let motion = twist.motion_after(after_s);
        let motion = [motion.x_m, motion.y_m, motion.heading_rad].map(|value| value as f32);
        Self { after_s: after_s as f32, motion }
    }

    fn motion(&self) -> Placement {
        let [x_m, y_m, heading_rad] = self.motion.map(f64::from);
        Placement::new(x_m, y_m, heading_rad)
    }
}

/// Poses at the stamps, as (record, pose). The velocity by which a scan is straightened is noisy. An error of it moves the pose at the stamp one
/// way and that at the end of the scan the other way, and leaves that in its middle as it is. So where scans follow on each other, the pose
/// at a stamp is that of the cubic through the middles of the scan, the two before and the one after: as many on either side of the stamp, so
/// that a robot that begins to turn there does not bend it. Where only one came before, it is that of the parabola.
pub(super) fn at_stamps(records: &[PoseRecord], samples: &[Sample]) -> Vec<(usize, Placement)> {
    let middles: Vec<Placement> = samples.iter().map(|s| s.pose.compose(s.middle.motion())).collect();
    let at_stamp = |(i, sample): (usize, &Sample)| {
        let pose = by_curve(records, samples, &middles, i).filter(|pose| {
            pose.distance_m(&sample.pose) <= MOVE_MAX.0 && pose.turn_rad(&sample.pose) <= MOVE_MAX.1
        });
        (sample.record, pose.unwrap_or(sample.pose))
    };
    samples.iter().enumerate().map(at_stamp).collect()
}

fn by_curve(
    records: &[PoseRecord],
    samples: &[Sample],
    middles: &[Placement],
    i: usize,
) -> Option<Placement> {
    let after_s = f64::from(samples[i].middle.after_s);
    if after_s <= 0.0 {
        return None;
    }
    let of = |j: usize| &records[samples[j].record];
    // Seconds from the middle of this scan to that of another.
    let later_s = |j: usize| {
        let stamps_s = of(j).stamp_ns.saturating_sub(of(i).stamp_ns) as f64 * 1e-9;
        stamps_s + f64::from(samples[j].middle.after_s) - after_s
    };
    let belongs = |j: &usize| {
        let (it, this) = (of(*j), of(i));
        it.id.lidar == this.id.lidar && it.trajectory == this.trajectory && samples[*j].middle.after_s > 0.0
    };
    let before = (0..i).rev().find(belongs)?;
    let after = (i + 1..samples.len()).find(belongs)?;
    let (before_s, next_s) = (later_s(before), later_s(after));
    let reach_s = NEAR * 2.0 * after_s;
    if !(-reach_s..0.0).contains(&before_s) || !(after_s..=reach_s).contains(&next_s) {
        return None;
    }
    let earlier = (0..before).rev().find(belongs).map(|j| (j, later_s(j)));
    let earlier = earlier.filter(|(_, earlier_s)| (before_s - reach_s..before_s).contains(earlier_s));
    let known = [Some((before, before_s)), Some((after, next_s)), earlier];
    // In the frame of the middle of this scan, whose own share is thus 0.
    let mut at = [0.0; 3];
    for (j, time_s) in known.into_iter().flatten() {
        let others =
            known.into_iter().flatten().map(|(_, other_s)| other_s).filter(|other_s| *other_s != time_s);
        let (share, bend) = shares(-after_s, time_s, others.chain([0.0]));
        let pose = middles[i].to(middles[j]);
        // A heading in the middle is the mean of those during the scan, which a robot that begins to turn leaves along a curve of its own.
        let of_heading = share - after_s * after_s / 6.0 * bend;
        at = [at[0] + share * pose.x_m, at[1] + share * pose.y_m, at[2] + of_heading * pose.heading_rad];
    }
    Some(middles[i].compose(Placement::new(at[0], at[1], at[2])))
}

/// Lagrange's polynomial that is 1 at a time and 0 at two or three others: its value at `at_s`, and its second derivative there.
fn shares(at_s: f64, time_s: f64, others_s: impl Iterator<Item = f64>) -> (f64, f64) {
    // Value, first and second derivative of the product so far.
    let product = others_s.fold((1.0, 0.0, 0.0), |(value, slope, bend), other_s| {
        let (factor, of_factor) = ((at_s - other_s) / (time_s - other_s), 1.0 / (time_s - other_s));
        (value * factor, slope * factor + value * of_factor, bend * factor + 2.0 * slope * of_factor)
    });
    (product.0, product.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::{PoseEstimate, ScanId};

    /// Where a robot is that turns on the spot, faster and faster.
    fn truth(time_s: f64) -> Placement {
        Placement::new(1.0, 2.0, time_s * time_s)
    }

    fn record(number: usize, lidar: u32) -> PoseRecord {
        let id = ScanId { sequence: number as u64, lidar, ..ScanId::default() };
        let mut pose = PoseEstimate { id, ..PoseEstimate::default() };
        pose.times.sensor_ns = number as i64 * 100_000_000;
        PoseRecord::new(&pose)
    }

    /// A scan of a tenth of a second, straightened by a velocity of turning that is off by so much.
    fn sample(number: usize, off_rad_s: f64) -> Sample {
        let (stamp_s, after_s) = (0.1 * number as f64, 0.05);
        let there = truth(stamp_s + after_s);
        // A fit finds the mean heading of a scan.
        let middle = Placement::new(there.x_m, there.y_m, there.heading_rad + 2.0 * 0.1 * 0.1 / 24.0);
        let turn_rad_s = 2.0 * (stamp_s + after_s) + off_rad_s;
        let motion = Twist { turn_rad_s, ..Twist::default() }.motion_after(after_s);
        let motion = [motion.x_m, motion.y_m, motion.heading_rad];
        let pose = middle.compose(Placement::new(motion[0], motion[1], motion[2]).inverse());
        let middle = MidScan { after_s: after_s as f32, motion: motion.map(|value| value as f32) };
        Sample { record: number, pose, middle }
    }

    fn off_rad(number: usize) -> f64 {
        if number.is_multiple_of(2) { 0.1 } else { -0.1 }
    }

    #[test]
    fn a_wrong_velocity_does_not_move_the_pose_at_the_stamp() {
        let records: Vec<_> = (0..20).map(|number| record(number, 0)).collect();
        let samples: Vec<_> = (0..20).map(|number| sample(number, off_rad(number))).collect();
        let poses = at_stamps(&records, &samples);
        for (number, pose) in &poses[1..19] {
            let truth = truth(0.1 * *number as f64);
            assert!(pose.distance_m(&truth) < 1e-3, "{number}: {pose:?} {truth:?}");
            assert!(pose.turn_rad(&truth) < 3e-4, "{number}: {pose:?} {truth:?}");
            assert!(samples[*number].pose.turn_rad(&truth) > 2e-3);
        }
    }

    #[test]
    fn a_robot_that_begins_to_turn_at_a_stamp_has_its_heading_there() {
        // It turns faster and faster from the tenth scan on.
        let truth_rad = |time_s: f64| 2.0 * (time_s - 1.0).max(0.0) * (time_s - 1.0).max(0.0);
        let records: Vec<_> = (0..20).map(|number| record(number, 0)).collect();
        let seen = |number: usize| {
            let beams = (0..100).map(|beam| truth_rad(0.1 * number as f64 + 0.001 * f64::from(beam)));
            let heading_rad = beams.sum::<f64>() / 100.0;
            let turn_rad = 0.05 * 4.0 * (0.1 * number as f64 - 0.95).max(0.0);
            let middle = MidScan { after_s: 0.05, motion: [0.0, 0.0, turn_rad as f32] };
            Sample { record: number, pose: Placement::new(1.0, 2.0, heading_rad - turn_rad), middle }
        };
        let samples: Vec<_> = (0..20).map(seen).collect();
        let off_rad = |number: usize| {
            let (_, pose) = at_stamps(&records, &samples)[number];
            (pose.heading_rad - truth_rad(0.1 * number as f64)).abs()
        };
        // The parabola is off by 0.0024.
        for number in 9..12 {
            assert!(off_rad(number) < 0.0012, "{number}: {}", off_rad(number));
        }
    }

    #[test]
    fn a_pose_stays_where_scans_are_missing_or_of_another_lidar_or_taken_at_once() {
        let stays = |records: &[PoseRecord], samples: &[Sample]| {
            let poses = at_stamps(records, samples);
            poses.iter().zip(samples).all(|((_, pose), sample)| *pose == sample.pose)
        };
        let records: Vec<_> = (0..20).map(|number| record(number, number as u32 % 3)).collect();
        let samples: Vec<_> = (0..20).map(|number| sample(number, off_rad(number))).collect();
        assert!(stays(&records, &samples), "the next scan of a lidar comes after three tenths of a second");
        let records: Vec<_> = (0..20).map(|number| record(number, 0)).collect();
        let few: Vec<_> = (0..20).step_by(4).map(|number| sample(number, off_rad(number))).collect();
        assert!(stays(&records, &few));
        let at_once: Vec<_> = samples.iter().map(|s| Sample { middle: MidScan::default(), ..*s }).collect();
        assert!(stays(&records, &at_once));
    }
}
