//! docs/configuration.md lists the keys that exist, with their defaults, and what the profiles set; docs/upgrading.md the old keys.

use super::old_keys::{Now, OLD_KEYS};
use super::{Configuration, Profile};
use crate::supervisor::SetDescription;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Sections of a configuration whose key `replicas` is one row.
const STAGES: [&str; 6] =
    ["lidar_ingest", "correlation_filter", "scan_matcher", "mapper", "dynamic_cleaner", "sync_manager"];

fn document(name: &str) -> String {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    std::fs::read_to_string(docs.join(name)).unwrap()
}

/// Keys with their values; an absent value is a null.
fn keys(value: &Value, path: &str, to: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                keys(value, &path, to);
            }
        }
        value => drop(to.insert(path.to_owned(), value.clone())),
    }
}

fn keys_of(configuration: &Configuration) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
    keys(&serde_json::to_value(configuration).unwrap(), "", &mut found);
    // Keys that are left out when they have no value.
    for key in ["start_pose", "odometry_topic", "imu_topic"] {
        found.entry(format!("lidar_ingest.{key}")).or_insert(Value::Null);
    }
    found
}

/// Cells of the rows of tables that begin with a key, by heading.
fn rows(message: &str) -> Vec<(String, Vec<String>)> {
    let mut heading = String::new();
    let mut found = Vec::new();
    for line in message.lines() {
        if let Some(name) = line.strip_prefix("## ") {
            heading = name.trim_matches(['[', ']']).to_owned();
        } else if line.starts_with("| `") {
            let cells = line.trim_matches('|').split(" | ").map(|cell| cell.trim().replace('`', ""));
            found.push((heading.clone(), cells.collect()));
        }
    }
    found
}

/// A value as a document writes it.
fn written(value: &Value) -> String {
    match value {
        Value::Null => "not set".to_owned(),
        Value::String(message) => message.clone(),
        Value::Array(values) => format!("[{}]", values.iter().map(written).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

#[test]
fn the_document_lists_exactly_the_keys_that_exist_with_their_defaults() {
    let mut listed = BTreeMap::new();
    for (heading, cells) in rows(&document("configuration.md")) {
        if heading == "Each stage" {
            listed.extend(STAGES.map(|stage| (format!("{stage}.replicas"), cells[1].clone())));
        } else if heading != "Profiles" && !heading.ends_with("SET.toml") {
            let doubled = listed.insert(format!("{heading}.{}", cells[0]), cells[1].replace('"', ""));
            assert!(doubled.is_none(), "{heading}.{} has two rows", cells[0]);
        }
    }
    let exist: BTreeMap<_, _> =
        keys_of(&Configuration::default()).into_iter().map(|(key, value)| (key, written(&value))).collect();
    let (listed_keys, existing): (BTreeSet<_>, BTreeSet<_>) =
        (listed.keys().collect(), exist.keys().collect());
    let missing: Vec<_> = existing.difference(&listed_keys).collect();
    let gone: Vec<_> = listed_keys.difference(&existing).collect();
    assert!(missing.is_empty() && gone.is_empty(), "without a row: {missing:?}; without a key: {gone:?}");
    assert_eq!(listed, exist);
}

/// Limit for the number of keys: one that no user changes becomes a constant.
const ROWS_MAX: usize = 116;

#[test]
fn the_document_stays_short() {
    let count =
        rows(&document("configuration.md")).iter().filter(|(heading, _)| heading != "Profiles").count();
    assert!(count <= ROWS_MAX, "{count} keys");
}

#[test]
fn the_document_lists_exactly_the_keys_of_a_set() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("set.toml");
    let mut exist = BTreeSet::new();
    let sources = [
        "kind = \"log\"\npath = \"drive.log\"",
        "kind = \"simulation\"",
        "kind = \"ld06\"\nport = \"/dev/ttyUSB0\"",
        "kind = \"lidars\"\nlidars = [{name = \"front\", kind = \"ld06\", port = \"/dev/ttyUSB0\"}]",
    ];
    for source in sources {
        std::fs::write(&path, format!("robot = \"r1\"\n[ros]\n[source]\n{source}\n")).unwrap();
        let mut found = BTreeMap::new();
        keys(&serde_json::to_value(SetDescription::read(&path).unwrap()).unwrap(), "", &mut found);
        exist.extend(found.into_keys().map(|key| match key.strip_prefix("stages.") {
            Some(limit) => limit.split('.').next_back().unwrap().to_owned(),
            None => key,
        }));
    }
    let rows = rows(&document("configuration.md"));
    let of_set = rows.into_iter().filter(|(heading, _)| heading.ends_with("SET.toml"));
    let listed: Vec<String> = of_set.map(|(_, cells)| cells[0].clone()).collect();
    assert_eq!(listed.iter().cloned().collect::<BTreeSet<_>>(), exist);
    assert_eq!(listed.len(), exist.len(), "a key has two rows");
}

#[test]
fn the_document_lists_exactly_what_the_profiles_set() {
    let message = document("configuration.md");
    let default = keys_of(&Configuration::default());
    for (profile, name) in [(Profile::Vinyslam, "vinyslam"), (Profile::Ndt, "ndt")] {
        let table = message.split(&format!("| key | default | {name} |")).nth(1).unwrap();
        let table: String =
            table.lines().skip(2).take_while(|line| !line.is_empty()).map(|l| format!("{l}\n")).collect();
        let listed: BTreeSet<Vec<String>> = rows(&table).into_iter().map(|(_, cells)| cells).collect();
        let set: BTreeSet<Vec<String>> = keys_of(&Configuration::of_profile(profile))
            .into_iter()
            .filter(|(key, value)| default[key] != *value)
            .map(|(key, value)| vec![key.clone(), written(&default[&key]), written(&value)])
            .collect();
        assert_eq!(listed, set, "{name}");
    }
}

#[test]
fn the_document_on_upgrading_lists_exactly_the_old_keys() {
    let listed: Vec<Vec<String>> = rows(&document("upgrading.md"))
        .into_iter()
        .filter(|(heading, _)| heading == "Keys")
        .map(|(_, cells)| cells)
        .collect();
    let message = |(key, now): &(&str, Now)| match now {
        Now::Fixed(value) => vec![(*key).to_owned(), format!("fixed at {value}")],
        Now::Called(name) => vec![(*key).to_owned(), (*name).to_owned()],
        Now::Gone(reason) => vec![(*key).to_owned(), format!("gone: {reason}")],
    };
    assert_eq!(listed, OLD_KEYS.iter().map(message).collect::<Vec<_>>());
}
