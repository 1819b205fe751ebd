//! A lidar on a line of its own, as the description of a set names it.

use flockslam_lidar_ingest::process::{LidarPlace, LidarSpec};
use flockslam_lidars::Family;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Rates of serial lines, bits a second, that may be meant.
const BAUD: std::ops::RangeInclusive<u32> = 1200..=20_000_000;

/// The line to a lidar.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LidarLine {
    /// Its serial port.
    pub port: Option<PathBuf>,
    /// Its host, and TCP port where that is another than usual, in place of a serial port.
    pub address: Option<String>,
    /// The rate of the serial line, bits a second; without one those of its models are tried.
    pub baud: Option<u32>,
    /// Its model, where it does not say it itself.
    pub model: Option<String>,
}

/// One of several lidars.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedLidar {
    /// Its name on the robot.
    pub name: String,
    /// Its family.
    pub kind: Family,
    /// As in [`LidarLine`].
    pub port: Option<PathBuf>,
    /// As in [`LidarLine`].
    pub address: Option<String>,
    /// As in [`LidarLine`].
    pub baud: Option<u32>,
    /// As in [`LidarLine`].
    pub model: Option<String>,
}

impl NamedLidar {
    /// The lidar that this describes.
    ///
    /// # Errors
    /// As [`LidarLine::spec`].
    pub fn spec(&self) -> Result<LidarSpec, (&'static str, String)> {
        let line = LidarLine {
            port: self.port.clone(),
            address: self.address.clone(),
            baud: self.baud,
            model: self.model.clone(),
        };
        line.spec(&self.name, self.kind)
    }
}

impl LidarLine {
    /// The lidar that this describes.
    ///
    /// # Errors
    /// The key that is wrong, and why.
    pub fn spec(&self, name: &str, family: Family) -> Result<LidarSpec, (&'static str, String)> {
        let place = match (&self.port, &self.address) {
            (Some(port), None) => LidarPlace::Port(port.clone()),
            (None, Some(address)) => LidarPlace::Address(address.clone()),
            (Some(_), Some(_)) => {
                return Err(("address", "a lidar has a port or an address, not both".to_owned()));
            }
            (None, None) => {
                let reason = "where is the lidar? For example port = \"/dev/ttyUSB0\"; `flockslam lidar list` finds it";
                return Err(("port", reason.to_owned()));
            }
        };
        if let (Some(address), None) = (&self.address, family.tcp_port())
            && !address.contains(':')
        {
            let reason = format!("{address:?} has no TCP port: HOST:PORT");
            return Err(("address", reason));
        }
        family.rates(self.model.as_deref()).map_err(|unknown| ("model", unknown.to_string()))?;
        if let Some(baud) = self.baud.filter(|baud| !BAUD.contains(baud)) {
            return Err(("baud", format!("{baud} is not between {} and {}", BAUD.start(), BAUD.end())));
        }
        let model = self.model.clone();
        Ok(LidarSpec { name: name.to_owned(), family, model, place, rate: self.baud })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_cannot_be_meant_is_refused_with_its_key() {
        let port = || Some(PathBuf::from("/dev/ttyUSB0"));
        let line = LidarLine { port: port(), ..LidarLine::default() };
        let spec = line.spec("", Family::Ld06).unwrap();
        assert_eq!(spec.to_string(), "lidar (ld06 at /dev/ttyUSB0)");
        assert_eq!(spec.rates(), [Some(230_400), Some(115_200)]);
        let key = |line: LidarLine, family| line.spec("", family).unwrap_err().0;
        assert_eq!(key(LidarLine::default(), Family::Urg), "port");
        let host = || Some("192.168.0.10".to_owned());
        assert_eq!(key(LidarLine { address: host(), ..line.clone() }, Family::Urg), "address");
        assert_eq!(key(LidarLine { address: host(), ..LidarLine::default() }, Family::Ld06), "address");
        assert!(LidarLine { address: host(), ..LidarLine::default() }.spec("", Family::Urg).is_ok());
        let model = Some("A1".to_owned());
        assert_eq!(key(LidarLine { model, ..line.clone() }, Family::Ld06), "model");
        assert_eq!(key(LidarLine { baud: Some(9), ..line }, Family::Ld06), "baud");
    }
}
