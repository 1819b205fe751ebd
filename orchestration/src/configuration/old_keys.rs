//! Keys of earlier versions: each is refused with what became of it, wherever keys are given.

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// What became of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Now {
    /// A constant of this value.
    Fixed(&'static str),
    /// The same key has another name.
    Called(&'static str),
    /// There is nothing left to set, for this reason.
    Gone(&'static str),
}

use Now::{Called, Fixed, Gone};

/// Old keys, sorted by section and name. docs/upgrading.md lists them for users.
pub const OLD_KEYS: &[(&str, Now)] = &[
    ("correlation_filter.consecutive_drops_max", Fixed("2")),
    ("correlation_filter.corridor_max", Fixed("0.6")),
    ("correlation_filter.histogram_threshold", Fixed("0.5")),
    ("correlation_filter.profile_threshold", Fixed("0.6")),
    ("correlation_filter.rest_drops_max", Fixed("40")),
    ("correlation_filter.shed_behind_scans", Fixed("16")),
    ("correlation_filter.threads", Fixed("2")),
    ("correlation_filter.unseen_travel_m", Fixed("0.12")),
    ("correlation_filter.unseen_turn_rad", Fixed("0.15")),
    ("correlation_filter.window", Fixed("3")),
    ("dynamic_cleaner.cleared_max", Gone("it follows dynamic_cleaner.method")),
    ("dynamic_cleaner.contradiction_max", Gone("it follows dynamic_cleaner.method")),
    ("dynamic_cleaner.join_m", Fixed("0.05")),
    ("dynamic_cleaner.lateral_margin_m", Fixed("0.1")),
    ("dynamic_cleaner.margin_m", Fixed("0.15")),
    ("dynamic_cleaner.margin_share", Fixed("0.015")),
    ("dynamic_cleaner.vote_distance_m", Fixed("0.15")),
    ("dynamic_cleaner.vote_turn_rad", Fixed("0.3")),
    ("lidar_ingest.max_beams", Fixed("10000000")),
    ("lidar_ingest.max_line_bytes", Fixed("67108864")),
    ("lidar_ingest.range_min_m", Fixed("0.05")),
    ("mapper.free_cap_nat", Gone("it follows mapper.sensor_model")),
    ("mapper.hit_nat", Fixed("1.5")),
    ("mapper.newcomer_views", Called("mapper.confirming_scans")),
    ("mapper.occupied_cap_nat", Gone("it follows mapper.sensor_model")),
    ("mapper.range_max_m", Fixed("30.0")),
    ("mapper.read_out", Gone("it follows mapper.sensor_model")),
    ("mapper.submap_length_m", Fixed("5.0")),
    ("scan_matcher.beams_max", Fixed("1000")),
    ("scan_matcher.correlative.points_max", Fixed("100")),
    ("scan_matcher.correlative.prior_heading", Fixed("1.0")),
    ("scan_matcher.correlative.prior_xy", Fixed("5.0")),
    ("scan_matcher.correlative.reach_m", Fixed("0.25")),
    ("scan_matcher.correlative.reach_rad", Fixed("0.2")),
    ("scan_matcher.correlative.refinements", Fixed("8")),
    ("scan_matcher.degenerate_below", Fixed("0.005")),
    ("scan_matcher.gate.score_share", Called("scan_matcher.rescue.below")),
    ("scan_matcher.gate.sigma_max_m", Fixed("0.1")),
    ("scan_matcher.gate.start_scans", Fixed("10")),
    ("scan_matcher.gauss_newton.iterations", Fixed("[4, 4, 6]")),
    ("scan_matcher.gauss_newton.prior_heading", Fixed("0.1")),
    ("scan_matcher.gauss_newton.prior_xy", Fixed("0.5")),
    ("scan_matcher.gauss_newton.step_max_m", Fixed("0.5")),
    ("scan_matcher.gauss_newton.turn_max_rad", Fixed("0.2")),
    ("scan_matcher.hill_climbing.failed_rounds_max", Fixed("6")),
    ("scan_matcher.hill_climbing.step_heading_rad", Fixed("0.1")),
    ("scan_matcher.hill_climbing.step_xy_m", Fixed("0.1")),
    ("scan_matcher.monte_carlo.failures_max", Fixed("20")),
    ("scan_matcher.monte_carlo.poses_max", Fixed("100")),
    ("scan_matcher.monte_carlo.sigma_heading_rad", Fixed("0.1")),
    ("scan_matcher.monte_carlo.sigma_xy_m", Fixed("0.2")),
    ("scan_matcher.ndt.flatness_min", Fixed("0.001")),
    ("scan_matcher.ndt.iterations", Fixed("20")),
    ("scan_matcher.ndt.points_min", Fixed("3.0")),
    ("scan_matcher.ndt.prior_heading", Fixed("0.02")),
    ("scan_matcher.ndt.prior_xy", Fixed("0.1")),
    ("scan_matcher.no_odometry.points_max", Fixed("100")),
    ("scan_matcher.no_odometry.prior_heading", Fixed("1.0")),
    ("scan_matcher.no_odometry.prior_xy", Fixed("5.0")),
    ("scan_matcher.no_odometry.reach_m", Fixed("0.3")),
    ("scan_matcher.no_odometry.reach_rad", Fixed("0.35")),
    ("scan_matcher.no_odometry.refinements", Fixed("8")),
    ("scan_matcher.rescue.candidates", Fixed("3")),
    ("scan_matcher.rescue.gain", Fixed("0.05")),
    ("scan_matcher.rescue.jump_m", Fixed("0.3")),
    ("scan_matcher.rescue.jump_rad", Fixed("0.3")),
    ("scan_matcher.rescue.lost_below", Fixed("0.25")),
    ("scan_matcher.rescue.mean_rate", Fixed("0.02")),
    ("scan_matcher.rescue.reach_m", Fixed("0.6")),
    ("scan_matcher.rescue.reach_rad", Fixed("0.35")),
    ("scan_matcher.unknown_score", Gone("it follows mapper.sensor_model")),
    ("set.window", Fixed("64")),
    ("simulation.dropout_share", Fixed("0.01")),
    ("simulation.laser_mount", Fixed("[0.1, 0.0, 0.0]")),
    ("simulation.mixed_pixel_share", Fixed("0.2")),
    ("simulation.odometry_scale_error", Fixed("0.02")),
    ("simulation.odometry_walk", Fixed("[0.01, 0.5]")),
    ("simulation.range_bias_m", Fixed("0.005")),
    ("simulation.range_min_m", Fixed("0.1")),
    ("simulation.range_sigma_m", Fixed("0.01")),
    ("simulation.speed_m_s", Fixed("0.8")),
    ("simulation.turn_rad_s", Fixed("1.0")),
    ("simulation.walker_speed_m_s", Fixed("[0.4, 1.5]")),
    ("sync_manager.chain_nodes", Fixed("20")),
    ("sync_manager.closure.chi_squared_max", Fixed("16.0")),
    ("sync_manager.closure.enabled", Called("sync_manager.close_loops")),
    ("sync_manager.closure.every_m", Fixed("1.5")),
    ("sync_manager.closure.inliers_min", Fixed("0.6")),
    ("sync_manager.closure.least_travel_m", Fixed("15.0")),
    ("sync_manager.closure.score_min", Fixed("0.55")),
    ("sync_manager.closure.searches_per_submap", Fixed("60")),
    ("sync_manager.closure.segments_per_query", Fixed("6")),
    ("sync_manager.dense_passes", Fixed("1")),
    ("sync_manager.final_nodes", Fixed("3")),
    ("sync_manager.flock.body_radius_m", Fixed("0.35")),
    ("sync_manager.flock.bytes_per_minute", Fixed("6000000")),
    ("sync_manager.flock.companions", Called("sync_manager.flock.wait_for_robots")),
    ("sync_manager.flock.farewell_s", Called("sync_manager.flock.wait_max_s")),
    ("sync_manager.map_passes", Fixed("1")),
    ("sync_manager.node_distance_m", Fixed("0.3")),
    ("sync_manager.node_turn_rad", Fixed("0.35")),
    ("sync_manager.range_max_m", Fixed("20.0")),
    ("sync_manager.range_min_m", Fixed("0.3")),
    ("sync_manager.refine", Gone("matching all scans once more at the end improved nothing")),
    ("sync_manager.segment_length_m", Fixed("5.0")),
    ("sync_manager.visits_kept", Fixed("3")),
];

/// The message for an old key: one line.
fn message_for(key: &str) -> Option<String> {
    let (_, now) = OLD_KEYS.iter().find(|(old, _)| *old == key)?;
    Some(match now {
        Fixed(value) => format!("{key} is now fixed at {value}"),
        Called(name) => format!("{key} is now called {name}"),
        Gone(reason) => format!("{key} is gone: {reason}"),
    })
}

/// The message for the first old key of a table.
pub fn in_table(table: &Table) -> Option<String> {
    below(table, "")
}

fn below(table: &Table, section: &str) -> Option<String> {
    table.iter().find_map(|(name, value)| {
        let key = format!("{section}{name}");
        message_for(&key).or_else(|| match value {
            Value::Table(table) => below(table, &format!("{key}.")),
            _ => None,
        })
    })
}

/// The first old key of a TOML text: its place in bytes and its message. A text that is not TOML has none.
pub fn in_text(message: &str) -> Option<(usize, String)> {
    below_in_text(DeTable::parse(message).ok()?.get_ref(), "")
}

fn below_in_text(table: &DeTable<'_>, section: &str) -> Option<(usize, String)> {
    let found = table.iter().filter_map(|(name, value)| {
        let key = format!("{section}{}", name.get_ref());
        let old = message_for(&key).map(|message| (name.span().start, message));
        old.or_else(|| match value.get_ref() {
            DeValue::Table(table) => below_in_text(table, &format!("{key}.")),
            _ => None,
        })
    });
    found.min_by_key(|(place, _)| *place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::configuration::{Configuration, ConfigurationError, Profile};
    use crate::supervisor::SetDescription;

    /// An old key as an assignment, with a value that it could have had.
    fn assignment((key, now): &(&str, Now)) -> String {
        match now {
            Fixed(value) => format!("{key}={value}"),
            Called(_) | Gone(_) => format!("{key}=true"),
        }
    }

    fn key_exists(key: &str) -> bool {
        let table = Value::try_from(Configuration::default()).unwrap();
        key.split('.').try_fold(&table, |value, part| value.get(part)).is_some()
    }

    #[test]
    fn old_keys_are_sorted_and_none_of_them_exists_any_more() {
        assert!(OLD_KEYS.is_sorted_by(|a, b| a.0 < b.0));
        for (key, now) in OLD_KEYS {
            assert!(!key_exists(key), "{key}");
            if let Called(name) = now {
                assert!(key_exists(name), "{name}");
            }
        }
    }

    #[test]
    fn each_old_key_is_refused_as_a_single_key() {
        for old in OLD_KEYS {
            let given = assignment(old);
            let refused = Configuration::load(Profile::Default, None, std::slice::from_ref(&given));
            let expected = format!("--set {given}: {}", message_for(old.0).unwrap());
            assert_eq!(refused.unwrap_err().to_string(), expected);
        }
        let whole = "sync_manager={ closure = { enabled = false } }".to_owned();
        let refused = Configuration::load(Profile::Default, None, &[whole]).unwrap_err().to_string();
        assert!(refused.ends_with("sync_manager.closure.enabled is now called sync_manager.close_loops"));
    }

    #[test]
    fn each_old_key_is_refused_in_a_file_with_its_line() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("robot.toml");
        for old in OLD_KEYS {
            let (section, name) = old.0.rsplit_once('.').unwrap();
            let given = assignment(old);
            let (_, value) = given.split_once('=').unwrap();
            let dotted = format!("page.enabled = true\n{} = {value}\n", old.0);
            let sectioned = format!("[page]\nenabled = true\n[{section}]\n# Turned.\n{name} = {value}\n");
            for (message, line) in [(dotted, 2), (sectioned, 5)] {
                std::fs::write(&path, message).unwrap();
                let refused = Configuration::load(Profile::Default, Some(&path), &[]).unwrap_err();
                assert!(matches!(refused, ConfigurationError::File { line: found, .. } if found == line));
                assert!(refused.to_string().ends_with(&format!(":{line}: {}", message_for(old.0).unwrap())));
            }
        }
    }

    #[test]
    fn each_old_key_is_refused_in_the_description_of_a_set_and_in_its_file() {
        let directory = tempfile::tempdir().unwrap();
        let write =
            |name: &str, message: String| std::fs::write(directory.path().join(name), message).unwrap();
        let refused = || {
            let description = SetDescription::read(&directory.path().join("set.toml")).unwrap();
            description.configuration(&[]).unwrap_err().to_string()
        };
        for old in OLD_KEYS {
            let expected = message_for(old.0).unwrap();
            write("set.toml", format!("robot = \"r1\"\nset = [{:?}]\n", assignment(old)));
            assert!(refused().ends_with(&expected));
            write("set.toml", "robot = \"r1\"\nconfig = \"robot.toml\"\n".to_owned());
            write("robot.toml", assignment(old));
            assert!(refused().ends_with(&format!("robot.toml:1: {expected}")));
        }
    }
}
