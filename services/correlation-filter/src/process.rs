//! The shell of correlation-filter: scans in, verdicts out.
//!
//! Replica 0 decides. The others describe their parts of large scans and send it the sums.

mod describer;
mod kept_counts;
mod matcher_load;
mod tally_shares;

pub use tally_shares::tally_part;

use crate::{CorrelationFilter, Settings};
use describer::{Describer, Helper};
use flockslam_bus::{Notifier, Publisher, ScanSample, Subscriber};
use flockslam_messages::{DropReason, KeepReason, ScanTally, Stage, Verdict};
use flockslam_stage::{Acknowledger, Actor, Mode, Shares, StageContext, StageError, run};
use kept_counts::KeptCounts;
use matcher_load::MatcherLoad;
use tally_shares::is_shared;

/// Replica 0 waits so long for a part of another replica; then it describes the part itself, with the same result.
const SHARE_DEADLINE_NS: u64 = 50_000_000;
/// Parts of later scans that are kept.
const SHARES_HELD_MAX: usize = 16;
/// Counts parts that replica 0 had to describe itself.
const SHARE_LATE: &str = "share-late";

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the bus fails.
pub fn run_stage(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::CorrelationFilter.name())?;
    let mut shell = shell(context, settings)?;
    run(context, &mut *shell, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// When the bus fails.
pub fn shell(context: &mut StageContext, settings: Settings) -> Result<Box<dyn Actor>, StageError> {
    let describer = Describer::open(context, &settings)?;
    if context.replica > 0 {
        let first = context.bus.notifier(Stage::CorrelationFilter.name())?;
        return Ok(Box::new(Helper { describer, tallies: context.bus.publisher()?, first }));
    }
    Ok(Box::new(Filter {
        verdicts: context.bus.publisher()?,
        matcher: context.bus.notifier(Stage::ScanMatcher.name())?,
        unnotified: false,
        acknowledger: Acknowledger::open(context, 0)?,
        load: if context.mode == Mode::Live { Some(MatcherLoad::open(context)?) } else { None },
        kept: KeptCounts::new(context),
        shares: Shares::new(context.bus.subscriber()?, describer.parts, SHARES_HELD_MAX, SHARE_DEADLINE_NS),
        describer,
        logic: CorrelationFilter::new(settings),
    }))
}

/// The replica that decides.
struct Filter {
    logic: CorrelationFilter,
    describer: Describer,
    verdicts: Publisher<Verdict>,
    matcher: Notifier,
    /// Verdicts were sent that the matcher has not been woken for.
    unnotified: bool,
    acknowledger: Acknowledger,
    load: Option<MatcherLoad>,
    kept: KeptCounts,
    shares: Shares<Subscriber<ScanTally>, Shared>,
}

/// A large scan whose parts are being described.
struct Shared {
    sample: ScanSample,
    started_ns: u64,
    overloaded: bool,
    sum: ScanTally,
}

impl Filter {
    /// Begins with a scan; a shared one waits for the other replicas.
    fn begin(&mut self, sample: ScanSample, context: &mut StageContext) -> Result<(), StageError> {
        let (header, started_ns) = (*sample.header(), context.now_ns());
        let overloaded = match &mut self.load {
            Some(load) => load.is_too_much(header.id.sequence)?,
            None => false,
        };
        let Describer { part, parts, threads, .. } = self.describer;
        let verdict = match sample.view() {
            Ok(scan) => {
                context.probe_scan(scan);
                if is_shared(scan, parts) {
                    let sum = tally_part(scan, part, parts, threads);
                    let shared = Shared { sample, started_ns, overloaded, sum };
                    self.shares.begin(header.id, shared, started_ns);
                    return Ok(());
                }
                let whole = self.logic.wants_tallies().then(|| tally_part(scan, 0, 1, threads));
                self.logic.classify(scan, whole.as_ref(), overloaded)
            }
            Err(problem) => {
                tracing::warn!(scan = header.id.sequence, %problem, "unreadable scan");
                let reason = DropReason::Empty as u32;
                Verdict { id: header.id, times: header.times, coefficient: 0.0, keep: 0, reason }
            }
        };
        self.publish(&verdict, started_ns, context)
    }

    /// Ends with a shared scan when all parts are there; true when it did.
    fn finish_shared(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let add = |shared: &mut Shared, tally: &ScanTally| {
            shared.sum.add(tally);
            true
        };
        let Some((mut shared, missing)) = self.shares.finish(context.now_ns(), add)? else {
            return Ok(false);
        };
        let Ok(scan) = shared.sample.view() else { return Ok(false) };
        for part in missing {
            context.dropped(SHARE_LATE);
            shared.sum.add(&tally_part(scan, part, self.describer.parts, self.describer.threads));
        }
        let verdict = self.logic.classify(scan, Some(&shared.sum), shared.overloaded);
        self.publish(&verdict, shared.started_ns, context)?;
        Ok(true)
    }

    fn publish(
        &mut self,
        verdict: &Verdict,
        started_ns: u64,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        self.verdicts.send(verdict)?;
        self.unnotified = true;
        if context.mode == Mode::Live {
            self.notify();
        }
        match DropReason::from_number(verdict.reason) {
            Some(reason) => context.dropped(reason.name()),
            None => KeepReason::from_number(verdict.reason).into_iter().for_each(|r| self.kept.count(r)),
        }
        let Verdict { id, keep, reason, coefficient, .. } = *verdict;
        tracing::debug!(scan = id.sequence, keep, reason, coefficient, "judged");
        context.handled(id.sequence, started_ns, verdict.times.monotonic_ns);
        self.acknowledger.finished(verdict.id.sequence + 1)
    }

    fn notify(&mut self) {
        self.unnotified = false;
        self.matcher.notify();
    }

    /// Judges all scans that are there; whether there was any.
    fn filter_all(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = self.finish_shared(context)?;
        while !self.shares.waits() {
            let Some(sample) = self.describer.scans.receive()? else { break };
            any = true;
            // A source that was restarted may send its last scan twice.
            if sample.header().id.sequence >= self.acknowledger.done() {
                self.begin(sample, context)?;
                self.finish_shared(context)?;
            }
        }
        Ok(any)
    }
}

impl Actor for Filter {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let any = self.filter_all(context)?;
        // In exact replay one wake is for all verdicts on what the source has sent at once.
        if self.unnotified {
            self.notify();
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.verdicts.refresh();
        self.kept.report(context);
        self.acknowledger.send()
    }

    fn waits(&self) -> bool {
        self.shares.waits()
    }

    fn waiting(&self) -> usize {
        usize::from(self.shares.waits())
    }

    fn close(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.kept.report(context);
        Ok(())
    }
}
