//! The arguments by which a set is asked to look for its robot in a known map.

use crate::arguments::RobotArgs;
use clap::{Args, ValueEnum};

/// `flockslam relocalize`.
#[derive(Clone, Debug, Args)]
pub struct RelocalizeArgs {
    /// Where to look: x and y in the map and a radius, metres; everywhere without it
    #[arg(long, value_name = "X,Y,R", value_parser = near, allow_hyphen_values = true)]
    pub near: Option<[f64; 3]>,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Three numbers, the last above zero.
fn near(text: &str) -> Result<[f64; 3], String> {
    let wrong = || format!("'{text}' is not X,Y,R: two coordinates and a radius in metres");
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.map_err(|_| wrong())?.as_slice() {
        &[x, y, r] if x.is_finite() && y.is_finite() && r > 0.0 && r.is_finite() => Ok([x, y, r]),
        _ => Err(wrong()),
    }
}

/// `flockslam mode`.
#[derive(Clone, Debug, Args)]
pub struct ModeArgs {
    /// What the set shall do: the map is not edited any more, or is made further
    #[arg(value_enum)]
    pub mode: WantedMode,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// What a set does with its map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WantedMode {
    /// It localizes in its map as it is now.
    Localize,
    /// It makes a map, or goes on with the one that it localizes in.
    Map,
}
