//! Seeded random numbers: the same seed gives the same numbers on every machine.

use flockslam_geometry::elementary::{cos, ln, sin_cos};

/// A small seeded generator (SplitMix64, Steele, Lea and Flood 2014, fig. 17): the same seed gives the same numbers on
/// every machine.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The stream of a seed.
    pub fn seeded(seed: u64) -> Self {
        Self { state: seed }
    }

    /// An own stream for each `(seed, purpose)`, so that switching one effect on does not change another.
    pub fn new(seed: u64, purpose: &str) -> Self {
        let mut random = Self::seeded(seed);
        for byte in purpose.bytes() {
            random.state = random.next_u64() ^ u64::from(byte);
        }
        random
    }

    /// Uniform in all 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Uniform in `[0, 1)`.
    pub fn share(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `[low, high)`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    /// Whether an event of this probability happens.
    pub fn happens(&mut self, probability: f64) -> bool {
        self.share() < probability
    }

    /// Uniform in `0..count`; `count` must be positive.
    pub fn below(&mut self, count: usize) -> usize {
        assert!(count > 0, "cannot draw from nothing");
        ((self.share() * count as f64) as usize).min(count - 1)
    }

    /// Uniform in `(0, 1]`.
    pub fn above_zero(&mut self) -> f64 {
        ((self.next_u64() >> 11) + 1) as f64 / (1u64 << 53) as f64
    }

    /// Two independent standard normal numbers (Box and Muller 1958).
    pub fn normal_pair(&mut self) -> (f64, f64) {
        let radius = (-2.0 * ln(self.above_zero())).sqrt();
        let (sin, cos) = sin_cos(std::f64::consts::TAU * self.above_zero());
        (radius * cos, radius * sin)
    }

    /// Standard normal (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * ln(1.0 - self.share())).sqrt();
        radius * cos(std::f64::consts::TAU * self.share())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        for seed in [1, 2, 5] {
            let mut random = Random::new(seed, "test");
            let count = 100_000;
            let normal: Vec<f64> = (0..count).map(|_| random.normal()).collect();
            let mean = normal.iter().sum::<f64>() / f64::from(count);
            let variance = normal.iter().map(|v| v * v).sum::<f64>() / f64::from(count);
            assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
            let share = (0..count).filter(|_| random.happens(0.2)).count();
            assert!((19_000..21_000).contains(&share), "{share}");
            let mut drawn = [0; 3];
            (0..3000).for_each(|_| drawn[random.below(3)] += 1);
            assert!(drawn.iter().all(|count| (800..1200).contains(count)), "{drawn:?}");
        }
    }

    #[test]
    fn pairs_have_mean_zero_and_variance_one() {
        for seed in 0..8 {
            let mut random = Random::seeded(seed);
            let numbers: Vec<f64> =
                (0..20_000).map(|_| random.normal_pair()).flat_map(|(a, b)| [a, b]).collect();
            let mean = numbers.iter().sum::<f64>() / numbers.len() as f64;
            let variance = numbers.iter().map(|n| n * n).sum::<f64>() / numbers.len() as f64;
            assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "seed {seed}: {mean} {variance}");
        }
    }

    #[test]
    fn purposes_have_streams_of_their_own() {
        assert_ne!(Random::new(1, "a").next_u64(), Random::new(1, "b").next_u64());
        assert_eq!(Random::new(1, "a").next_u64(), Random::new(1, "a").next_u64());
    }
}
