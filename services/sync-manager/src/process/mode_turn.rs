//! What the shell does when the mode of its set changes: it takes the journal in once more, in the other mode, as a successor of this process would.
//! The poses say which scans the set has localized with, so all processes change at the same scan, and no death of one changes that.

use super::SyncProcess;
use super::fuser::Fuser;
use super::localized;
use crate::{BackEnd, LocalizingManager, Settings, SyncManager};
use flockslam_messages::{PoseEstimate, PoseFlags};
use flockslam_results::{SetMode, SubmapStore, Summary, Unattached};
use flockslam_stage::{JournalReader, StageContext, StageError};

/// Scans that the set has localized with, by their sequences: first and last of each stretch.
#[derive(Debug, Default)]
pub(super) struct LocalStretches {
    stretches: Vec<(u64, u64)>,
    scans: u64,
    last: Option<u64>,
}

impl LocalStretches {
    /// Adds the scan with this sequence.
    pub fn add(&mut self, sequence: u64) {
        self.scans += 1;
        match self.stretches.last_mut() {
            Some((_, last)) if self.last.is_some_and(|before| before == *last) => *last = sequence,
            _ => self.stretches.push((sequence, sequence)),
        }
        self.last = Some(sequence);
    }

    /// A scan of the map has come.
    pub fn end(&mut self) {
        self.last = None;
    }

    /// Whether the scan with this sequence is one of them.
    pub fn holds(&self, sequence: u64) -> bool {
        self.stretches.iter().any(|(first, last)| (*first..=*last).contains(&sequence))
    }

    /// The newest of them.
    pub fn newest(&self) -> Option<u64> {
        self.stretches.last().map(|(_, last)| *last)
    }

    /// Number of scans.
    pub fn scans(&self) -> u64 {
        self.scans
    }
}

impl SyncProcess {
    /// Changes the mode at this pose, if it was requested.
    pub(super) fn turn_to(
        &mut self,
        pose: &PoseEstimate,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        let localizes = pose.has(PoseFlags::LOCALIZING);
        if self.logic.localizing().is_some() == localizes {
            return Ok(());
        }
        tracing::info!(scan = pose.id.sequence, mode = if localizes { "localize" } else { "map" }, "changes");
        self.logic = back_end(context, &self.settings, localizes)?;
        self.fuser = Fuser::new(SubmapStore::new(&context.submap_dir), &self.settings);
        self.trajectories.begin_anew()?;
        self.journal = JournalReader::open(&context.journal_dir)?;
        self.waiting_submaps.clear();
        (self.next_submap, self.join.expected) = (0, 0);
        (self.summary, self.local, self.localisation) = (Summary::default(), LocalStretches::default(), None);
        (self.recovered, self.correction) = (false, None);
        self.catch_up(pose.id.sequence, context)?;
        self.go_on(context)?;
        if localizes && self.is_active {
            self.report_unattached(Unattached::default(), context);
        }
        Ok(())
    }

    /// Goes on after the poses of the journal: live, with the last conclusion that the front end has not received.
    pub(super) fn go_on(&mut self, context: &StageContext) -> Result<(), StageError> {
        self.recovered = true;
        let Some(last) = self.pose else { return Ok(()) };
        let is_of_this_session = last.id.sequence >= context.first_sequence;
        if let Some(localizing) = self.logic.localizing() {
            if is_of_this_session {
                localizing.resume();
            }
            return Ok(());
        }
        // What was concluded before the set localized, or in an earlier session, says nothing of where the robot is now.
        let since = self.local.newest().map_or(context.first_sequence, |newest| newest + 1);
        let not_received = self.correction.filter(|correction| {
            correction.revision > last.corrections && correction.scan >= since.max(context.first_sequence)
        });
        match not_received.filter(|_| self.is_watched) {
            Some(correction) => self.correct(&correction),
            None => Ok(()),
        }
    }
}

/// Whether the set localizes, by the supervisor's last order.
pub(super) fn localizes(context: &StageContext) -> bool {
    SetMode::read(&context.result_dir).map_or(context.localizes, |mode| mode.localizes)
}

/// The back end of a set: one that makes a map, or one that localizes.
pub(super) fn back_end(
    context: &StageContext,
    settings: &Settings,
    localizes: bool,
) -> Result<BackEnd, StageError> {
    if localizes {
        let surroundings = localized::load(&context.result_dir)?;
        return Ok(BackEnd::Localizing(Box::new(LocalizingManager::new(surroundings))));
    }
    let mut mapping = SyncManager::new(settings.clone());
    if !settings.flock.name.is_empty() {
        mapping.publish_to_flock();
    }
    Ok(BackEnd::Mapping(Box::new(mapping)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_end_where_a_scan_of_the_map_comes() {
        let mut local = LocalStretches::default();
        (10..15).for_each(|sequence| local.add(sequence));
        local.end();
        (30..32).for_each(|sequence| local.add(sequence));
        let held: Vec<u64> = (0..40).filter(|sequence| local.holds(*sequence)).collect();
        assert_eq!(held, [10, 11, 12, 13, 14, 30, 31]);
        assert_eq!((local.scans(), local.newest()), (7, Some(31)));
    }
}
