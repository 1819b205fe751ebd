//! Faults against real processes: what is done to a set, and what must hold nevertheless. Both the short form (a test) and the long
//! one (a table) are made of these.

mod evidence;
mod fault_trials;
mod input;
mod journal_cost;
mod localized_trial;
mod overload_trial;
mod storage;

pub use evidence::Evidence;
pub use fault_trials::{
    Trial, crashing_starts, descriptors, endless_loop, everything_at_once, jumping_clock,
    kills_of_each_stage, kills_of_the_leader, kills_while_saving, left_behind, stops_of_each_stage, storm,
    too_much_is_left, with_failpoint,
};
use flockslam_random::Random;
pub use input::{corrupt_scans, repetitions};
pub use journal_cost::JournalCost;
pub use localized_trial::kills_while_localized;
pub use overload_trial::{Overload, overload};
pub use storage::{refusing_disk, terminations, torn_files};

/// Seeded random numbers: the same seed, the same faults.
pub struct Seeded(Random);

impl Seeded {
    pub fn new(seed: u64) -> Self {
        Self(Random::seeded(seed))
    }

    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.next_u64() % limit
    }
}
