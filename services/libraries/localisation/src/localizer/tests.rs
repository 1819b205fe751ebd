//! A small building with two rooms that are the same, and robots in it.

use super::*;
use crate::KnownMap;
use flockslam_evidence::CellState;
use flockslam_geometry::Point;

const CELL_M: f64 = 0.05;

/// A plan of rectangles, metres: x, y, width, height of free space; walls of two cells around it.
fn plan(rooms: &[[f64; 4]]) -> KnownMap {
    let (width, height) = (600, 400);
    let is_free = |x: i64, y: i64| {
        let (x, y) = ((x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M);
        rooms.iter().any(|[left, low, w, h]| x > *left && x < left + w && y > *low && y < low + h)
    };
    let mut map = KnownMap::of_width(width, CELL_M, Point::default());
    for y in 0..height {
        let state = |x: i64| {
            if is_free(x, y) {
                return CellState::Free;
            }
            let beside = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy)));
            let is_wall = beside.into_iter().any(|(dx, dy)| is_free(x + dx, y + dy));
            if is_wall { CellState::Occupied } else { CellState::Unknown }
        };
        map.push_row((0..width as i64).map(state));
    }
    map.measured()
}

/// Two rooms that are the same, on a corridor whose ends are not.
const EQUAL_ROOMS: [[f64; 4]; 6] = [
    [2.0, 2.0, 4.0, 5.0],
    [3.5, 7.0, 1.0, 1.0],
    [14.0, 2.0, 4.0, 5.0],
    [15.5, 7.0, 1.0, 1.0],
    [1.0, 8.0, 22.0, 2.0],
    [20.0, 10.0, 3.0, 4.0],
];

/// What a lidar of 180 beams all around sees in a map, up to 12 m.
fn seen(map: &KnownMap, at: Placement) -> Vec<PackedPoint> {
    let beam = |k: i32| {
        let angle = f64::from(k) * std::f64::consts::TAU / 180.0;
        let (sin, cos) = angle.sin_cos();
        (0..1200).map(|step| f64::from(step) * 0.01).find_map(|range_m| {
            let (x, y) = at.apply(range_m * cos, range_m * sin);
            let hit = map.at(x, y).state != CellState::Free;
            hit.then(|| PackedPoint::from_metres(range_m * cos, range_m * sin)).flatten()
        })
    };
    (0..180).filter_map(beam).collect()
}

/// Drives straight through these places and looks around every 0.3 m; the frame of odometry is anywhere. Gives the belief at the end.
fn drive(
    localizer: &mut Localizer,
    world: &KnownMap,
    places: &[(f64, f64)],
    odom_from_map: Placement,
) -> Belief {
    for pair in places.windows(2) {
        let (dx, dy) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        let steps = (dx.hypot(dy) / 0.3).ceil().max(1.0) as i32;
        for step in 0..=steps {
            let share = f64::from(step) / f64::from(steps);
            let at = Placement::new(pair[0].0 + share * dx, pair[0].1 + share * dy, dy.atan2(dx));
            localizer.see(odom_from_map.compose(at), &seen(world, at));
        }
    }
    localizer.belief().clone()
}

fn localizer() -> (Localizer, KnownMap) {
    let map = plan(&EQUAL_ROOMS);
    (Localizer::new(Surroundings::new(map.clone())), map)
}

const ANYWHERE: (f64, f64, f64) = (-31.0, 12.0, 2.3);

fn anywhere() -> Placement {
    Placement::new(ANYWHERE.0, ANYWHERE.1, ANYWHERE.2)
}

#[test]
fn a_robot_is_found_at_its_first_scan_where_that_is_unmistakable_and_followed() {
    let (mut localizer, map) = localizer();
    let start = Placement::new(21.0, 12.5, 0.4);
    let belief = localizer.see(anywhere().compose(start), &seen(&map, start)).clone();
    assert_eq!(belief.knowledge, Knowledge::Localized, "{belief:?}");
    assert!(belief.hypotheses[0].map_from_base.distance_m(&start) < 0.03, "{belief:?}");
    let belief = drive(&mut localizer, &map, &[(21.0, 12.5), (21.0, 9.0), (5.0, 9.0)], anywhere());
    let end = Placement::new(5.0, 9.0, std::f64::consts::PI);
    let off_m = belief.hypotheses[0].map_from_base.distance_m(&end);
    println!("{off_m:.3} m off at the end, {:?}", belief.covariance);
    assert!(belief.knowledge == Knowledge::Localized && off_m < 0.05, "{belief:?}");
    assert_eq!(localizer.searches(), 1);
}

#[test]
fn equal_rooms_stay_ambiguous_until_a_difference_is_seen() {
    let (mut localizer, map) = localizer();
    let belief = drive(&mut localizer, &map, &[(15.0, 3.0), (17.0, 3.0), (16.0, 5.5)], anywhere());
    assert_eq!(belief.knowledge, Knowledge::Ambiguous, "{belief:?}");
    let weights: Vec<f64> = belief.hypotheses.iter().map(|hypothesis| hypothesis.weight).collect();
    assert!(weights.len() >= 2 && weights[1] > 0.3 && belief.entropy_nat() > 0.6, "{weights:?}");
    assert_eq!(localizer.map_from_odom(), None);
    let belief = drive(&mut localizer, &map, &[(16.0, 5.5), (16.0, 9.0), (20.0, 9.0)], anywhere());
    let end = Placement::new(20.0, 9.0, 0.0);
    assert_eq!(belief.knowledge, Knowledge::Localized, "{belief:?}");
    assert!(belief.hypotheses[0].map_from_base.distance_m(&end) < 0.05, "{belief:?}");
}

#[test]
fn a_hint_tells_equal_rooms_apart() {
    for (hinted_x, room_x) in [(4.4, 4.0), (15.6, 16.0)] {
        let (mut localizer, map) = localizer();
        // The robot stands in the right room, or in the left one: what it sees is the same.
        let at = Placement::new(16.0, 4.0, 1.0);
        let hint = Hint { map_from_base: Placement::new(hinted_x, 3.8, 1.1), sigma_m: 0.5, sigma_rad: 0.2 };
        localizer.relocalize(Some(hint));
        let belief = localizer.see(anywhere().compose(at), &seen(&map, at)).clone();
        assert_eq!(belief.knowledge, Knowledge::Localized, "{belief:?}");
        let expected = Placement::new(room_x, 4.0, 1.0);
        let off_m = belief.hypotheses[0].map_from_base.distance_m(&expected);
        assert!(off_m < 0.05, "{off_m} m: {belief:?}");
    }
}

#[test]
fn a_robot_in_another_building_is_not_localized() {
    let (mut localizer, _) = localizer();
    let other = plan(&[[2.0, 2.0, 7.0, 3.0], [8.0, 5.0, 3.0, 9.0], [11.0, 12.0, 12.0, 6.0]]);
    let way = [(3.0, 3.5), (8.5, 4.0), (9.5, 7.0), (9.5, 13.0), (14.0, 15.0), (20.0, 14.0)];
    for pair in way.windows(2) {
        let belief = drive(&mut localizer, &other, pair, anywhere());
        assert_ne!(belief.knowledge, Knowledge::Localized, "{belief:?}");
    }
}

/// A corridor of another building fits one of the map for some metres.
#[test]
fn an_unconfirmed_place_is_accepted_once_it_is_found_again_farther_on() {
    let (mut localizer, map) = localizer();
    let place = Placement::new(4.0, -2.0, 0.5);
    let mut confirmed = |x_m: f64, off_m: f64| {
        let odom = Placement::new(x_m, 0.0, 0.0);
        localizer.recent.push(odom, &seen(&map, Placement::new(21.0, 12.0, 0.0)), VERIFIED_M);
        localizer.confirms(&odom, &place.compose(Placement::new(x_m, off_m, 0.0)))
    };
    assert!(!confirmed(0.0, 0.0) && !confirmed(1.5, 0.1) && confirmed(2.1, 0.1), "2.1 m after it was found");
    assert!(!confirmed(3.0, 2.0) && !confirmed(4.5, 2.1) && confirmed(5.1, 2.0), "another place");
    localizer.relocalize(None);
    assert!(localizer.unconfirmed.is_none());
}

#[test]
fn a_kidnapped_robot_detects_it_and_is_relocalized() {
    let (mut localizer, map) = localizer();
    let belief = drive(&mut localizer, &map, &[(21.0, 13.0), (21.5, 9.0), (21.5, 11.0)], anywhere());
    assert_eq!(belief.knowledge, Knowledge::Localized);
    // It is put down elsewhere, and its odometry has not noticed.
    let moved = Placement::new(21.5, 11.0, 0.0).compose(Placement::new(2.0, 9.0, 0.0).inverse());
    let (mut lost, mut knowledge) = (false, Knowledge::Localized);
    for pair in
        [(2.0, 9.0), (4.0, 9.2), (4.0, 5.0), (5.0, 3.0), (4.0, 5.0), (4.0, 9.0), (9.0, 9.0)].windows(2)
    {
        knowledge = drive(&mut localizer, &map, pair, anywhere().compose(moved)).knowledge;
        lost |= knowledge != Knowledge::Localized || localizer.searches() > 1;
    }
    let belief = localizer.belief();
    let off_m = belief.hypotheses[0].map_from_base.distance_m(&Placement::new(9.0, 9.0, 0.0));
    assert!(lost && knowledge == Knowledge::Localized && off_m < 0.1, "{off_m} m: {belief:?}");
}

#[test]
fn a_robot_whose_front_end_turns_wrongly_is_followed_on_where_it_is() {
    let (mut localizer, map) = localizer();
    let odom_from_map = anywhere();
    drive(&mut localizer, &map, &[(20.5, 13.5), (21.5, 9.0), (12.0, 9.0)], odom_from_map);
    assert_eq!(localizer.belief().knowledge, Knowledge::Localized);
    // Within a step the front end turns by 4° about the robot, and is 5 cm off.
    let here = Placement::new(12.0, 9.0, std::f64::consts::PI);
    let slip = here.compose(Placement::new(0.05, 0.0, 0.07)).compose(here.inverse());
    let odom_from_map = odom_from_map.compose(slip);
    let searches = localizer.searches();
    for step in 0..10 {
        let at = Placement::new(12.0 - 0.1 * f64::from(step), 9.0, std::f64::consts::PI);
        localizer.see(odom_from_map.compose(at), &seen(&map, at));
        let found = localizer.belief().hypotheses[0].map_from_base;
        let (off_m, off_rad) = (found.distance_m(&at), found.turn_rad(&at));
        assert!(off_m < 0.1 && off_rad < 0.01, "{step}: {off_m} m, {off_rad} rad");
    }
    assert_eq!((localizer.belief().knowledge, localizer.searches()), (Knowledge::Localized, searches));
}

#[test]
fn a_break_of_odometry_and_an_order_clear_the_place() {
    let (mut localizer, map) = localizer();
    let at = Placement::new(21.0, 12.5, 0.4);
    localizer.see(at, &seen(&map, at));
    assert!(localizer.map_from_odom().is_some());
    localizer.odometry_breaks();
    assert_eq!((localizer.map_from_odom(), localizer.belief().knowledge), (None, Knowledge::Unknown));
    localizer.see(at, &seen(&map, at));
    assert!(localizer.map_from_odom().is_some());
    localizer.relocalize(None);
    assert_eq!(localizer.map_from_odom(), None);
    let searches = localizer.searches();
    localizer.see(at, &seen(&map, at));
    assert!(localizer.map_from_odom().is_some() && localizer.searches() == searches + 1);
    localizer.odometry_breaks();
    assert_eq!(localizer.see(at, &[]).knowledge, Knowledge::Unknown, "nothing is seen");
}

/// A plan shows walls alone; in the building stand tables and cupboards, a fifth of what is seen and more.
#[test]
fn a_robot_is_found_among_furniture_that_the_plan_does_not_show_and_stays_found() {
    let rooms = [[2.0, 2.0, 6.0, 5.0], [4.0, 7.0, 1.5, 1.0], [1.0, 8.0, 22.0, 2.0], [18.0, 10.0, 5.0, 6.0]];
    let map = plan(&rooms);
    let furniture = [
        [3.0, 2.0, 0.8, 1.0],
        [6.4, 5.5, 0.8, 0.8],
        [9.0, 9.4, 1.2, 0.6],
        [14.0, 8.0, 1.0, 0.7],
        [19.0, 14.6, 1.2, 0.8],
    ];
    let stands = |x: f64, y: f64| {
        furniture.iter().any(|[left, low, w, h]| x > *left && x < left + w && y > *low && y < low + h)
    };
    let mut building = KnownMap::of_width(map.width(), CELL_M, Point::default());
    for y in 0..map.height() {
        let state = |x: usize| {
            let (x, y) = ((x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M);
            if stands(x, y) { CellState::Occupied } else { map.at(x, y).state }
        };
        building.push_row((0..map.width()).map(state));
    }
    let building = building.measured();
    let mut localizer = Localizer::new(Surroundings::new(map));
    let way =
        [(5.0, 3.5), (4.8, 7.5), (8.0, 8.8), (16.0, 9.2), (20.0, 9.0), (20.5, 12.0), (20.0, 9.0), (8.0, 8.8)];
    let belief = drive(&mut localizer, &building, &way, anywhere());
    let end = Placement::new(8.0, 8.8, (8.8f64 - 9.0).atan2(8.0 - 20.0));
    let off_m = belief.hypotheses[0].map_from_base.distance_m(&end);
    println!(
        "{off_m:.3} m off after {} searches, {:?}",
        localizer.searches(),
        belief.hypotheses[0].agreement
    );
    assert!(belief.knowledge == Knowledge::Localized && off_m < 0.08, "{belief:?}");
}

/// The map with so much of it replaced by this state, metres: x, y, width, height.
fn with(map: &KnownMap, [left, low, w, h]: [f64; 4], inside: CellState) -> KnownMap {
    let mut changed = KnownMap::of_width(map.width(), CELL_M, Point::default());
    for y in 0..map.height() {
        let state = |x: usize| {
            let (x, y) = ((x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M);
            let is_inside = x > left && x < left + w && y > low && y < low + h;
            if is_inside { inside } else { map.at(x, y).state }
        };
        changed.push_row((0..map.width()).map(state));
    }
    changed.measured()
}

/// Most of what it sees is behind where the cupboard stood, at walls that the map shows.
#[test]
fn a_cupboard_that_was_taken_away_beside_a_robot_is_no_reason_to_be_lost() {
    let building = plan(&EQUAL_ROOMS);
    let map = with(&building, [20.3, 11.2, 0.6, 0.8], CellState::Occupied);
    let mut localizer = Localizer::new(Surroundings::new(map.clone()));
    let start = Placement::new(22.0, 13.2, 0.4);
    let belief = localizer.see(anywhere().compose(start), &seen(&map, start)).clone();
    assert_eq!(belief.knowledge, Knowledge::Localized, "{belief:?}");
    let belief = drive(
        &mut localizer,
        &building,
        &[(22.0, 13.2), (21.3, 11.6), (21.3, 11.0), (21.5, 9.0), (14.0, 9.0)],
        anywhere(),
    );
    let end = Placement::new(14.0, 9.0, std::f64::consts::PI);
    let off_m = belief.hypotheses[0].map_from_base.distance_m(&end);
    assert!(belief.knowledge == Knowledge::Localized && off_m < 0.05, "{off_m} m: {belief:?}");
    assert_eq!(localizer.searches(), 1);
    let beside = Placement::new(21.2, 11.6, 3.0);
    let points = seen(&building, beside);
    let points: Vec<SeenPoint> = points
        .iter()
        .map(|p| SeenPoint { x_m: p.x_m(), y_m: p.y_m(), from_x_m: 0.0, from_y_m: 0.0 })
        .collect();
    let Agreement { explained, contradicted, through, .. } =
        localizer.surroundings().agreement(&points, &beside);
    assert!(explained > 0.9 && through > 0.0 && contradicted < 0.1, "{explained} {contradicted} {through}");
}

#[test]
fn scans_before_a_kidnapping_do_not_prevent_relocalization() {
    let (mut localizer, map) = localizer();
    let belief = drive(
        &mut localizer,
        &map,
        &[(2.0, 9.0), (21.0, 9.0), (21.5, 13.0), (21.0, 10.5), (20.5, 9.0), (16.0, 9.0)],
        anywhere(),
    );
    assert_eq!(belief.knowledge, Knowledge::Localized);
    let moved = Placement::new(16.0, 9.0, 0.0).compose(Placement::new(22.0, 13.5, -2.0).inverse());
    let way = [(22.0, 13.5), (21.0, 11.5), (21.3, 10.5), (21.3, 9.0), (19.0, 9.0)];
    let belief = drive(&mut localizer, &map, &way, anywhere().compose(moved));
    let off_m =
        belief.hypotheses[0].map_from_base.distance_m(&Placement::new(19.0, 9.0, std::f64::consts::PI));
    assert!(localizer.searches() > 1, "it has noticed");
    assert!(belief.knowledge == Knowledge::Localized && off_m < 0.1, "{off_m} m after 7.5 m: {belief:?}");
}
