//! All answers of a setup, and the description of a set that they make.

use flockslam_lidars::Family;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use toml::Value;

/// Longest name of a set.
const NAME_MAX: usize = 22;
/// A lidar sits nearer than this to the middle of its robot, metres.
const MOUNTED_WITHIN_M: f64 = 10.0;

/// What the set does with its map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SetupMode {
    /// It makes a map, and goes on with it at the next start.
    Map,
    /// It finds the robot in a map that is known.
    Localize,
}

/// Where a lidar sits on its robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// Ahead of the middle of the robot, metres.
    pub x_m: f64,
    /// To the left of it, metres.
    pub y_m: f64,
    /// Where its zero points, degrees counter-clockwise from ahead.
    pub heading_deg: f64,
}

impl FromStr for Mounting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || "write it as X_M,Y_M,HEADING_DEG, for example 0.1,0,180".to_owned();
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
        let [x_m, y_m, heading_deg] = numbers.map_err(|_| form())?.try_into().map_err(|_| form())?;
        if ![x_m, y_m].iter().all(|at: &f64| at.abs() <= MOUNTED_WITHIN_M) {
            return Err(format!("a lidar sits within {MOUNTED_WITHIN_M} m of the middle of its robot"));
        }
        if !(-360.0..=360.0).contains(&heading_deg) {
            return Err("a heading is between -360 and 360 degrees".to_owned());
        }
        Ok(Self { x_m, y_m, heading_deg })
    }
}

/// The lidar, as it was found or named.
#[derive(Clone, Debug, PartialEq)]
pub struct AnsweredLidar {
    /// Its family.
    pub family: Family,
    /// Its serial port …
    pub port: Option<PathBuf>,
    /// … or its host.
    pub address: Option<String>,
    /// The rate of its line, bits a second.
    pub baud: Option<u32>,
    /// Its model, where it has to be named.
    pub model: Option<String>,
}

/// All answers.
#[derive(Clone, Debug, PartialEq)]
pub struct SetAnswers {
    /// Name of the set.
    pub robot: String,
    /// Its lidar.
    pub lidar: AnsweredLidar,
    /// Where that sits.
    pub mounting: Mounting,
    /// It hangs upside down.
    pub upside_down: bool,
    /// What it does with its map.
    pub mode: SetupMode,
    /// The map.
    pub map: PathBuf,
    /// It is a node of a ROS 2 graph.
    pub ros: bool,
    /// Further settings, as for `--set`.
    pub assignments: Vec<String>,
}

impl SetAnswers {
    /// The text of the description.
    pub fn text(&self) -> String {
        let mut text = String::from("# Written by `flockslam setup`; docs/configuration.md has all keys.\n");
        let mut line = |key: &str, value: Value| {
            writeln!(text, "{key} = {value}").expect("a string takes any text");
        };
        let of_path = |path: &Path| Value::String(path.display().to_string());
        line("robot", Value::String(self.robot.clone()));
        let key = if self.mode == SetupMode::Map { "map" } else { "localize" };
        line(key, of_path(&self.map));
        let Mounting { x_m, y_m, heading_deg } = self.mounting;
        let upside_down = if self.upside_down { ", upside_down = true" } else { "" };
        let mounting = format!(
            "lidar_ingest.lidars=[{{ x_m = {x_m:?}, y_m = {y_m:?}, heading_deg = {heading_deg:?}{upside_down} }}]"
        );
        let assignments = std::iter::once(&mounting).chain(&self.assignments).cloned().map(Value::String);
        line("set", Value::Array(assignments.collect()));
        text.push_str("\n[source]\n");
        let mut line = |key: &str, value: Value| {
            writeln!(text, "{key} = {value}").expect("a string takes any text");
        };
        line("kind", Value::String(self.lidar.family.name().to_owned()));
        self.lidar.port.iter().for_each(|port| line("port", of_path(port)));
        self.lidar.address.iter().for_each(|address| line("address", Value::String(address.clone())));
        self.lidar.baud.iter().for_each(|baud| line("baud", Value::Integer(i64::from(*baud))));
        self.lidar.model.iter().for_each(|model| line("model", Value::String(model.clone())));
        if self.ros {
            text.push_str("\n[ros]\nargs = []\n");
        }
        text
    }
}

/// A name that a set may have.
///
/// # Errors
/// Why it may not.
pub fn set_name(text: &str) -> Result<String, String> {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-';
    if text.is_empty() || text.len() > NAME_MAX || !text.chars().all(fits) {
        return Err(format!("a name has letters, digits and '-', at most {NAME_MAX}"));
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervisor::{SetDescription, SourceDescription};

    fn answers() -> SetAnswers {
        SetAnswers {
            robot: "r1".to_owned(),
            lidar: AnsweredLidar {
                family: Family::Ld06,
                port: Some(PathBuf::from("/dev/serial/by-id/a \"b\"")),
                address: None,
                baud: Some(230_400),
                model: None,
            },
            mounting: Mounting { x_m: 0.1, y_m: -0.05, heading_deg: 180.0 },
            upside_down: true,
            mode: SetupMode::Map,
            map: PathBuf::from("/var/lib/flockslam-r1"),
            ros: true,
            assignments: vec!["page.enabled=false".to_owned()],
        }
    }

    fn read(answers: &SetAnswers) -> SetDescription {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("set.toml");
        std::fs::write(&path, answers.text()).unwrap();
        SetDescription::read(&path).unwrap()
    }

    #[test]
    fn the_text_is_a_description_with_all_answers_in_it() {
        let set = read(&answers());
        assert_eq!(set.map, Some(PathBuf::from("/var/lib/flockslam-r1")));
        assert!(set.ros.is_some() && set.localize.is_none());
        let SourceDescription::Ld06(line) = &set.source else { panic!("{:?}", set.source) };
        assert_eq!((line.port.clone(), line.baud), (answers().lidar.port, Some(230_400)));
        let lidars = set.configuration(&[]).unwrap().lidar_ingest.lidars;
        let [lidar] = lidars.as_slice() else { panic!("{lidars:?}") };
        assert_eq!((lidar.x_m, lidar.y_m, lidar.heading_deg), (0.1, -0.05, 180.0));
        assert!(lidar.upside_down && !set.configuration(&[]).unwrap().page.enabled);
        let known = SetAnswers { mode: SetupMode::Localize, ros: false, ..answers() };
        let set = read(&known);
        assert!(set.map.is_none() && set.ros.is_none() && set.localize == Some(known.map));
    }

    #[test]
    fn mountings_and_names_that_cannot_be_meant_are_refused() {
        assert_eq!("0.1, 0,-90".parse(), Ok(Mounting { x_m: 0.1, y_m: 0.0, heading_deg: -90.0 }));
        for wrong in ["", "1,2", "1,2,3,4", "a,0,0", "11,0,0", "0,NaN,0", "0,0,400", "0,0,inf"] {
            assert!(wrong.parse::<Mounting>().is_err(), "{wrong}");
        }
        assert!(set_name("r-1").is_ok());
        for wrong in ["", "r 1", "r/1", "a-name-that-is-far-too-long"] {
            assert!(set_name(wrong).is_err(), "{wrong}");
        }
    }
}
