//! The journal read once more at the end, at the final poses.

use crate::PlacedSubmap;
use crate::fuse::Fuser;
use crate::hindsight::Hindsight;
use flockslam_messages::Deskew;
use flockslam_stage::flock_files::NamedPose;
use flockslam_stage::{JournalReader, StageContext, StageError};

/// Of more accepted scans than this only some are looked at, evenly spread: the work is bounded.
const SCANS_MAX: u64 = 20_000;

/// Clears the cells of the finished map that the accepted scans, so many, have looked through; `scans` are the final poses of all
/// scans, in the order of their sequences. Scans of submaps that are not in the map say nothing.
///
/// # Errors
/// When journal or store fail.
pub(super) fn look_back(
    fuser: &mut Fuser,
    layout: &[PlacedSubmap],
    scans: &[NamedPose],
    accepted: u64,
    context: &mut StageContext,
) -> Result<(), StageError> {
    let Some(mut hindsight) = fuser.map().map(Hindsight::new) else { return Ok(()) };
    let every = accepted.div_ceil(SCANS_MAX).max(1);
    let mut journal = JournalReader::open(&context.journal_dir)?;
    let (mut number, mut next) = (0, 0);
    while let Some(record) = journal.read_next()? {
        context.alive();
        let (Some(scan), sequence) = (&record.scan, record.pose.id.sequence) else { continue };
        number += 1;
        let in_map = layout.binary_search_by_key(&record.pose.submap, |placed| placed.number).is_ok();
        if number % every != 0 || !in_map || sequence < next {
            continue;
        }
        next = sequence + 1;
        let place = scans.binary_search_by_key(&sequence, |row| row.sequence);
        if let (Ok(place), Ok(scan)) = (place, scan.view()) {
            hindsight.look(scan, &Deskew::new(scan, record.pose.twist), scans[place].pose);
        }
    }
    let free = hindsight.free();
    tracing::debug!(cells = free.len(), scans = number, "looked back");
    fuser.clear(&free, layout)
}
