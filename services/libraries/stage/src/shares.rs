//! A scan that several processes of a stage share: each does a part, and the first one publishes.

use crate::inbox::{Named, Port};
use crate::{Deadline, StageError};
use flockslam_bus::{SliceSample, SliceTopic};
use flockslam_messages::{ScanId, ScanTally, SectorHeader};

/// The result of one process for its share of a scan.
pub trait Share: Named {
    /// Number of the share, and number of all shares.
    fn part(&self) -> (u32, u32);
}

impl Share for ScanTally {
    fn part(&self) -> (u32, u32) {
        (self.part, self.parts)
    }
}

impl Share for SectorHeader {
    fn part(&self) -> (u32, u32) {
        (self.part, self.parts)
    }
}

impl<H: SliceTopic + Share> Share for SliceSample<H> {
    fn part(&self) -> (u32, u32) {
        self.header().part()
    }
}

/// The state of the first process of a stage, which waits for the shares of the others; share 0 is its own. It
/// does missing shares itself after the deadline.
pub struct Shares<P: Port, W> {
    port: P,
    held: Vec<P::Message>,
    held_max: usize,
    deadline: Deadline,
    /// By number: whether the share of the present scan has arrived.
    arrived: Vec<bool>,
    work: Option<(ScanId, W)>,
}

impl<P: Port, W> Shares<P, W>
where
    P::Message: Share,
{
    /// Shares of `count` processes. Others may be ahead: at most `held_max` shares of later scans are held.
    pub fn new(port: P, parts: u32, held_max: usize, deadline_ns: u64) -> Self {
        let arrived = (0..parts).map(|part| part == 0).collect();
        let deadline = Deadline::new(deadline_ns);
        Self { port, held: Vec::with_capacity(held_max + 1), held_max, deadline, arrived, work: None }
    }

    /// Processes that share.
    pub fn parts(&self) -> u32 {
        self.arrived.len() as u32
    }

    /// Begins to wait for the shares of a scan; `work` is this process' own part of it.
    pub fn begin(&mut self, scan: ScanId, work: W, now_ns: u64) {
        self.work = Some((scan, work));
        self.deadline.end();
        self.deadline.passes(now_ns);
    }

    /// Whether a scan waits for shares.
    pub fn waits(&self) -> bool {
        self.work.is_some()
    }

    /// Gives arrived shares to `take`, which returns whether they fit. Returns the work, with the numbers of the shares that
    /// are missing, once all are there or the deadline has passed.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn finish(
        &mut self,
        now_ns: u64,
        mut take: impl FnMut(&mut W, &P::Message) -> bool,
    ) -> Result<Option<(W, Vec<u32>)>, StageError> {
        let Self { port, held, held_max, arrived, work, .. } = self;
        let Some((scan, known)) = work else { return Ok(None) };
        while let Some(share) = port.next()? {
            // Another process may be ahead; shares of earlier scans are of no use any more.
            if share.scan().sequence >= scan.sequence {
                held.push(share);
                held.drain(..held.len().saturating_sub(*held_max));
            }
        }
        let parts = arrived.len() as u32;
        held.retain(|share| {
            let (part, of) = share.part();
            let wanted = share.scan() == *scan && of == parts;
            if let Some(arrived) = arrived.get_mut(part as usize).filter(|arrived| wanted && !**arrived) {
                *arrived = take(known, share);
            }
            share.scan().sequence > scan.sequence
        });
        if !self.deadline.passes(now_ns) && self.arrived.contains(&false) {
            return Ok(None);
        }
        let missing = (0..parts).filter(|part| !self.arrived[*part as usize]).collect();
        self.arrived.iter_mut().skip(1).for_each(|arrived| *arrived = false);
        Ok(self.work.take().map(|(_, work)| (work, missing)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_bus::BusError;
    use std::cell::RefCell;

    struct Tallies(RefCell<Vec<ScanTally>>);

    impl Port for Tallies {
        type Message = ScanTally;

        fn next(&self) -> Result<Option<ScanTally>, BusError> {
            Ok(self.0.borrow_mut().pop())
        }
    }

    fn shares(of: &[(u64, u32)]) -> Shares<Tallies, Vec<u32>> {
        let tally = |(sequence, part): &(u64, u32)| {
            let id = ScanId { sequence: *sequence, ..ScanId::default() };
            ScanTally { id, part: *part, parts: 3, ..ScanTally::default() }
        };
        Shares::new(Tallies(RefCell::new(of.iter().rev().map(tally).collect())), 3, 4, 10)
    }

    fn begin(shares: &mut Shares<Tallies, Vec<u32>>, sequence: u64) {
        shares.begin(ScanId { sequence, ..ScanId::default() }, Vec::new(), 100);
    }

    fn take(work: &mut Vec<u32>, share: &ScanTally) -> bool {
        work.push(share.part);
        true
    }

    #[test]
    fn work_is_given_back_once_all_shares_are_there_each_taken_once() {
        let mut shares = shares(&[(4, 1), (5, 2), (5, 2), (6, 1), (5, 1)]);
        assert_eq!(shares.finish(100, take).unwrap(), None);
        begin(&mut shares, 5);
        assert_eq!(shares.finish(101, take).unwrap(), Some((vec![2, 1], Vec::new())));
        begin(&mut shares, 6);
        assert_eq!(shares.finish(110, take).unwrap(), None);
        assert!(shares.waits());
        assert_eq!(shares.finish(111, take).unwrap(), Some((vec![1], vec![2])), "the other one is late");
        assert!(!shares.waits());
    }

    #[test]
    fn shares_that_do_not_fit_are_missing_and_of_those_ahead_the_oldest_is_dropped() {
        let ahead: Vec<_> = (7..100).map(|sequence| (sequence, 1)).collect();
        let mut shares = shares(&ahead);
        begin(&mut shares, 5);
        assert_eq!(shares.finish(111, |_, _| false).unwrap(), Some((Vec::new(), vec![1, 2])));
        assert_eq!(shares.held.iter().map(|share| share.id.sequence).collect::<Vec<_>>(), [96, 97, 98, 99]);
        begin(&mut shares, 97);
        assert_eq!(shares.finish(111, |_, _| false).unwrap().unwrap().1, [1, 2]);
        assert_eq!(shares.held.len(), 2);
    }
}
