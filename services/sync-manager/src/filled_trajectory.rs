//! A pose for every scan from the poses of a few: along the front end's path, along odometry, or on a curve, between known poses.

use crate::between::{Curve, Way};
use crate::pose_record::PoseRecord;
use flockslam_geometry::elementary::hypot;
use flockslam_registration::cloud::Placement;

/// The source of poses between known poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// The front end's path: its matches are better than odometry.
    FrontEnd,
    /// What the known poses themselves prove best: odometry, where there is any, or a smooth curve. The front end has only
    /// predicted there, and its path jumps at the next match.
    Measured,
}

impl Between {
    fn motion(self, from: &PoseRecord, to: &PoseRecord) -> Placement {
        match (self, from.odometry, to.odometry) {
            (Self::Measured, Some(from), Some(to)) => from.to(to),
            _ => from.odom.to(to.odom),
        }
    }
}

/// Poses for all records from the known ones, given as (record, pose) in ascending order of records.
///
/// Between two known records the motion that is known there is laid on both, and the two results are blended by the share
/// of the way; or both are joined by a curve. Where another trajectory begins nothing is blended: scans that were lost before it belong to it, the others to the
/// trajectory before.
pub fn filled(records: &[PoseRecord], known: &[(usize, Placement)], between: Between) -> Vec<Placement> {
    let Some(&(first, _)) = known.first() else {
        return records.iter().map(|r| r.odom).collect();
    };
    let carried = |anchor: (usize, Placement), i: usize| {
        anchor.1.compose(between.motion(&records[anchor.0], &records[i]))
    };
    let blended = |start: (usize, Placement), end: (usize, Placement), i: usize, share: f64| {
        carried(start, i).interpolate(&carried(end, i), share)
    };
    // Scans of several lidars are neither evenly spaced, nor do their stamps step forward.
    let is_of_several = records.windows(2).any(|pair| pair[0].id.lidar != pair[1].id.lidar);
    let way = match between {
        Between::FrontEnd => Way::Odometry,
        Between::Measured if is_of_several => Way::Odometry,
        Between::Measured => Way::chosen(records, known, |middle| {
            let (start, end, i) = (known[middle - 1], known[middle + 1], known[middle].0);
            blended(start, end, i, shares_of_way(between, &records[start.0..=end.0])[i - start.0])
        }),
    };
    let curve = (way != Way::Odometry).then(|| Curve::new(records, known, way));
    let mut poses: Vec<Placement> = (0..first).map(|i| carried(known[0], i)).collect();
    for (k, pair) in known.windows(2).enumerate() {
        let (start, end) = (pair[0].0, pair[1].0);
        poses.push(pair[0].1);
        if records[start].trajectory != records[end].trajectory {
            let after = |r: &PoseRecord| r.lost || r.trajectory == records[end].trajectory;
            poses.extend((start + 1..end).map(|i| carried(pair[usize::from(after(&records[i]))], i)));
        } else if let Some(curve) = curve.as_ref().filter(|curve| curve.spans(k)) {
            poses.extend((start + 1..end).map(|i| curve.at(k, i)));
        } else {
            let shares = shares_of_way(between, &records[start..=end]);
            poses.extend((start + 1..end).map(|i| blended(pair[0], pair[1], i, shares[i - start])));
        }
    }
    let last = known[known.len() - 1];
    poses.extend((last.0..records.len()).map(|i| carried(last, i)));
    poses
}

/// Share of the path at each record from the first to the last, by the motions that are blended: they err where the robot moves. A turn of
/// one radian counts as a metre.
fn shares_of_way(between: Between, records: &[PoseRecord]) -> Vec<f64> {
    let mut way = vec![0.0; records.len()];
    for i in 1..records.len() {
        let motion = between.motion(&records[i - 1], &records[i]);
        // The smallest step keeps records of a robot at rest apart.
        way[i] = way[i - 1] + hypot(motion.x_m, motion.y_m) + motion.heading_rad.abs() + 1e-6;
    }
    let whole = way[records.len() - 1];
    way.iter().map(|w| w / whole).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanId;

    /// A metre behind the one before it.
    fn record(i: usize) -> PoseRecord {
        PoseRecord {
            id: ScanId { sequence: i as u64, ..ScanId::default() },
            stamp_ns: i as i64,
            odom: Placement::new(i as f64, 0.0, 0.0),
            odometry: None,
            submap: 0,
            trajectory: 0,
            is_given: false,
            lost: false,
            continues: false,
        }
    }

    #[test]
    fn corrections_are_blended_along_the_way() {
        let records: Vec<_> = (0..12).map(record).collect();
        let known = [(1, Placement::new(1.0, 0.0, 0.0)), (9, Placement::new(9.0, 0.8, 0.0))];
        let poses = filled(&records, &known, Between::FrontEnd);
        assert_eq!(poses.len(), 12);
        for (i, pose) in poses.iter().enumerate() {
            let expected = 0.1 * (i.clamp(1, 9) - 1) as f64;
            assert!(
                (pose.y_m - expected).abs() < 1e-5 && (pose.x_m - i as f64).abs() < 1e-5,
                "{i}: {pose:?}"
            );
        }
        assert_eq!(filled(&records, &[], Between::FrontEnd)[3], records[3].odom);
    }

    #[test]
    fn lost_scans_belong_to_the_trajectory_that_begins_after_them() {
        let record =
            |i: usize| PoseRecord { trajectory: u32::from(i >= 6), lost: (3..6).contains(&i), ..record(i) };
        let records: Vec<_> = (0..10).map(record).collect();
        let known = [(1, Placement::new(1.0, 0.0, 0.0)), (6, Placement::new(6.0, 50.0, 0.0))];
        let poses = filled(&records, &known, Between::FrontEnd);
        let sides: Vec<bool> = poses.iter().map(|pose| pose.y_m > 25.0).collect();
        assert_eq!(sides, (0..10).map(|i| i >= 3).collect::<Vec<_>>());
    }

    /// Odometry errs in the turn at the end, the front end's path trembles all the time.
    #[test]
    fn a_robot_that_stands_stays_where_it_is_known_to_be() {
        let record = |i: usize| PoseRecord {
            odom: Placement::new(0.002 * (i % 2) as f64, 0.0, 0.0),
            odometry: Some(Placement::new(0.0, 0.0, if i < 30 { 0.0 } else { 0.03 })),
            ..record(i)
        };
        let records: Vec<_> = (0..=30).map(record).collect();
        let known = [(0, Placement::IDENTITY), (30, Placement::new(0.0, 0.0, 0.01))];
        let poses = filled(&records, &known, Between::Measured);
        let turned_rad = poses[..30].iter().map(|pose| pose.heading_rad.abs()).fold(0.0, f64::max);
        assert!(turned_rad < 1e-4, "{turned_rad}");
    }
}
