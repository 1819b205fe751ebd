//! The families of lidars: their names, their lines, their decoders.

use crate::Driver;
use crate::ld06::Ld06;
use crate::rplidar::Rplidar;
use crate::sick_tim::SickTim;
use crate::urg::Urg;
use crate::ydlidar::Ydlidar;
use crate::ydlidar_models;
use serde::{Deserialize, Serialize};

/// A family of lidars that speak alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// LDROBOT LD06, LD19, STL-19P, LDS-02.
    Ld06,
    /// Slamtec RPLIDAR A, S and C series.
    Rplidar,
    /// YDLIDAR X, G, S, T-mini and TG series.
    Ydlidar,
    /// Hokuyo URG and UST.
    Urg,
    /// SICK TiM and LMS1xx.
    SickTim,
}

/// A model that a family does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownModel {
    /// The family.
    pub family: Family,
    /// What was said.
    pub model: String,
}

impl std::fmt::Display for UnknownModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let known = self.family.models().collect::<Vec<_>>().join(", ");
        write!(f, "{:?} is no model of {}; known are {known}", self.model, self.family.name())
    }
}

impl std::error::Error for UnknownModel {}

/// Models whose line runs at a rate of its own, by family, and that rate.
const RATES: [(Family, &str, u32); 27] = [
    (Family::Ld06, "LD06", 230_400),
    (Family::Ld06, "LD19", 230_400),
    (Family::Ld06, "STL-19P", 230_400),
    (Family::Ld06, "LDS-02", 115_200),
    (Family::Rplidar, "A1", 115_200),
    (Family::Rplidar, "A2M8", 115_200),
    (Family::Rplidar, "A2M7", 256_000),
    (Family::Rplidar, "A2M12", 256_000),
    (Family::Rplidar, "A3", 256_000),
    (Family::Rplidar, "S1", 256_000),
    (Family::Rplidar, "C1", 460_800),
    (Family::Rplidar, "S2", 1_000_000),
    (Family::Rplidar, "S3", 1_000_000),
    (Family::Ydlidar, "X2", 115_200),
    (Family::Ydlidar, "X4", 128_000),
    (Family::Ydlidar, "S4", 115_200),
    (Family::Ydlidar, "G2B", 230_400),
    (Family::Ydlidar, "G4", 230_400),
    (Family::Ydlidar, "G6", 512_000),
    (Family::Ydlidar, "T-mini", 230_400),
    (Family::Ydlidar, "T-mini Pro", 230_400),
    (Family::Ydlidar, "T-mini Plus", 230_400),
    (Family::Ydlidar, "TG15", 512_000),
    (Family::Ydlidar, "TG30", 512_000),
    (Family::Ydlidar, "TG50", 512_000),
    (Family::Urg, "URG-04LX", 115_200),
    (Family::SickTim, "TiM", 115_200),
];

impl Family {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Ld06, Self::Rplidar, Self::Ydlidar, Self::Urg, Self::SickTim];

    /// Its name in descriptions of sets.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ld06 => "ld06",
            Self::Rplidar => "rplidar",
            Self::Ydlidar => "ydlidar",
            Self::Urg => "urg",
            Self::SickTim => "sick-tim",
        }
    }

    /// Models that have a rate of their own.
    pub fn models(self) -> impl Iterator<Item = &'static str> {
        RATES.into_iter().filter(move |(family, _, _)| *family == self).map(|(_, model, _)| model)
    }

    /// Rates of the line, the likeliest first: of the model alone, or of all models.
    ///
    /// # Errors
    /// When the family has no such model.
    pub fn rates(self, model: Option<&str>) -> Result<Vec<u32>, UnknownModel> {
        let plain = |name: &str| name.replace([' ', '-', '_'], "").to_uppercase();
        let is_meant = |name: &str| model.is_none_or(|model| plain(model) == plain(name));
        let mut rates: Vec<u32> = Vec::new();
        for (_, _, rate) in RATES.iter().filter(|(family, name, _)| *family == self && is_meant(name)) {
            if !rates.contains(rate) {
                rates.push(*rate);
            }
        }
        match (rates.is_empty(), model) {
            (true, Some(model)) => {
                let is_known = self == Self::Ydlidar && ydlidar_models::by_name(model).is_some();
                let unknown = || UnknownModel { family: self, model: model.to_owned() };
                if is_known { self.rates(None) } else { Err(unknown()) }
            }
            _ => Ok(rates),
        }
    }

    /// The TCP port where lidars of this family with an Ethernet line listen.
    pub fn tcp_port(self) -> Option<u16> {
        match self {
            Self::Urg => Some(10_940),
            Self::SickTim => Some(2112),
            Self::Ld06 | Self::Rplidar | Self::Ydlidar => None,
        }
    }

    /// A decoder. `rate` of the line in bits a second; `None` where bytes come in packets.
    pub fn driver(self, model: Option<&str>, rate: Option<u32>) -> Box<dyn Driver> {
        // A byte is ten bits on the line: it has a start and a stop.
        let byte_ns = rate.map_or(0, |rate| 10_000_000_000 / i64::from(rate.max(1)));
        match self {
            Self::Ld06 => Box::new(Ld06::new(model, byte_ns)),
            Self::Rplidar => Box::new(Rplidar::new(byte_ns)),
            Self::Ydlidar => Box::new(Ydlidar::new(model, byte_ns)),
            Self::Urg => Box::new(Urg::new(byte_ns)),
            Self::SickTim => Box::new(SickTim::new(byte_ns)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_report_their_rates_and_others_are_rejected() {
        assert_eq!(Family::Ld06.rates(None), Ok(vec![230_400, 115_200]));
        assert_eq!(Family::Ld06.rates(Some("lds02")), Ok(vec![115_200]));
        assert_eq!(Family::Rplidar.rates(Some("s2")), Ok(vec![1_000_000]));
        assert_eq!(Family::Rplidar.rates(None).unwrap().len(), 4);
        assert_eq!(Family::Ydlidar.rates(Some("G10")), Family::Ydlidar.rates(None));
        let refused = Family::Ld06.rates(Some("A1")).unwrap_err().to_string();
        assert_eq!(refused, "\"A1\" is no model of ld06; known are LD06, LD19, STL-19P, LDS-02");
    }

    #[test]
    fn each_family_has_a_decoder() {
        for family in Family::ALL {
            let mut driver = family.driver(None, Some(115_200));
            driver.take(&[0x55; 100], 0, &mut |_| panic!("no lidar says this"));
            assert_eq!(driver.counts().bytes, 100, "{}", family.name());
        }
    }
}
