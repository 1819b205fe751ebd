//! How far the matcher is behind: the reason to shed scans.

use flockslam_bus::Subscriber;
use flockslam_messages::{Progress, Stage};
use flockslam_stage::{StageContext, StageError};

/// Live: scans that the matcher may be behind before every scan is dropped but one in four, until it has caught up. A quarter of what
/// may be on its way.
const SHED_BEHIND_SCANS: u64 = 16;

/// How far the matcher is behind, live.
pub(super) struct MatcherLoad {
    progress: Subscriber<Progress>,
    matched: u64,
}

impl MatcherLoad {
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        Ok(Self { progress: context.bus.subscriber()?, matched: 0 })
    }

    /// Whether this scan comes while the matcher has too many before it.
    pub fn is_too_much(&mut self, sequence: u64) -> Result<bool, StageError> {
        while let Some(progress) = self.progress.receive()? {
            if progress.stage == Stage::ScanMatcher as u32 {
                self.matched = self.matched.max(progress.done);
            }
        }
        Ok(sequence.saturating_sub(self.matched) > SHED_BEHIND_SCANS)
    }
}
