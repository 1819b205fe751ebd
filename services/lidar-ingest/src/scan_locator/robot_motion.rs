//! How the robot moves at the time of a scan and during it, by odometry and by its gyroscope.

use super::{Frames, Live, ODOMETRY_AGE_NS, ScanLocator, Sighting};
use flockslam_geometry::{Pose, Twist, wrap_angle};
use flockslam_messages::{HEADING_ONLY, ScanBuffer};
use flockslam_transforms::{Isometry3, LookupError, planar};

/// Where odometry has the robot at the end of a scan, or as far as it reaches.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionEnd {
    odom_from_base: Isometry3<f64>,
    /// For so long it is known, of the duration of the scan, seconds; `None`: to the end.
    extrapolated: Option<(f64, f64)>,
}

impl MotionEnd {
    /// The motion during the scan from the pose at its start; `None` where numbers are not finite.
    pub(super) fn motion_from(&self, from: Pose) -> Option<Pose> {
        let known = from.to(planar(&self.odom_from_base));
        let motion = self.extrapolated.map_or(known, |(known_s, duration_s)| {
            Twist::from_motion(known, known_s).motion_after(duration_s)
        });
        Some(motion).filter(|motion| motion.is_finite())
    }
}

impl ScanLocator {
    pub(super) fn integrate_gyro(&mut self, frames: &Frames) {
        let transforms = &self.transforms;
        self.gyro.integrate(|reading| {
            let base_from_imu = transforms.lookup(&frames.base, &reading.frame, reading.stamp_ns);
            base_from_imu.map(|transform| transform.rotation).unwrap_or_default()
        });
    }

    /// The heading by the gyro at a time, where it is asked for.
    pub(super) fn heading_at(&self, frames: &Frames, at_ns: i64) -> Result<f64, LookupError> {
        let has_odometry = self.odometry_frames.is_some() || frames.odom.is_some();
        if has_odometry && !self.gyro_leads {
            Err(LookupError::Unlinked)
        } else {
            self.gyro.heading_rad(at_ns)
        }
    }

    /// `odom_from_base` at a time.
    pub(super) fn odometry_in_space(
        &self,
        frames: &Frames,
        at_ns: i64,
    ) -> Result<Isometry3<f64>, LookupError> {
        if let Some((parent, child)) = &self.odometry_frames {
            let moved = self.odometry.lookup(parent, child, at_ns)?;
            let base = match *child == frames.base {
                true => Isometry3::identity(),
                false => self.transforms.lookup(child, &frames.base, at_ns).unwrap_or_default(),
            };
            return Ok(moved * base);
        }
        let odom = frames.odom.as_deref().ok_or(LookupError::Unlinked)?;
        self.transforms.lookup(odom, &frames.base, at_ns)
    }

    fn odometry_at(&self, frames: &Frames, at_ns: i64) -> Result<Pose, LookupError> {
        self.odometry_in_space(frames, at_ns).map(|pose| planar(&pose))
    }

    /// Where odometry has the robot at the last beam of a scan that began at a time. Live, where odometry reaches over half of the scan
    /// and no further, where it has the robot last.
    pub(super) fn motion_end(
        &self,
        frames: &Frames,
        sighting: &Sighting,
        from_ns: i64,
    ) -> Result<MotionEnd, LookupError> {
        let scan = match sighting {
            Sighting::Scan(scan) => scan.scan.view().ok().filter(|scan| scan.takes_time()),
            Sighting::Cloud(_) => None,
        };
        let duration_s = scan.map_or(0.0, |scan| scan.time_s(scan.len() - 1));
        if duration_s <= 0.0 {
            return Err(LookupError::Unlinked);
        }
        let until_ns = from_ns.saturating_add((duration_s * 1e9) as i64);
        let at_end = self.odometry_in_space(frames, until_ns);
        if at_end != Err(LookupError::NotYet) || self.live.is_none() {
            return at_end.map(|odom_from_base| MotionEnd { odom_from_base, extrapolated: None });
        }
        let known_ns = self.odometry_known_until_ns(frames).ok_or(LookupError::NotYet)?;
        let known_s = known_ns.saturating_sub(from_ns) as f64 * 1e-9;
        if known_s < 0.5 * duration_s {
            return Err(LookupError::NotYet);
        }
        let odom_from_base = self.odometry_in_space(frames, known_ns)?;
        Ok(MotionEnd { odom_from_base, extrapolated: Some((known_s, duration_s)) })
    }

    fn odometry_known_until_ns(&self, frames: &Frames) -> Option<i64> {
        match (&self.odometry_frames, &frames.odom) {
            (Some((parent, child)), _) => self.odometry.known_until_ns(parent, child),
            (None, Some(odom)) => self.transforms.known_until_ns(odom, &frames.base),
            (None, None) => None,
        }
    }

    /// The newest odometry, where it is not much older than a scan.
    pub(super) fn last_odometry(&self, frames: &Frames, stamp_ns: i64) -> Option<Pose> {
        let known_until_ns = self.odometry_known_until_ns(frames)?;
        let age_ns = stamp_ns.saturating_sub(known_until_ns);
        let is_near = (0..=ODOMETRY_AGE_NS).contains(&age_ns);
        let last = is_near.then(|| self.odometry_at(frames, known_until_ns).ok()).flatten()?;
        Some(match &self.live {
            None => last,
            Some(live) => {
                last * self.twist(live, frames, known_until_ns, last).motion_after(age_ns as f64 * 1e-9)
            }
        })
    }

    /// Last twist of the robot: from odometry, else from its last poses.
    fn twist(&self, live: &Live, frames: &Frames, until_ns: i64, last: Pose) -> Twist {
        let by_poses = || {
            let before = self.odometry_at(frames, until_ns - ODOMETRY_AGE_NS).ok()?;
            Some(Twist::from_motion(before.to(last), ODOMETRY_AGE_NS as f64 * 1e-9))
        };
        live.twist.or_else(by_poses).unwrap_or_default()
    }

    /// Gives a scan the pose by odometry, with the gyro's turns where these lead; the gyro's heading alone where there is no odometry.
    pub(super) fn add_odometry(
        &mut self,
        scan: &mut ScanBuffer,
        odometry: Option<Pose>,
        heading_rad: Option<f64>,
    ) {
        let odometry = odometry.filter(|pose| pose.is_finite());
        let header = &mut scan.header;
        match (odometry, heading_rad) {
            (Some(odometry), heading_rad) if self.gyro_leads => {
                let fused = self.fused.map_or(odometry, |(before, heading_before_rad, fused)| {
                    let motion = before.to(odometry);
                    let turned_rad =
                        heading_rad.zip(heading_before_rad).map(|(now, before)| wrap_angle(now - before));
                    fused * Pose { heading_rad: turned_rad.unwrap_or(motion.heading_rad), ..motion }
                });
                self.fused = Some((odometry, heading_rad, fused));
                (header.odometry, header.has_odometry) = (fused, 1);
            }
            (Some(odometry), _) => (header.odometry, header.has_odometry) = (odometry, 1),
            (None, Some(heading_rad)) => {
                (header.odometry, header.has_odometry) = (Pose::new(0.0, 0.0, heading_rad), HEADING_ONLY);
            }
            (None, None) => {}
        }
    }
}
