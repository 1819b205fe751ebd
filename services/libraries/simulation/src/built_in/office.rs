//! The office: corridors, halls, rooms and furniture, given as lists of coordinates.

use crate::drawing::Drawing;
use crate::floor_plan::FloorPlan;

/// Size of the building, metres.
const SIZE_M: (f64, f64) = (30.0, 20.0);

/// Centre lines of the walls, x and y of both ends, metres; gaps between them are doors of 1.2 m.
const WALLS: [[f64; 4]; 31] = [
    [0.0, 0.0, 30.0, 0.0],
    [30.0, 0.0, 30.0, 20.0],
    [0.0, 20.0, 30.0, 20.0],
    [0.0, 0.0, 0.0, 20.0],
    // Four rooms in the south, the middle two with a door between them.
    [0.0, 6.0, 2.9, 6.0],
    [4.1, 6.0, 10.4, 6.0],
    [11.6, 6.0, 18.4, 6.0],
    [19.6, 6.0, 25.9, 6.0],
    [27.1, 6.0, 30.0, 6.0],
    [7.5, 0.0, 7.5, 6.0],
    [15.0, 0.0, 15.0, 1.4],
    [15.0, 2.6, 15.0, 6.0],
    [22.5, 0.0, 22.5, 6.0],
    // Three rooms in the north, the eastern two with a door between them.
    [0.0, 14.0, 4.4, 14.0],
    [5.6, 14.0, 14.4, 14.0],
    [15.6, 14.0, 24.4, 14.0],
    [25.6, 14.0, 30.0, 14.0],
    [10.0, 14.0, 10.0, 20.0],
    [20.0, 14.0, 20.0, 17.4],
    [20.0, 18.6, 20.0, 20.0],
    // The block in the middle: two rooms, a way through.
    [8.0, 8.0, 17.4, 8.0],
    [18.6, 8.0, 22.0, 8.0],
    [8.0, 12.0, 10.9, 12.0],
    [12.1, 12.0, 22.0, 12.0],
    [8.0, 8.0, 8.0, 12.0],
    [22.0, 8.0, 22.0, 12.0],
    [15.0, 8.0, 15.0, 9.4],
    [15.0, 10.6, 15.0, 12.0],
    // Wall stubs in the corridors.
    [13.0, 7.6, 13.0, 8.0],
    [16.0, 12.0, 16.0, 12.4],
    [20.5, 6.0, 20.5, 6.4],
];

/// Furniture: centre x and y, length, width in metres, turn in degrees.
const BOXES: [[f64; 5]; 21] = [
    [1.8, 1.4, 1.6, 0.8, 0.0],
    [0.35, 4.2, 0.5, 2.4, 0.0],
    [6.7, 5.0, 1.2, 0.5, 0.0],
    [9.8, 2.4, 1.6, 0.8, 12.0],
    [13.0, 4.2, 1.6, 0.8, -8.0],
    [18.0, 0.6, 3.0, 0.6, 0.0],
    [24.8, 2.2, 1.4, 1.4, 30.0],
    [29.6, 5.0, 0.5, 1.4, 0.0],
    [26.2, 10.2, 2.0, 1.8, 20.0],
    [29.5, 8.5, 0.5, 3.0, 0.0],
    [23.2, 9.0, 0.6, 1.2, 0.0],
    [5.0, 16.0, 5.5, 0.4, 0.0],
    [5.0, 18.2, 5.5, 0.4, 0.0],
    [15.2, 17.2, 3.6, 1.2, 5.0],
    [11.0, 19.5, 1.4, 0.6, 0.0],
    [22.4, 15.8, 0.8, 2.0, 0.0],
    [27.0, 19.0, 2.0, 0.8, 0.0],
    [28.3, 16.2, 1.2, 0.7, 40.0],
    [9.0, 8.9, 0.9, 0.6, 0.0],
    [21.3, 10.0, 0.8, 2.2, 0.0],
    [0.5, 13.0, 0.6, 1.4, 0.0],
];

/// Pillars and round tables: centre and radius, metres.
const ROUNDS: [[f64; 3]; 13] = [
    [2.5, 8.8, 0.25],
    [5.6, 8.8, 0.25],
    [2.5, 11.4, 0.25],
    [5.6, 11.4, 0.25],
    [28.2, 2.6, 0.6],
    [20.8, 3.4, 0.3],
    [13.6, 10.9, 0.2],
    [13.6, 16.2, 0.22],
    [14.8, 18.2, 0.22],
    [16.2, 16.4, 0.22],
    [16.6, 18.4, 0.22],
    [24.6, 16.8, 0.45],
    [28.4, 12.6, 0.3],
];

/// The tour: it enters every room, goes around the block both ways and comes back.
const TOUR: [[f64; 2]; 34] = [
    [4.0, 7.2],
    [3.5, 3.4],
    [3.5, 7.0],
    [11.0, 7.0],
    [11.2, 4.0],
    [14.0, 2.0],
    [17.5, 2.6],
    [19.0, 5.0],
    [19.0, 7.0],
    [18.0, 9.4],
    [14.0, 10.0],
    [11.5, 10.4],
    [11.5, 13.0],
    [15.0, 13.0],
    [15.0, 15.0],
    [18.6, 17.8],
    [21.6, 18.0],
    [25.0, 15.0],
    [25.0, 13.0],
    [28.6, 11.0],
    [24.2, 7.4],
    [26.5, 4.4],
    [26.5, 7.0],
    [19.0, 7.2],
    [9.0, 7.0],
    [4.0, 10.0],
    [5.0, 15.0],
    [1.2, 17.2],
    [8.8, 17.2],
    [5.0, 14.9],
    [5.0, 13.0],
    [15.0, 13.2],
    [23.4, 12.6],
    [23.6, 7.2],
];

/// Two corridors and two halls around a block, nine rooms, pillars and furniture.
pub(crate) fn office() -> FloorPlan {
    let mut drawing = Drawing::new(SIZE_M);
    WALLS.into_iter().for_each(|wall| drawing.wall(wall));
    BOXES.into_iter().for_each(|piece| drawing.rectangle(piece));
    ROUNDS.into_iter().for_each(|round| drawing.round(round));
    drawing.finish(&TOUR)
}
