//! Votes against cells: how many scans from different places have looked through each. The cleaner clears a cell once
//! it has enough of them.

use flockslam_evidence::{CellIndex, CellTable};
use flockslam_geometry::Pose;

/// Counts for cells how many scans from different places have looked through them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Votes {
    cells: CellTable<Vote>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Vote {
    /// 0: none so far.
    count: u8,
    x_m: f32,
    y_m: f32,
    heading_rad: f32,
}

/// When a vote counts beside the last one.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Counts {
    /// When the lidar has moved so far between them.
    FromOtherPlaces {
        /// Metres.
        distance_m: f64,
        /// Radians.
        turn_rad: f64,
    },
    /// Always, up to so many votes.
    UpTo(u8),
}

impl Votes {
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a vote for a cell, given from `laser` in scan number `scan`, if it counts; gives the number of votes.
    pub fn add(&mut self, cell: CellIndex, laser: Pose, scan: u32, counts: Counts) -> u8 {
        let vote = self.cells.touch(cell, scan);
        let last = Pose::new(f64::from(vote.x_m), f64::from(vote.y_m), f64::from(vote.heading_rad));
        let counts = match counts {
            Counts::FromOtherPlaces { distance_m, turn_rad } => {
                laser.distance_m(last) >= distance_m || laser.turn_rad(last) >= turn_rad
            }
            Counts::UpTo(most) => vote.count < most,
        };
        if vote.count == 0 || counts {
            vote.count = vote.count.saturating_add(1);
            (vote.x_m, vote.y_m) = (laser.x_m as f32, laser.y_m as f32);
            vote.heading_rad = laser.heading_rad as f32;
        }
        vote.count
    }

    /// Removes all votes for a cell.
    pub fn remove(&mut self, cell: CellIndex) {
        self.cells.remove(cell);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASELINE: Counts = Counts::FromOtherPlaces { distance_m: 0.1, turn_rad: 0.2 };

    #[test]
    fn votes_from_one_place_count_once_and_support_takes_them_back() {
        let (mut votes, cell) = (Votes::new(), CellIndex::new(3, -4));
        let at = |x_m, heading_rad| Pose::new(x_m, 0.0, heading_rad);
        assert_eq!(votes.add(cell, at(0.0, 0.0), 1, BASELINE), 1);
        assert_eq!(votes.add(cell, at(0.05, 0.1), 2, BASELINE), 1);
        assert_eq!(votes.add(cell, at(0.12, 0.1), 3, BASELINE), 2);
        assert_eq!(votes.add(cell, at(0.12, 0.4), 4, BASELINE), 3);
        votes.remove(cell);
        assert_eq!(votes.add(cell, at(0.12, 0.4), 5, BASELINE), 1);
        // Of a robot that stands, scans count so far that one from elsewhere decides.
        assert_eq!([6, 7, 8].map(|scan| votes.add(cell, at(0.12, 0.4), scan, Counts::UpTo(2))), [2, 2, 2]);
        assert_eq!(votes.add(cell, at(0.32, 0.4), 9, BASELINE), 3);
    }
}
