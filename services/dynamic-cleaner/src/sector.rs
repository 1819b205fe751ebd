use std::f64::consts::TAU;

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
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_direction_is_of_one_sector(
            direction in -20.0..20.0_f64, parts in 1_u32..9,
        ) {
            let sectors: Vec<_> = (0..parts).map(|part| Sector::new(part, parts)).collect();
            prop_assert_eq!(sectors.iter().filter(|sector| sector.has(direction)).count(), 1);
        }
    }
}
