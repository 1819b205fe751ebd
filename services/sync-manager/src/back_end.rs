//! The two back ends behind what they have in common: one makes a map, the other localizes in one.

use crate::{LocalizingManager, SyncManager};
use flockslam_messages::{BeamRange, Correction, PoseEstimate, ScanId, ScanView, SubmapClosed};

/// A back end of a robot.
pub enum BackEnd {
    /// Makes a map.
    Mapping(Box<SyncManager>),
    /// Localizes in a known one.
    Localizing(Box<LocalizingManager>),
}

impl BackEnd {
    /// Takes the published pose of a scan.
    pub fn pose(&mut self, pose: &PoseEstimate) {
        match self {
            Self::Mapping(manager) => manager.pose(pose),
            Self::Localizing(manager) => manager.pose(pose),
        }
    }

    /// Takes a scan whose pose has just been given.
    pub fn node(&mut self, scan: ScanView<'_>, pose: &PoseEstimate, moving: &[BeamRange]) {
        match self {
            Self::Mapping(manager) => manager.node(scan, pose, moving),
            Self::Localizing(manager) => manager.node(scan, pose, moving),
        }
    }

    /// Concludes what can be concluded after a scan that has entered the map, whose pose and points have just been given.
    pub fn scan_accepted(&mut self, id: ScanId) -> Correction {
        match self {
            Self::Mapping(manager) => manager.scan_accepted(id),
            Self::Localizing(manager) => manager.scan_accepted(id),
        }
    }

    /// Concludes what can be concluded after a closed submap.
    pub fn submap_closed(&mut self, notice: &SubmapClosed) -> Correction {
        match self {
            Self::Mapping(manager) => manager.submap_closed(notice),
            Self::Localizing(manager) => manager.submap_closed(notice),
        }
    }

    /// The one that makes a map.
    pub fn mapping(&mut self) -> Option<&mut SyncManager> {
        match self {
            Self::Mapping(manager) => Some(manager),
            Self::Localizing(_) => None,
        }
    }

    /// The one that localizes.
    pub fn localizing(&mut self) -> Option<&mut LocalizingManager> {
        match self {
            Self::Mapping(_) => None,
            Self::Localizing(manager) => Some(manager),
        }
    }
}
