//! Fills the readings of a machine.

use super::machine_readings::{DiskReading, Machine, MemoryReading, PortReading};
use flockslam_bus::Room;
use flockslam_lidar_ingest::process::serial_ports;
use rustix::fs::{Access, access, statvfs};
use rustix::process::{Resource, getrlimit};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;

/// Reads what can be read. `places` are those on disk that a set would use, each with its purpose.
pub fn read_machine(places: &[(String, &Path)]) -> Machine {
    let shared_memory =
        Room::now().map(|room| MemoryReading { total_bytes: room.total_bytes, free_bytes: room.free_bytes });
    Machine {
        version: crate::VERSION.to_owned(),
        kernel: text("/proc/sys/kernel/osrelease"),
        system: system_name(),
        processors: std::thread::available_parallelism().map_or(1, usize::from),
        governors: governors(),
        memory: memory(),
        shared_memory,
        open_files: getrlimit(Resource::Nofile).maximum,
        nice_min: getrlimit(Resource::Nice).current.map(|limit| 20 - limit.min(40) as i32),
        utc_ns: now_ns(),
        clock_is_synchronised: clock_is_synchronised(),
        ports: ports(),
        disks: places.iter().map(|(purpose, path)| read_disk(purpose, path)).collect(),
        receive_buffer_bytes: text("/proc/sys/net/core/rmem_default").and_then(|text| text.parse().ok()),
    }
    .with_rights_of_root()
}

impl Machine {
    /// Root is bound by no limit of `nice`.
    fn with_rights_of_root(mut self) -> Self {
        if rustix::process::geteuid().is_root() {
            self.nice_min = None;
        }
        self
    }
}

/// The time, nanoseconds of UTC: whether it can be right is one of the findings, and lines of the log are stamped by it.
pub(super) fn now_ns() -> i64 {
    flockslam_telemetry::utc_ns()
}

fn text(path: impl AsRef<Path>) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

fn system_name() -> Option<String> {
    let release = text("/etc/os-release")?;
    let name = release.lines().find_map(|line| line.strip_prefix("PRETTY_NAME="))?;
    Some(name.trim_matches('"').to_owned())
}

fn governors() -> Vec<String> {
    let cpus = fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    cpus.filter_map(|cpu| text(cpu.path().join("cpufreq/scaling_governor"))).collect()
}

fn memory() -> Option<MemoryReading> {
    let table = text("/proc/meminfo")?;
    let bytes = |name: &str| {
        let line = table.lines().find_map(|line| line.strip_prefix(name))?;
        Some(line.split_whitespace().next()?.parse::<u64>().ok()? << 10)
    };
    Some(MemoryReading { total_bytes: bytes("MemTotal:")?, free_bytes: bytes("MemAvailable:")? })
}

/// What the time service says, where there is one that can be asked.
fn clock_is_synchronised() -> Option<bool> {
    if Path::new("/run/systemd/timesync/synchronized").exists() {
        return Some(true);
    }
    let asked = Command::new("timedatectl").args(["show", "--property=NTPSynchronized", "--value"]).output();
    match asked.ok().map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned())?.as_str() {
        "yes" => Some(true),
        "no" => Some(false),
        _ => None,
    }
}

fn ports() -> Vec<PortReading> {
    serial_ports()
        .into_iter()
        .map(|port| {
            let name = port.path.file_name().unwrap_or_default().to_owned();
            let latency = Path::new("/sys/bus/usb-serial/devices").join(name).join("latency_timer");
            PortReading {
                usb: port.usb,
                is_allowed: access(&port.path, Access::READ_OK | Access::WRITE_OK).is_ok(),
                group: fs::metadata(&port.path).ok().and_then(|port| group_name(port.gid())),
                latency_ms: text(latency).and_then(|text| text.parse().ok()),
                path: port.path,
            }
        })
        .collect()
}

fn group_name(number: u32) -> Option<String> {
    let groups = text("/etc/group")?;
    let number = number.to_string();
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)? == number).then(|| name.to_owned())
    })
}

/// Of the nearest directory above that is there: the set makes the rest.
pub fn read_disk(purpose: &str, path: &Path) -> DiskReading {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let there = absolute.ancestors().find(|above| above.exists()).unwrap_or(Path::new("/"));
    let free = statvfs(there).ok().map(|found| found.f_bavail.saturating_mul(found.f_frsize));
    DiskReading {
        purpose: purpose.to_owned(),
        path: absolute.clone(),
        free_bytes: free,
        is_writable: access(there, Access::WRITE_OK).is_ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_is_read() {
        let directory = tempfile::tempdir().unwrap();
        let machine = read_machine(&[("the map".to_owned(), &directory.path().join("not/there"))]);
        assert!(machine.kernel.is_some() && machine.processors > 0 && machine.memory.is_some());
        assert!(machine.shared_memory.unwrap().total_bytes > 0);
        let disk = &machine.disks[0];
        assert!(disk.is_writable && disk.free_bytes.is_some(), "{disk:?}");
        assert!(machine.utc_ns > 1_735_689_600_000_000_000, "{}", machine.utc_ns);
        assert_eq!(group_name(0).as_deref(), Some("root"));
    }
}
