//! Finds serial ports, and what lidar answers at one.

use super::lidar_line::{LidarPlace, LidarSpec, Line};
use flockslam_lidars::{Device, Driver, Family};
use flockslam_telemetry::monotonic_ns;
use rustix::event::{Timespec, poll};
use serialport::SerialPortType;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A lidar that has not answered at a rate within this does not speak so; nanoseconds.
const ANSWER_NS: u64 = 1_200_000_000;
/// So many good packets are no accident.
const PACKETS: u64 = 4;
const LOOK: Duration = Duration::from_millis(10);
/// Where the system lists serial ports.
const PORTS_DIR: &str = "/sys/class/tty";
/// Read at once.
const BUFFER_BYTES: usize = 1 << 14;

/// A serial port of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundPort {
    /// Its device file.
    pub path: PathBuf,
    /// A name of it that stays when others are plugged in.
    pub stable: Option<PathBuf>,
    /// What is plugged in, where it is on USB.
    pub usb: Option<String>,
}

/// A lidar that answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundLidar {
    /// How it speaks.
    pub family: Family,
    /// At which rate, bits a second.
    pub rate: Option<u32>,
    /// Its identification.
    pub device: Device,
}

/// The serial ports of this machine, those on USB first.
pub fn serial_ports() -> Vec<FoundPort> {
    // Without sysfs, as in a chroot, the library panics.
    let found = if Path::new(PORTS_DIR).is_dir() { serialport::available_ports() } else { Ok(Vec::new()) };
    let found = found.unwrap_or_default();
    let mut ports: Vec<FoundPort> = found
        .into_iter()
        .map(|port| {
            let usb = match port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let says = [usb.manufacturer, usb.product].into_iter().flatten().collect::<Vec<_>>();
                    Some(format!("{} ({:04x}:{:04x})", says.join(" "), usb.vid, usb.pid))
                }
                _ => None,
            };
            // The system's list has paths of its own for some ports.
            let path = PathBuf::from(&port.port_name);
            let path = path.file_name().map(|name| Path::new("/dev").join(name)).unwrap_or(path);
            FoundPort { stable: stable_name(&path), path, usb }
        })
        .collect();
    ports.sort_by_key(|port| (port.usb.is_none(), port.path.clone()));
    ports
}

fn stable_name(path: &Path) -> Option<PathBuf> {
    let names = std::fs::read_dir("/dev/serial/by-id").ok()?;
    let is_it = |name: &PathBuf| std::fs::canonicalize(name).is_ok_and(|target| target == path);
    names.flatten().map(|name| name.path()).find(is_it)
}

/// What lidar answers at a place. With `asks` false nothing is sent: only lidars that send without a request are found.
///
/// # Errors
/// When the place cannot be used, in words for the user.
pub fn identify(place: &LidarPlace, asks: bool) -> Result<Option<FoundLidar>, String> {
    for (family, rate) in candidates(place) {
        let spec = LidarSpec { name: String::new(), family, model: None, place: place.clone(), rate };
        let mut line = Line::open(&spec, rate)?;
        let mut driver = family.driver(None, rate);
        if listens(&mut line, &mut *driver, asks) {
            return Ok(Some(FoundLidar { family, rate, device: driver.device().clone() }));
        }
    }
    Ok(None)
}

/// Families and rates, those first that speak by themselves.
fn candidates(place: &LidarPlace) -> Vec<(Family, Option<u32>)> {
    match place {
        LidarPlace::Address(_) => Family::ALL
            .into_iter()
            .filter(|family| family.tcp_port().is_some())
            .map(|family| (family, None))
            .collect(),
        LidarPlace::Port(_) => {
            let serial = Family::ALL.into_iter().filter(|family| *family != Family::SickTim);
            let rates = |family: Family| family.rates(None).unwrap_or_default();
            serial
                .flat_map(|family| rates(family).into_iter().map(move |rate| (family, Some(rate))))
                .collect()
        }
    }
}

fn listens(line: &mut Line, driver: &mut dyn Driver, asks: bool) -> bool {
    let began_ns = monotonic_ns();
    let mut bytes = vec![0; BUFFER_BYTES];
    while monotonic_ns() - began_ns < ANSWER_NS {
        while let Some(act) = if asks { driver.act(monotonic_ns() as i64) } else { None } {
            if line.carry_out(&act).is_err() {
                return false;
            }
        }
        let limit = Timespec::try_from(LOOK).ok();
        let mut waits = [line.poll_fd()];
        let ready = poll(&mut waits, limit.as_ref()).is_ok_and(|ready| ready > 0);
        if ready {
            match line.read(&mut bytes) {
                Ok(length) => driver.take(&bytes[..length], monotonic_ns() as i64, &mut |_| ()),
                Err(_) => return false,
            }
        }
        let (device, packets) = (driver.device(), driver.counts().packets);
        if device.serial_number.is_some() || packets >= PACKETS {
            return true;
        }
    }
    false
}
