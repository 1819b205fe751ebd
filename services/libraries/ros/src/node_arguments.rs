//! What follows `--ros-args` on a command line.

use crate::{NodeIdentity, ParameterValue, Remap, RosError, parameters_of_file};
use std::path::PathBuf;

/// What follows `--ros-args`: remappings, parameters, files of parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeArguments {
    /// `-r`, `--remap`.
    pub remaps: Vec<Remap>,
    /// `-p`, `--param` and `--params-file`, in their order.
    parameters: Vec<Given>,
    /// Arguments that have no effect here.
    pub unhonoured: Vec<String>,
}

#[derive(Clone, Debug, PartialEq)]
enum Given {
    Value(String, ParameterValue),
    File(PathBuf),
}

impl NodeArguments {
    /// Reads arguments; a leading `--ros-args` and a closing `--` may be among them.
    ///
    /// # Errors
    /// When one has no sense.
    pub fn parse(arguments: &[String]) -> Result<Self, RosError> {
        let mut found = Self::default();
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            let refused =
                |reason: &str| RosError::Argument { argument: argument.clone(), reason: reason.to_owned() };
            let mut value = || rest.next().ok_or_else(|| refused("its value is missing"));
            match argument.as_str() {
                "--ros-args" | "--" => {}
                "-r" | "--remap" => found.remaps.push(remap(value()?)?),
                "-p" | "--param" => found.parameters.push(parameter(value()?)?),
                "--params-file" => found.parameters.push(Given::File(value()?.into())),
                "--log-level" | "--log-config-file" | "--log-file-name" | "-e" | "--enclave" => {
                    let value = value()?;
                    found.unhonoured.push(format!("{argument} {value}"));
                }
                log if log.starts_with("--enable-") || log.starts_with("--disable-") => {
                    found.unhonoured.push(argument.clone());
                }
                assignment if assignment.contains(":=") => found.remaps.push(remap(argument)?),
                _ => return Err(refused("it is none of -r, -p, --params-file")),
            }
        }
        Ok(found)
    }

    /// The parameters of a node, those of its files among them; of equal names the last counts.
    ///
    /// # Errors
    /// When a file cannot be used.
    pub fn parameters(&self, node: &NodeIdentity) -> Result<Vec<(String, ParameterValue)>, RosError> {
        let mut found = Vec::new();
        for given in &self.parameters {
            match given {
                Given::Value(name, value) => found.push((name.clone(), value.clone())),
                Given::File(path) => found.extend(parameters_of_file(path, node)?),
            }
        }
        Ok(found)
    }
}

fn remap(text: &str) -> Result<Remap, RosError> {
    let refused =
        || RosError::Argument { argument: format!("-r {text}"), reason: "write it as FROM:=TO".to_owned() };
    let (from, to) =
        text.split_once(":=").filter(|(from, to)| !from.is_empty() && !to.is_empty()).ok_or_else(refused)?;
    let (node, from) = match from.split_once(':') {
        Some((node, from)) => (Some(node.to_owned()), from),
        None => (None, from),
    };
    let from = match from {
        "__name" => "__node",
        from => from,
    };
    Ok(Remap { node, from: from.to_owned(), to: to.to_owned() })
}

fn parameter(text: &str) -> Result<Given, RosError> {
    let refused =
        |reason: &str| RosError::Argument { argument: format!("-p {text}"), reason: reason.to_owned() };
    let (name, value) = text.split_once(":=").ok_or_else(|| refused("write it as NAME:=VALUE"))?;
    let value = ParameterValue::from_text(value).ok_or_else(|| refused("this is no value of a parameter"))?;
    // `node:name` is for one node; this process has one.
    let name = name.rsplit(':').next().unwrap_or(name);
    Ok(Given::Value(name.to_owned(), value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<NodeArguments, String> {
        let arguments: Vec<String> = text.split(' ').map(str::to_owned).collect();
        NodeArguments::parse(&arguments).map_err(|error| error.to_string())
    }

    #[test]
    fn arguments_are_those_of_every_node() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("p.yaml");
        std::fs::write(&file, "/**:\n  ros__parameters:\n    odom_frame: from_file\n").unwrap();
        let text = format!(
            "--ros-args -r scan:=front/scan -r __ns:=/r1 --remap __node:=slam -p map_frame:=m --params-file {} \
             -p use_sim_time:=true --log-level info --enable-rosout-logs --",
            file.display()
        );
        let found = parse(&text).unwrap();
        let node = NodeIdentity::new("flockslam", found.remaps.clone()).unwrap();
        assert_eq!(
            (node.full_name().as_str(), node.resolve("scan").unwrap().as_str()),
            ("/r1/slam", "/r1/front/scan")
        );
        let parameters = found.parameters(&node).unwrap();
        let names: Vec<_> = parameters.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["map_frame", "odom_frame", "use_sim_time"]);
        assert_eq!(found.unhonoured, ["--log-level info", "--enable-rosout-logs"]);
    }

    #[test]
    fn what_has_no_sense_is_refused_with_its_place() {
        assert_eq!(parse("-r scan").unwrap_err(), "--ros-args -r scan: write it as FROM:=TO");
        assert_eq!(parse("-p").unwrap_err(), "--ros-args -p: its value is missing");
        assert!(parse("-p x").unwrap_err().contains("NAME:=VALUE"));
        assert!(parse("--fast").unwrap_err().contains("none of -r, -p"));
    }
}
