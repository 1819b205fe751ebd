//! The fallback of the matcher: poses by odometry alone, for a robot whose matcher cannot be started.

use super::last_pose;
use super::metrics::PoseMetrics;
use crate::{ScanMatcher, Settings};
use flockslam_bus::{Publisher, ScanSubscriber};
use flockslam_messages::{PoseEstimate, Stage};
use flockslam_stage::{Acknowledger, Actor, JournalWriter, LeaderLock, StageContext, StageError, run};

/// Runs in the place of the stage until its stop is requested. Nothing is matched and nothing enters the map; each pose is `degraded`.
///
/// # Errors
/// When the bus fails.
pub fn run_odometry_fallback(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::ScanMatcher.name())?;
    // Another process of the stage may still work.
    let turn = LeaderLock::ask(context)?;
    if !turn.stand_by(context, &event, |_| Ok(0))? {
        return Ok(());
    }
    let mut logic = ScanMatcher::new(settings);
    // The journal may be unusable, and may be the reason why the matcher fails.
    let last = last_pose(context).ok().flatten();
    last.iter().for_each(|last| logic.resume(last));
    let next = last.map_or(context.first_sequence, |last| last.id.sequence + 1);
    let mut actor = OdometryFallback {
        logic,
        scans: context.bus.scan_subscriber()?,
        poses: context.bus.publisher()?,
        journal: JournalWriter::open(&context.journal_dir).ok(),
        acknowledger: Acknowledger::open(context, next)?,
        metrics: PoseMetrics::new(&context.metrics),
    };
    run(context, &mut actor, &event)
}

struct OdometryFallback {
    logic: ScanMatcher,
    scans: ScanSubscriber,
    poses: Publisher<PoseEstimate>,
    journal: Option<JournalWriter>,
    acknowledger: Acknowledger,
    metrics: PoseMetrics,
}

impl Actor for OdometryFallback {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while let Some(sample) = self.scans.receive()? {
            let (header, started_ns) = (*sample.header(), context.now_ns());
            if header.id.sequence < self.acknowledger.done() {
                continue;
            }
            let Ok(scan) = sample.view() else {
                context.dropped("unreadable");
                self.acknowledger.finished(header.id.sequence + 1)?;
                continue;
            };
            let pose = self.logic.follow_odometry(scan);
            let journaled = self.journal.as_mut().is_some_and(|journal| journal.append(&pose, scan).is_ok());
            if !journaled {
                context.dropped("not-journaled");
            }
            self.poses.send(&pose)?;
            context.handled(header.id.sequence, started_ns, header.times.monotonic_ns);
            self.metrics.published(&pose);
            self.acknowledger.finished(header.id.sequence + 1)?;
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.poses.refresh();
        self.acknowledger.send()
    }
}
