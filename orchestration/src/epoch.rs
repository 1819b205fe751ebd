//! A second epoch of submaps: the accepted scans of a run, entered anew at refined poses.

use crate::configuration::Configuration;
use flockslam_dynamic_cleaner::DynamicCleaner;
use flockslam_evidence::{FusedMap, Tile, TileGrid, TileKey};
use flockslam_geometry::Pose;
use flockslam_mapper::Mapper;
use flockslam_messages::{PoseEstimate, ScanView};
use flockslam_stage::results::{self, LayoutRow, StampedPose};
use flockslam_stage::{JournalReader, StageError, SubmapStore};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The originals: as the mapper stored them, with where they lie in the final map.
pub const ORIGINALS: &str = "epoch-1";
/// The submaps of refined poses; they lie in the frame of the map itself.
pub const REFINED: &str = "epoch-2";

/// Copies the submaps of a run and their layout into `to/epoch-1`, in place of what an earlier run left there.
///
/// # Errors
/// When a file cannot be read or written.
pub fn keep_originals(store: &SubmapStore, layout: &[LayoutRow], to: &Path) -> Result<(), StageError> {
    let (directory, partial) = begin(to, ORIGINALS)?;
    for number in 0..store.count() {
        let file = store.file(number);
        let name = file.file_name().unwrap_or_default();
        fs::copy(&file, partial.join(name)).map_err(|e| StageError::file(&file, e))?;
    }
    results::write_layout(&partial, layout)?;
    replace(&partial, &directory)
}

/// Removes what an earlier run left of both in `from`, and `from` itself when there is nothing else in it.
///
/// # Errors
/// When something cannot be removed.
pub fn forget(from: &Path) -> Result<(), StageError> {
    [ORIGINALS, REFINED].iter().try_for_each(|epoch| remove(&from.join(epoch)))?;
    // Whatever else is there is the user's.
    let _ = fs::remove_dir(from);
    Ok(())
}

/// Enters the accepted scans of a journal at refined poses into submaps in `to/epoch-2`, in place of what an earlier run left
/// there, and gives their sum.
///
/// `poses` are those of all scans, in the order of the journal; scans of submaps that `layout` has no place for are left out.
///
/// # Errors
/// When the journal cannot be read, or a submap cannot be written.
pub fn rebuild(
    journal: &Path,
    configuration: &Configuration,
    poses: &[StampedPose],
    layout: &[LayoutRow],
    to: &Path,
) -> Result<FusedMap, StageError> {
    let (directory, partial) = begin(to, REFINED)?;
    let in_map: BTreeSet<u32> = layout.iter().map(|row| row.number).collect();
    let mut rebuild = Rebuild::new(configuration, SubmapStore::new(&partial));
    let mut rows = poses.iter().peekable();
    let mut journal = JournalReader::open(journal)?;
    while let Some(record) = journal.read_next()? {
        // Live, a pose may have been lost on its way to the back end.
        let Some(row) = rows.next_if(|row| row.stamp_ns == record.pose.times.sensor_ns) else { continue };
        let Some(scan) = record.scan.filter(|_| in_map.contains(&record.pose.submap)) else { continue };
        if let Ok(scan) = scan.view() {
            rebuild.insert(scan, &record.pose, row.pose)?;
        }
    }
    let map = rebuild.finish()?;
    replace(&partial, &directory)?;
    Ok(map)
}

/// What the mapper and the cleaner do, one scan after the other.
struct Rebuild {
    mapper: Mapper,
    cleaner: DynamicCleaner,
    grid: TileGrid<Box<Tile>>,
    store: SubmapStore,
    cell_size_m: f64,
}

impl Rebuild {
    fn new(configuration: &Configuration, store: SubmapStore) -> Self {
        let cell_size_m = configuration.mapper.cell_size_m;
        Self {
            mapper: Mapper::new(configuration.mapper.clone()),
            cleaner: DynamicCleaner::new(configuration.dynamic_cleaner.clone()),
            grid: TileGrid::new(cell_size_m),
            store,
            cell_size_m,
        }
    }

    fn insert(
        &mut self,
        scan: ScanView<'_>,
        online: &PoseEstimate,
        map_from_base: Pose,
    ) -> Result<(), StageError> {
        let pose = PoseEstimate {
            odom_from_base: map_from_base,
            map_from_odom: Pose::IDENTITY,
            chain: 0,
            generation: self.mapper.generation(),
            ..*online
        };
        let marks = self.cleaner.handle(scan, &pose, &self.grid);
        let insertion = self.mapper.insert(scan, &pose, marks.cleared);
        let (changed, retired) = (insertion.changed.to_vec(), insertion.retired.to_vec());
        insertion.closed.iter().try_for_each(|submap| self.store.save(submap))?;
        retired.into_iter().for_each(|key| drop(self.grid.remove(key)));
        changed.into_iter().for_each(|key| self.read_tile(key));
        self.store_cleared()
    }

    /// Brings a changed tile into the grid that the next scan is judged by.
    fn read_tile(&mut self, key: TileKey) {
        let mut tile = self.grid.remove(key).unwrap_or_else(|| Tile::unknown(0));
        if self.mapper.write_tile(key, &mut tile) {
            // What is out of the grid's reach is out of the mapper's too.
            let _ = self.grid.set(key, tile);
        }
    }

    fn store_cleared(&mut self) -> Result<(), StageError> {
        self.mapper.take_cleared().iter().try_for_each(|submap| self.store.save(submap))
    }

    fn finish(mut self) -> Result<FusedMap, StageError> {
        if let Some(last) = self.mapper.close() {
            self.store.save(&last)?;
        }
        self.store_cleared()?;
        let mut map = FusedMap::new(self.cell_size_m);
        for number in 0..self.store.count() {
            let submap = self.store.load(number)?;
            let added = map.add(&submap, submap.odom_from_submap);
            added.map_err(|far| StageError::file("the refined map", far))?;
        }
        Ok(map)
    }
}

/// The directory of an epoch, and an empty one beside it to be filled first.
fn begin(to: &Path, epoch: &str) -> Result<(PathBuf, PathBuf), StageError> {
    let (directory, partial) = (to.join(epoch), to.join(format!(".{epoch}")));
    remove(&partial)?;
    fs::create_dir_all(&partial).map_err(|e| StageError::file(&partial, e))?;
    Ok((directory, partial))
}

fn replace(partial: &Path, directory: &Path) -> Result<(), StageError> {
    remove(directory)?;
    fs::rename(partial, directory).map_err(|e| StageError::file(directory, e))
}

fn remove(directory: &Path) -> Result<(), StageError> {
    match fs::remove_dir_all(directory) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(StageError::file(directory, error)),
        _ => Ok(()),
    }
}
