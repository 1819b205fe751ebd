//! One log: a record for each number, or the two that contradict each other.

use crate::kind::Kind;
use crate::{Numbers, Record};
use std::collections::BTreeMap;
use std::sync::Arc;

/// One log of one robot.
#[derive(Clone, Debug, Default)]
pub struct Log {
    slots: BTreeMap<u64, Slot>,
    numbers: Numbers,
    bytes: u64,
}

/// The state of one number.
#[derive(Clone, Debug)]
pub enum Slot {
    /// One record.
    Whole(Arc<Record>),
    /// Two records: the robot contradicts itself, and neither counts. They are kept as proof.
    Quarantined(Box<[Arc<Record>; 2]>),
}

impl Slot {
    /// Each record in it with its bytes.
    pub fn each<'a>(&'a self, mut visit: impl FnMut(Kind, &'a Arc<[u8]>)) {
        match self {
            Self::Whole(record) => visit(record.kind(), record.bytes()),
            // The proof that a name was used twice goes before anything else.
            Self::Quarantined(both) => {
                both.iter().for_each(|record| visit(Kind::Withdrawal, record.bytes()));
            }
        }
    }

    /// Whether it holds the record with this hash and no other.
    pub fn is_just(&self, hash: &[u8; 32]) -> bool {
        self.hash() == *hash
    }

    /// The hash by which others know what is here: zeros when it is in doubt.
    fn hash(&self) -> [u8; 32] {
        match self {
            Self::Whole(record) => record.hash,
            Self::Quarantined(_) => [0; 32],
        }
    }
}

impl Log {
    /// Takes a record in that it does not hold; false when another one has its number.
    pub fn insert(&mut self, record: Record) -> bool {
        let number = record.name.number;
        match self.slots.get_mut(&number) {
            None => {
                self.bytes += record.bytes().len() as u64;
                self.numbers.insert(number);
                self.slots.insert(number, Slot::Whole(Arc::new(record)));
                true
            }
            Some(slot) => {
                if let Slot::Whole(first) = slot {
                    self.bytes += record.bytes().len() as u64;
                    *slot = Slot::Quarantined(Box::new([Arc::clone(first), Arc::new(record)]));
                }
                false
            }
        }
    }

    /// Whether a record is known already.
    pub fn holds(&self, number: u64, hash: &[u8; 32]) -> bool {
        match self.slots.get(&number) {
            None => false,
            Some(Slot::Whole(record)) => record.hash == *hash,
            Some(Slot::Quarantined(_)) => true,
        }
    }

    /// The state of a number.
    pub fn slot(&self, number: u64) -> Option<&Slot> {
        self.slots.get(&number)
    }

    /// All numbers with their states.
    pub fn slots(&self) -> impl Iterator<Item = (u64, &Slot)> {
        self.slots.iter().map(|(number, slot)| (*number, slot))
    }

    /// The records that are not in doubt.
    pub fn records(&self) -> impl Iterator<Item = &Arc<Record>> {
        self.slots.values().filter_map(|slot| match slot {
            Slot::Whole(record) => Some(record),
            Slot::Quarantined(_) => None,
        })
    }

    /// Numbers of all records.
    pub fn numbers(&self) -> &Numbers {
        &self.numbers
    }

    /// Number and hash of each.
    pub fn hashes(&self) -> Vec<(u64, [u8; 32])> {
        self.slots().map(|(number, slot)| (number, slot.hash())).collect()
    }

    /// Exclusive or of the hashes' first halves.
    pub fn digest(&self) -> [u8; 16] {
        let mut digest = [0; 16];
        for slot in self.slots.values() {
            digest.iter_mut().zip(slot.hash()).for_each(|(sum, byte)| *sum ^= byte);
        }
        digest
    }

    /// Bytes of all records.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}
