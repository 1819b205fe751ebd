//! dynamic-cleaner, run again: the cells that it cleared, from its scans, their poses and the grids that it had.

use super::grid_copy::{CommitChanges, GridCopy};
use flockslam_dynamic_cleaner::{DynamicCleaner, Settings};
use flockslam_messages::{ClearedCell, PoseEstimate, PoseFlags, ScanView, StageInputs};

/// Cleaners, one process after the other.
pub struct CleanerRerun {
    settings: Settings,
    cell_size_m: f64,
    logic: DynamicCleaner,
    grid: GridCopy,
    process: u64,
    handled: u64,
}

impl CleanerRerun {
    /// Before the first process.
    pub fn new(settings: Settings, cell_size_m: f64) -> Self {
        let (logic, grid) = (DynamicCleaner::new(settings.clone()), GridCopy::new(cell_size_m));
        Self { settings, cell_size_m, logic, grid, process: 0, handled: 0 }
    }

    /// Whether the inputs are of another process than the last ones.
    pub fn is_new(&self, inputs: &StageInputs) -> bool {
        inputs.process != self.process
    }

    /// Goes on with the process of these inputs; gives how many scans before are missing.
    pub fn follow(&mut self, inputs: &StageInputs) -> u64 {
        if self.is_new(inputs) {
            (self.process, self.handled) = (inputs.process, 0);
            self.logic = DynamicCleaner::new(self.settings.clone());
            self.grid = GridCopy::new(self.cell_size_m);
        }
        let missing = inputs.handled.saturating_sub(self.handled + 1);
        self.handled = inputs.handled;
        missing
    }

    /// Takes the grid up to the commit at place `to`; a new process begins with the one at place `first`.
    pub fn take_grid(&mut self, changes: &CommitChanges, first: usize, to: usize) {
        self.grid.advance(changes, first, to);
    }

    /// The place of the next commit that it takes; `None` before the first.
    pub fn next_commit(&self) -> Option<usize> {
        self.grid.next()
    }

    /// Tiles of its grid.
    pub fn tiles(&self) -> usize {
        self.grid.grid().len()
    }

    /// Looks at a scan; the cleared cells when it is one that enters the map.
    pub fn handle(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        inputs: &StageInputs,
    ) -> Option<Vec<ClearedCell>> {
        let (has_scan, has_grid) = (inputs.has_scan == 1, inputs.has_grid == 1);
        let (logic, grid) = (&mut self.logic, self.grid.grid());
        if pose.has(PoseFlags::INSERT) {
            if !has_scan || !has_grid {
                return Some(Vec::new());
            }
            logic.watch(scan, pose, grid);
            return Some(logic.handle(scan, pose, grid).cleared.to_vec());
        }
        if has_scan {
            logic.watch(scan, pose, grid);
            if has_grid {
                logic.look_on(scan, pose, grid);
            }
        }
        None
    }
}
