//! Notices that the time of a stream has gone back: a simulation was restarted, a recording is played again, a clock was put back.

/// Stamps may lie behind the newest by this much and belong to the same time, nanoseconds: they come out of order.
const DISORDER_NS: i64 = 2_000_000_000;

/// Looks at the stamps of one stream.
#[derive(Clone, Copy, Debug, Default)]
pub struct TimeWatch {
    newest_ns: Option<i64>,
    /// The last stamp, when it lay far behind the newest.
    behind_ns: Option<i64>,
}

impl TimeWatch {
    /// Whether the last stamp lay far behind, which the next one confirms or not.
    pub fn is_behind(&self) -> bool {
        self.behind_ns.is_some()
    }

    /// Takes the next stamp, nanoseconds; whether time has gone back to it. One message that is seconds late says nothing. When the next
    /// one follows it, time goes on from there.
    pub fn goes_back(&mut self, stamp_ns: i64) -> bool {
        let is_behind =
            self.newest_ns.is_some_and(|newest_ns| newest_ns.saturating_sub(stamp_ns) > DISORDER_NS);
        if !is_behind {
            self.newest_ns = Some(self.newest_ns.map_or(stamp_ns, |newest_ns| newest_ns.max(stamp_ns)));
            self.behind_ns = None;
            return false;
        }
        // A message that is repeated with its old stamp is no time that goes on.
        let follows = |before_ns: i64| (1..DISORDER_NS).contains(&stamp_ns.saturating_sub(before_ns));
        let goes_back = self.behind_ns.is_some_and(follows);
        if goes_back {
            *self = Self { newest_ns: Some(stamp_ns), behind_ns: None };
        } else {
            self.behind_ns = Some(stamp_ns);
        }
        goes_back
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn seen(stamps_ms: &[i64]) -> Vec<bool> {
        let mut watch = TimeWatch::default();
        stamps_ms.iter().map(|stamp_ms| watch.goes_back(stamp_ms * MS)).collect()
    }

    #[test]
    fn time_has_gone_back_when_older_stamps_go_on() {
        assert_eq!(seen(&[9000, 9100, 100, 200, 300, 400]), [false, false, false, true, false, false]);
        assert_eq!(seen(&[9000, 7500, 9100]), [false; 3], "out of order");
        assert_eq!(seen(&[9000, 100, 9100, 200, 9200]), [false; 5], "one of two senders is late");
        assert_eq!(seen(&[9000, 100, 100, 100]), [false; 4], "an old message is repeated");
        assert_eq!(
            seen(&[9000, 100, 200, 9100, 9200, 150, 250]),
            [false, false, true, false, false, false, true]
        );
    }
}
