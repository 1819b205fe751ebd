//! One step of the matcher, compiled here, where code is optimised.

use flockslam_evidence::{Tile, TileGrid};
use flockslam_messages::{PoseEstimate, ScanView, Verdict};
use flockslam_scan_matcher::ScanMatcher;

/// The pose of a scan by the grid (frame: `odom`), as [`ScanMatcher::handle`] gives it.
pub fn matched(
    matcher: &mut ScanMatcher,
    scan: ScanView<'_>,
    verdict: &Verdict,
    grid: &TileGrid<Box<Tile>>,
) -> PoseEstimate {
    matcher.handle(scan, verdict, grid)
}
