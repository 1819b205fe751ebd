//! A simulated person who follows the robot.

use super::body::{Body, RADIUS_M, squeezed};
use crate::drive::Turn;
use flockslam_geometry::{Point, Pose};
use std::collections::VecDeque;

/// So far behind the robot, along its way, metres.
const BEHIND_M: f64 = 1.2;
/// Where the robot jumps farther than this in one turn it was kidnapped, metres, and is followed from its new pose.
const CARRIED_M: f64 = 1.0;

/// A person who walks behind the robot on its path: an operator.
#[derive(Clone, Debug)]
pub(super) struct Follower {
    /// The robot's way, the oldest point first; the follower goes to the first.
    trail: VecDeque<Point>,
    position: Point,
}

impl Follower {
    /// Stands behind the robot.
    pub(super) fn new(robot: Pose) -> Self {
        let trail = trail_behind(robot);
        Self { position: trail[0], trail }
    }

    /// Follows the robot on its turn.
    pub(super) fn follow(&mut self, turn: &Turn) -> Body {
        if self.trail.back().is_some_and(|last| last.distance_m(turn.start().position()) > CARRIED_M) {
            *self = Self::new(turn.start());
        }
        self.trail.push_back(turn.end().position());
        self.shorten();
        let start = self.position;
        // The robot may come back the way it went.
        self.position = squeezed(self.trail[0], turn.end().position());
        Body { start, end: self.position, radius_m: RADIUS_M }
    }

    /// Lets the trail begin so far behind its end.
    fn shorten(&mut self) {
        let lengths = self.trail.iter().zip(self.trail.iter().skip(1)).map(|(a, b)| a.distance_m(*b));
        let mut excess_m = lengths.sum::<f64>() - BEHIND_M;
        while excess_m > 0.0 {
            let (first, second) = (self.trail[0], self.trail[1]);
            let piece_m = first.distance_m(second);
            if piece_m <= excess_m {
                self.trail.pop_front();
                excess_m -= piece_m;
            } else {
                let share = excess_m / piece_m;
                self.trail[0] = Point::new(
                    first.x_m + share * (second.x_m - first.x_m),
                    first.y_m + share * (second.y_m - first.y_m),
                );
                break;
            }
        }
    }
}

fn trail_behind(robot: Pose) -> VecDeque<Point> {
    VecDeque::from([robot.apply(Point::new(-BEHIND_M, 0.0)), robot.position()])
}
