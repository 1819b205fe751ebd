//! The test of a group of closures between two robots against what both have seen: free space of one where the other saw a wall speaks against it, and so
//! does another place that fits as well.

use super::FlockGraph;
use super::alternatives::{Place, RelativePose};
use super::overlap::Fit;
use flockslam_loop_closure::closure::Closure;
use flockslam_registration::cloud::Placement;
use std::collections::BTreeMap;

/// Places of a group that are looked at, so far apart along the second robot's way, metres.
const PLACES: usize = 3;
const APART_M: f64 = 20.0;
/// Scans that must be compared at a place, around both robots' trajectories together, before there is a result.
const SCANS_MIN: u32 = 30;
/// The same around a single closure.
const SCANS_ALONE_MIN: u32 = 8;
/// Tells the result for a single closure from that for a pose.
const ALONE: u64 = u64::MAX;
/// Largest share of what both have seen that one of them may deny: what is the same has up to 0.047 with people in it, rooms that only look
/// alike mostly 0.06 and more.
const DENIED_MAX: f64 = 0.05;
/// Another explanation is as good when its share is no more than this multiple of the claimed one's and a little …
const ALTERNATIVE: (f64, f64) = (1.5, 0.02);
/// … and it explains at least this share of what the claimed one does.
const EXPLAINED: f64 = 0.4;
/// Results that are cached.
const CACHED_MAX: usize = 4096;

/// What was found out about groups of closures. It follows from the records alone: that it is cached saves time and changes nothing.
#[derive(Clone, Debug, Default)]
pub struct Inspected {
    results: BTreeMap<Vec<u64>, bool>,
}

impl Inspected {
    /// The cached result of this key, computed when it is new.
    fn cached_result(&mut self, name: Vec<u64>, compute: impl FnOnce() -> bool) -> bool {
        if let Some(cached_result) = self.results.get(&name) {
            return *cached_result;
        }
        let cached_result = compute();
        if self.results.len() >= CACHED_MAX {
            self.results.clear();
        }
        self.results.insert(name, cached_result);
        cached_result
    }
}

impl FlockGraph {
    /// Whether a group of closures between two robots, which agree with each other, may act: what both robots have seen there is the
    /// same, and it fits nowhere else as well.
    ///
    /// Buildings are full of things that look alike: a few matches that agree can always be found. Where robots are connected
    /// rightly, neither has seen free space where the other saw a wall.
    pub(super) fn stands(&self, group: &[usize], inspected: &mut Inspected) -> bool {
        let mut relatives: Vec<RelativePose> =
            group.iter().map(|i| RelativePose::of(&self.closures[*i])).collect();
        relatives.sort_by_key(|relative| (relative.to, relative.from));
        let turned: Vec<RelativePose> = relatives.iter().map(RelativePose::turned).collect();
        // The first places, not the best spread ones: what was found out about them stays when the group grows.
        let cell = |relative: &RelativePose| (self.nodes[relative.to].travel_m / APART_M) as u64;
        let places = relatives.chunk_by(|a, b| cell(a) == cell(b)).map(|some| &some[0]);
        places.take(PLACES).all(|middle| {
            let there = Place::new(self, middle, &relatives);
            let back = Place::new(self, &middle.turned(), &turned);
            let name = [self.named(&there, middle), self.named(&back, &middle.turned())].concat();
            inspected.cached_result(name, || is_sure(&[there.fits(self), back.fits(self)]))
        })
    }

    /// Whether what both robots have seen around a closure between them is the same. That it may be so elsewhere too does not matter where
    /// other relative poses say that it should be here.
    pub(super) fn is_the_same_there(&self, closure: &Closure, inspected: &mut Inspected) -> bool {
        let relative = RelativePose::of(closure);
        let place = Place::new(self, &relative, &[relative]);
        let mut name = self.named(&place, &relative);
        name.push(ALONE);
        inspected.cached_result(name, || {
            let claimed = place.fit(self);
            claimed.scans >= SCANS_ALONE_MIN && claimed.denied_share() <= DENIED_MAX
        })
    }

    /// All that the result for a pose depends on, to the bit: a cached one must be the same as one that is worked out.
    fn named(&self, place: &Place, middle: &RelativePose) -> Vec<u64> {
        let mut name = vec![self.nodes[middle.to].sequence];
        for range in &place.nodes {
            let (first, last) = (&self.nodes[range.start], &self.nodes[range.end - 1]);
            name.extend([
                first.sequence,
                last.sequence,
                first.travel_m.to_bits(),
                first.drift_bound_m.to_bits(),
            ]);
        }
        for (to, first_from_second) in &place.relatives {
            name.push(self.nodes[*to].sequence);
            let Placement { x_m, y_m, heading_rad, .. } = *first_from_second;
            name.extend([x_m, y_m, heading_rad].map(f64::to_bits));
        }
        name
    }
}

/// Whether what both have seen is the same, and would not be somewhere else: fits as claimed and as they would be otherwise, around what
/// the second robot has seen and around what the first has. One of them may have seen only a part of a place that the other knows well.
fn is_sure(fits: &[(Fit, Option<Fit>); 2]) -> bool {
    let has_alternative = |(claimed, other): &(Fit, Option<Fit>)| {
        let as_good = ALTERNATIVE.0 * claimed.denied_share() + ALTERNATIVE.1;
        let explained = EXPLAINED * f64::from(claimed.seen);
        other.is_some_and(|other| f64::from(other.seen) >= explained && other.denied_share() <= as_good)
    };
    let [(there, _), (back, _)] = fits;
    let both = there.and(back);
    both.scans >= SCANS_MIN && both.denied_share() <= DENIED_MAX && !fits.iter().any(has_alternative)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unique_match_is_certain() {
        let fit = |seen: u32, denied: u32| Fit { scans: 30, seen, denied };
        let claimed = fit(1750, 10);
        let around = |claimed: Fit, other: Option<Fit>| [(claimed, other), (fit(1800, 12), None)];
        assert!(is_sure(&around(fit(1750, 45), None)) && !is_sure(&around(fit(1750, 400), None)));
        assert!(
            !is_sure(&[(Fit { scans: 5, ..claimed }, None); 2]) && !is_sure(&[(Fit::default(), None); 2])
        );
        // A room farther on, with other furniture; with the same; and something small that fits anywhere.
        assert!(is_sure(&around(claimed, Some(fit(1700, 150)))));
        assert!(!is_sure(&around(claimed, Some(fit(1600, 20)))));
        assert!(is_sure(&around(claimed, Some(fit(300, 2)))));
    }

    #[test]
    fn a_hall_of_which_one_has_seen_only_a_part_fits_both_ways_round_in_what_the_other_has_seen() {
        let there = (Fit { scans: 22, seen: 1166, denied: 41 }, None);
        let claimed = Fit { scans: 22, seen: 1148, denied: 35 };
        let turned_round = Fit { scans: 16, seen: 616, denied: 14 };
        assert!(is_sure(&[there, (claimed, None)]));
        assert!(
            !is_sure(&[there, (claimed, Some(turned_round))])
                && !is_sure(&[(claimed, Some(turned_round)), there])
        );
    }
}
