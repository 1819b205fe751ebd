//! Kept scans, counted by reason.

use flockslam_messages::KeepReason;
use flockslam_stage::StageContext;
use flockslam_telemetry::{LabelledCounters, names};

/// Counts kept scans by reason.
pub(super) struct KeptCounts {
    counts: [u64; KeepReason::ALL.len()],
    metrics: LabelledCounters,
}

impl KeptCounts {
    pub fn new(context: &StageContext) -> Self {
        let reasons = KeepReason::ALL.map(KeepReason::name);
        let metrics = context.metrics.counters(names::KEPT, names::LABEL_REASON, &reasons);
        Self { counts: [0; KeepReason::ALL.len()], metrics }
    }

    pub fn count(&mut self, reason: KeepReason) {
        if let Some(place) = KeepReason::ALL.iter().position(|known| *known == reason) {
            self.counts[place] += 1;
            self.metrics.count(place);
        }
    }

    pub fn report(&self, context: &mut StageContext) {
        for (reason, count) in KeepReason::ALL.iter().zip(self.counts).filter(|(_, count)| *count > 0) {
            context.report.count(&format!("kept/{}", reason.name()), count);
        }
    }
}
