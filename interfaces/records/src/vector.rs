//! Version vectors: the state of each log of a collection.

use crate::codec::{Reader, Writer};
use crate::{Numbers, RecordError, RobotId};

/// Most logs in a vector.
const LOGS_MAX: usize = 8192;

/// The state of a collection, log by log: a version vector.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Vector {
    /// In the order of (robot, epoch), each once.
    pub logs: Vec<LogState>,
}

/// The state of one log of a collection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogState {
    /// Whose log.
    pub robot: RobotId,
    /// Which of its logs.
    pub epoch: u64,
    /// Numbers of the records.
    pub numbers: Numbers,
    /// Exclusive or of their hashes: tells whether two that have the same numbers have the same records.
    pub digest: [u8; 16],
}

impl Vector {
    /// Its entry for one log.
    pub fn log(&self, robot: &RobotId, epoch: u64) -> Option<&LogState> {
        let place = self.logs.binary_search_by(|log| (&log.robot, log.epoch).cmp(&(robot, epoch)));
        place.ok().map(|place| &self.logs[place])
    }

    pub(crate) fn write(&self, out: &mut Writer) {
        let sent = &self.logs[..self.logs.len().min(LOGS_MAX)];
        out.varint(sent.len() as u64);
        for log in sent {
            out.robot(&log.robot);
            out.u64(log.epoch);
            log.numbers.write(out);
            out.bytes(&log.digest);
        }
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let count = input.count("logs", LOGS_MAX, 58)?;
        let mut logs: Vec<LogState> = Vec::with_capacity(count);
        for _ in 0..count {
            let (robot, epoch) = (input.robot()?, input.u64()?);
            let numbers = Numbers::read(input)?;
            let log = LogState { robot, epoch, numbers, digest: input.array()? };
            if logs.last().is_some_and(|last| (&last.robot, last.epoch) >= (&log.robot, log.epoch)) {
                return Err(RecordError::Malformed("the order of logs"));
            }
            logs.push(log);
        }
        Ok(Self { logs })
    }
}
