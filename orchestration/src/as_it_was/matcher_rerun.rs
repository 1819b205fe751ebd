//! scan-matcher, run again: each pose is computed from its scan, the verdict that was used, the grid and the correction in hand.

use super::grid_copy::{CommitChanges, GridCopy};
use flockslam_messages::{Commit, Correction, PoseEstimate, ScanView, StageInputs, StageStart, Verdict};
use flockslam_scan_matcher::{ScanMatcher, Settings};

/// Matchers, one process after the other.
pub struct MatcherRerun {
    settings: Settings,
    cell_size_m: f64,
    logic: ScanMatcher,
    grid: GridCopy,
    /// The present process, and how many scans it has handled.
    process: u64,
    handled: u64,
    correction: Correction,
    /// Corrections before this one are in the pose that the process began with.
    corrections_before: u32,
}

impl MatcherRerun {
    /// Before the first process.
    pub fn new(settings: Settings, cell_size_m: f64) -> Self {
        Self {
            logic: ScanMatcher::new(settings.clone()),
            settings,
            cell_size_m,
            grid: GridCopy::new(cell_size_m),
            process: 0,
            handled: 0,
            correction: Correction::default(),
            corrections_before: 0,
        }
    }

    /// Whether the inputs are of another process than the last ones.
    pub fn is_new(&self, inputs: &StageInputs) -> bool {
        inputs.process != self.process
    }

    /// Goes on with the process of these inputs, which began after the last of the poses `before`, in order; gives how many scans before are
    /// missing. One that `has_followed` its predecessor has the same grid.
    pub fn follow(&mut self, inputs: &StageInputs, before: &[PoseEstimate], has_followed: bool) -> u64 {
        if self.is_new(inputs) {
            (self.process, self.handled) = (inputs.process, 0);
            self.logic = ScanMatcher::new(self.settings.clone());
            if !has_followed {
                self.grid = GridCopy::new(self.cell_size_m);
            }
            self.correction = Correction::default();
            self.corrections_before = 0;
            if let Some(last) = before.last() {
                self.corrections_before = last.corrections;
                if inputs.start == StageStart::Continued as u32 {
                    self.logic.resume_detached(last);
                } else {
                    before.iter().for_each(|pose| self.logic.restore(pose));
                    self.logic.resume(last);
                }
            }
        }
        let missing = inputs.handled.saturating_sub(self.handled + 1);
        self.handled = inputs.handled;
        missing
    }

    /// Goes on as after this pose, where what came before is not known.
    pub fn take_over(&mut self, pose: &PoseEstimate) {
        self.logic.resume(pose);
    }

    /// Takes the grid up to the commit at place `to`, which is `commit`; a new process begins with the one at place `first`.
    pub fn take_grid(&mut self, changes: &CommitChanges, first: usize, to: usize, commit: &Commit) {
        self.grid.advance(changes, first, to);
        self.logic.committed(commit);
    }

    /// Tiles of its grid.
    pub fn tiles(&self) -> usize {
        self.grid.grid().len()
    }

    /// The pose of a scan.
    pub fn handle(&mut self, scan: ScanView<'_>, inputs: &StageInputs) -> PoseEstimate {
        if inputs.correction != self.correction {
            self.correction = inputs.correction;
            // One that a process on standby had received is in the pose that it began with.
            if inputs.handled > 1 || self.correction.revision > self.corrections_before {
                self.logic.corrected(&self.correction);
            }
        }
        let header = scan.header();
        let (keep, reason) = (inputs.keep, inputs.reason);
        let verdict = Verdict { id: header.id, times: header.times, keep, reason, ..Verdict::default() };
        self.logic.handle(scan, &verdict, self.grid.grid())
    }
}
