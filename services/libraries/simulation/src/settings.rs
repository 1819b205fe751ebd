//! Settings of the simulated world, robot and lidar, section `[simulation]` of the configuration.

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
}

/// Section `[simulation]`: the simulated world, its robot and its lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything random.
    pub seed: u64,
    /// What the robot drives through: `office` – A floor of 30 × 20 m: two corridors and two halls around a block, nine
    /// rooms; `hotel` – Four parallel corridors of 60 m with identical rooms at regular spacing; `warehouse` – Nine
    /// parallel aisles of 32 m between identical racks; `yard` – Outdoors: for tens of metres along nothing or a tree. A
    /// map given with `--world` takes its place.
    pub world: WorldName,
    /// How long the robot drives, seconds.
    pub duration_s: f64,
    /// How far into its tour the robot is when it takes the first scan, seconds of driving.
    pub lead_s: f64,
    /// Fastest driving, m/s.
    pub speed_m_s: f64,
    /// Fastest turning, rad/s.
    pub turn_rad_s: f64,
    /// Turns of the lidar per second.
    pub scan_rate_hz: f64,
    /// Beams of a scan.
    pub beams: u32,
    /// Field of view, degrees; it is centred ahead, and beams run counter-clockwise.
    pub field_of_view_deg: f64,
    /// Mounting pose `base_from_laser`: metres, metres, radians.
    pub laser_mount: [f64; 3],
    /// Nothing nearer than this is measured (-Inf), metres.
    pub range_min_m: f32,
    /// Nothing farther than this is measured (+Inf), metres.
    pub range_max_m: f32,
    /// Standard deviation of a range, metres.
    pub range_sigma_m: f64,
    /// Constant error of all ranges, metres.
    pub range_bias_m: f64,
    /// Share of the beams at the edge of something that give a range between the near and the far surface.
    pub mixed_pixel_share: f64,
    /// Share of the beams that come back without a return (+Inf).
    pub dropout_share: f64,
    /// Standard deviation of the constant relative errors of the odometry's distances and turns.
    pub odometry_scale_error: f64,
    /// Random walk of odometry: metres and degrees (standard deviation) over one metre of driving.
    pub odometry_walk: [f64; 2],
    /// How often, over the whole drive, a wheel slips for about a second.
    pub wheel_slips: u32,
    /// When the robot is carried away, unnoticed by its wheels, and put down at another free place with another heading:
    /// seconds since the start, at most 100 times.
    pub kidnap_at_s: Vec<f64>,
    /// People who walk from place to place around the robot, and now and then stand for some seconds.
    pub walkers: u32,
    /// Their speeds lie between these, m/s.
    pub walker_speed_m_s: [f64; 2],
    /// Whether somebody walks behind the robot.
    pub follower: bool,
    /// Doors at most, in passages of up to 1.7 m: they open and close at random, and open for whoever comes near.
    pub doors: u32,
    /// Pallets that appear around the robot and vanish.
    pub pallets: u32,
}

/// Kidnaps in one drive.
const KIDNAPS_MAX: usize = 100;
/// People, doors or pallets.
const CHANGING_MAX: u32 = 1000;
/// Nobody walks faster, m/s.
pub(super) const WALKER_SPEED_MAX_M_S: f64 = 1.8;

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            world: WorldName::Office,
            duration_s: 250.0,
            lead_s: 0.0,
            speed_m_s: 0.8,
            turn_rad_s: 1.0,
            scan_rate_hz: 10.0,
            beams: 360,
            field_of_view_deg: 360.0,
            laser_mount: [0.1, 0.0, 0.0],
            range_min_m: 0.1,
            range_max_m: 12.0,
            range_sigma_m: 0.01,
            range_bias_m: 0.005,
            mixed_pixel_share: 0.2,
            dropout_share: 0.01,
            odometry_scale_error: 0.02,
            odometry_walk: [0.01, 0.5],
            wheel_slips: 4,
            kidnap_at_s: Vec::new(),
            walkers: 0,
            walker_speed_m_s: [0.4, 1.5],
            follower: false,
            doors: 0,
            pallets: 0,
        }
    }
}

impl Settings {
    /// Says which setting is out of its range, and what the range is.
    ///
    /// # Errors
    /// `Err` with the name of the setting and its range.
    pub fn check(&self) -> Result<(), &'static str> {
        let share = |value: f64| (0.0..=1.0).contains(&value);
        let error = |value: f64| (0.0..=10.0).contains(&value);
        let rules = [
            ((0.1..=100_000.0).contains(&self.duration_s), "duration_s must be between 0.1 and 100000"),
            ((0.0..=10_000.0).contains(&self.lead_s), "lead_s must be between 0 and 10000"),
            ((0.05..=5.0).contains(&self.speed_m_s), "speed_m_s must be between 0.05 and 5"),
            ((0.05..=10.0).contains(&self.turn_rad_s), "turn_rad_s must be between 0.05 and 10"),
            ((0.1..=1000.0).contains(&self.scan_rate_hz), "scan_rate_hz must be between 0.1 and 1000"),
            ((1..=10_000_000).contains(&self.beams), "beams must be between 1 and 10000000"),
            (
                self.field_of_view_deg > 0.0 && self.field_of_view_deg <= 360.0,
                "field_of_view_deg must be up to 360",
            ),
            (self.laser_mount.iter().all(|value| value.abs() < 10.0), "laser_mount must lie within 10 m"),
            (
                self.range_min_m >= 0.0 && self.range_min_m < self.range_max_m,
                "range_min_m must be below range_max_m",
            ),
            (self.range_max_m <= 1000.0, "range_max_m must be at most 1000"),
            (error(self.range_sigma_m), "range_sigma_m must be between 0 and 10"),
            (self.range_bias_m.abs() <= 10.0, "range_bias_m must be between -10 and 10"),
            (share(self.mixed_pixel_share), "mixed_pixel_share must be between 0 and 1"),
            (share(self.dropout_share), "dropout_share must be between 0 and 1"),
            (share(self.odometry_scale_error), "odometry_scale_error must be between 0 and 1"),
            (self.odometry_walk.iter().all(|value| error(*value)), "odometry_walk must be between 0 and 10"),
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
            (
                0.0 < self.walker_speed_m_s[0]
                    && self.walker_speed_m_s[0] <= self.walker_speed_m_s[1]
                    && self.walker_speed_m_s[1] <= WALKER_SPEED_MAX_M_S,
                "walker_speed_m_s must be two ascending speeds up to 1.8",
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
            (Settings { speed_m_s: 0.0, ..good() }, "speed_m_s must be between 0.05 and 5"),
            (Settings { turn_rad_s: 11.0, ..good() }, "turn_rad_s must be between 0.05 and 10"),
            (Settings { scan_rate_hz: f64::NAN, ..good() }, "scan_rate_hz must be between 0.1 and 1000"),
            (Settings { beams: 0, ..good() }, "beams must be between 1 and 10000000"),
            (Settings { field_of_view_deg: 0.0, ..good() }, "field_of_view_deg must be up to 360"),
            (Settings { laser_mount: [10.0, 0.0, 0.0], ..good() }, "laser_mount must lie within 10 m"),
            (Settings { range_min_m: 12.0, ..good() }, "range_min_m must be below range_max_m"),
            (Settings { range_max_m: 1001.0, ..good() }, "range_max_m must be at most 1000"),
            (Settings { range_sigma_m: -0.1, ..good() }, "range_sigma_m must be between 0 and 10"),
            (Settings { range_bias_m: f64::NAN, ..good() }, "range_bias_m must be between -10 and 10"),
            (Settings { mixed_pixel_share: 1.1, ..good() }, "mixed_pixel_share must be between 0 and 1"),
            (Settings { dropout_share: -0.1, ..good() }, "dropout_share must be between 0 and 1"),
            (
                Settings { odometry_scale_error: 2.0, ..good() },
                "odometry_scale_error must be between 0 and 1",
            ),
            (Settings { odometry_walk: [0.0, 11.0], ..good() }, "odometry_walk must be between 0 and 10"),
            (Settings { wheel_slips: 10_001, ..good() }, "wheel_slips must be at most 10000"),
            (Settings { kidnap_at_s: vec![1.0; 101], ..good() }, "kidnap_at_s must have at most 100 times"),
            (Settings { kidnap_at_s: vec![-1.0], ..good() }, "kidnap_at_s must be between 0 and 100000"),
            (Settings { doors: 1001, ..good() }, "walkers, doors and pallets must be at most 1000 each"),
            (
                Settings { walker_speed_m_s: [1.0, 0.5], ..good() },
                "walker_speed_m_s must be two ascending speeds up to 1.8",
            ),
        ];
        for (settings, rule) in wrong {
            assert_eq!(settings.check(), Err(rule));
        }
    }
}
