//! Switches that make a log harder in a repeatable way.

use crate::Settings;
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::sin_cos;
use flockslam_messages::ScanBuffer;
use flockslam_random::Random;
use std::f64::consts::{FRAC_PI_2, PI};

/// Largest distance that odometry jumps within one scan, metres.
const JUMP_M: f64 = 1.0;
/// Largest turn that odometry jumps within one scan, radians.
const JUMP_RAD: f64 = FRAC_PI_2;
/// Length that is assumed of a stream whose end is not known.
const UNKNOWN_SCANS: u64 = 10_000;
/// False returns lie within this range, metres.
const FALSE_RETURN_MAX_M: f32 = 30.0;

/// Applies the experiment switches of the settings to a stream of scans, in its order.
#[derive(Clone, Debug)]
pub struct Experiment {
    settings: Settings,
    noise: Random,
    jump_noise: Random,
    beam_noise: Random,
    /// Scans before which odometry jumps, in rising order.
    jumps: Vec<u64>,
    scans: u64,
    /// Raw and changed odometry of the scan before.
    last: Option<(Pose, Pose)>,
}

impl Experiment {
    /// An experiment on a stream of about `expected_scans` scans, over which the jumps of odometry are spread: one at a
    /// random place of each of as many equal parts. 0 stands for an unknown number (a pipe). The settings must have
    /// passed their check.
    pub fn new(settings: &Settings, expected_scans: u64) -> Self {
        let stream = |purpose| Random::new(settings.seed, purpose);
        let mut places = stream("places of jumps");
        let scans = if expected_scans == 0 { UNKNOWN_SCANS } else { expected_scans };
        let part = (scans - 1) as f64 / f64::from(settings.odometry_jumps.max(1));
        let place = |i: u32| (1.0 + (f64::from(i) + places.share()) * part) as u64;
        Self {
            settings: settings.clone(),
            noise: stream("odometry noise"),
            jump_noise: stream("jumps"),
            beam_noise: stream("beam noise"),
            jumps: (0..settings.odometry_jumps).map(place).collect(),
            scans: 0,
            last: None,
        }
    }

    /// Changes one scan in place; without any switch set it leaves every bit as it is.
    pub fn apply(&mut self, scan: &mut ScanBuffer) {
        if !self.settings.odometry {
            (scan.header.has_odometry, scan.header.odometry) = (0, Pose::IDENTITY);
        }
        if !self.settings.odometry || self.settings.odometry_noise != [0.0, 0.0] {
            // It would tell what the experiment hides.
            scan.drop_motion();
        }
        if scan.header.has_odometry == 1 {
            scan.header.odometry = self.change_odometry(scan.header.odometry);
        }
        if let (0, Some([x_m, y_m, heading_rad])) = (self.scans, self.settings.start_pose) {
            // A robot without odometry is given its start as well.
            (scan.header.has_odometry, scan.header.starts_at_odometry) = (1, 1);
            scan.header.odometry = Pose::new(x_m, y_m, heading_rad);
        }
        self.spoil_beams(scan);
        if !self.scans.is_multiple_of(self.settings.keep_every) {
            scan.header.withheld = 1;
        }
        self.scans += 1;
    }

    fn change_odometry(&mut self, raw: Pose) -> Pose {
        let [sigma_m, sigma_deg] = self.settings.odometry_noise;
        let exact =
            self.settings.start_pose.is_none() && self.jumps.is_empty() && (sigma_m, sigma_deg) == (0.0, 0.0);
        if exact {
            return raw;
        }
        let changed = match self.last {
            None => self.settings.start_pose.map_or(raw, |[x, y, heading]| Pose::new(x, y, heading)),
            Some((raw_before, before)) => {
                before * raw_before.to(raw) * self.random_walk(sigma_m, sigma_deg) * self.jump()
            }
        };
        self.last = Some((raw, changed));
        changed
    }

    fn random_walk(&mut self, sigma_m: f64, sigma_deg: f64) -> Pose {
        let mut step = |sigma: f64| sigma * self.noise.normal();
        Pose::new(step(sigma_m), step(sigma_m), step(sigma_deg.to_radians()))
    }

    fn jump(&mut self) -> Pose {
        if self.jumps.binary_search(&self.scans).is_err() {
            return Pose::IDENTITY;
        }
        let (sin, cos) = sin_cos(self.jump_noise.between(-PI, PI));
        let distance_m = self.jump_noise.between(0.0, JUMP_M);
        Pose::new(distance_m * cos, distance_m * sin, self.jump_noise.between(-JUMP_RAD, JUMP_RAD))
    }

    fn spoil_beams(&mut self, scan: &mut ScanBuffer) {
        let share = self.settings.beam_noise_share;
        if share <= 0.0 {
            return;
        }
        let (min_m, max_m) = (scan.header.range_min_m, scan.header.range_max_m.min(FALSE_RETURN_MAX_M));
        for range in &mut scan.numbers[..scan.header.beam_count as usize] {
            if self.beam_noise.happens(share) {
                *range = self.beam_noise.between(f64::from(min_m), f64::from(max_m)) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCANS: u64 = 1000;

    /// A robot that drives a circle, seen through an experiment.
    fn run(settings: &Settings) -> Vec<ScanBuffer> {
        let mut experiment = Experiment::new(settings, SCANS);
        (0..SCANS)
            .map(|i| i as f64 * 0.01)
            .map(|t| {
                let mut scan = ScanBuffer::from_ranges(&[40.0; 100], 0.0, 0.01);
                (scan.header.odometry, scan.header.has_odometry) =
                    (Pose::new(5.0 * t.sin(), -5.0 * t.cos(), t), 1);
                experiment.apply(&mut scan);
                scan
            })
            .collect()
    }

    fn steps(scans: &[ScanBuffer]) -> Vec<Pose> {
        scans.windows(2).map(|pair| pair[0].header.odometry.to(pair[1].header.odometry)).collect()
    }

    fn differing_steps(a: &[ScanBuffer], b: &[ScanBuffer]) -> usize {
        let differs = |(a, b): (Pose, Pose)| a.distance_m(b) > 1e-9 || a.turn_rad(b) > 1e-9;
        steps(a).into_iter().zip(steps(b)).filter(|pair| differs(*pair)).count()
    }

    #[test]
    fn a_start_pose_turns_the_whole_odometry() {
        let raw = run(&Settings::default());
        let turned = run(&Settings { start_pose: Some([1.0, 2.0, 0.7]), ..Settings::default() });
        assert_eq!(turned[0].header.odometry, Pose::new(1.0, 2.0, 0.7));
        assert_eq!(differing_steps(&raw, &turned), 0);
        assert_eq!(raw[7].header.odometry, Pose::new(5.0 * 0.07f64.sin(), -5.0 * 0.07f64.cos(), 0.07));
    }

    #[test]
    fn jumps_are_as_many_as_asked_and_bounded() {
        let raw = run(&Settings::default());
        for (jumps, seed) in [(1, 1), (3, 1), (10, 1), (1, 2), (3, 3), (10, 4)] {
            let jumping = run(&Settings { odometry_jumps: jumps, seed, ..Settings::default() });
            assert_eq!(differing_steps(&raw, &jumping), jumps as usize, "seed {seed}");
            // The robot itself goes 0.05 m and turns by 0.01 rad in a step.
            let is_bounded = |step: &Pose| {
                step.position().norm_m() < JUMP_M + 0.06 && step.heading_rad.abs() < JUMP_RAD + 0.02
            };
            assert!(steps(&jumping).iter().all(is_bounded), "seed {seed}");
        }
    }

    #[test]
    fn noise_is_seeded_and_changes_every_step() {
        let settings = Settings { odometry_noise: [0.01, 0.5], ..Settings::default() };
        let noisy = run(&settings);
        assert_eq!(differing_steps(&run(&Settings::default()), &noisy), SCANS as usize - 1);
        assert_eq!(noisy, run(&settings));
        assert_ne!(noisy, run(&Settings { seed: 2, ..settings }));
    }

    #[test]
    fn beams_scans_and_odometry_can_be_taken_away() {
        let settings =
            Settings { beam_noise_share: 0.1, keep_every: 4, odometry: false, ..Settings::default() };
        let scans = run(&settings);
        let spoiled: usize = scans.iter().map(|s| s.numbers.iter().filter(|r| **r != 40.0).count()).sum();
        assert!((9_000..11_000).contains(&spoiled));
        assert_eq!(scans.iter().filter(|s| s.header.withheld == 0).count(), 250);
        assert!(scans.iter().all(|s| s.header.has_odometry == 0 && s.header.odometry == Pose::IDENTITY));
    }
}
