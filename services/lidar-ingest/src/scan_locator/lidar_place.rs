//! Where the lidar of a scan sits on the robot.

use super::{BASE_FRAMES, Frames, LocateError, ScanLocator, Sighting};
use flockslam_messages::ScanBuffer;
use flockslam_transforms::{Isometry3, Mounting, MountingError};

/// Where a lidar sits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// In space.
    pub base_from_laser: Isometry3<f64>,
    /// In the plane, where it scans there.
    mounting: Result<Mounting, MountingError>,
}

impl ScanLocator {
    /// Where a lidar sat when it has seen this.
    pub(super) fn sits_at(
        &mut self,
        frames: &Frames,
        lidar: u32,
        sighting: &Sighting,
    ) -> Result<Place, LocateError> {
        let base_from_laser = match sighting.mounting() {
            Some(mounting) if self.settings.lidars.get(lidar as usize).is_none() => mounting.in_space(),
            _ => self.place(frames, lidar, sighting.frame(), sighting.stamp_ns())?,
        };
        let same = |last: &&Place| last.base_from_laser == base_from_laser;
        let place = self.last_places.get(&lidar).filter(same).copied().unwrap_or_else(|| Place {
            base_from_laser,
            mounting: Mounting::from_transform(&base_from_laser),
        });
        if let (Sighting::Scan(_), Err(problem)) = (sighting, place.mounting) {
            return Err(LocateError::Tilted { frame: sighting.frame().to_owned(), problem });
        }
        self.last_places.insert(lidar, place);
        Ok(place)
    }

    /// A scan with the place of its lidar, in the plane.
    pub(super) fn mounted(&self, mut scan: ScanBuffer, lidar: u32, place: &Place) -> ScanBuffer {
        let Ok(mounting) = place.mounting else { return scan };
        let mirrored = self.settings.lidars.get(lidar as usize).is_some_and(|given| given.mirrored);
        let header = &mut scan.header;
        header.base_from_laser = mounting.base_from_laser;
        if mounting.upside_down != mirrored {
            header.angle_min_rad = -header.angle_min_rad;
            header.angle_increment_rad = -header.angle_increment_rad;
        }
        scan
    }

    /// Whether it is known where a lidar sits.
    pub(super) fn is_placed(&self, lidar: u32, frame: &str) -> bool {
        let child = self.odometry_frames.as_ref().map(|(_, child)| child.as_str());
        let mut bases = BASE_FRAMES.into_iter().chain(child);
        self.settings.lidars.get(lidar as usize).is_some()
            || bases.any(|base| self.transforms.links(base, frame))
    }

    pub(super) fn choose_frames(&self, laser: &str) -> Frames {
        let child = self.odometry_frames.as_ref().map(|(_, child)| child.as_str());
        let linked = |base: &&str| *base == laser || self.transforms.links(base, laser);
        let candidates = || BASE_FRAMES.into_iter().chain(child);
        let linked = candidates().find(linked);
        let base = linked.or_else(|| candidates().find(|base| self.transforms.knows(base))).unwrap_or(laser);
        let ancestors = self.transforms.ancestors(base);
        Frames {
            base: base.to_owned(),
            odom: ancestors.into_iter().find(|frame| frame.contains("odom")).map(str::to_owned),
        }
    }

    /// `base_from_laser`, in space.
    fn place(
        &self,
        frames: &Frames,
        lidar: u32,
        laser: &str,
        stamp_ns: i64,
    ) -> Result<Isometry3<f64>, LocateError> {
        if let Some(given) = self.settings.lidars.get(lidar as usize) {
            return Ok(given.base_from_laser());
        }
        if frames.base == laser || self.transforms.is_empty() {
            // No mounting is given: the lidar's frame is the base frame.
            return Ok(Isometry3::identity());
        }
        let before = self.last_places.get(&lidar).map(|last| last.base_from_laser);
        let at_stamp = self.transforms.lookup(&frames.base, laser, stamp_ns).ok();
        // What is published as if it moved, and is fixed, holds beyond its last message.
        let last = || {
            let until_ns = self.transforms.known_until_ns(&frames.base, laser)?;
            self.transforms.lookup(&frames.base, laser, until_ns).ok()
        };
        let place = at_stamp.or(before).or_else(last);
        place.ok_or(LocateError::Unlinked { frame: laser.to_owned() })
    }
}
