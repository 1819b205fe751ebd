//! `flockslam down`, `status`, `restart`, `pause`, `resume`, `reset`, `relocalize`, `mode` and `scale`: orders to a running set.

use super::{CommandError, print};
use crate::arguments::{RobotArgs, ScaleArgs, StageOrderArgs, StatusArgs};
use crate::localisation_arguments::{ModeArgs, RelocalizeArgs, WantedMode};
use crate::supervisor::{Reply, Request, ask};
use flockslam_bus::RuntimeDir;
use std::time::{Duration, Instant};

/// A set ends within this time after the order to stop. It takes a second or two; a machine that others keep busy, and where no process
/// may come before them, takes longer.
const DOWN_LIMIT: Duration = Duration::from_secs(60);
/// A change of the mode is looked at so often.
const MODE_LOOK: Duration = Duration::from_millis(50);

/// Stops a set and waits for its end.
///
/// # Errors
/// When there is no such set, or it does not stop.
pub fn down(args: &RobotArgs) -> Result<(), CommandError> {
    let robot = choose(args)?;
    order(&robot, &Request::Down)?;
    let deadline = Instant::now() + DOWN_LIMIT;
    while RuntimeDir::running().contains(&robot) {
        if Instant::now() > deadline {
            return Err(CommandError::failed(format!("{robot} has not ended yet")));
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}

/// Prints how a set is.
///
/// # Errors
/// When there is no such set.
pub fn status(args: &StatusArgs) -> Result<(), CommandError> {
    let robot = choose(&args.robot)?;
    let Reply::Status(status) = order(&robot, &Request::Status)? else {
        return Err(CommandError::failed("the set answered something else"));
    };
    if args.json {
        let json = serde_json::to_string_pretty(&status).map_err(CommandError::failed)?;
        print(&format!("{json}\n"));
    } else {
        print(&status.to_string());
    }
    Ok(())
}

/// Replaces the processes of a stage.
///
/// # Errors
/// When there is no such set, or the stage does not run.
pub fn restart(args: &StageOrderArgs) -> Result<(), CommandError> {
    order(&choose(&args.robot)?, &Request::Restart(args.stage.name().to_owned())).map(drop)
}

/// Lets a set rest, or go on.
///
/// # Errors
/// When there is no such set.
pub fn pause(args: &RobotArgs, rests: bool) -> Result<(), CommandError> {
    order(&choose(args)?, &Request::Pause(rests)).map(drop)
}

/// Lets a set drop its map.
///
/// # Errors
/// When there is no such set, or it keeps its map on disk.
pub fn reset(args: &RobotArgs) -> Result<(), CommandError> {
    order(&choose(args)?, &Request::Reset).map(drop)
}

/// Lets a set look for its robot in the known map anew.
///
/// # Errors
/// When there is no such set, or it makes a map.
pub fn relocalize(args: &RelocalizeArgs) -> Result<(), CommandError> {
    // The heading is not known; what is within the radius is within three standard deviations.
    let hint = args.near.map(|[x_m, y_m, radius_m]| [x_m, y_m, 0.0, radius_m / 3.0, std::f64::consts::PI]);
    order(&choose(&args.robot)?, &Request::Relocalize(hint)).map(drop)
}

/// Lets a set localize in its map as it is, or map again, and waits until it does.
///
/// # Errors
/// When there is no such set, or its mode cannot be changed.
pub fn mode(args: &ModeArgs) -> Result<(), CommandError> {
    let robot = choose(&args.robot)?;
    order(&robot, &Request::Localize(args.mode == WantedMode::Localize))?;
    loop {
        let Reply::Status(status) = order(&robot, &Request::Status)? else {
            return Err(CommandError::failed("the set answered something else"));
        };
        if let Some(outcome) = status.mode.outcome() {
            return outcome.map_err(CommandError::failed);
        }
        std::thread::sleep(MODE_LOOK);
    }
}

/// Changes the number of processes of a stage.
///
/// # Errors
/// When there is no such set, or it cannot run so many.
pub fn scale(args: &ScaleArgs) -> Result<(), CommandError> {
    let (stage, replicas) = args.wanted;
    order(&choose(&args.robot)?, &Request::Scale(stage.name().to_owned(), replicas)).map(drop)
}

/// Asks a running set; what it refuses is an error.
///
/// # Errors
/// When it does not answer or refuses.
pub(super) fn order(robot: &str, request: &Request) -> Result<Reply, CommandError> {
    let socket = RuntimeDir::path_of(robot).join("control");
    match ask(&socket, request).map_err(CommandError::failed)? {
        Reply::Refused(reason) => Err(CommandError::user(reason)),
        reply => Ok(reply),
    }
}

/// The set that is meant: the one that was named, or the only one that runs.
pub(super) fn choose(args: &RobotArgs) -> Result<String, CommandError> {
    let running = RuntimeDir::running();
    match (&args.robot, running.as_slice()) {
        (Some(robot), running) if running.contains(robot) => Ok(robot.clone()),
        (Some(robot), _) => Err(CommandError::user(format!("no set named {robot} is running here"))),
        (None, [only]) => Ok(only.clone()),
        (None, []) => Err(CommandError::user("no set is running here")),
        (None, several) => {
            let names = several.join(", ");
            Err(CommandError::user(format!("several sets are running: name one with --robot ({names})")))
        }
    }
}
