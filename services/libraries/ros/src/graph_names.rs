//! Names in a graph: relative, private and absolute ones, and remappings.

use crate::RosError;

/// Another name for a topic or a service: what follows `-r` on a command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// The node it is for; `None` for any.
    pub node: Option<String>,
    /// The name in the program.
    pub from: String,
    /// The name in the graph.
    pub to: String,
}

/// The name of a node, its namespace, and how its names are remapped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeIdentity {
    /// Name of the node.
    pub name: String,
    /// Its namespace: begins with `/`.
    pub namespace: String,
    /// In the order of the command line; the first that fits counts.
    pub remaps: Vec<Remap>,
}

impl NodeIdentity {
    /// The node of this name, as a command line renames it.
    ///
    /// # Errors
    /// When a name is none by the rules of ROS.
    pub fn new(name: &str, remaps: Vec<Remap>) -> Result<Self, RosError> {
        let last =
            |from: &str| remaps.iter().rev().find(|remap| remap.from == from).map(|remap| remap.to.clone());
        let name = last("__node").unwrap_or_else(|| name.to_owned());
        let namespace = match last("__ns") {
            Some(namespace) if namespace.starts_with('/') => namespace,
            Some(namespace) => format!("/{namespace}"),
            None => "/".to_owned(),
        };
        check_token(&name, &name)?;
        if namespace != "/" {
            namespace[1..].split('/').try_for_each(|token| check_token(token, &namespace))?;
        }
        Ok(Self { name, namespace, remaps })
    }

    /// Namespace and name.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }

    /// The name in the graph of a name in the program: `~/x` is below the node, `x` in its namespace, `/x` is what it is. Remapped.
    ///
    /// # Errors
    /// When a name is none by the rules of ROS.
    pub fn resolve(&self, name: &str) -> Result<String, RosError> {
        let full = self.expand(name)?;
        for remap in &self.remaps {
            let is_for_this = remap.node.as_ref().is_none_or(|node| *node == self.name);
            let is_name = !remap.from.starts_with("__");
            if is_for_this && is_name && self.expand(&remap.from).is_ok_and(|from| from == full) {
                return self.expand(&remap.to);
            }
        }
        Ok(full)
    }

    fn expand(&self, name: &str) -> Result<String, RosError> {
        let full = match (name.strip_prefix("~/"), name.starts_with('/')) {
            (Some(private), _) => format!("{}/{private}", self.full_name()),
            (None, true) => name.to_owned(),
            (None, false) => format!("{}/{name}", self.namespace.trim_end_matches('/')),
        };
        full[1..].split('/').try_for_each(|token| check_token(token, name))?;
        Ok(full)
    }
}

fn check_token(token: &str, name: &str) -> Result<(), RosError> {
    let refused = |reason: &str| Err(RosError::Name { name: name.to_owned(), reason: reason.to_owned() });
    match token.chars().next() {
        None => refused("nothing stands between two slashes"),
        Some(first) if first.is_ascii_digit() => refused("no part of it may begin with a digit"),
        Some(_) if token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') => Ok(()),
        Some(_) => refused("it is made of letters, digits, _ and /"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn remap(from: &str, to: &str) -> Remap {
        Remap { node: None, from: from.to_owned(), to: to.to_owned() }
    }

    #[test]
    fn names_lie_where_node_and_namespace_are() {
        let plain = NodeIdentity::new("flockslam", Vec::new()).unwrap();
        assert_eq!(plain.full_name(), "/flockslam");
        let resolved = ["scan", "/scan", "~/save"].map(|name| plain.resolve(name).unwrap());
        assert_eq!(resolved, ["/scan", "/scan", "/flockslam/save"]);
        let renamed = vec![remap("__node", "slam_toolbox"), remap("__ns", "/r1/nav")];
        let below = NodeIdentity::new("flockslam", renamed).unwrap();
        let resolved = ["scan", "/scan", "~/save"].map(|name| below.resolve(name).unwrap());
        assert_eq!(resolved, ["/r1/nav/scan", "/scan", "/r1/nav/slam_toolbox/save"]);
    }

    #[test]
    fn the_first_remapping_that_fits_counts() {
        let mut for_other = remap("scan", "other");
        for_other.node = Some("amcl".to_owned());
        let remaps = vec![remap("__ns", "r1"), for_other, remap("scan", "front/scan"), remap("/tf", "tf")];
        let node = NodeIdentity::new("flockslam", remaps).unwrap();
        assert_eq!(node.resolve("scan").unwrap(), "/r1/front/scan");
        assert_eq!(node.resolve("/r1/scan").unwrap(), "/r1/front/scan");
        assert_eq!(node.resolve("/tf").unwrap(), "/r1/tf");
        assert_eq!(node.resolve("/tf_static").unwrap(), "/tf_static");
    }

    #[test]
    fn what_is_no_name_is_refused_with_the_rule() {
        let node = NodeIdentity::new("flockslam", Vec::new()).unwrap();
        for name in ["", "/", "a//b", "1st", "a/2b", "sc an", "a/"] {
            assert!(node.resolve(name).is_err(), "{name:?}");
        }
        assert!(NodeIdentity::new("my node", Vec::new()).is_err());
        let error = NodeIdentity::new("a", vec![remap("__ns", "/1")]).unwrap_err().to_string();
        assert_eq!(error, "'/1' is not a name that ROS allows: no part of it may begin with a digit");
    }
}
