//! What moves or changes in a simulated world: people, doors, pallets. All of it follows from the settings and their seed,
//! and goes on from one turn of the lidar to the next.

mod body;
mod door;
mod follower;
mod pallet;
mod traffic;
mod walker;

pub use body::MoverTruth;

use super::drive::Turn;
use super::free_space::FreeSpace;
use super::{BeamLabel, Settings, World};
use body::Body;
use door::Door;
use flockslam_geometry::{Point, Pose};
use flockslam_random::Random;
use follower::Follower;
use pallet::Pallet;
use std::sync::Arc;
use traffic::Passer;
use walker::Walker;

/// Everything that moves or changes.
#[derive(Clone, Debug)]
pub(super) struct Dynamics {
    room: Arc<FreeSpace>,
    walkers: Vec<Walker>,
    follower: Option<Follower>,
    doors: Vec<Door>,
    pallets: Vec<Pallet>,
    traffic: Vec<Passer>,
    /// Where everybody who walks is during the turn at hand: the walkers in their order, then the follower, then
    /// the traffic.
    bodies: Vec<Body>,
    turn_s: f64,
    now_s: f64,
}

impl Dynamics {
    /// The settings' people, doors and pallets in a world whose robot stands at `robot`. A turn of the lidar takes `turn_s`.
    pub(super) fn new(
        settings: &Settings,
        world: &World,
        room: Arc<FreeSpace>,
        robot: Pose,
        turn_s: f64,
    ) -> Self {
        let start = room.nearest(robot.position());
        let walker =
            |i| Walker::new(&room, robot.position(), Random::new(settings.seed, &format!("walker {i}")));
        let pallet = |i| Pallet::new(Random::new(settings.seed, &format!("pallet {i}")));
        Self {
            walkers: (0..settings.walkers).map(walker).collect(),
            follower: settings.follower.then(|| Follower::new(robot)),
            doors: door::hang(settings.doors, world, &room, start, settings.seed),
            pallets: (0..settings.pallets).map(pallet).collect(),
            traffic: traffic::on_paths(world.paths(), settings.seed),
            bodies: Vec::new(),
            room,
            turn_s,
            now_s: 0.0,
        }
    }

    /// Goes on by one turn of the lidar, during which the robot drives `turn`.
    pub(super) fn advance(&mut self, world: &World, turn: &Turn) {
        let robot = turn.start().position();
        self.bodies.clear();
        for walker in &mut self.walkers {
            self.bodies.push(walker.walk(world, &self.room, robot, self.turn_s));
        }
        self.bodies.extend(self.follower.as_mut().map(|follower| follower.follow(turn)));
        for passer in &mut self.traffic {
            self.bodies.extend(passer.pass(robot, self.turn_s));
        }
        for door in &mut self.doors {
            let passers = std::iter::once(robot).chain(self.bodies.iter().map(|body| body.start));
            door.decide(self.now_s, passers);
        }
        for pallet in &mut self.pallets {
            pallet.decide(self.now_s, &self.room, robot);
        }
        self.now_s += self.turn_s;
    }

    /// Distance to what a beam meets first that is not part of the world itself, metres, and what it is; the beam leaves
    /// `seconds` after the turn's start.
    pub(super) fn cast(&self, from: Point, direction: Point, seconds: f64) -> Option<(f64, BeamLabel)> {
        let share = seconds / self.turn_s;
        let moving = self.bodies.iter().filter_map(|body| body.cast(from, direction, share));
        let doors = self.doors.iter().filter_map(|door| door.cast(from, direction));
        let pallets = self.pallets.iter().filter_map(|pallet| pallet.cast(from, direction));
        let moving = moving.map(|distance_m| (distance_m, BeamLabel::MotionState));
        let changed = doors.chain(pallets).map(|distance_m| (distance_m, BeamLabel::Changed));
        moving.chain(changed).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Moving bodies and their motion at the turn's start.
    pub(super) fn movers(&self) -> impl Iterator<Item = MoverTruth> {
        let turn_s = self.turn_s;
        (0..).zip(&self.bodies).map(move |(id, body)| body.truth(id, turn_s))
    }
}

#[cfg(test)]
mod tests;
