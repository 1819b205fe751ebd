//! Hashes of types (REP 2011, `RIHS01`): SHA-256 of a description of the type and of all types in it, in JSON.

use crate::interface_definitions::INTERFACES;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Numbers of basic types (`type_description_interfaces/FieldType`).
const BASIC: [(&str, u32); 15] = [
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("char", 13),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
    ("wstring", 18),
];
/// Number of a type that has fields.
const NESTED: u32 = 1;
/// What is added for an array, a bounded and an unbounded sequence.
const ARRAY: u32 = 48;
const BOUNDED: u32 = 96;
const UNBOUNDED: u32 = 144;
/// What a type without fields has.
const NO_FIELDS: &str = "uint8 structure_needs_at_least_one_member";

/// A field: number of its type, greatest length, name of a type that has fields, its own name.
struct Field {
    kind: u32,
    capacity: u64,
    nested: String,
    name: String,
}

/// Types by name, with their fields.
type Types = BTreeMap<String, Vec<Field>>;

/// The hash of a message or service, such as `sensor_msgs/msg/LaserScan`; `None` for an unsupported one.
pub fn type_hash(name: &str) -> Option<String> {
    let mut types = Types::new();
    describe(name, &mut types)?;
    let own = types.remove(name)?;
    let others: Vec<_> = types.iter().map(|(name, fields)| description(name, fields)).collect();
    let json = format!(
        r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
        description(name, &own),
        others.join(", ")
    );
    let digest = Sha256::digest(json.as_bytes());
    Some(digest.iter().fold("RIHS01_".to_owned(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    }))
}

/// The supported interfaces, such as `sensor_msgs/msg/LaserScan`.
pub fn interface_names() -> impl Iterator<Item = &'static str> {
    INTERFACES.iter().map(|(name, _)| *name)
}

/// Adds a type and all types in it.
fn describe(name: &str, types: &mut Types) -> Option<()> {
    if types.contains_key(name) {
        return Some(());
    }
    let definition = INTERFACES.iter().find(|(known, _)| *known == name)?.1;
    match definition.split_once("---") {
        Some((request, response)) => describe_service(name, [request, response], types),
        None => add(name, definition, types),
    }
}

/// A service is described as its three messages; the event is what introspection publishes.
fn describe_service(name: &str, [request, response]: [&str; 2], types: &mut Types) -> Option<()> {
    let part = |part: &str| format!("{name}_{part}");
    add(&part("Request"), request, types)?;
    add(&part("Response"), response, types)?;
    describe("service_msgs/msg/ServiceEventInfo", types)?;
    let one_at_most = |name: &str, kind: &str| Field {
        kind: NESTED + BOUNDED,
        capacity: 1,
        nested: part(kind),
        name: name.to_owned(),
    };
    let event = vec![
        nested("info", "service_msgs/msg/ServiceEventInfo"),
        one_at_most("request", "Request"),
        one_at_most("response", "Response"),
    ];
    types.insert(part("Event"), event);
    let messages = vec![
        nested("request_message", &part("Request")),
        nested("response_message", &part("Response")),
        nested("event_message", &part("Event")),
    ];
    types.insert(name.to_owned(), messages);
    Some(())
}

fn nested(name: &str, kind: &str) -> Field {
    Field { kind: NESTED, capacity: 0, nested: kind.to_owned(), name: name.to_owned() }
}

fn add(name: &str, definition: &str, types: &mut Types) -> Option<()> {
    let definition = if definition.trim().is_empty() { NO_FIELDS } else { definition };
    let fields = definition.split(';').map(field).collect::<Option<Vec<_>>>()?;
    for field in fields.iter().filter(|field| !field.nested.is_empty()) {
        describe(&field.nested, types)?;
    }
    types.insert(name.to_owned(), fields);
    Some(())
}

fn field(text: &str) -> Option<Field> {
    let (kind, name) = text.trim().split_once(' ')?;
    let (kind, many) = kind.split_once('[').unwrap_or((kind, ""));
    let length = many.trim_end_matches(']');
    let (more, capacity) = match (many, length.strip_prefix("<=")) {
        ("", _) => (0, 0),
        (_, Some(most)) => (BOUNDED, most.parse().ok()?),
        (_, None) if length.is_empty() => (UNBOUNDED, 0),
        (_, None) => (ARRAY, length.parse().ok()?),
    };
    let (number, nested) = match (BASIC.iter().find(|(basic, _)| *basic == kind), kind.split_once('/')) {
        (Some((_, number)), _) => (*number, String::new()),
        (None, Some((package, kind))) => (NESTED, format!("{package}/msg/{kind}")),
        (None, None) => return None,
    };
    Some(Field { kind: number + more, capacity, nested, name: name.to_owned() })
}

fn description(name: &str, fields: &[Field]) -> String {
    let field = |Field { kind, capacity, nested, name }: &Field| {
        format!(
            r#"{{"name": "{name}", "type": {{"type_id": {kind}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}}}"#
        )
    };
    let fields: Vec<_> = fields.iter().map(field).collect();
    format!(r#"{{"type_name": "{name}", "fields": [{}]}}"#, fields.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_that_ros_has() {
        // From `ros2 topic info --verbose` of Jazzy, and the JSON files of its packages.
        for (name, expected) in [
            ("std_msgs/msg/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
            (
                "builtin_interfaces/msg/Time",
                "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
            ),
            ("tf2_msgs/msg/TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
            (
                "lifecycle_msgs/srv/GetState",
                "800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
            ),
        ] {
            assert_eq!(type_hash(name).as_deref(), Some(format!("RIHS01_{expected}").as_str()), "{name}");
        }
    }

    #[test]
    fn every_interface_can_be_hashed_and_no_other() {
        for (name, _) in INTERFACES {
            assert!(type_hash(name).is_some(), "{name}");
        }
        assert_eq!(type_hash("std_msgs/msg/Empty"), None);
    }
}
