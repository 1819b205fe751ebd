//! What is wrong with a machine. Takes readings; gives findings.

use super::finding::Finding;
use super::machine_readings::{DiskReading, Machine, PortReading};
use crate::supervisor::OPEN_FILES;

/// Shared memory of one set of default size with some room, bytes.
const SHARED_MEMORY_MIN_BYTES: u64 = 32 << 20;
/// Memory that a set of default size takes on the way through a building, bytes.
const MEMORY_MIN_BYTES: u64 = 256 << 20;
/// Journal and submaps of an hour take less than this, bytes.
const DISK_GOOD_BYTES: u64 = 1 << 30;
/// With less a set soon has nothing left to write to, bytes.
const DISK_MIN_BYTES: u64 = 100 << 20;
/// No clock that runs rightly is before this: 1 January 2025, nanoseconds of UTC.
const NOT_BEFORE_NS: i64 = 1_735_689_600_000_000_000;
/// `nice` that the units of the package allow to the stages on the way to a pose.
const NICE_WANTED: i32 = -10;
/// An adapter that holds bytes back longer makes scans late, milliseconds.
const LATENCY_MAX_MS: u64 = 4;

/// All findings on a machine.
pub fn check_machine(machine: &Machine) -> Vec<Finding> {
    let mut found = Vec::new();
    found.extend(shared_memory(machine));
    found.extend(open_files(machine));
    found.extend(memory(machine));
    found.extend(clock(machine));
    found.extend(processors(machine));
    machine.ports.iter().for_each(|port| found.extend(of_port(port)));
    machine.disks.iter().for_each(|disk| found.extend(of_disk(disk)));
    found
}

fn shared_memory(machine: &Machine) -> Option<Finding> {
    let room = machine.shared_memory?;
    let (total_mb, free_mb) = (room.total_bytes >> 20, room.free_bytes >> 20);
    (room.free_bytes < SHARED_MEMORY_MIN_BYTES).then(|| {
        let cure = "mount -o remount,size=128m /dev/shm, --shm-size=128m for a container, or remove what others have left there";
        Finding::error("shared memory", format!("/dev/shm has {total_mb} MB, {free_mb} MB of it free"), cure)
    })
}

fn open_files(machine: &Machine) -> Option<Finding> {
    let allowed = machine.open_files.filter(|allowed| *allowed < OPEN_FILES)?;
    Some(Finding::error(
        "limits",
        format!("a process may open {allowed} files, a set needs {OPEN_FILES}"),
        format!("ulimit -Hn {OPEN_FILES}, or LimitNOFILE={OPEN_FILES} in the unit"),
    ))
}

fn memory(machine: &Machine) -> Option<Finding> {
    let free_mb = machine.memory.filter(|memory| memory.free_bytes < MEMORY_MIN_BYTES)?.free_bytes >> 20;
    let cure = "end other programs, or give [stages.sync-manager] memory_max_bytes";
    Some(Finding::warning("memory", format!("{free_mb} MB can be had"), cure))
}

fn clock(machine: &Machine) -> Option<Finding> {
    if machine.utc_ns < NOT_BEFORE_NS {
        let what = "the clock is before 2025: stamps of scans and of other machines will not fit";
        return Some(Finding::error("clock", what, "set it, and install a time service (chrony)"));
    }
    (machine.clock_is_synchronised == Some(false)).then(|| {
        let what = "no time service keeps the clock: stamps of other machines will not fit, and it may jump";
        Finding::warning("clock", what, "timedatectl set-ntp true, or install chrony")
    })
}

fn processors(machine: &Machine) -> Vec<Finding> {
    let mut found = Vec::new();
    let slow = machine.governors.iter().filter(|governor| *governor == "powersave").count();
    if slow > 0 {
        let what = format!("{slow} of {} processors are kept slow by `powersave`", machine.governors.len());
        let cure = "cpupower frequency-set -g schedutil (or performance)";
        found.push(Finding::warning("governor", what, cure));
    }
    if machine.processors == 1 {
        let what = "one processor: the loop closures of sync-manager share it with the way to a pose";
        found.push(Finding::info(
            "processors",
            what,
            "nice = 10 in [stages.sync-manager], as in one-robot.toml",
        ));
    }
    if let Some(least) = machine.nice_min.filter(|least| *least > NICE_WANTED) {
        let what = format!("this user may not go below nice {least}: other programs hold the stages up");
        let cure = format!("LimitNICE={NICE_WANTED} in the unit, as flockslam@.service has it");
        found.push(Finding::info("limits", what, cure));
    }
    found
}

fn of_port(port: &PortReading) -> Vec<Finding> {
    let mut found = Vec::new();
    let path = port.path.display();
    // Ports of the board often have no lidar.
    let Some(usb) = &port.usb else { return found };
    if !port.is_allowed {
        let group = port.group.as_deref().unwrap_or("dialout");
        let cure = format!("sudo usermod -a -G {group} $USER, then log in anew");
        found.push(Finding::error("ports", format!("no permission for {path} ({usb})"), cure));
    }
    if let Some(latency_ms) = port.latency_ms.filter(|latency_ms| *latency_ms > LATENCY_MAX_MS) {
        let name = port.path.file_name().unwrap_or_default().to_string_lossy();
        let what = format!("the adapter of {path} holds bytes back for {latency_ms} ms");
        let cure = format!("echo 1 | sudo tee /sys/bus/usb-serial/devices/{name}/latency_timer");
        found.push(Finding::warning("ports", what, cure));
    }
    found
}

fn of_disk(disk: &DiskReading) -> Option<Finding> {
    let (path, purpose) = (disk.path.display(), &disk.purpose);
    if !disk.is_writable {
        let what = format!("{purpose} would be in {path}, which this user may not write");
        return Some(Finding::error("disk", what, "another directory, or its owner: chown"));
    }
    let free_mb = disk.free_bytes? >> 20;
    let what = format!("{free_mb} MB are free for {purpose} in {path}");
    let cure = "make room there, or name another directory";
    match disk.free_bytes? {
        ..DISK_MIN_BYTES => Some(Finding::error("disk", what, cure)),
        DISK_MIN_BYTES..DISK_GOOD_BYTES => Some(Finding::warning("disk", what, cure)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::Severity;
    use super::super::machine_readings::MemoryReading;
    use super::*;
    use std::path::PathBuf;

    fn memory_of(total_mb: u64, free_mb: u64) -> Option<MemoryReading> {
        Some(MemoryReading { total_bytes: total_mb << 20, free_bytes: free_mb << 20 })
    }

    fn good() -> Machine {
        Machine {
            version: "0.1.0".to_owned(),
            kernel: Some("6.1".to_owned()),
            processors: 4,
            governors: vec!["schedutil".to_owned(); 4],
            memory: memory_of(2000, 1000),
            shared_memory: memory_of(64, 60),
            open_files: Some(1024),
            nice_min: Some(-10),
            utc_ns: NOT_BEFORE_NS + 1,
            clock_is_synchronised: Some(true),
            ports: vec![port()],
            disks: vec![disk(2000)],
            receive_buffer_bytes: Some(4 << 20),
            ..Machine::default()
        }
    }

    fn port() -> PortReading {
        PortReading {
            path: PathBuf::from("/dev/ttyUSB0"),
            usb: Some("CP2102 (10c4:ea60)".to_owned()),
            is_allowed: true,
            group: Some("dialout".to_owned()),
            latency_ms: Some(1),
        }
    }

    fn disk(free_mb: u64) -> DiskReading {
        let (purpose, path) = ("the map".to_owned(), PathBuf::from("/var/lib"));
        DiskReading { purpose, path, free_bytes: Some(free_mb << 20), is_writable: true }
    }

    #[test]
    fn a_good_machine_and_one_without_readings_have_no_findings() {
        assert_eq!(check_machine(&good()), []);
        let silent = Machine { utc_ns: NOT_BEFORE_NS, processors: 2, ..Machine::default() };
        assert_eq!(check_machine(&silent), []);
    }

    #[test]
    fn each_fault_of_a_machine_is_one_finding_with_its_cure() {
        use Severity::{Error, Info, Warning};
        let port_with = |change: fn(&mut PortReading)| {
            let mut port = port();
            change(&mut port);
            vec![port]
        };
        let closed = DiskReading { is_writable: false, ..disk(2000) };
        let slow = || vec!["powersave".to_owned(), "schedutil".to_owned()];
        let cases: [(Machine, Severity, &str, &str); 13] = [
            (Machine { shared_memory: memory_of(64, 31), ..good() }, Error, "31 MB of it free", "--shm-size"),
            (Machine { open_files: Some(256), ..good() }, Error, "256 files", "LimitNOFILE=320"),
            (Machine { memory: memory_of(512, 100), ..good() }, Warning, "100 MB can", "memory_max_bytes"),
            (Machine { utc_ns: 0, ..good() }, Error, "before 2025", "chrony"),
            (Machine { clock_is_synchronised: Some(false), ..good() }, Warning, "no time service", "set-ntp"),
            (Machine { governors: slow(), ..good() }, Warning, "1 of 2", "cpupower"),
            (Machine { processors: 1, ..good() }, Info, "one processor", "nice = 10"),
            (Machine { nice_min: Some(0), ..good() }, Info, "nice 0", "LimitNICE=-10"),
            (
                Machine { ports: port_with(|port| port.is_allowed = false), ..good() },
                Error,
                "no permission for /dev/ttyUSB0",
                "usermod -a -G dialout",
            ),
            (
                Machine { ports: port_with(|port| port.latency_ms = Some(16)), ..good() },
                Warning,
                "16 ms",
                "devices/ttyUSB0/latency_timer",
            ),
            (Machine { disks: vec![closed], ..good() }, Error, "may not write", "chown"),
            (Machine { disks: vec![disk(500)], ..good() }, Warning, "500 MB are free for the map", "room"),
            (Machine { disks: vec![disk(50)], ..good() }, Error, "50 MB", "room"),
        ];
        for (machine, severity, what, cure) in cases {
            let found = check_machine(&machine);
            let [finding] = found.as_slice() else { panic!("{what}: {found:?}") };
            assert_eq!(finding.severity, severity, "{finding}");
            assert!(finding.what.contains(what) && finding.cure.contains(cure), "{finding}");
        }
    }

    #[test]
    fn a_port_of_the_board_without_permission_is_no_finding() {
        let board = PortReading { usb: None, is_allowed: false, ..port() };
        assert_eq!(check_machine(&Machine { ports: vec![board], ..good() }), []);
    }
}
