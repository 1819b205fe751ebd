//! The acknowledgement of a stage, and the list of all stages.

use crate::message::message;

message! {
    /// A stage has finished with all scans up to and including a number: flow control of exact replay.
    #[derive(Eq)]
    pub struct Progress = "flockslam/progress/v1" {
        /// A [`Stage`] as number.
        pub stage: u32,
        /// Which replica of it.
        pub replica: u32,
        /// All scans with a sequence below this are done.
        pub done: u64,
    }
}

/// The six stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum Stage {
    /// A sensor, a log or a simulated world becomes scans.
    LidarIngest = 0,
    /// Scans become verdicts.
    CorrelationFilter = 1,
    /// A scan and the grid become a pose.
    ScanMatcher = 2,
    /// A scan and a pose become evidence.
    Mapper = 3,
    /// Stale cells are found.
    DynamicCleaner = 4,
    /// Submaps become one consistent map.
    SyncManager = 5,
}

impl Stage {
    /// All stages, in the order in which they are started.
    pub const ALL: [Stage; 6] = [
        Self::SyncManager,
        Self::Mapper,
        Self::DynamicCleaner,
        Self::ScanMatcher,
        Self::CorrelationFilter,
        Self::LidarIngest,
    ];

    /// The name used on the command line, in metrics and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::LidarIngest => "lidar-ingest",
            Self::CorrelationFilter => "correlation-filter",
            Self::ScanMatcher => "scan-matcher",
            Self::Mapper => "mapper",
            Self::DynamicCleaner => "dynamic-cleaner",
            Self::SyncManager => "sync-manager",
        }
    }

    /// The stage of this name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.name() == name)
    }
}
