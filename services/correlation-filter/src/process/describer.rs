//! Describes scans, alone or together with other replicas.

use super::tally_shares::{is_shared, tally_part};
use crate::{CorrelationFilter, Settings};
use flockslam_bus::{Notifier, Publisher, ScanSubscriber};
use flockslam_messages::ScanTally;
use flockslam_stage::{Actor, StageContext, StageError};

/// Threads of each process that describe a large scan, one for each 100 thousand beams at most: the other stages need processors too.
const THREADS: usize = 2;

/// Describes scans, alone or together with other replicas.
pub(super) struct Describer {
    pub scans: ScanSubscriber,
    pub part: u32,
    pub parts: u32,
    pub threads: usize,
}

impl Describer {
    pub fn open(context: &StageContext, settings: &Settings) -> Result<Self, StageError> {
        let wants_tallies = CorrelationFilter::new(settings.clone()).wants_tallies();
        Ok(Self {
            scans: context.bus.scan_subscriber()?,
            part: context.replica,
            parts: if wants_tallies { settings.replicas.max(1) as u32 } else { 1 },
            threads: THREADS,
        })
    }
}

/// A replica other than the first.
pub(super) struct Helper {
    pub describer: Describer,
    pub tallies: Publisher<ScanTally>,
    pub first: Notifier,
}

impl Actor for Helper {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let Describer { scans, part, parts, threads } = &self.describer;
        let mut any = false;
        while let Some(sample) = scans.receive()? {
            any = true;
            let started_ns = context.now_ns();
            let Ok(scan) = sample.view() else { continue };
            if is_shared(scan, *parts) && part < parts {
                self.tallies.send(&tally_part(scan, *part, *parts, *threads))?;
                self.first.notify();
                let times = scan.header().times;
                context.handled(scan.header().id.sequence, started_ns, times.monotonic_ns);
            }
        }
        Ok(any)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.tallies.refresh();
        Ok(())
    }
}
