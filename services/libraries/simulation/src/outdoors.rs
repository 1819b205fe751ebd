//! What a lidar meets outdoors besides firm outlines: the ground, glass, and plants that give another return each time.

use super::drawing::rectangle_corners;
use super::floor_plan::{FloorPlan, Outline, sides};
use super::index::{Segment, Surface};
use super::terrain::Terrain;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{hypot, ln, sin_cos};
use flockslam_random::Random;

/// Height of the lidar above the ground, metres: on a small robot.
const LIDAR_HEIGHT_M: f64 = 0.4;
/// Glass returns a beam that meets it at less than this angle to its normal, radians.
const GLASS_RETURNS_RAD: f64 = 0.15;
/// Mean depth at which a beam ends in leaves, metres.
const LEAVES_M: f64 = 0.35;
/// Share of the beams at the ground that return: they meet it at a grazing angle.
const GROUND_SHARE: f64 = 0.7;
/// Standard deviation of a range to the ground as a share of the range: grass and grazing.
const GROUND_SIGMA: f64 = 0.02;
/// Standard deviation of the lidar's tilt on its springs, as a slope.
const SPRING_SLOPE: f64 = 0.003;

/// Ground, plants and paths.
#[derive(Clone, Debug)]
pub(super) struct Outdoors {
    terrain: Terrain,
    plants: Vec<Plant>,
    /// Both ends of each path.
    paths: Vec<(Point, Point)>,
}

/// A hedge or a bush: a rectangle of leaves.
#[derive(Clone, Debug)]
pub(super) struct Plant {
    /// Centre x and y, length, width in metres, turn in degrees.
    pub(super) rectangle: [f64; 5],
    pub(super) height_m: f64,
}

/// How a lidar stands during a turn: the slope of its plane beyond that of the ground, along x and y.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tilt(Point);

impl Tilt {
    /// The tilt of a turn.
    pub(super) fn drawn(random: &mut Random) -> Self {
        Self(Point::new(SPRING_SLOPE * random.normal(), SPRING_SLOPE * random.normal()))
    }
}

impl Outdoors {
    pub(super) fn new(terrain: Terrain, plants: Vec<Plant>, paths: Vec<(Point, Point)>) -> Self {
        Self { terrain, plants, paths }
    }

    /// Both ends of each path that has traffic.
    pub(super) fn paths(&self) -> &[(Point, Point)] {
        &self.paths
    }

    /// Outlines of the plants.
    pub(super) fn outlines(&self) -> impl Iterator<Item = Segment> {
        self.plants.iter().flat_map(|plant| {
            let corners = rectangle_corners(plant.rectangle).to_vec();
            sides(&Outline { corners, surface: Surface::Wall }).collect::<Vec<_>>()
        })
    }

    /// The range that a beam gives, metres along the beam; infinite without a return within `max_m`. `direction` is a unit
    /// vector.
    pub(super) fn range_m(
        &self,
        plan: &FloorPlan,
        (from, direction): (Point, Point),
        tilt: Tilt,
        max_m: f64,
        random: &mut Random,
    ) -> f64 {
        let at = |t: f64| Point::new(from.x_m + t * direction.x_m, from.y_m + t * direction.y_m);
        let gradient = self.terrain.gradient(from);
        let slope = (gradient.x_m + tilt.0.x_m) * direction.x_m + (gradient.y_m + tilt.0.y_m) * direction.y_m;
        let lidar_m = self.terrain.height_m(from) + LIDAR_HEIGHT_M;
        let clearance_m = |t: f64| lidar_m + slope * t - self.terrain.height_m(at(t));
        let ground_m = self.terrain.meets(clearance_m, max_m);
        let firm_m =
            plan.cast_where(from, direction, ground_m.min(max_m), |segment, t| match segment.surface {
                Surface::Wall => true,
                Surface::Glass => facing(segment, direction),
                Surface::Low(height_m) => clearance_m(t) < f64::from(height_m),
            });
        let leaves = |plant: &Plant| plant.range_m(from, direction, clearance_m, random);
        let leaves_m = self.plants.iter().map(leaves).fold(f64::INFINITY, f64::min);
        let length = hypot(slope, 1.0);
        let nearest_m = firm_m.min(leaves_m);
        if nearest_m <= ground_m {
            return nearest_m * length;
        }
        if random.happens(GROUND_SHARE) {
            ground_m * (1.0 + GROUND_SIGMA * random.normal()) * length
        } else {
            f64::INFINITY
        }
    }
}

/// Whether a beam meets a pane near its normal.
fn facing(pane: &Segment, direction: Point) -> bool {
    let along = (direction.x_m * pane.along.x_m + direction.y_m * pane.along.y_m) / pane.along.norm_m();
    along.abs() < GLASS_RETURNS_RAD
}

impl Plant {
    /// Where a beam ends in the leaves, if it does: at a random depth, each time another.
    fn range_m(
        &self,
        from: Point,
        direction: Point,
        clearance_m: impl Fn(f64) -> f64,
        random: &mut Random,
    ) -> f64 {
        let Some((enters_m, leaves_m)) = self.chord(from, direction) else { return f64::INFINITY };
        let range_m = enters_m - LEAVES_M * ln(random.above_zero());
        if range_m < leaves_m && clearance_m(range_m) < self.height_m { range_m } else { f64::INFINITY }
    }

    /// Distances at which a beam enters and leaves the rectangle (slabs: Kay and Kajiya 1986).
    fn chord(&self, from: Point, direction: Point) -> Option<(f64, f64)> {
        let [x, y, length_m, width_m, turn_deg] = self.rectangle;
        let (sin, cos) = sin_cos(turn_deg.to_radians());
        let (dx, dy) = (from.x_m - x, from.y_m - y);
        let axes = [
            (cos * dx + sin * dy, cos * direction.x_m + sin * direction.y_m, 0.5 * length_m),
            (cos * dy - sin * dx, cos * direction.y_m - sin * direction.x_m, 0.5 * width_m),
        ];
        let mut chord = (0.0_f64, f64::INFINITY);
        for (position, rate, half) in axes {
            let (a, b) = ((-half - position) / rate, (half - position) / rate);
            chord = (chord.0.max(a.min(b)), chord.1.min(a.max(b)));
        }
        (chord.0 < chord.1).then_some(chord)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: (Point, Point) = (Point { x_m: 0.0, y_m: 0.0 }, Point { x_m: 1.0, y_m: 0.0 });

    #[test]
    fn a_hedge_gives_another_return_within_its_depth_each_time() {
        let hedge = Plant { rectangle: [5.0, 0.0, 1.0, 10.0, 0.0], height_m: 1.2 };
        let mut random = Random::seeded(1);
        let ranges: Vec<f64> =
            (0..200).map(|_| hedge.range_m(AHEAD.0, AHEAD.1, |_| 0.4, &mut random)).collect();
        let hits: Vec<f64> = ranges.iter().copied().filter(|range_m| range_m.is_finite()).collect();
        assert!(hits.len() > 170 && hits.iter().all(|range_m| (4.5..5.5).contains(range_m)), "{hits:?}");
        let (low, high) =
            (hits.iter().fold(9.0, |a: f64, b| a.min(*b)), hits.iter().fold(0.0, |a: f64, b| a.max(*b)));
        assert!(high - low > 0.5, "{low} to {high}");
        assert!(hedge.range_m(AHEAD.0, AHEAD.1, |_| 1.5, &mut random).is_infinite(), "a beam above it");
    }

    #[test]
    fn glass_returns_only_what_meets_it_squarely() {
        let pane =
            Segment { start: Point::new(3.0, -9.0), along: Point::new(0.0, 18.0), surface: Surface::Glass };
        assert!(facing(&pane, AHEAD.1));
        let oblique = Point::new(0.5_f64.cos(), 0.5_f64.sin());
        assert!(!facing(&pane, oblique));
    }
}
