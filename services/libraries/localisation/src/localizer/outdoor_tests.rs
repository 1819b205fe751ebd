//! A park with a few walls and trees, and ground that gives other returns each time.

use super::*;
use crate::KnownMap;
use flockslam_evidence::CellState;
use flockslam_geometry::Point;

const CELL_M: f64 = 0.1;
const SIDE: usize = 700;
/// Rectangles, metres: left, lower, width, height. The first four are walls, the others trees.
const STANDING: [[f64; 4]; 10] = [
    [8.0, 60.0, 17.0, 0.4],
    [55.0, 12.0, 0.4, 21.0],
    [12.0, 9.0, 26.0, 0.4],
    [45.0, 58.0, 9.0, 0.4],
    [24.0, 30.0, 0.4, 0.4],
    [31.0, 44.0, 0.4, 0.4],
    [42.0, 28.0, 0.4, 0.4],
    [18.0, 47.0, 0.4, 0.4],
    [36.0, 19.0, 0.4, 0.4],
    [47.0, 41.0, 0.4, 0.4],
];

/// Numbers between 0 and 1 from a linear congruential generator (Knuth 1997, 3.2.1).
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1 << 24)
    }
}

/// The park, with a single cell for each square metre and more where the ground was met once.
fn park(returns: usize) -> KnownMap {
    let mut states = vec![CellState::Free; SIDE * SIDE];
    let mut numbers = Numbers(7);
    for _ in 0..returns {
        let cell = (numbers.next() * (SIDE * SIDE) as f64) as usize;
        states[cell] = CellState::Occupied;
    }
    for [left, low, width, height] in STANDING.map(|sizes| sizes.map(|metres| metres / CELL_M)) {
        for y in low as usize..(low + height) as usize {
            (left as usize..(left + width) as usize).for_each(|x| states[y * SIDE + x] = CellState::Occupied);
        }
    }
    let mut map = KnownMap::of_width(SIDE, CELL_M, Point::default());
    states.chunks(SIDE).for_each(|row| map.push_row(row.iter().copied()));
    map.measured()
}

/// What a lidar of 360 beams sees there up to 30 m; half of the beams that go far meet the ground on their way.
fn seen(world: &KnownMap, at: Placement, numbers: &mut Numbers) -> Vec<PackedPoint> {
    let beam = |degree: i32| {
        let (sin, cos) = f64::from(degree).to_radians().sin_cos();
        let (meets_ground, ground_m) = (numbers.next() < 0.5, 4.0 + 26.0 * numbers.next());
        let stands = |range_m: &f64| {
            let (x_m, y_m) = at.apply(range_m * cos, range_m * sin);
            world.at(x_m, y_m).state == CellState::Occupied
        };
        let firm_m = (0..600).map(|step| f64::from(step) * 0.05).find(stands).unwrap_or(f64::INFINITY);
        let range_m = if meets_ground { firm_m.min(ground_m) } else { firm_m };
        if range_m.is_finite() { PackedPoint::from_metres(range_m * cos, range_m * sin) } else { None }
    };
    (0..360).filter_map(beam).collect()
}

#[test]
fn a_robot_in_a_park_is_found_by_what_stands_there_and_followed() {
    let world = park(0);
    let mut localizer = Localizer::new(Surroundings::new(park(6000)));
    let odom_from_map = Placement::new(-31.0, 12.0, 2.3);
    let mut numbers = Numbers(3);
    let mut found_after_m = None;
    for step in 0..100 {
        let travel_m = 0.3 * f64::from(step);
        let at = Placement::new(20.0 + 0.8 * travel_m, 35.0 - 0.6 * travel_m, -0.6435);
        let belief = localizer.see(odom_from_map.compose(at), &seen(&world, at, &mut numbers));
        if belief.knowledge == Knowledge::Localized {
            let off_m = belief.hypotheses[0].map_from_base.distance_m(&at);
            assert!(off_m < 0.3, "{off_m:.2} m off after {travel_m:.1} m");
            found_after_m.get_or_insert(travel_m);
        }
        assert!(
            found_after_m.is_none() || belief.knowledge == Knowledge::Localized,
            "lost at {travel_m:.1} m"
        );
    }
    let found_after_m = found_after_m.expect("it is found");
    println!("found after {found_after_m:.1} m, {} searches", localizer.searches());
    assert!(found_after_m < 12.2, "found after {found_after_m:.1} m");
}

#[test]
fn a_robot_in_another_park_is_not_found() {
    // The same trees with other walls, turned by a right angle.
    let mut states = vec![CellState::Free; SIDE * SIDE];
    for [left, low, width, height] in STANDING.map(|sizes| sizes.map(|metres| metres / CELL_M)) {
        for y in low as usize..(low + height) as usize {
            for x in left as usize..(left + width) as usize {
                states[(SIDE - 1 - y / 2) * SIDE + x * 2 / 3 + 90] = CellState::Occupied;
            }
        }
    }
    let mut other = KnownMap::of_width(SIDE, CELL_M, Point::default());
    states.chunks(SIDE).for_each(|row| other.push_row(row.iter().copied()));
    let other = other.measured();
    let mut localizer = Localizer::new(Surroundings::new(park(6000)));
    let mut numbers = Numbers(11);
    for step in 0..60 {
        let travel_m = 0.3 * f64::from(step);
        let at = Placement::new(28.0 + travel_m, 52.0 - 0.4 * travel_m, -0.38);
        let belief = localizer.see(at, &seen(&other, at, &mut numbers));
        assert_ne!(belief.knowledge, Knowledge::Localized, "after {travel_m:.1} m: {belief:?}");
    }
}

/// The front end does not notice that it is carried: what it sees elsewhere has to contradict the map.
#[test]
fn a_robot_that_is_carried_through_a_park_is_lost_within_a_few_metres() {
    let world = park(0);
    let mut localizer = Localizer::new(Surroundings::new(park(6000)));
    let mut numbers = Numbers(3);
    let along = |travel_m: f64| Placement::new(20.0 + 0.8 * travel_m, 35.0 - 0.6 * travel_m, -0.6435);
    let elsewhere = |travel_m: f64| Placement::new(52.0 - 0.8 * travel_m, 53.0 - 0.6 * travel_m, -2.498);
    for step in 0..60 {
        let at = along(0.3 * f64::from(step));
        localizer.see(at, &seen(&world, at, &mut numbers));
    }
    assert_eq!(localizer.belief().knowledge, Knowledge::Localized);
    let odom_from_elsewhere = along(18.0).compose(elsewhere(0.0).inverse());
    let lost_after_m = (0..60).map(|step| 0.3 * f64::from(step)).find(|travel_m| {
        let at = elsewhere(*travel_m);
        localizer.see(odom_from_elsewhere.compose(at), &seen(&world, at, &mut numbers));
        localizer.belief().knowledge != Knowledge::Localized
    });
    println!("lost after {lost_after_m:.1?} m");
    assert!(lost_after_m.is_some_and(|travel_m| travel_m < 3.0), "lost after {lost_after_m:.1?} m");
}
