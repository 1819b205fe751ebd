//! The state of the back end for readers while it works.

use super::SyncManager;
use flockslam_loop_closure::closure::Closure;

impl SyncManager {
    /// Closed loops in the present solution: x and y of both ends, metres; then 1 for an inlier, else 0.
    pub fn loops(&self) -> Vec<[f64; 5]> {
        let ends = |(closure, is_inlier): (&Closure, &bool)| {
            let (from, to) = (self.poses.get(closure.edge.from)?, self.poses.get(closure.edge.to)?);
            Some([from.x_m, from.y_m, to.x_m, to.y_m, f64::from(u8::from(*is_inlier))])
        };
        self.closures.iter().zip(&self.is_inlier).filter_map(ends).collect()
    }
}
