//! Checks the numbers of a configuration, given as a TOML table: finite, not negative, and within bounds where a key has some.

use toml::{Table, Value};

/// Keys whose numbers may be negative; their own sections bound them.
const SIGNED: &[&str] = &[
    "lidar_ingest.start_pose",
    "lidar_ingest.lidars.x_m",
    "lidar_ingest.lidars.y_m",
    "lidar_ingest.lidars.heading_deg",
    "lidar_ingest.calibration.x_m",
    "lidar_ingest.calibration.y_m",
    "lidar_ingest.calibration.heading_deg",
    "lidar_ingest.calibration.offset_s",
    "lidar_ingest.cloud_heights_m",
    "lidar_ingest.self_mask",
];

/// Keys that need more than "not negative": least and greatest value.
const BOUNDED: &[(&str, f64, f64)] = &[
    ("set.live_tiles", 64.0, 65_536.0),
    ("lidar_ingest.replicas", 1.0, 8.0),
    ("scan_matcher.replicas", 1.0, 8.0),
    ("mapper.replicas", 1.0, 8.0),
    ("dynamic_cleaner.replicas", 1.0, 8.0),
    ("sync_manager.replicas", 1.0, 8.0),
    ("correlation_filter.replicas", 1.0, 8.0),
    ("mapper.cell_size_m", 0.01, 1.0),
    ("mapper.miss_nat", 0.0, 16.0),
    ("mapper.submap_insertions", 1.0, 2000.0),
    ("mapper.confirming_scans", 1.0, 255.0),
];

/// Refuses numbers that make no sense: (key, reason).
pub fn check(table: &Table) -> Result<(), (String, String)> {
    table.iter().try_for_each(|(section, value)| check_value(section, value))
}

fn check_value(key: &str, value: &Value) -> Result<(), (String, String)> {
    match value {
        Value::Table(table) => {
            table.iter().try_for_each(|(name, value)| check_value(&format!("{key}.{name}"), value))
        }
        Value::Array(values) => values.iter().try_for_each(|value| check_value(key, value)),
        Value::Integer(number) => check_number(key, *number as f64),
        Value::Float(number) => check_number(key, *number),
        _ => Ok(()),
    }
}

fn check_number(key: &str, number: f64) -> Result<(), (String, String)> {
    let refuse = |reason: String| Err((key.to_owned(), format!("{number} {reason}")));
    if let Some((_, least, greatest)) = BOUNDED.iter().find(|(name, ..)| *name == key)
        && !(*least..=*greatest).contains(&number)
    {
        return refuse(format!("is not between {least} and {greatest}"));
    }
    if !number.is_finite() {
        return refuse("is not a finite number".to_owned());
    }
    if number < 0.0 && !SIGNED.contains(&key) {
        return refuse("is negative".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::configuration::{Configuration, Profile};

    #[test]
    fn every_bounded_key_exists_and_its_default_is_good() {
        for profile in [Profile::Default, Profile::Vinyslam, Profile::Ndt] {
            let table = Table::try_from(Configuration::of_profile(profile)).unwrap();
            assert_eq!(check(&table), Ok(()));
            for (key, ..) in BOUNDED {
                let mut value = Some(&Value::Table(table.clone())).cloned();
                for part in key.split('.') {
                    value = value.and_then(|value| value.get(part).cloned());
                }
                assert!(value.is_some(), "{key}");
            }
        }
    }

    #[test]
    fn bounds_are_inclusive_and_nothing_beyond_them_is_accepted() {
        for &(key, least, greatest) in BOUNDED {
            assert!(check_number(key, least).is_ok() && check_number(key, greatest).is_ok(), "{key}");
            for beyond in [least - 1e-6, greatest * 1.001, f64::NAN, f64::INFINITY] {
                assert!(check_number(key, beyond).is_err(), "{key} = {beyond}");
            }
        }
    }

    #[test]
    fn senseless_numbers_are_refused() {
        for (section, key, number) in [
            ("mapper", "miss_nat", -1.0),
            ("mapper", "cell_size_m", f64::NAN),
            ("dynamic_cleaner", "radius_m", -3.0),
        ] {
            let table = Table::from_iter([(key.to_owned(), Value::Float(number))]);
            let refused = check(&Table::from_iter([(section.to_owned(), Value::Table(table))])).unwrap_err();
            assert_eq!(refused.0, format!("{section}.{key}"));
        }
    }
}
