//! The shell of correlation-filter: scans in, verdicts out.

use crate::{CorrelationFilter, Settings};
use flockslam_bus::{BellRinger, Publisher, ScanSample, ScanSubscriber};
use flockslam_messages::{DropReason, Stage, Verdict};
use flockslam_stage::{Acknowledger, Actor, StageContext, StageError, run};
use flockslam_telemetry::monotonic_ns;

/// Runs the stage until it is asked to stop.
///
/// # Errors
/// When the bus fails.
pub fn run_stage(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let bell = context.bus.listener(Stage::CorrelationFilter.name())?;
    let mut actor = Filter {
        logic: CorrelationFilter::new(settings),
        scans: context.bus.scan_subscriber()?,
        verdicts: context.bus.publisher()?,
        matcher: context.bus.ringer(Stage::ScanMatcher.name())?,
        acknowledger: Acknowledger::open(context, 0)?,
    };
    run(context, &mut actor, &bell)
}

struct Filter {
    logic: CorrelationFilter,
    scans: ScanSubscriber,
    verdicts: Publisher<Verdict>,
    matcher: BellRinger,
    acknowledger: Acknowledger,
}

impl Filter {
    fn judge(&mut self, sample: &ScanSample, context: &mut StageContext) -> Result<(), StageError> {
        let (header, started_ns) = (sample.header(), monotonic_ns());
        let verdict = match sample.view() {
            Ok(scan) => {
                context.report.report.scan_address = scan.ranges().as_ptr() as u64;
                self.logic.handle(scan)
            }
            Err(problem) => {
                tracing::warn!(scan = %header.id, %problem, "unreadable scan");
                let reason = DropReason::Empty as u32;
                Verdict { id: header.id, times: header.times, coefficient: 0.0, keep: 0, reason }
            }
        };
        self.verdicts.send(&verdict)?;
        self.matcher.ring();
        if let Some(reason) = DropReason::from_number(verdict.reason) {
            context.dropped(reason.name());
        }
        context.handled(header.id.sequence, started_ns, header.times.monotonic_ns);
        self.acknowledger.finished(header.id.sequence + 1)
    }
}

impl Actor for Filter {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while let Some(sample) = self.scans.receive()? {
            any = true;
            // A source that was restarted may send its last scan twice.
            if sample.header().id.sequence >= self.acknowledger.done() {
                self.judge(&sample, context)?;
            }
        }
        Ok(any)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.verdicts.refresh();
        self.acknowledger.send()
    }
}
