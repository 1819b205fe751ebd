//! Who of several simulated robots is near whom: the outside program that reports contacts, for robots that have no radio.

use super::CommandError;
use flockslam_bus::RuntimeDir;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_results::FlockStatus;
use flockslam_simulation::{Settings, Simulation, World};
use flockslam_stage::heartbeat_file;
use flockslam_telemetry::read_heartbeat;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;

/// A contact is reported for so long, seconds: it is reported again before that is over.
const LASTING_S: f64 = 0.5;

/// Robots in one simulated world, and how far they can reach each other.
pub struct Contacts {
    robots: Vec<Simulated>,
    world: World,
    range_m: f64,
    socket: UnixDatagram,
}

/// One robot: its name in the flock, the directory of its set, and where it is by each of its scans.
struct Simulated {
    name: String,
    runtime: PathBuf,
    poses: Vec<Pose>,
}

impl Contacts {
    /// The contacts of robots that drive as these settings say, each given with its name and the name of its set.
    ///
    /// # Errors
    /// When a setting is out of its range, or there is no socket to be had.
    pub fn new(robots: &[(String, String, Settings)], range_m: f64) -> Result<Self, CommandError> {
        let world = robots.first().map_or_else(World::floor_plan, |(_, _, first)| World::built_in(first));
        let drive = |(name, set, settings): &(String, String, Settings)| {
            // The way does not depend on what the lidar sees.
            let blind = Settings { beams: 1, ..settings.clone() };
            let mut simulation = Simulation::new(&blind, world.clone()).map_err(CommandError::user)?;
            let (mut scan, mut poses) = (ScanBuffer::default(), Vec::new());
            while let Some(pose) = simulation.next_scan(&mut scan) {
                poses.push(pose);
            }
            Ok(Simulated { name: name.clone(), runtime: RuntimeDir::path_of(set), poses })
        };
        let robots = robots.iter().map(drive).collect::<Result<_, CommandError>>()?;
        let socket = UnixDatagram::unbound().map_err(CommandError::failed)?;
        // A robot that is busy learns of it the next time.
        socket.set_nonblocking(true).map_err(CommandError::failed)?;
        Ok(Self { robots, world, range_m, socket })
    }

    /// Reports to every robot which others are near it now. When all have ended their drives, they come together.
    pub fn report(&self) {
        let together = self.robots.iter().all(Simulated::has_ended);
        let places: Vec<Option<Pose>> = self.robots.iter().map(Simulated::place).collect();
        for (robot, place) in self.robots.iter().zip(&places) {
            let near = self.robots.iter().zip(&places).filter(|(other, at)| {
                let sees = || place.zip(**at).is_some_and(|(a, b)| self.are_near(a, b));
                other.name != robot.name && (together || sees())
            });
            let lines: String = near.map(|(other, _)| format!("near {} {LASTING_S}\n", other.name)).collect();
            if !lines.is_empty() {
                // A robot that has not started yet, or has gone, receives nothing.
                let _ = self.socket.send_to(lines.as_bytes(), robot.runtime.join("status/contacts"));
            }
        }
    }

    /// Within range, and nothing of the building in between.
    fn are_near(&self, a: Pose, b: Pose) -> bool {
        let apart_m = a.distance_m(b);
        if apart_m > self.range_m || apart_m <= f64::EPSILON {
            return apart_m <= f64::EPSILON;
        }
        let toward = Point::new((b.x_m - a.x_m) / apart_m, (b.y_m - a.y_m) / apart_m);
        self.world.cast(Point::new(a.x_m, a.y_m), toward, apart_m).is_none()
    }
}

impl Simulated {
    /// Whether it has come to the end of its drive.
    fn has_ended(&self) -> bool {
        FlockStatus::read(&self.runtime.join("status")).is_some_and(|status| status.has_ended)
    }

    /// Where the robot is now; `None` before its first scan.
    fn place(&self) -> Option<Pose> {
        let matcher = format!("{}-0", Stage::ScanMatcher.name());
        let beat = read_heartbeat(&heartbeat_file(&self.runtime.join("status"), &matcher)).ok()??;
        // After its last scan it stands where it was.
        let last = usize::try_from(beat.handled).ok()?.checked_sub(1)?;
        self.poses.get(last.min(self.poses.len().checked_sub(1)?)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_far_away_or_behind_a_wall_are_not_near() {
        let contacts = Contacts {
            robots: Vec::new(),
            world: World::floor_plan(),
            range_m: 8.0,
            socket: UnixDatagram::unbound().unwrap(),
        };
        let drive =
            Simulation::new(&Settings { beams: 1, ..Settings::default() }, World::floor_plan()).unwrap();
        let poses: Vec<Pose> = drive.map(|(_, pose)| pose).collect();
        let (first, next) = (poses[0], poses[5]);
        assert!(contacts.are_near(first, next) && contacts.are_near(next, first));
        assert!(contacts.are_near(first, first));
        let far = poses.iter().filter(|pose| pose.distance_m(first) > 8.0);
        assert!(far.clone().count() > 0 && far.clone().all(|pose| !contacts.are_near(first, *pose)));
        let hidden =
            poses.iter().filter(|pose| pose.distance_m(first) < 8.0 && !contacts.are_near(first, **pose));
        assert!(hidden.count() > 0, "walls hide some of what is within range");
    }
}
