//! Files of parameters, as every node of ROS 2 takes them: YAML, by names of nodes with wildcards.

use crate::{NodeIdentity, ParameterValue, RosError};
use serde_yaml::{Mapping, Value};
use std::path::Path;

/// Below this key stand the parameters of a node.
const PARAMETERS: &str = "ros__parameters";

/// The parameters of a node in a file: what stands under its name, or under a wildcard that fits; later entries replace earlier ones.
///
/// # Errors
/// When the file cannot be read or is not such a file.
pub fn parameters_of_file(
    path: &Path,
    node: &NodeIdentity,
) -> Result<Vec<(String, ParameterValue)>, RosError> {
    let refused = |reason: String| RosError::ParameterFile { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| refused(error.to_string()))?;
    parameters_of_text(&text, &node.full_name()).map_err(refused)
}

fn parameters_of_text(text: &str, node: &str) -> Result<Vec<(String, ParameterValue)>, String> {
    let root: Value = serde_yaml::from_str(text).map_err(|error| error.to_string())?;
    let Value::Mapping(root) = root else {
        return Err("a file of parameters names nodes, and below each ros__parameters".to_owned());
    };
    let mut found = Vec::new();
    walk(&root, String::new(), node, &mut found)?;
    Ok(found)
}

fn walk(
    mapping: &Mapping,
    above: String,
    node: &str,
    found: &mut Vec<(String, ParameterValue)>,
) -> Result<(), String> {
    for (key, value) in mapping {
        let key = key.as_str().ok_or_else(|| format!("{above}: a key is not a text"))?;
        match value {
            Value::Mapping(parameters) if key == PARAMETERS => {
                if fits(&above, node) {
                    flatten(parameters, "", found)?;
                }
            }
            Value::Mapping(below) => {
                let name = format!("{}/{}", above.trim_end_matches('/'), key.trim_start_matches('/'));
                walk(below, name, node, found)?;
            }
            Value::Null => {}
            _ => return Err(format!("{above}/{key}: {PARAMETERS} is missing above it")),
        }
    }
    Ok(())
}

/// Whether a name with `*` for one part and `**` for any number of them is that of a node.
fn fits(pattern: &str, node: &str) -> bool {
    fn parts_fit(pattern: &[&str], node: &[&str]) -> bool {
        match (pattern.split_first(), node.split_first()) {
            (None, None) => true,
            (Some((&"**", rest)), _) => (0..=node.len()).any(|skipped| parts_fit(rest, &node[skipped..])),
            (Some((first, rest)), Some((part, others))) => {
                (*first == "*" || first == part) && parts_fit(rest, others)
            }
            _ => false,
        }
    }
    let parts =
        |name: &str| name.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect::<Vec<_>>();
    let (pattern, node) = (parts(pattern), parts(node));
    let [pattern, node] = [&pattern, &node].map(|parts| parts.iter().map(String::as_str).collect::<Vec<_>>());
    parts_fit(&pattern, &node)
}

fn flatten(mapping: &Mapping, above: &str, found: &mut Vec<(String, ParameterValue)>) -> Result<(), String> {
    for (key, value) in mapping {
        let key = key.as_str().ok_or("a name of a parameter is not a text")?;
        let name = if above.is_empty() { key.to_owned() } else { format!("{above}.{key}") };
        match value {
            Value::Mapping(below) => flatten(below, &name, found)?,
            value => {
                // What no parameter here can be is unknown by its name in any case.
                let value = ParameterValue::from_yaml(value).unwrap_or(ParameterValue::Text(String::new()));
                found.push((name, value));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "slam_toolbox:\n  ros__parameters:\n    odom_frame: odom\n    resolution: 0.05\n    use_sim_time: true\n\
                        amcl:\n  ros__parameters:\n    odom_frame: other\n\
                        /**:\n  ros__parameters:\n    transform_timeout: 0.5\n    nested: {deep: 3}\n\
                        r1:\n  slam_toolbox:\n    ros__parameters:\n      map_frame: r1/map\n";

    #[test]
    fn a_node_gets_what_stands_under_its_name_and_under_wildcards() {
        let names = |node: &str| {
            parameters_of_text(FILE, node).unwrap().into_iter().map(|(name, _)| name).collect::<Vec<_>>()
        };
        let own = ["odom_frame", "resolution", "use_sim_time", "transform_timeout", "nested.deep"];
        assert_eq!(names("/slam_toolbox"), own);
        assert_eq!(names("/r1/slam_toolbox"), ["transform_timeout", "nested.deep", "map_frame"]);
        assert_eq!(names("/nobody"), ["transform_timeout", "nested.deep"]);
        let found = parameters_of_text(FILE, "/slam_toolbox").unwrap();
        assert_eq!(found[1].1, ParameterValue::Double(0.05));
    }

    #[test]
    fn wildcards_fit_parts() {
        assert!(
            fits("/**", "/a/b") && fits("/*/b", "/a/b") && fits("/a/**", "/a/b/c") && fits("/**/c", "/a/b/c")
        );
        assert!(!fits("/*", "/a/b") && !fits("/a", "/a/b") && !fits("/a/b", "/a"));
    }

    #[test]
    fn a_file_that_is_none_is_refused() {
        assert!(parameters_of_text("- 1", "/a").is_err());
        assert!(parameters_of_text("a: 1", "/a").unwrap_err().contains("ros__parameters is missing"));
        assert!(parameters_of_text("a: [", "/a").is_err());
        let node = NodeIdentity::new("a", Vec::new()).unwrap();
        let missing = parameters_of_file(Path::new("/nowhere.yaml"), &node).unwrap_err().to_string();
        assert!(missing.starts_with("/nowhere.yaml: "), "{missing}");
    }
}
