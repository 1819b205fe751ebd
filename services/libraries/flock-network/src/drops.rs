//! Reasons for which messages and records of the flock are not used, and a counter for each.

use flockslam_records::Refusal;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why a message or a record of another robot is not used, or one to another robot not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dropped {
    /// The message was longer than any message may be.
    TooLong,
    /// Its sender exceeds the rate limit.
    TooMany,
    /// It came while too many others waited.
    Overflow,
    /// It is no message of the flock.
    Malformed,
    /// It is of a build that this one does not know.
    Version,
    /// Its sender is not near.
    NotNear,
    /// It contains bytes that are no record, or one that its robot has not signed.
    BadRecord,
    /// Two records have one name: neither counts.
    Quarantined,
    /// It found no room on its way out.
    NotSent,
    /// Its receiver has been sent as much as it may be for now.
    Budget,
    /// A record was refused, for this reason.
    Refused(Refusal),
}

impl Dropped {
    /// All of them.
    pub const ALL: [Dropped; 16] = [
        Self::TooLong,
        Self::TooMany,
        Self::Overflow,
        Self::Malformed,
        Self::Version,
        Self::NotNear,
        Self::BadRecord,
        Self::Quarantined,
        Self::NotSent,
        Self::Budget,
        Self::Refused(Refusal::NotTrusted),
        Self::Refused(Refusal::Robots),
        Self::Refused(Refusal::Epochs),
        Self::Refused(Refusal::Records),
        Self::Refused(Refusal::Bytes),
        Self::Refused(Refusal::AllBytes),
    ];

    /// Its name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::TooLong => "too-long",
            Self::TooMany => "too-many-messages",
            Self::Overflow => "queue-overflow",
            Self::Malformed => "malformed",
            Self::Version => "unknown-version",
            Self::NotNear => "not-near",
            Self::BadRecord => "bad-record",
            Self::Quarantined => "quarantined",
            Self::NotSent => "not-sent",
            Self::Budget => "over-budget",
            Self::Refused(refusal) => refusal.name(),
        }
    }

    fn place(self) -> usize {
        Self::ALL.iter().position(|other| *other == self).expect("all are listed")
    }
}

/// How often each reason applied; counted from several threads.
#[derive(Debug, Default)]
pub struct Drops([AtomicU64; Dropped::ALL.len()]);

impl Drops {
    /// Counts so many more.
    pub fn count(&self, reason: Dropped, times: u64) {
        self.0[reason.place()].fetch_add(times, Ordering::Relaxed);
    }

    /// Counts so far, in the order of [`Dropped::ALL`].
    pub fn counts(&self) -> [u64; Dropped::ALL.len()] {
        std::array::from_fn(|place| self.0[place].load(Ordering::Relaxed))
    }

    /// Those that are not 0, by name.
    pub fn by_name(&self) -> BTreeMap<String, u64> {
        let named = Dropped::ALL.iter().zip(self.counts()).filter(|(_, count)| *count > 0);
        named.map(|(reason, count)| (reason.name().to_owned(), count)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_has_a_place() {
        let drops = Drops::default();
        for refusal in Refusal::ALL {
            drops.count(Dropped::Refused(refusal), 2);
        }
        assert_eq!(drops.by_name().len(), Refusal::ALL.len());
        assert!(drops.by_name().values().all(|count| *count == 2));
    }
}
