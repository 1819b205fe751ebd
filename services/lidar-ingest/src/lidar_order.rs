//! Whether a scan of another lidar, taken earlier, may still come: several live lidars are brought into the order of time without
//! waiting for one that is silent.

use std::collections::BTreeMap;

/// A lidar that was silent for so many of its turns is not waited for.
const TURNS_MISSED: i64 = 3;
/// No lidar takes longer for a turn, nanoseconds: one that paused did not turn slowly.
const TURN_MAX_NS: i64 = 1_200_000_000;

/// When the last scan of each lidar was received, and how fast it turns.
#[derive(Debug, Default)]
pub struct LidarOrder {
    lidars: BTreeMap<u32, LastScan>,
}

#[derive(Debug)]
struct LastScan {
    stamp_ns: i64,
    received_ns: i64,
    /// Between the stamps of the last two scans; `None` after the first one and after a pause.
    turn_ns: Option<i64>,
}

impl LidarOrder {
    /// A scan of a lidar, stamped at one time, was received at another.
    pub fn note(&mut self, lidar: u32, stamp_ns: i64, received_ns: i64) {
        let before = self.lidars.get(&lidar).map(|last| stamp_ns.saturating_sub(last.stamp_ns));
        let turn_ns = before.filter(|turn_ns| (1..=TURN_MAX_NS).contains(turn_ns));
        self.lidars.insert(lidar, LastScan { stamp_ns, received_ns, turn_ns });
    }

    /// Whether another lidar, which sends at `now_ns`, may still give a scan that is stamped before this one: not so soon after its last.
    pub fn may_come_before(&self, lidar: u32, stamp_ns: i64, now_ns: i64) -> bool {
        let mut others = self.lidars.iter().filter(|(other, _)| **other != lidar).map(|(_, last)| last);
        others.any(|last| {
            let Some(turn_ns) = last.turn_ns else { return false };
            let is_live = now_ns.saturating_sub(last.received_ns) < TURNS_MISSED * turn_ns;
            is_live && last.stamp_ns.saturating_add(turn_ns / 2) < stamp_ns
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_lidar_is_waited_for_when_its_next_scan_is_due_and_not_when_it_is_silent() {
        let mut order = LidarOrder::default();
        assert!(!order.may_come_before(0, 1000, 1000));
        order.note(1, 800, 900);
        assert!(!order.may_come_before(0, 1000, 1000), "how fast it turns is not known");
        order.note(1, 900, 1000);
        assert!(!order.may_come_before(0, 940, 1040), "its next scan comes later");
        assert!(order.may_come_before(0, 1010, 1100), "its next scan is due");
        assert!(!order.may_come_before(1, 1010, 1100), "its own scans are in order");
        assert!(!order.may_come_before(0, 1300, 1300), "it is silent");
        order.note(1, 5_000_000_000, 1400);
        assert!(!order.may_come_before(0, 5_000_000_100, 1400), "after a pause");
    }
}
