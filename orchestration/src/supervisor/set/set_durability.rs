//! Whether what the stages keep in files is there, or waits in their memory since a file system is full.

use super::ProcessSet;
use flockslam_bus::Megabytes;
use rustix::fs::statvfs;
use std::path::Path;

impl ProcessSet {
    /// Asks the signs of life, and says what has changed.
    pub(super) fn look_for_durability(&mut self) {
        let status_dir = self.runtime.status();
        let refused = |child: &&super::StageChild| {
            child.is_running() && child.beat(&status_dir).is_some_and(|beat| !beat.durable)
        };
        let stages: Vec<_> = self.children.iter().filter(refused).map(|child| child.stage.name()).collect();
        let is_durable = stages.is_empty();
        if !self.supervision.live {
            // Of a set that lives its saved map counts too.
            self.metrics.set_not_durable(!is_durable);
        }
        match (self.not_durable.is_none(), is_durable) {
            (true, false) => {
                let problem = problem(&stages, self.runtime.spill());
                tracing::error!(problem, "NOT DURABLE: what cannot be written waits in memory");
                self.not_durable = Some(problem);
            }
            (false, true) => {
                tracing::warn!("durable again: all that waited is written");
                self.not_durable = None;
            }
            (false, false) => self.not_durable = Some(problem(&stages, self.runtime.spill())),
            (true, true) => {}
        }
    }
}

fn problem(stages: &[&str], directory: &Path) -> String {
    let free = statvfs(directory).map(|found| Megabytes(found.f_bavail.saturating_mul(found.f_frsize)));
    let free = free.map_or_else(|error| error.to_string(), |free| format!("{free} free"));
    format!("{} cannot write in {} ({free})", stages.join(", "), directory.display())
}
