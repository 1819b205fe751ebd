//! `cargo bench -p flockslam --bench map_search -- MAP.yaml [TILES]`: how long a search of a whole known map takes. A map of nav2's kind is laid
//! out so many times side by side in both directions; what robots at places drawn from it would see around them, to a centimetre, is looked for:
//! once as a robot's first search does, and once as its second one does, which gives unknown cells more weight.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

use flockslam::store::read_nav2_map;
use flockslam_evidence::CellState;
use flockslam_geometry::Point;
use flockslam_localisation::{KnownMap, MUCH_UNKNOWN, PlaceField, PlaceSearch, SearchRequest, UNKNOWN};
use flockslam_random::Random;
use flockslam_registration::cloud::Placement;
use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

const SEARCHES: usize = 24;
/// What a robot sees while it drives for some metres: rings of beams at places that it passed, up to this range, metres.
const RANGE_M: f64 = 15.0;
const BEAMS: u32 = 180;
/// The same as a robot's own search asks for.
const REQUEST: SearchRequest = SearchRequest { score_min: 0.45, share_min: 0.75, near: None };

/// The points that a lidar at a pose would see, in its frame.
fn seen(map: &KnownMap, at: &Placement, random: &mut Random) -> Vec<(f64, f64)> {
    let mut points = Vec::new();
    for beam in 0..BEAMS {
        let angle_rad = std::f64::consts::TAU * f64::from(beam) / f64::from(BEAMS);
        let (sin, cos) = angle_rad.sin_cos();
        let steps = (RANGE_M / 0.02) as u32;
        let ranges = (0..steps).map(|step| 0.02 * f64::from(step));
        let state = |range_m: f64| {
            let (x_m, y_m) = at.apply(range_m * cos, range_m * sin);
            map.at(x_m, y_m).state
        };
        let end = ranges.into_iter().find(|range_m| state(*range_m) != CellState::Free);
        if let Some(range_m) = end.filter(|range_m| state(*range_m) == CellState::Occupied) {
            let range_m = range_m + 0.01 * random.normal();
            points.push((range_m * cos, range_m * sin));
        }
    }
    points
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().filter(|argument| argument != "--bench").collect();
    let Some(map) = arguments.get(1) else {
        println!("map_search needs MAP.yaml");
        return Ok(());
    };
    let tiles: usize = arguments.get(2).map_or(Ok(1), |tiles| tiles.parse())?;
    let stored = read_nav2_map(Path::new(map))?;
    let mut rows: Vec<Vec<CellState>> = Vec::new();
    stored.for_each_row(|row| rows.push(row.iter().map(CellState::of).collect()));
    let mut known = KnownMap::of_width(stored.width * tiles, stored.cell_size_m, Point::new(0.0, 0.0));
    for row in (0..tiles).flat_map(|_| &rows) {
        known.push_row((0..tiles).flat_map(|_| row.iter().copied()));
    }
    let known = known.measured();
    let (width_m, height_m) =
        (known.width() as f64 * known.cell_size_m(), known.height() as f64 * known.cell_size_m());
    for (name, unknown) in [("first", UNKNOWN), ("second", MUCH_UNKNOWN)] {
        let started = Instant::now();
        let field = PlaceField::new(&known, unknown);
        let made = started.elapsed();
        let (mut random, mut search) = (Random::new(1, "map search"), PlaceSearch::default());
        let (mut times, mut found) = (Vec::<Duration>::new(), 0);
        while times.len() < SEARCHES {
            let at = Placement::new(
                random.between(0.0, width_m),
                random.between(0.0, height_m),
                random.between(-3.0, 3.0),
            );
            let points = seen(&known, &at, &mut random);
            if known.at(at.x_m, at.y_m).state != CellState::Free || points.len() < 60 {
                continue;
            }
            let started = Instant::now();
            let places = search.find(&field, &points, &REQUEST);
            times.push(started.elapsed());
            let is_there = |place: &Placement| place.distance_m(&at) < 0.6 && place.turn_rad(&at) < 0.25;
            found +=
                usize::from(tiles > 1 || places.found.iter().any(|place| is_there(&place.map_from_cloud)));
        }
        times.sort();
        println!(
            "{:.0} m² known, {width_m:.0} m x {height_m:.0} m, {name}: {SEARCHES} searches, median {:.3} s, slowest {:.3} s; {found} among the places found; field made in {:.3} s",
            known.known_area_m2(),
            times[SEARCHES / 2].as_secs_f64(),
            times[SEARCHES - 1].as_secs_f64(),
            made.as_secs_f64(),
        );
    }
    Ok(())
}
