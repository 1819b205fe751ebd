//! The final cleaning: reads the journal once more at the end, from the last scan back, at the final poses.

use super::fuser::Fuser;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_map_fusion::{APART_NS, FinalCleaning, VIEWS};
use flockslam_messages::{Deskew, PoseFlags};
use flockslam_results::flock_files::NamedPose;
use flockslam_stage::{JournalReader, StageContext, StageError};
use std::ops::Range;

/// Of more accepted scans than this an evenly spaced selection is used: the work is bounded.
const SCANS_MAX: u64 = 20_000;

/// Clears the cells of the finished map that the accepted scans, so many, have looked through; `scans` are the final poses of all
/// scans, in the order of their sequences. Scans of submaps that are not in the map are not used.
///
/// # Errors
/// When journal or store fail.
pub(super) fn clear_at_end(
    fuser: &mut Fuser,
    submaps_in_map: &[PlacedSubmap],
    scans: &[NamedPose],
    accepted: u64,
    context: &mut StageContext,
) -> Result<(), StageError> {
    let Some(mut final_cleaning) = fuser.map().map(FinalCleaning::new) else { return Ok(()) };
    let mut journal = JournalReader::open(&context.journal_dir)?;
    let accepted = accepted_scans(&mut journal, submaps_in_map, scans, accepted, context)?;
    for (position, rows) in accepted.iter().rev() {
        context.alive();
        let Some(record) = journal.read_at(*position)? else { continue };
        if let Some(scan) = record.scan.as_ref().and_then(|scan| scan.view().ok()) {
            let rows = &scans[rows.clone()];
            final_cleaning.look(scan, &Deskew::new(scan, record.pose.twist), rows[0].pose, views(rows));
        }
    }
    let free = final_cleaning.free();
    tracing::debug!(cells = free.len(), scans = accepted.len(), "looked back");
    fuser.clear(&free)
}

/// The accepted scans that are looked at, in order: where each is in the journal, and which of `scans` it stands for, itself first: how long
/// it stood for what was seen is known from the next one.
fn accepted_scans(
    journal: &mut JournalReader,
    submaps_in_map: &[PlacedSubmap],
    scans: &[NamedPose],
    accepted: u64,
    context: &mut StageContext,
) -> Result<Vec<(u64, Range<usize>)>, StageError> {
    let every = accepted.div_ceil(SCANS_MAX).max(1);
    let (mut number, mut next) = (0, 0);
    let mut found: Vec<(u64, Range<usize>)> = Vec::new();
    loop {
        let position = journal.position();
        let Some(record) = journal.read_next()? else { return Ok(found) };
        context.alive();
        let sequence = record.pose.id.sequence;
        if record.scan.is_none() || record.pose.has(PoseFlags::LOCALIZING) {
            continue;
        }
        number += 1;
        let in_map = submaps_in_map.binary_search_by_key(&record.pose.submap, |placed| placed.number).is_ok();
        if number % every != 0 || !in_map || sequence < next {
            continue;
        }
        next = sequence + 1;
        let Ok(place) = scans.binary_search_by_key(&sequence, |row| row.sequence) else { continue };
        if let Some((_, before)) = found.last_mut() {
            before.end = place;
        }
        found.push((position, place..scans.len()));
    }
}

/// Number of views that a scan counts for: scans that showed about the same are not in the journal.
fn views(scans: &[NamedPose]) -> u8 {
    let mut last_ns = scans[0].stamp_ns;
    let mut is_apart = |scan: &&NamedPose| {
        let is_apart = scan.stamp_ns.saturating_sub(last_ns) >= APART_NS as i64;
        last_ns = if is_apart { scan.stamp_ns } else { last_ns };
        is_apart
    };
    1 + scans.iter().filter(|scan| is_apart(scan)).take(usize::from(VIEWS) - 1).count() as u8
}
