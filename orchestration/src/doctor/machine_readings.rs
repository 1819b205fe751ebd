//! A machine as `flockslam doctor` sees it: readings alone, so that every check can be tested without the machine.

use serde::Serialize;
use std::path::PathBuf;

/// Readings of a machine. What could not be read is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Machine {
    /// Version of this build of flockslam.
    pub version: String,
    /// Version of the kernel.
    pub kernel: Option<String>,
    /// The distribution, as `/etc/os-release` says.
    pub system: Option<String>,
    /// Processors that this process may use.
    pub processors: usize,
    /// Governor of each processor that has one.
    pub governors: Vec<String>,
    /// Memory.
    pub memory: Option<MemoryReading>,
    /// Memory of the file system of shared memory.
    pub shared_memory: Option<MemoryReading>,
    /// Files that a process may open at most; `None` without a limit.
    pub open_files: Option<u64>,
    /// Least `nice` that this user may set.
    pub nice_min: Option<i32>,
    /// The clock, nanoseconds of UTC.
    pub utc_ns: i64,
    /// Whether the clock is kept by a time service.
    pub clock_is_synchronised: Option<bool>,
    /// Serial ports, those on USB first.
    pub ports: Vec<PortReading>,
    /// Places on disk that a set would use.
    pub disks: Vec<DiskReading>,
    /// Default size of the buffer of a socket that receives, bytes.
    pub receive_buffer_bytes: Option<u64>,
}

/// A kind of memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MemoryReading {
    /// All of it, bytes.
    pub total_bytes: u64,
    /// What can be had, bytes.
    pub free_bytes: u64,
}

/// A serial port.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PortReading {
    /// Its device file.
    pub path: PathBuf,
    /// What is plugged in, where it is on USB.
    pub usb: Option<String>,
    /// Whether this user may read and write it.
    pub is_allowed: bool,
    /// The group that may.
    pub group: Option<String>,
    /// How long its adapter holds bytes back, milliseconds.
    pub latency_ms: Option<u64>,
}

/// A place on disk.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DiskReading {
    /// What for.
    pub purpose: String,
    /// Where.
    pub path: PathBuf,
    /// What can be written there, bytes.
    pub free_bytes: Option<u64>,
    /// Whether this user may write there.
    pub is_writable: bool,
}
