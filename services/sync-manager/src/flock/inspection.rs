use super::Atlas;
use super::overlap::Fit;
use super::rivals::Place;
use crate::closure::Closure;
use flockslam_registration::cloud::Placement;
use std::collections::BTreeMap;

/// Places of a group that are looked at, so far apart along the second robot's way, metres.
const PLACES: usize = 3;
const APART_M: f64 = 20.0;
/// Scans that must be compared at a place before anything is said.
const SCANS_MIN: u32 = 16;
/// The same around a single closure.
const SCANS_ALONE_MIN: u32 = 8;
/// Tells the verdict on a closure alone from that on a place.
const ALONE: u64 = u64::MAX;
/// Largest share of what both have seen that one of them may deny: what is the same has up to 0.045 with people in it, rooms that only look
/// alike mostly 0.06 and more.
const DENIED_MAX: f64 = 0.05;
/// Another explanation is as good when its share is no more than this multiple of the claimed one's and a little …
const RIVAL: (f64, f64) = (1.5, 0.02);
/// … and it explains at least this share of what the claimed one does.
const EXPLAINED: f64 = 0.4;
/// Verdicts that are remembered.
const REMEMBERED_MAX: usize = 4096;

/// What was found out about groups of closures. It follows from the records alone: that it is remembered saves time and changes nothing.
#[derive(Clone, Debug, Default)]
pub struct Inspected {
    verdicts: BTreeMap<Vec<u64>, bool>,
}

impl Inspected {
    /// The verdict of this name, worked out when it is new.
    fn verdict(&mut self, name: Vec<u64>, work_out: impl FnOnce() -> bool) -> bool {
        if let Some(verdict) = self.verdicts.get(&name) {
            return *verdict;
        }
        let verdict = work_out();
        if self.verdicts.len() >= REMEMBERED_MAX {
            self.verdicts.clear();
        }
        self.verdicts.insert(name, verdict);
        verdict
    }
}

impl Atlas {
    /// Whether a group of closures between two robots, which agree with each other, may be believed: what both robots have seen there is the
    /// same, and it fits nowhere else as well.
    ///
    /// Buildings are full of things that look alike: a few matches that agree can always be found. Where robots are tied together
    /// rightly, neither has seen free space where the other saw a wall.
    pub(super) fn stands(&self, group: &[usize], inspected: &mut Inspected) -> bool {
        let mut closures: Vec<Closure> = group.iter().map(|i| self.closures[*i]).collect();
        closures.sort_by_key(|closure| (closure.edge.to, closure.edge.from));
        // The first places, not the best spread ones: what was found out about them stays when the group grows.
        let cell = |closure: &Closure| (self.nodes[closure.edge.to].travel_m / APART_M) as u64;
        let places = closures.chunk_by(|a, b| cell(a) == cell(b)).map(|some| &some[0]);
        places.take(PLACES).all(|middle| {
            let place = Place::new(self, middle, &closures);
            inspected.verdict(self.named(&place, middle), || {
                let (claimed, other) = place.fits(self);
                is_sure(&claimed, other.as_ref())
            })
        })
    }

    /// Whether what both robots have seen around a closure between them is the same. That it may be so elsewhere too does not matter where
    /// other ties say that it should be here.
    pub(super) fn is_the_same_there(&self, closure: &Closure, inspected: &mut Inspected) -> bool {
        let place = Place::new(self, closure, std::slice::from_ref(closure));
        let mut name = self.named(&place, closure);
        name.push(ALONE);
        inspected.verdict(name, || {
            let claimed = place.fit(self);
            claimed.scans >= SCANS_ALONE_MIN && claimed.denied_share() <= DENIED_MAX
        })
    }

    /// All that the verdict on a place depends on, to the bit: who remembers it must conclude the same as who works it out.
    fn named(&self, place: &Place, middle: &Closure) -> Vec<u64> {
        let mut name = vec![self.nodes[middle.edge.to].sequence];
        for range in &place.nodes {
            let (first, last) = (&self.nodes[range.start], &self.nodes[range.end - 1]);
            name.extend([first.sequence, last.sequence, first.travel_m.to_bits(), first.doubt_m.to_bits()]);
        }
        for (to, first_from_second) in &place.ties {
            name.push(self.nodes[*to].sequence);
            let Placement { x_m, y_m, heading_rad, .. } = *first_from_second;
            name.extend([x_m, y_m, heading_rad].map(f64::to_bits));
        }
        name
    }
}

/// Whether what both have seen is the same, and would not be somewhere else.
fn is_sure(claimed: &Fit, other: Option<&Fit>) -> bool {
    let as_good = RIVAL.0 * claimed.denied_share() + RIVAL.1;
    let is_rival = |other: &Fit| {
        f64::from(other.seen) >= EXPLAINED * f64::from(claimed.seen) && other.denied_share() <= as_good
    };
    claimed.scans >= SCANS_MIN && claimed.denied_share() <= DENIED_MAX && !other.is_some_and(is_rival)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fits_once_and_nowhere_else_is_sure() {
        let fit = |seen: u32, denied: u32| Fit { scans: 30, seen, denied };
        let claimed = fit(1750, 10);
        assert!(is_sure(&fit(1750, 45), None) && !is_sure(&fit(1750, 200), None));
        assert!(!is_sure(&Fit { scans: 5, ..claimed }, None) && !is_sure(&Fit::default(), None));
        // A room farther on, with other furniture; with the same; and something small that fits anywhere.
        assert!(is_sure(&claimed, Some(&fit(1700, 150))));
        assert!(!is_sure(&claimed, Some(&fit(1600, 20))));
        assert!(is_sure(&claimed, Some(&fit(300, 2))));
    }
}
