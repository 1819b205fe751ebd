//! The yard: buildings, trees and a car park, with little to see between them.

use crate::drawing::Drawing;
use crate::floor_plan::FloorPlan;
use flockslam_random::Random;

const SIZE_M: (f64, f64) = (130.0, 80.0);

/// Two buildings, a shed, a hedge: centre x and y, length, width in metres, turn in degrees.
const BUILDINGS: [[f64; 5]; 4] = [
    [35.0, 9.0, 50.0, 10.0, 0.0],
    [40.0, 66.0, 14.0, 10.0, 0.0],
    [112.0, 24.0, 4.0, 3.0, 25.0],
    [8.0, 40.0, 0.9, 14.0, 0.0],
];
/// Pilasters of the great building, from west to east, metres.
const PILASTERS: (f64, f64, usize) = (12.5, 5.0, 10);
/// Trunks of trees and lamp posts: centre and radius, metres.
const TRUNKS: [[f64; 3]; 19] = [
    [14.5, 19.5, 0.1],
    [33.0, 19.6, 0.1],
    [52.0, 19.4, 0.1],
    [66.0, 14.5, 0.2],
    [79.0, 20.5, 0.15],
    [101.0, 16.5, 0.2],
    [104.5, 27.0, 0.1],
    [121.0, 33.0, 0.18],
    [117.0, 38.5, 0.1],
    [81.5, 52.5, 0.1],
    [80.0, 64.0, 0.22],
    [70.5, 50.5, 0.16],
    [58.0, 57.5, 0.2],
    [52.5, 52.0, 0.1],
    [33.5, 52.0, 0.25],
    [23.0, 55.0, 0.15],
    [14.5, 47.5, 0.2],
    [15.0, 33.0, 0.1],
    [11.0, 25.0, 0.18],
];
/// Rows of parking spaces: y of the row, metres; every car is about 4.4 × 1.8 m.
const PARKING_ROWS_M: [f64; 3] = [46.5, 57.5, 69.0];
const PARKING: (f64, f64, usize) = (87.0, 2.6, 14);
const PARKED_SHARE: f64 = 0.7;

/// The tour: along the great building, over the open to the car park, around in it, past the small building and back.
const TOUR: [[f64; 2]; 16] = [
    [12.0, 17.0],
    [35.0, 17.5],
    [60.0, 17.5],
    [80.0, 17.5],
    [100.0, 20.0],
    [117.0, 31.0],
    [124.5, 42.0],
    [124.5, 52.0],
    [86.0, 52.0],
    [84.0, 63.0],
    [122.0, 63.2],
    [125.0, 52.0],
    [85.0, 52.0],
    [60.0, 53.5],
    [30.0, 56.5],
    [12.5, 45.0],
];

/// A campus: from the building to the car park the lidar sees nothing or one tree for tens of metres.
pub(crate) fn yard() -> FloorPlan {
    let (mut drawing, mut random) = (Drawing::new(SIZE_M), Random::new(1, "yard"));
    BUILDINGS.into_iter().for_each(|building| drawing.rectangle(building));
    TRUNKS.into_iter().for_each(|trunk| drawing.round(trunk));
    let (first_m, every_m, count) = PILASTERS;
    for i in 0..count {
        drawing.rectangle([first_m + i as f64 * every_m, 14.1, 0.4, 0.3, 0.0]);
    }
    PARKING_ROWS_M.into_iter().for_each(|row_m| park(&mut drawing, row_m, &mut random));
    drawing.finish(&TOUR)
}

/// Cars side by side, not all places taken, none exactly parked.
fn park(drawing: &mut Drawing, row_m: f64, random: &mut Random) {
    let (first_m, every_m, count) = PARKING;
    for place in 0..count {
        if random.happens(PARKED_SHARE) {
            let x_m = first_m + place as f64 * every_m + random.between(-0.2, 0.2);
            let y_m = row_m + random.between(-0.4, 0.4);
            let (width_m, length_m) = (random.between(1.7, 1.9), random.between(3.8, 4.8));
            drawing.rectangle([x_m, y_m, width_m, length_m, random.between(-3.0, 3.0)]);
        }
    }
}
