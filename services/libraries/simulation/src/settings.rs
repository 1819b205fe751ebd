//! Settings of the simulated world, robot and lidar, section `[simulation]` of the configuration.

use crate::Errors;
use serde::{Deserialize, Serialize};

/// The built-in worlds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WorldName {
    /// A floor of 30 × 20 m: two corridors and two halls around a block, nine rooms.
    #[default]
    Office,
    /// Four parallel corridors of 60 m with identical rooms at regular spacing.
    Hotel,
    /// Nine parallel aisles of 32 m between identical racks.
    Warehouse,
    /// Outdoors, 130 × 80 m: a path between two buildings and a car park, for tens of metres along nothing or a tree.
    Yard,
    /// Outdoors, 250 × 200 m on uneven ground: buildings with glass and colonnades, lawns, hedges, trees, traffic.
    Campus,
}

/// Section `[simulation]`: the simulated world, its robot and its lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything random.
    pub seed: u64,
    /// What the robot drives through: `office` – A floor of 30 × 20 m: two corridors and two halls around a block, nine
    /// rooms; `hotel` – Four parallel corridors of 60 m with identical rooms at regular spacing; `warehouse` – Nine
    /// parallel aisles of 32 m between identical racks; `yard` – Outdoors: for tens of metres along nothing or a tree;
    /// `campus` – Outdoors, 50 000 m² on uneven ground: glass, colonnades, lawns, hedges, trees, traffic. A map given with
    /// `--world` takes its place.
    pub world: WorldName,
    /// Seed from which the campus is made.
    pub world_seed: u64,
    /// How long the robot drives, seconds.
    pub duration_s: f64,
    /// How far into its tour the robot is when it takes the first scan, seconds of driving.
    pub lead_s: f64,
    /// Turns of the lidar per second. On the campus the robot drives so slowly that scans are 0.3 m apart at most.
    pub scan_rate_hz: f64,
    /// Beams of a scan.
    pub beams: u32,
    /// Angle that the beams cover, the middle one ahead, degrees.
    pub field_of_view_deg: f64,
    /// Nothing farther than this is measured (+Inf), metres.
    pub range_max_m: f32,
    /// How often, over the whole drive, a wheel slips for about a second.
    pub wheel_slips: u32,
    /// When the robot is kidnapped, without a trace in its odometry, and put down at another free place with another heading:
    /// seconds since the start, at most 100 times.
    pub kidnap_at_s: Vec<f64>,
    /// People who walk from place to place around the robot, and now and then stand for some seconds.
    pub walkers: u32,
    /// Whether a person walks behind the robot.
    pub follower: bool,
    /// Doors at most, in passages of up to 1.7 m: they open and close at random, and open for people and robots that come near.
    pub doors: u32,
    /// Pallets that appear around the robot and vanish.
    pub pallets: u32,
}

/// Kidnaps in one drive.
const KIDNAPS_MAX: usize = 100;
/// People, doors or pallets.
const CHANGING_MAX: u32 = 1000;

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            world: WorldName::Office,
            world_seed: 1,
            duration_s: 250.0,
            lead_s: 0.0,
            scan_rate_hz: 10.0,
            beams: 360,
            field_of_view_deg: 360.0,
            range_max_m: 12.0,
            wheel_slips: 4,
            kidnap_at_s: Vec::new(),
            walkers: 0,
            follower: false,
            doors: 0,
            pallets: 0,
        }
    }
}

impl Settings {
    /// Errors of lidar and wheels that are usual in the world.
    pub(super) fn errors(&self) -> Errors {
        if matches!(self.world, WorldName::Campus) { Errors::outdoors() } else { Errors::default() }
    }

    /// Says which setting is out of its range, and what the range is.
    ///
    /// # Errors
    /// `Err` with the name of the setting and its range.
    pub fn check(&self) -> Result<(), &'static str> {
        let rules = [
            ((0.1..=100_000.0).contains(&self.duration_s), "duration_s must be between 0.1 and 100000"),
            ((0.0..=10_000.0).contains(&self.lead_s), "lead_s must be between 0 and 10000"),
            ((0.1..=1000.0).contains(&self.scan_rate_hz), "scan_rate_hz must be between 0.1 and 1000"),
            ((1.0..=360.0).contains(&self.field_of_view_deg), "field_of_view_deg must be between 1 and 360"),
            ((1..=10_000_000).contains(&self.beams), "beams must be between 1 and 10000000"),
            ((1.0..=1000.0).contains(&self.range_max_m), "range_max_m must be between 1 and 1000"),
            (self.wheel_slips <= 10_000, "wheel_slips must be at most 10000"),
            (self.kidnap_at_s.len() <= KIDNAPS_MAX, "kidnap_at_s must have at most 100 times"),
            (
                self.kidnap_at_s.iter().all(|at_s| (0.0..=100_000.0).contains(at_s)),
                "kidnap_at_s must be between 0 and 100000",
            ),
            (
                [self.walkers, self.doors, self.pallets].iter().all(|count| *count <= CHANGING_MAX),
                "walkers, doors and pallets must be at most 1000 each",
            ),
        ];
        rules.into_iter().find(|(kept, _)| !kept).map_or(Ok(()), |(_, rule)| Err(rule))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_named() {
        assert_eq!(Settings::default().check(), Ok(()));
        let good = Settings::default;
        let wrong = [
            (Settings { duration_s: 0.0, ..good() }, "duration_s must be between 0.1 and 100000"),
            (Settings { lead_s: -1.0, ..good() }, "lead_s must be between 0 and 10000"),
            (Settings { scan_rate_hz: f64::NAN, ..good() }, "scan_rate_hz must be between 0.1 and 1000"),
            (Settings { field_of_view_deg: 361.0, ..good() }, "field_of_view_deg must be between 1 and 360"),
            (Settings { beams: 0, ..good() }, "beams must be between 1 and 10000000"),
            (Settings { range_max_m: 1001.0, ..good() }, "range_max_m must be between 1 and 1000"),
            (Settings { range_max_m: f32::NAN, ..good() }, "range_max_m must be between 1 and 1000"),
            (Settings { wheel_slips: 10_001, ..good() }, "wheel_slips must be at most 10000"),
            (Settings { kidnap_at_s: vec![1.0; 101], ..good() }, "kidnap_at_s must have at most 100 times"),
            (Settings { kidnap_at_s: vec![-1.0], ..good() }, "kidnap_at_s must be between 0 and 100000"),
            (Settings { doors: 1001, ..good() }, "walkers, doors and pallets must be at most 1000 each"),
        ];
        for (settings, rule) in wrong {
            assert_eq!(settings.check(), Err(rule));
        }
    }
}
