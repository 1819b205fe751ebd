//! Sets of record numbers, kept and sent as ranges.

use crate::RecordError;
use crate::codec::{Reader, Writer};

/// Most ranges in a set that comes from outside.
const RANGES_MAX: usize = 64;

/// A set of record numbers, as ranges: what has been received of a log is nearly always one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Numbers {
    /// First and last of each range, apart and in rising order.
    ranges: Vec<(u64, u64)>,
}

impl Numbers {
    /// Whether a number is in the set.
    pub fn contains(&self, number: u64) -> bool {
        let after = self.ranges.partition_point(|range| range.0 <= number);
        after > 0 && self.ranges[after - 1].1 >= number
    }

    /// Adds a number.
    pub fn insert(&mut self, number: u64) {
        if self.contains(number) {
            return;
        }
        let at = self.ranges.partition_point(|range| range.0 <= number);
        self.ranges.insert(at, (number, number));
        if at + 1 < self.ranges.len() && number.checked_add(1) == Some(self.ranges[at + 1].0) {
            self.ranges[at].1 = self.ranges[at + 1].1;
            self.ranges.remove(at + 1);
        }
        if at > 0 && self.ranges[at - 1].1.checked_add(1) == Some(number) {
            self.ranges[at - 1].1 = self.ranges[at].1;
            self.ranges.remove(at);
        }
    }

    /// How many numbers there are.
    pub fn count(&self) -> u64 {
        self.ranges.iter().map(|(first, last)| last - first + 1).sum()
    }

    /// The number behind the greatest.
    pub fn end(&self) -> u64 {
        self.ranges.last().map_or(0, |(_, last)| last + 1)
    }

    /// The ranges, at most as many as a message may hold: the first ones.
    pub(crate) fn write(&self, out: &mut Writer) {
        let sent = &self.ranges[..self.ranges.len().min(RANGES_MAX)];
        out.varint(sent.len() as u64);
        let mut from = 0;
        for (first, last) in sent {
            out.varint(first - from);
            out.varint(last - first);
            from = last + 1;
        }
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let count = input.count("ranges of numbers", RANGES_MAX, 2)?;
        let mut ranges: Vec<(u64, u64)> = Vec::with_capacity(count);
        let mut from = 0u64;
        for _ in 0..count {
            let gap = input.varint()?;
            let first = from.checked_add(gap).filter(|_| gap > 0 || ranges.is_empty());
            let first = first.ok_or(RecordError::Malformed("ranges of numbers"))?;
            let last = first.checked_add(input.varint()?).filter(|last| *last < u64::MAX);
            let last = last.ok_or(RecordError::Malformed("ranges of numbers"))?;
            ranges.push((first, last));
            from = last + 1;
        }
        Ok(Self { ranges })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn is_a_set(numbers in proptest::collection::vec(0u64..60, 0..80)) {
            let mut set = Numbers::default();
            let mut model = BTreeSet::new();
            for number in numbers {
                set.insert(number);
                model.insert(number);
            }
            prop_assert!((0..62).all(|n| set.contains(n) == model.contains(&n)));
            prop_assert_eq!(set.count(), model.len() as u64);
            prop_assert_eq!(set.end(), model.last().map_or(0, |last| last + 1));
            prop_assert!(set.ranges.windows(2).all(|w| w[0].1 + 1 < w[1].0));
            let mut out = Writer::default();
            set.write(&mut out);
            prop_assert_eq!(Numbers::read(&mut Reader(&out.0)).unwrap(), set);
        }
    }

    #[test]
    fn a_set_that_overflows_is_refused() {
        let mut out = Writer::default();
        out.varint(1);
        out.varint(u64::MAX - 1);
        out.varint(5);
        assert!(Numbers::read(&mut Reader(&out.0)).is_err());
    }
}
