//! The hotel: parallel corridors with identical rooms at regular spacing.

use crate::drawing::{Drawing, WALL_M};
use crate::floor_plan::FloorPlan;
use flockslam_geometry::elementary::{atan2, sin_cos};
use flockslam_random::Random;

/// Corridors from west to east.
const CORRIDORS: usize = 4;
/// Depth of a room, and width of a corridor, between the centre lines of their walls, metres.
const ROOM_DEPTH_M: f64 = 5.0;
const CORRIDOR_M: f64 = 2.2;
/// From corridor to corridor, metres.
const PITCH_M: f64 = 2.0 * ROOM_DEPTH_M + CORRIDOR_M;
/// Width of the three passages from south to north, and of a room, metres.
const PASSAGE_M: f64 = 2.4;
const ROOM_M: f64 = 4.0;
/// Rooms in a row between two passages.
const ROOMS: usize = 7;
const WING_M: f64 = ROOM_M * ROOMS as f64;
/// Western sides of the passages, and of the wings between them, metres.
const PASSAGES_M: [f64; 3] = [0.0, PASSAGE_M + WING_M, 2.0 * (PASSAGE_M + WING_M)];
const SIZE_M: (f64, f64) = (PASSAGES_M[2] + PASSAGE_M, CORRIDORS as f64 * PITCH_M);
/// Width of a door, and its distance from the nearer wall of the room, metres.
const DOOR_M: f64 = 0.95;
const DOOR_OFF_M: f64 = 0.5;
/// Shares of doors that are shut and that are ajar; the others stand open.
const SHUT_SHARE: f64 = 0.65;
const AJAR_SHARE: f64 = 0.2;
const LEAF_M: f64 = 0.05;

/// Four parallel corridors, three passages across, and 112 identical rooms at regular spacing. Only small things differ:
/// doors that are ajar, pictures, a table or an extinguisher here and there.
pub(crate) fn hotel() -> FloorPlan {
    let mut hotel = Hotel { drawing: Drawing::new(SIZE_M), random: Random::new(1, "hotel") };
    hotel.drawing.outer_walls();
    for corridor in 0..CORRIDORS {
        if corridor > 0 {
            let back_m = corridor as f64 * PITCH_M;
            wings().for_each(|(west, east)| hotel.drawing.wall([west, back_m, east, back_m]));
        }
        let south_m = corridor as f64 * PITCH_M + ROOM_DEPTH_M;
        for (west_m, _) in wings() {
            hotel.row(west_m, south_m, -1.0);
            hotel.row(west_m, south_m + CORRIDOR_M, 1.0);
        }
        hotel.passage_walls(south_m);
    }
    hotel.drawing.finish(&tour())
}

/// Western and eastern ends of the two wings.
fn wings() -> impl Iterator<Item = (f64, f64)> {
    PASSAGES_M[..2].iter().map(|west_m| (west_m + PASSAGE_M, west_m + PASSAGE_M + WING_M))
}

/// Along every corridor and passage, most of them in both directions.
fn tour() -> Vec<[f64; 2]> {
    let crossings = [
        (0, 0),
        (2, 0),
        (2, 1),
        (0, 1),
        (0, 2),
        (2, 2),
        (2, 3),
        (0, 3),
        (0, 0),
        (1, 0),
        (1, 3),
        (2, 3),
        (2, 0),
    ];
    let at = |(passage, corridor): (usize, usize)| {
        let y_m = corridor as f64 * PITCH_M + ROOM_DEPTH_M + CORRIDOR_M / 2.0;
        [PASSAGES_M[passage] + PASSAGE_M / 2.0, y_m]
    };
    crossings.map(at).to_vec()
}

struct Hotel {
    drawing: Drawing,
    random: Random,
}

impl Hotel {
    /// Rooms of a wing on one side of a corridor: their doors are in the wall at `y_m`, they lie to its north
    /// (`side` = 1) or south (-1).
    fn row(&mut self, west_m: f64, y_m: f64, side: f64) {
        for room in 0..=ROOMS {
            let x_m = west_m + room as f64 * ROOM_M;
            self.drawing.wall([x_m, y_m, x_m, y_m + side * ROOM_DEPTH_M]);
        }
        for room in 0..ROOMS {
            self.room(west_m + room as f64 * ROOM_M, y_m, side, room % 2 == 1);
        }
    }

    /// One room; neighbours are mirror images.
    fn room(&mut self, west_m: f64, y_m: f64, side: f64, mirrored: bool) {
        // From the wall that is nearer to the door.
        let x = |off_m: f64| if mirrored { west_m + ROOM_M - off_m } else { west_m + off_m };
        let hand = if mirrored { -1.0 } else { 1.0 };
        let (door, rest) = (DOOR_OFF_M, DOOR_OFF_M + DOOR_M);
        self.drawing.wall([x(0.0), y_m, x(door - WALL_M / 2.0), y_m]);
        self.drawing.wall([x(rest + WALL_M / 2.0), y_m, x(ROOM_M), y_m]);
        self.door(x(rest), y_m + side * (WALL_M - LEAF_M) / 2.0, hand, side);
        // Bathroom, bed and desk.
        self.drawing.rectangle([x(3.0), y_m + side * 1.05, 1.8, 1.9, 0.0]);
        let shift_m = self.random.between(-0.1, 0.1);
        self.drawing.rectangle([x(2.8) + shift_m, y_m + side * 3.6, 2.0, 1.5, 0.0]);
        self.drawing.rectangle([x(0.5), y_m + side * (3.6 + shift_m), 0.6, 1.3, 0.0]);
        self.wall_things(x(2.7), y_m - side * WALL_M / 2.0, side);
    }

    /// A door leaf, hinged at (x, y) away from the room's corner; it opens into the room.
    fn door(&mut self, x_m: f64, y_m: f64, hand: f64, side: f64) {
        let drawn = self.random.share();
        let opened_deg = match drawn {
            _ if drawn < SHUT_SHARE => 0.0,
            _ if drawn < SHUT_SHARE + AJAR_SHARE => self.random.between(10.0, 40.0),
            _ => self.random.between(75.0, 95.0),
        };
        // Shut it is from the hinge towards the corner.
        let (sin, cos) = sin_cos(f64::to_radians(opened_deg));
        let (dx, dy) = (-hand * cos, side * sin);
        let half_m = 0.5 * (DOOR_M - 0.02);
        let turn_deg = atan2(dy, dx).to_degrees();
        self.drawing.rectangle([x_m + half_m * dx, y_m + half_m * dy, 2.0 * half_m, LEAF_M, turn_deg]);
    }

    /// What hangs on or stands at a corridor's wall between two doors; the corridor is opposite of `side`.
    fn wall_things(&mut self, x_m: f64, face_m: f64, side: f64) {
        let x_m = x_m + self.random.between(-0.4, 0.4);
        let drawn = self.random.share();
        let (width_m, depth_m) = match drawn {
            _ if drawn < 0.35 => (self.random.between(0.4, 1.2), self.random.between(0.03, 0.06)),
            _ if drawn < 0.42 => (0.2, 0.18),
            _ if drawn < 0.48 => (self.random.between(0.6, 0.9), 0.3),
            _ => return,
        };
        self.drawing.rectangle([x_m, face_m - side * depth_m / 2.0, width_m, depth_m, 0.0]);
    }

    /// Pictures and radiators along the passages, beside the rooms south and north of a corridor.
    fn passage_walls(&mut self, south_m: f64) {
        for (wing, (west_m, east_m)) in wings().enumerate() {
            for y_m in [south_m - 0.5 * ROOM_DEPTH_M, south_m + CORRIDOR_M + 0.5 * ROOM_DEPTH_M] {
                for (face_m, side) in [(west_m, -1.0), (east_m, 1.0)] {
                    if self.random.happens(0.5) {
                        continue;
                    }
                    let (length_m, depth_m) = (self.random.between(0.5, 1.4), 0.05 + 0.05 * wing as f64);
                    let x_m = face_m + side * (WALL_M + depth_m) / 2.0;
                    let y_m = y_m + self.random.between(-1.0, 1.0);
                    self.drawing.rectangle([x_m, y_m, depth_m, length_m, 0.0]);
                }
            }
        }
    }
}
