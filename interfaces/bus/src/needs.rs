//! What a set needs of shared memory, by its capacity and its processes; and whether it is there.

use crate::bus::topics;
use crate::room::{Megabytes, Room, SHARED_MEMORY};
use crate::tile_port::LANES;
use crate::{Capacity, LargeScanHeader, SliceTopic, Topic};
use flockslam_messages::{
    Control, Correction, FlockFrame, FlockRobots, LocalisationOrder, MarksHeader, MovingBeamsHeader,
    PartInserted, PoseEstimate, Progress, ScanHeader, ScanTally, SectorHeader, Stage, TileMessage,
    TracksHeader, Verdict,
};
use std::fmt;

/// Queues between each publisher and each reader, and what iceoryx2 keeps of its ports, in a set of one process for each stage
/// (measured: 1.7 MB), bytes. It grows with the square of the number of processes.
const CONNECTIONS_BYTES: u64 = 2 << 20;
/// Heartbeats, reports and configuration of the set, bytes.
const STATUS_BYTES: u64 = 1 << 20;

/// What a set takes of shared memory when it starts, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// For scans.
    pub scans_bytes: u64,
    /// For tiles of the grid.
    pub tiles_bytes: u64,
    /// For all other messages.
    pub messages_bytes: u64,
    /// For queues and for the state of processes.
    pub rest_bytes: u64,
}

/// A set does not fit into shared memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{room}; this set needs {}: {needs}. Give it more (--shm-size={}m for a container, or mount -o remount,size={}m {SHARED_MEMORY}), or \
     remove what others have left there",
    Megabytes(needs.total_bytes()), enough_mb(*needs, *room), enough_mb(*needs, *room)
)]
pub struct TooSmall {
    /// What is needed.
    pub needs: Needs,
    /// What there is.
    pub room: Room,
}

impl Needs {
    /// Of a set with so many processes of each stage.
    pub fn of(capacity: &Capacity, processes: impl Fn(Stage) -> usize) -> Self {
        let all: usize = Stage::ALL.into_iter().map(&processes).sum();
        let mut needs = Self::default();
        for topic in topics(capacity) {
            let publishers = match publisher(topic.name) {
                Some(stage) if is_of_shares(topic.name) && processes(stage) == 1 => 0,
                Some(stage) => processes(stage),
                // All processes, and the supervisor.
                None => all + 1,
            };
            let (place, ports) = match topic.name {
                TileMessage::NAME => (&mut needs.tiles_bytes, LANES * publishers),
                ScanHeader::NAME | LargeScanHeader::NAME => (&mut needs.scans_bytes, publishers),
                _ => (&mut needs.messages_bytes, publishers),
            };
            *place += topic.reserved_bytes() * ports as u64;
        }
        let (all, stages) = (all as u64, Stage::ALL.len() as u64);
        needs.rest_bytes = CONNECTIONS_BYTES * all * all / (stages * stages) + STATUS_BYTES;
        needs
    }

    /// All of it, bytes.
    pub fn total_bytes(&self) -> u64 {
        self.scans_bytes + self.tiles_bytes + self.messages_bytes + self.rest_bytes
    }

    /// Whether it is there now.
    ///
    /// # Errors
    /// When it is not.
    pub fn check(self, room: Option<Room>) -> Result<(), TooSmall> {
        match room {
            Some(room) if room.free_bytes < self.total_bytes() => Err(TooSmall { needs: self, room }),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Needs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [tiles, scans, messages, rest] =
            [self.tiles_bytes, self.scans_bytes, self.messages_bytes, self.rest_bytes].map(Megabytes);
        write!(f, "tiles {tiles}, scans {scans}, other messages {messages}, queues and state {rest}")
    }
}

/// A round size with which the set fits beside what is taken, MB.
fn enough_mb(needs: Needs, room: Room) -> u64 {
    let taken_bytes = room.total_bytes.saturating_sub(room.free_bytes);
    ((needs.total_bytes() + taken_bytes).div_ceil(1 << 20)).next_multiple_of(32)
}

/// Whose processes publish on a topic; all stages when `None`.
fn publisher(topic: &str) -> Option<Stage> {
    match topic {
        ScanHeader::NAME | LargeScanHeader::NAME => Some(Stage::LidarIngest),
        Verdict::NAME | ScanTally::NAME => Some(Stage::CorrelationFilter),
        PoseEstimate::NAME | MovingBeamsHeader::NAME => Some(Stage::ScanMatcher),
        MarksHeader::NAME | SectorHeader::NAME | TracksHeader::NAME => Some(Stage::DynamicCleaner),
        Correction::NAME | FlockFrame::NAME | FlockRobots::NAME => Some(Stage::SyncManager),
        Control::NAME | Progress::NAME | LocalisationOrder::NAME => None,
        // Tiles, commits, submaps, and what several mappers tell each other.
        _ => Some(Stage::Mapper),
    }
}

/// Whether a topic is for several processes that share the work of their stage, which open it only then.
fn is_of_shares(topic: &str) -> bool {
    [ScanTally::NAME, PartInserted::NAME, SectorHeader::NAME].contains(&topic)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_default_set() -> Needs {
        Needs::of(&Capacity::default(), |_| 1)
    }

    #[test]
    fn a_default_set_takes_less_than_half_of_what_containers_have() {
        let needs = of_default_set();
        println!("{}: {needs}", Megabytes(needs.total_bytes()));
        assert!((16 << 20..24 << 20).contains(&needs.total_bytes()), "{needs}");
        assert!(Needs::of(&Capacity::default(), |_| 2).total_bytes() > 2 * needs.total_bytes());
    }

    #[test]
    fn what_does_not_fit_is_reported_in_one_line_with_a_cure() {
        let room = |total_mb: u64, free_mb: u64| {
            Some(Room { total_bytes: total_mb << 20, free_bytes: free_mb << 20 })
        };
        assert_eq!(of_default_set().check(room(64, 64)), Ok(()));
        assert_eq!(of_default_set().check(None), Ok(()));
        let text = of_default_set().check(room(9, 8)).unwrap_err().to_string();
        println!("{text}");
        assert!(text.starts_with("/dev/shm has 9.0 MB, 8.0 MB of it free; this set needs "), "{text}");
        assert!(text.contains("--shm-size=32m") && !text.contains('\n'), "{text}");
    }
}
