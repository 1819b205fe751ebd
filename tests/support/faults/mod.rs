//! Faults against real processes: what is done to a set, and what must hold nevertheless. Both the short form (a test) and the long
//! one (a table) are made of these.

mod evidence;
mod trials;

pub use evidence::Evidence;
pub use trials::{
    Trial, crashing_starts, everything_at_once, kills_of_each_stage, kills_while_saving, stops_of_each_stage,
    storm,
};

/// A small generator of seeded random numbers (splitmix64): the same seed, the same faults.
pub struct Seeded(u64);

impl Seeded {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit
    }
}
