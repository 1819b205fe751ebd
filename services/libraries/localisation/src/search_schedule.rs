//! When a robot that is not found in the map is looked for again: after some travel or turning; once several searches have failed, after the
//! more of either the more work a search is.

use flockslam_registration::cloud::Placement;

/// It is looked for again after this much travel, metres, or turning, radians.
const AGAIN: (f64, f64) = (0.9, 0.7);
/// So many searches are made like this: most robots are found by then.
const PROMPT: u32 = 24;
/// After these, a search that has summed up so many blocks of cells is followed by a metre of travel, and so on: in the map of another
/// building a robot would spend most of its time with searching.
const BLOCKS_PER_M: u64 = 200_000;
/// A robot that comes from where nothing is mapped is found this much later at most, metres.
const APART_MAX_M: f64 = 4.5;

/// Since a robot has lost its place, or was switched on.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SearchSchedule {
    /// Where it was looked for last, by the front end.
    last: Option<Placement>,
    searches: u32,
    /// Work of the last search, in blocks.
    blocks: u64,
}

impl SearchSchedule {
    /// Whether a search is due.
    pub(crate) fn is_due(&self, odom_from_base: &Placement) -> bool {
        let (way_m, turn_rad) = self.apart();
        self.last.is_none_or(|last| {
            last.distance_m(odom_from_base) >= way_m || last.turn_rad(odom_from_base) >= turn_rad
        })
    }

    /// A search begins here. Gives whether the robot sees other things than at the last one.
    pub(crate) fn begin(&mut self, odom_from_base: Placement) -> bool {
        let last = self.last.replace(odom_from_base);
        last.is_none_or(|last| last.distance_m(&odom_from_base) >= AGAIN.0)
    }

    /// The search has looked at the map, with so much work, in blocks.
    pub(crate) fn searched(&mut self, blocks: u64) {
        self.searches += 1;
        self.blocks = blocks;
    }

    /// How often the map has been looked at.
    pub(crate) fn searches(&self) -> u32 {
        self.searches
    }

    /// Travel, metres, and turning, radians, until the next search.
    fn apart(&self) -> (f64, f64) {
        if self.searches < PROMPT {
            return AGAIN;
        }
        let way_m = (self.blocks as f64 / BLOCKS_PER_M as f64).clamp(AGAIN.0, APART_MAX_M);
        (way_m, AGAIN.1 * way_m / AGAIN.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_m: f64) -> Placement {
        Placement::new(x_m, 0.0, 0.0)
    }

    /// Travel between the searches of a robot that is not found, each of so much work.
    fn ways_m(blocks: u64) -> Vec<f64> {
        let mut schedule = SearchSchedule::default();
        let (mut ways_m, mut last_m) = (Vec::new(), 0.0);
        for step in 0..1000 {
            let x_m = 0.1 * f64::from(step);
            if schedule.is_due(&at(x_m)) {
                schedule.begin(at(x_m));
                schedule.searched(blocks);
                ways_m.push(x_m - last_m);
                last_m = x_m;
            }
        }
        ways_m.split_off(1)
    }

    #[test]
    fn searches_that_are_much_work_become_rarer_and_others_do_not() {
        assert!(ways_m(BLOCKS_PER_M / 2).iter().all(|way_m| (0.89..1.01).contains(way_m)));
        let ways_m = ways_m(3 * BLOCKS_PER_M);
        let (prompt, paid) = ways_m.split_at(PROMPT as usize - 1);
        assert!(prompt.iter().all(|way_m| (0.89..1.01).contains(way_m)), "{prompt:?}");
        assert!(paid.iter().all(|way_m| (2.99..3.11).contains(way_m)) && paid.len() > 20, "{paid:?}");
    }

    #[test]
    fn however_much_work_it_is_a_search_follows_within_some_metres() {
        let ways_m = ways_m(u64::MAX);
        assert!(ways_m.iter().all(|way_m| *way_m < APART_MAX_M + 0.11), "{ways_m:?}");
    }

    #[test]
    fn a_robot_that_turns_sees_the_same_from_another_side() {
        let mut schedule = SearchSchedule::default();
        assert!(schedule.begin(at(0.0)));
        schedule.searched(1);
        assert!(schedule.is_due(&Placement::new(0.0, 0.0, 0.71)) && !schedule.is_due(&at(0.5)));
        assert!(!schedule.begin(Placement::new(0.0, 0.0, 0.71)));
    }
}
