//! The bond with a lifecycle manager: a heartbeat that says that the node is alive. Pure.

use flockslam_ros::messages::{BondStatus, Header};
use std::time::Duration;

/// A heartbeat follows another after this.
pub const HEARTBEAT_PERIOD: Duration = Duration::from_millis(100);
/// A node without a heartbeat for this time counts as dead.
pub const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(4);

/// One side of a bond.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bond {
    /// Name of the node: both sides say it.
    id: String,
    /// Of this side. The other side takes another one for another node, so it outlives the process.
    instance: String,
}

impl Bond {
    /// The bond of a node.
    pub fn new(id: &str, instance: &str) -> Self {
        Self { id: id.to_owned(), instance: instance.to_owned() }
    }

    /// A heartbeat; one that is not active ends the bond.
    pub fn status(&self, now_ns: i64, is_active: bool) -> BondStatus {
        BondStatus {
            header: Header::new(now_ns, ""),
            id: self.id.clone(),
            instance_id: self.instance.clone(),
            active: is_active,
            heartbeat_timeout: HEARTBEAT_TIMEOUT.as_secs_f32(),
            heartbeat_period: HEARTBEAT_PERIOD.as_secs_f32(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_know_the_bond_by_the_name_of_the_node() {
        let status = Bond::new("flockslam", "a1").status(1_500_000_000, true);
        assert_eq!(
            (status.id.as_str(), status.instance_id.as_str(), status.active),
            ("flockslam", "a1", true)
        );
        assert_eq!((status.heartbeat_timeout, status.heartbeat_period), (4.0, 0.1));
        assert_eq!((status.header.stamp.sec, status.header.stamp.nanosec), (1, 500_000_000));
    }
}
