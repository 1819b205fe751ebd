//! The warehouse: parallel aisles between identical racks.

use crate::drawing::{Drawing, WALL_M};
use crate::floor_plan::FloorPlan;
use flockslam_random::Random;

/// Double racks, and from one to the next, metres.
const RACKS: usize = 8;
const PITCH_M: f64 = 4.8;
/// Width of the aisles between them, metres.
const AISLE_M: f64 = 2.6;
const DEPTH_M: f64 = PITCH_M - AISLE_M;
/// Bays of a rack, and the length of one, metres.
const BAYS: usize = 12;
const BAY_M: f64 = 2.7;
/// Where the racks begin in the west, and how wide the hall is beyond their ends, metres.
const WEST_M: f64 = 4.5;
const EAST_M: f64 = WEST_M + BAY_M * BAYS as f64;
const SIZE_M: (f64, f64) = (EAST_M + WEST_M, RACKS as f64 * PITCH_M + AISLE_M);
/// Places for pallets in a bay, and the share of them that are taken.
const PALLETS: usize = 3;
const TAKEN_SHARE: f64 = 0.88;
/// Width and depth of a loaded pallet, metres, and how exactly it is put down, metres and degrees.
const PALLET_M: (f64, f64) = (0.8, 1.0);
const PUT_DOWN: (f64, f64) = (0.03, 1.0);
/// Side of an upright, metres.
const UPRIGHT_M: f64 = 0.1;

/// A hall with nine parallel aisles between eight identical double racks, full of pallets.
pub(crate) fn warehouse() -> FloorPlan {
    let (mut drawing, mut random) = (Drawing::new(SIZE_M), Random::new(1, "warehouse"));
    drawing.outer_walls();
    for rack in 0..RACKS {
        let south_m = AISLE_M + rack as f64 * PITCH_M;
        uprights(&mut drawing, south_m);
        for (face_m, inward) in [(south_m, 1.0), (south_m + DEPTH_M, -1.0)] {
            pallets(&mut drawing, face_m, inward, &mut random);
        }
        // A roller door in the west for every second rack, pilasters in the east.
        if rack % 2 == 0 {
            drawing.rectangle([WALL_M, south_m + 0.5 * DEPTH_M, 0.2, 3.2, 0.0]);
        }
        drawing.rectangle([SIZE_M.0 - 0.25, south_m + 0.5 * DEPTH_M, 0.3, 0.4, 0.0]);
    }
    // What stands about: chargers, a packing table, bins.
    for thing in [[1.0, 0.9, 1.4, 0.9, 0.0], [1.1, 22.0, 0.8, 1.8, 0.0], [40.3, 14.2, 0.9, 1.3, 8.0]] {
        drawing.rectangle(thing);
    }
    drawing.round([40.6, 33.0, 0.3]);
    drawing.finish(&tour())
}

/// Up and down all aisles in turn, then every third one until all are done again.
fn tour() -> Vec<[f64; 2]> {
    let aisles = (0..=RACKS).chain((0..3).flat_map(|first| (first..=RACKS).step_by(3)));
    let (west_m, east_m) = (0.5 * WEST_M, EAST_M + 0.5 * WEST_M);
    let ends = |(i, aisle): (usize, usize)| {
        let y_m = aisle as f64 * PITCH_M + 0.5 * AISLE_M;
        let (from_m, to_m) = if i % 2 == 0 { (west_m, east_m) } else { (east_m, west_m) };
        [[from_m, y_m], [to_m, y_m]]
    };
    aisles.enumerate().flat_map(ends).collect()
}

/// Four rows of uprights carry a double rack.
fn uprights(drawing: &mut Drawing, south_m: f64) {
    let half_m = 0.5 * UPRIGHT_M;
    let middle_m = 0.5 * DEPTH_M;
    for bay in 0..=BAYS {
        let x_m = WEST_M + bay as f64 * BAY_M;
        for depth_m in [half_m, middle_m - UPRIGHT_M, middle_m + UPRIGHT_M, DEPTH_M - half_m] {
            drawing.rectangle([x_m, south_m + depth_m, UPRIGHT_M, UPRIGHT_M, 0.0]);
        }
    }
}

/// The pallets behind one face of a rack.
fn pallets(drawing: &mut Drawing, face_m: f64, inward: f64, random: &mut Random) {
    let place_m = (BAY_M - UPRIGHT_M) / PALLETS as f64;
    for bay in 0..BAYS {
        for place in 0..PALLETS {
            if !random.happens(TAKEN_SHARE) {
                continue;
            }
            let (exact_m, exact_deg) = PUT_DOWN;
            let x_m = WEST_M + bay as f64 * BAY_M + 0.5 * UPRIGHT_M + (place as f64 + 0.5) * place_m;
            let x_m = x_m + random.between(-exact_m, exact_m);
            let y_m = face_m + inward * (0.5 * PALLET_M.1 + 0.02 + random.between(0.0, 2.0 * exact_m));
            drawing.rectangle([x_m, y_m, PALLET_M.0, PALLET_M.1, random.between(-exact_deg, exact_deg)]);
        }
    }
}
