//! Settings of a ROS graph from the environment: the domain, and how far it reaches.

use crate::RosError;
use crate::zenoh_node::zenoh_configuration;

/// Domains whose ports lie in the range that Linux leaves free.
const DOMAIN_MAX: u16 = 232;

/// How far nodes look for each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// On this machine.
    Localhost,
    /// In the networks that this machine is in.
    Subnet,
}

/// What carries the messages of the graph. Topics are the same for both implementations of DDS; who has called a service stands beside
/// calls and answers for Fast DDS, and others by the standard, and before them for Cyclone DDS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Middleware {
    /// DDS, with callers of Fast DDS.
    FastDds,
    /// DDS, with callers of Cyclone DDS.
    CycloneDds,
    /// Zenoh, as rmw_zenoh.
    Zenoh,
}

/// The part of the environment that every node of ROS 2 follows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    /// Nodes of different domains do not see each other (`ROS_DOMAIN_ID`).
    pub domain: u16,
    /// From `ROS_LOCALHOST_ONLY` and `ROS_AUTOMATIC_DISCOVERY_RANGE`.
    pub reach: Reach,
    /// From `RMW_IMPLEMENTATION`; Fast DDS unless it says otherwise.
    pub middleware: Middleware,
    /// A file with the configuration of zenoh (`ZENOH_SESSION_CONFIG_URI`); empty for none.
    pub zenoh_file: String,
    /// Single keys over it, `KEY=VALUE;…` (`ZENOH_CONFIG_OVERRIDE`).
    pub zenoh_overrides: String,
    /// Variables that are set and have no effect here, each with the reason.
    pub unhonoured: Vec<String>,
}

impl Environment {
    /// From the environment of this process.
    ///
    /// # Errors
    /// When a variable has no sense.
    pub fn of_this_process() -> Result<Self, RosError> {
        Self::from_variables(|name| std::env::var(name).ok())
    }

    /// From variables by name.
    ///
    /// # Errors
    /// When a variable has no sense.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Self, RosError> {
        let text = |name: &str| variable(name).unwrap_or_default();
        let domain = match text("ROS_DOMAIN_ID").as_str() {
            "" => 0,
            value => match value.parse() {
                Ok(domain) if domain <= DOMAIN_MAX => domain,
                _ => {
                    let reason = "a domain is a number from 0 to 232";
                    return Err(RosError::Environment {
                        name: "ROS_DOMAIN_ID",
                        value: value.to_owned(),
                        reason,
                    });
                }
            },
        };
        let range = text("ROS_AUTOMATIC_DISCOVERY_RANGE");
        let reach = match range.to_ascii_uppercase().as_str() {
            _ if text("ROS_LOCALHOST_ONLY") == "1" => Reach::Localhost,
            "" | "SUBNET" | "SYSTEM_DEFAULT" => Reach::Subnet,
            "LOCALHOST" => Reach::Localhost,
            _ => {
                let reason = "it may be SUBNET or LOCALHOST: without discovery no node is found";
                return Err(RosError::Environment {
                    name: "ROS_AUTOMATIC_DISCOVERY_RANGE",
                    value: range,
                    reason,
                });
            }
        };
        let mut unhonoured = Vec::new();
        let named = text("RMW_IMPLEMENTATION");
        let middleware = match named.as_str() {
            "rmw_zenoh_cpp" => Middleware::Zenoh,
            "rmw_cyclonedds_cpp" => Middleware::CycloneDds,
            "" | "rmw_fastrtps_cpp" | "rmw_fastrtps_dynamic_cpp" => Middleware::FastDds,
            _ => {
                unhonoured
                    .push(format!("RMW_IMPLEMENTATION={named}: nodes of DDS are in reach, others are not"));
                Middleware::FastDds
            }
        };
        let (without_effect, reason): (&[_], _) = match middleware {
            Middleware::Zenoh => (
                &[
                    "ROS_LOCALHOST_ONLY",
                    "ROS_AUTOMATIC_DISCOVERY_RANGE",
                    "ROS_DISCOVERY_SERVER",
                    "ROS_STATIC_PEERS",
                    "ZENOH_ROUTER_CHECK_ATTEMPTS",
                ],
                "nodes are found as the configuration of zenoh says, through its router",
            ),
            _ => (&["ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"], "nodes are found by multicast only"),
        };
        for name in without_effect {
            let value = text(name);
            if !value.is_empty() {
                unhonoured.push(format!("{name}={value}: {reason}"));
            }
        }
        Ok(Self {
            domain,
            reach,
            middleware,
            zenoh_file: text("ZENOH_SESSION_CONFIG_URI"),
            zenoh_overrides: text("ZENOH_CONFIG_OVERRIDE"),
            unhonoured,
        })
    }

    /// Whether a node can be opened with it, as far as that is known without the network.
    ///
    /// # Errors
    /// When the configuration of zenoh cannot be used.
    pub fn check(&self) -> Result<(), RosError> {
        match self.middleware {
            Middleware::Zenoh => zenoh_configuration(self).map(drop),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<Environment, String> {
        let find =
            |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned());
        Environment::from_variables(find).map_err(|error| error.to_string())
    }

    #[test]
    fn domain_and_reach_follow_the_variables() {
        let plain = read(&[]).unwrap();
        assert_eq!((plain.domain, plain.reach, plain.unhonoured.len()), (0, Reach::Subnet, 0));
        let there = read(&[("ROS_DOMAIN_ID", "42"), ("ROS_LOCALHOST_ONLY", "1")]).unwrap();
        assert_eq!((there.domain, there.reach), (42, Reach::Localhost));
        let range = read(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost"), ("ROS_LOCALHOST_ONLY", "0")]);
        assert_eq!(range.unwrap().reach, Reach::Localhost);
    }

    #[test]
    fn what_has_no_sense_is_refused_and_what_has_no_effect_is_named() {
        for domain in ["x", "-1", "233", "70000"] {
            assert!(
                read(&[("ROS_DOMAIN_ID", domain)]).unwrap_err().starts_with("ROS_DOMAIN_ID="),
                "{domain}"
            );
        }
        assert!(read(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]).unwrap_err().contains("no node is found"));
        let named = read(&[
            ("RMW_IMPLEMENTATION", "rmw_connextdds"),
            ("ROS_DISCOVERY_SERVER", "10.0.0.1:11811"),
            ("ROS_STATIC_PEERS", "10.0.0.2"),
        ]);
        assert_eq!(named.unwrap().unhonoured.len(), 3);
        let zenoh = read(&[("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"), ("ROS_LOCALHOST_ONLY", "1")]).unwrap();
        assert_eq!((zenoh.middleware, zenoh.unhonoured.len()), (Middleware::Zenoh, 1));
        let cyclone = read(&[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")]).unwrap();
        assert_eq!((cyclone.middleware, cyclone.unhonoured.len()), (Middleware::CycloneDds, 0));
        assert_eq!(read(&[]).unwrap().middleware, Middleware::FastDds);
    }
}
