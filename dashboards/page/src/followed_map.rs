//! Follows the map of closed submaps as stages store it, in small steps. Reads files of a set; gives the fused map where the solution has it.

use crate::fused_picture::FusedPicture;
use crate::known_submap::{KNOWN, known_submap};
use flockslam_bus::RuntimeDir;
use flockslam_evidence::{Submap, TileKey};
use flockslam_geometry::Pose;
use flockslam_map_fusion::FusedMap;
use flockslam_results::{self as results, LivePoses, SetMode, SubmapStore};
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The newest submaps may be stored once more, with cells that have been cleared.
const REPLACED_AMONG: usize = 12;

/// Tells versions of a file apart that replace one another.
pub type Version = (u64, i64, i64);

/// The map of closed submaps of a set, kept up with what is stored.
pub struct FollowedMap {
    store: SubmapStore,
    results: PathBuf,
    cell_size_m: f64,
    optimises: bool,
    /// The set localizes: its map is the known one.
    localizes: bool,
    mode_file: Option<Version>,
    /// Submaps that are stored.
    stored: u32,
    origins: Vec<(u32, Pose)>,
    submap_poses: BTreeMap<u32, Pose>,
    poses_file: Option<Version>,
    /// Which version of each of the newest files is in the picture.
    versions: BTreeMap<u32, Version>,
    picture: FusedPicture,
}

/// What is new in the files of a set.
#[derive(Debug, Default)]
pub struct Stored {
    /// Submaps are new, or their places.
    pub is_new: bool,
    /// What was concluded, when that is new.
    pub poses: Option<LivePoses>,
}

impl FollowedMap {
    /// The map of a set; `optimises`: its sync-manager says where submaps lie. Of a set that localizes it is the known map, in cells of
    /// this size.
    pub fn new(runtime: &RuntimeDir, optimises: bool, cell_size_m: f64) -> Self {
        let mut followed = Self {
            store: SubmapStore::new(&runtime.submaps()),
            results: runtime.results(),
            cell_size_m,
            optimises,
            localizes: false,
            mode_file: None,
            stored: 0,
            origins: Vec::new(),
            submap_poses: BTreeMap::new(),
            poses_file: None,
            versions: BTreeMap::new(),
            picture: FusedPicture::default(),
        };
        followed.mode_file = version_of(&SetMode::file(&followed.results));
        followed.take_mode(true);
        followed
    }

    /// Shows the known map while the set localizes in one, otherwise its submaps. A set that says nothing of its mode does so when
    /// there `may_be` one.
    fn take_mode(&mut self, may_be: bool) {
        let localizes = SetMode::read(&self.results).map_or(may_be, |mode| mode.localizes);
        let known = localizes.then(|| known_submap(&self.results, self.cell_size_m)).flatten();
        self.localizes = known.is_some();
        self.submap_poses.clear();
        self.poses_file = None;
        if let Some(known) = known {
            self.picture.remove(KNOWN);
            self.submap_poses.insert(KNOWN, Pose::IDENTITY);
            if let Err(far) = self.picture.place(KNOWN, known.encode(), Pose::IDENTITY) {
                tracing::warn!(%far, "the known map is not in the picture");
            }
        }
    }

    /// Looks at what stages have stored. What cannot be read now is read later.
    pub fn look(&mut self) -> Stored {
        let mut stored = Stored::default();
        let mode = version_of(&SetMode::file(&self.results));
        if mode != self.mode_file {
            self.mode_file = mode;
            self.take_mode(self.localizes);
            stored.is_new = true;
        }
        while let Ok(bytes) = std::fs::read(self.store.file(self.stored)) {
            if let Ok(submap) = Submap::decode(&bytes) {
                self.origins.push((self.stored, submap.odom_from_submap));
            }
            self.stored += 1;
            stored.is_new = true;
        }
        let version = version_of(&results::live_poses_file(&self.results));
        let is_new = version != self.poses_file || (stored.is_new && !self.optimises);
        if is_new && !self.localizes {
            self.poses_file = version;
            let poses = results::read_live_poses(&self.results).unwrap_or_default();
            self.submap_poses = if self.optimises {
                poses.submaps.iter().map(|row| (row.number, pose_of(row.map_from_odom))).collect()
            } else {
                (0..self.stored).map(|number| (number, Pose::IDENTITY)).collect()
            };
            stored = Stored { is_new: true, poses: Some(poses) };
        }
        self.drop_replaced();
        stored
    }

    /// Takes submaps out of the picture whose file was replaced: they come in anew.
    fn drop_replaced(&mut self) {
        for (number, version) in self.versions.clone().iter().rev().take(REPLACED_AMONG) {
            if version_of(&self.store.file(*number)).is_some_and(|present| present != *version) {
                self.versions.remove(number);
                self.picture.remove(*number);
            }
        }
    }

    /// One step of the picture towards the solution: it may take as long as a few tens of milliseconds. False when it is there.
    pub fn step(&mut self) -> bool {
        let stray = self.picture.next_stray(&self.submap_poses);
        if let Some(stray) = stray {
            self.picture.remove(stray);
        }
        let Some((number, place)) = self.picture.next_step(&self.submap_poses, self.stored) else {
            return stray.is_some();
        };
        let file = self.store.file(number);
        let Some(version) = version_of(&file) else { return false };
        let placed = std::fs::read(&file).map(|bytes| self.picture.place(number, bytes, place));
        if let Ok(Err(far)) = placed {
            tracing::warn!(%far, number, "a submap is not in the picture");
        }
        if self.picture.holds(number) {
            self.versions.insert(number, version);
        } else {
            // It is not a submap, or has no place: it is not tried again.
            self.submap_poses.remove(&number);
        }
        true
    }

    /// Places of submaps in the solution: `map_from_odom` of each.
    pub fn submap_poses(&self) -> &BTreeMap<u32, Pose> {
        &self.submap_poses
    }

    /// Where each submap is in odom.
    pub fn origins(&self) -> &[(u32, Pose)] {
        &self.origins
    }

    /// Takes note that a tile was looked at; `None` when none has changed since.
    pub fn next_changed(&mut self) -> Option<TileKey> {
        self.picture.next_changed()
    }

    /// The map; `None` before the first submap.
    pub fn map(&self) -> Option<&FusedMap> {
        self.picture.map()
    }
}

/// The version of a file; `None` while there is none.
pub fn version_of(file: &Path) -> Option<Version> {
    let metadata = std::fs::metadata(file).ok()?;
    Some((metadata.ino(), metadata.mtime(), metadata.mtime_nsec()))
}

fn pose_of([x_m, y_m, heading_rad]: [f64; 3]) -> Pose {
    Pose::new(x_m, y_m, heading_rad)
}
