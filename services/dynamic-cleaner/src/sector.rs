use std::f64::consts::TAU;
use std::ops::Range;

/// One of several equal sectors of the circle around the lidar: the share of one replica of the cleaner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sector {
    part: u32,
    parts: u32,
}

impl Sector {
    /// The whole circle.
    pub const WHOLE: Self = Self { part: 0, parts: 1 };

    /// Number `part` (from 0) of `parts` sectors; the first begins at the lidar's x-axis.
    pub fn new(part: u32, parts: u32) -> Self {
        assert!(part < parts, "a sector is one of its circle");
        Self { part, parts }
    }

    /// Whether a direction in the laser frame, radians, lies in it. Every direction lies in exactly one sector.
    pub(crate) fn has(self, direction_rad: f64) -> bool {
        if self.parts == 1 {
            return true;
        }
        let turn = (direction_rad / TAU).rem_euclid(1.0);
        ((turn * f64::from(self.parts)) as u32).min(self.parts - 1) == self.part
    }

    /// Its share of the beams of a scan.
    pub(crate) fn beams(self, count: usize) -> Range<usize> {
        let bound = |part: u32| (count as u64 * u64::from(part) / u64::from(self.parts)) as usize;
        bound(self.part)..bound(self.part + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_direction_and_every_beam_is_of_one_sector(
            direction in -20.0..20.0_f64, parts in 1_u32..9, beams in 0_usize..100_000,
        ) {
            let sectors: Vec<_> = (0..parts).map(|part| Sector::new(part, parts)).collect();
            prop_assert_eq!(sectors.iter().filter(|sector| sector.has(direction)).count(), 1);
            let shares: Vec<_> = sectors.iter().map(|sector| sector.beams(beams)).collect();
            prop_assert_eq!((shares[0].start, shares[shares.len() - 1].end), (0, beams));
            prop_assert!(shares.windows(2).all(|pair| pair[0].end == pair[1].start));
        }
    }
}
