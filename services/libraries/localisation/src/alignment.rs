//! Point-to-line refinement of a pose in the known map by Gauss–Newton (Censi 2008), and how well points agree with the map at a pose.

use crate::place_field::{MUCH_UNKNOWN, UNKNOWN};
use crate::surface_lines::SurfaceLines;
use crate::{KnownMap, PlaceField};
use flockslam_evidence::{CellState, floor};
use flockslam_geometry::elementary::{atan2, hypot, sin_cos};
use flockslam_pose_graph::{Symmetric, inverse, times};
use flockslam_registration::cloud::Placement;

/// Gauss–Newton steps.
const STEPS: u32 = 12;
/// Points farther from their line than this are not used in the first half of the steps, and in the second, metres.
const GATES_M: (f64, f64) = (0.3, 0.15);
/// Scale of the Cauchy kernel, metres.
const KERNEL_M: f64 = 0.05;
/// The pose at which points are nearest to something: number of points, what is far, metres, …
const NEAREST_POINTS: usize = 96;
const NEAREST_M: f64 = 0.4;
/// … and steps on each side, and their length: in each direction, metres, and in heading, radians.
const NEAREST_STEPS: (i32, f64) = (3, 0.1);
const NEAREST_TURNS: (i32, f64) = (3, 0.005);
/// A direction of which the surfaces say less than this share of what they say across it is open.
const OPEN_SHARE: f64 = 0.03;
/// A point nearer to something occupied than this is explained by it, metres.
const EXPLAINED_M: f64 = 0.15;
/// A point in free space farther than this from all that is occupied contradicts the map, metres.
const CONTRADICTED_M: f64 = 0.3;
/// What is before a point by less than this is not in its beam, metres.
const BEFORE_M: f64 = 0.4;
/// A surface that beams pass is counted in squares of this side, metres, as points of a cloud are.
const THROUGH_M: f64 = 0.1;
/// Agreement is a share of at least this share of all points, however many lie among scattered returns.
const TELLING_MIN: f64 = 0.3;
/// Steps along a beam, metres.
const BEAM_STEP_M: f64 = 0.1;

/// A point of a cloud, and where it was seen from, metres in the cloud's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoint {
    /// The point.
    pub x_m: f64,
    /// Its other coordinate.
    pub y_m: f64,
    /// Where the robot was.
    pub from_x_m: f64,
    /// The other coordinate of that.
    pub from_y_m: f64,
}

/// Where a cloud fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The pose of the cloud's origin in the map.
    pub map_from_cloud: Placement,
    /// `Σ w J Jᵀ` over all points at it, 1/m² of a unit weight: translation in the map's axes, rotation about the cloud's origin; of the
    /// prior nothing is in it.
    pub information: Symmetric,
    /// Share of the points within the gate of a line.
    pub inliers: f64,
}

/// How points agree with the map at a pose: shares of all points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Points near something occupied.
    pub explained: f64,
    /// Points in known-free space, and what the map shows and beams have passed.
    pub contradicted: f64,
    /// Points near something occupied that no beam passed anything to reach: the stricter share, which asks that nothing was taken away.
    pub clear: f64,
    /// Points behind something that their beam would have met.
    pub behind: f64,
    /// Of what contradicts, what beams have passed, each square of its surface once, however many points lie behind it: furniture is moved, but
    /// no beam passes through a wall.
    pub through: f64,
}

/// The known map in the forms that search, refinement and verification read.
pub struct Surroundings {
    map: KnownMap,
    field: PlaceField,
    border_field: PlaceField,
    outdoors: OutdoorMap,
    lines: SurfaceLines,
}

/// What is firm in a map: no ground, grass and leaves.
struct OutdoorMap {
    map: KnownMap,
    field: PlaceField,
}

impl Surroundings {
    /// Works them out once.
    pub fn new(map: KnownMap) -> Self {
        let [field, border_field] = [UNKNOWN, MUCH_UNKNOWN].map(|unknown| PlaceField::new(&map, unknown));
        let firm = map.without_scattered();
        let outdoors = OutdoorMap { field: PlaceField::wide(&firm, UNKNOWN), map: firm };
        let lines = SurfaceLines::new(&map);
        Self { map, field, border_field, outdoors, lines }
    }

    /// The map itself.
    pub fn map(&self) -> &KnownMap {
        &self.map
    }

    /// What a search reads.
    pub fn field(&self) -> &PlaceField {
        &self.field
    }

    /// What a search reads for a robot that may see much that the map does not have.
    pub fn border_field(&self) -> &PlaceField {
        &self.border_field
    }

    /// What a search reads for a robot outdoors.
    pub fn outdoor_field(&self) -> &PlaceField {
        &self.outdoors.field
    }

    /// The pose near a place of a wide search at which points are nearest to something occupied: within a cell of that, nearer than lines
    /// draw a fit.
    pub fn nearest_outdoors(&self, points: &[SeenPoint], place: Placement) -> Placement {
        let map = &self.outdoors.map;
        let few = points.iter().step_by(points.len().div_ceil(NEAREST_POINTS).max(1));
        let few: Vec<(f64, f64)> = few.map(|point| (point.x_m, point.y_m)).collect();
        let nearness = |at: &Placement| -> f64 {
            let distances = few.iter().map(|(x_m, y_m)| {
                let (x_m, y_m) = at.apply(*x_m, *y_m);
                map.at(x_m, y_m).distance_m.min(NEAREST_M)
            });
            -distances.sum::<f64>()
        };
        let steps = |count: i32, step: f64| (-count..=count).map(move |k| f64::from(k) * step);
        let mut best = (nearness(&place), place);
        for turn in steps(NEAREST_TURNS.0, NEAREST_TURNS.1) {
            for dx in steps(NEAREST_STEPS.0, NEAREST_STEPS.1) {
                for dy in steps(NEAREST_STEPS.0, NEAREST_STEPS.1) {
                    let at = Placement::new(place.x_m + dx, place.y_m + dy, place.heading_rad + turn);
                    let near = nearness(&at);
                    if near > best.0 {
                        best = (near, at);
                    }
                }
            }
        }
        best.1
    }

    /// Fits points to the surfaces of the map from `guess`, drawn to it by `prior` (information in the map's axes). `None` when no point
    /// meets a surface.
    pub fn fit(&self, points: &[SeenPoint], guess: Placement, prior: &Symmetric) -> Option<Fit> {
        let mut at = guess;
        let open = self.sums(points, &at, GATES_M.0).open_direction();
        let mut step = 0;
        while step < STEPS {
            let is_first_half = 2 * step < STEPS;
            let gate_m = if is_first_half { GATES_M.0 } else { GATES_M.1 };
            let sums = self.sums(points, &at, gate_m).without(open);
            let turn = flockslam_geometry::wrap_angle(at.heading_rad - guess.heading_rad);
            let from_guess = [at.x_m - guess.x_m, at.y_m - guess.y_m, turn];
            let (mut h, mut g) = (sums.h, sums.g);
            for (h, prior) in h.iter_mut().zip(prior) {
                *h += prior;
            }
            let pull = times(prior, &from_guess);
            g.iter_mut().zip(pull).for_each(|(g, pull)| *g += pull);
            let delta = solved(&h, &g)?;
            let bounded = |v: f64, most: f64| v.clamp(-most, most);
            let delta = [bounded(delta[0], 0.3), bounded(delta[1], 0.3), bounded(delta[2], 0.2)];
            at = Placement::new(at.x_m - delta[0], at.y_m - delta[1], at.heading_rad - delta[2]);
            let is_small = delta[0] * delta[0] + delta[1] * delta[1] < 1e-8 && delta[2].abs() < 1e-5;
            step = match (is_small, is_first_half) {
                (true, true) => STEPS / 2,
                (true, false) => break,
                (false, _) => step + 1,
            };
        }
        let sums = self.sums(points, &at, GATES_M.1).without(open);
        (sums.inliers > 0).then(|| Fit {
            map_from_cloud: at,
            information: sums.h,
            inliers: f64::from(sums.inliers) / points.len() as f64,
        })
    }

    fn sums(&self, points: &[SeenPoint], at: &Placement, gate_m: f64) -> Sums {
        let mut sums = Sums::default();
        let kernel = 1.0 / (KERNEL_M * KERNEL_M);
        for point in points {
            let (rx, ry) = at.rotate(point.x_m, point.y_m);
            let (x, y) = (at.x_m + rx, at.y_m + ry);
            let view = at.rotate(point.x_m - point.from_x_m, point.y_m - point.from_y_m);
            let Some(line) = self.lines.near(x, y, view) else { continue };
            let (nx, ny) = (f64::from(line.normal_x), f64::from(line.normal_y));
            let distance = nx * (x - f64::from(line.x_m)) + ny * (y - f64::from(line.y_m));
            if distance.abs() > gate_m {
                continue;
            }
            let flat = f64::from(line.flatness);
            let weight = flat * flat / (1.0 + distance * distance * kernel);
            let jt = ny * rx - nx * ry;
            let (wx, wy, wt) = (weight * nx, weight * ny, weight * jt);
            let h = [wx * nx, wx * ny, wx * jt, wy * ny, wy * jt, wt * jt];
            sums.h.iter_mut().zip(h).for_each(|(sum, h)| *sum += h);
            sums.g.iter_mut().zip([wx, wy, wt]).for_each(|(sum, w)| *sum += w * distance);
            sums.inliers += 1;
        }
        sums
    }

    /// How points agree with the map at a pose.
    pub fn agreement(&self, points: &[SeenPoint], map_from_cloud: &Placement) -> Agreement {
        agreement_with(&self.map, points, map_from_cloud)
    }

    /// How firm points agree with what is firm in the map.
    pub fn agreement_outdoors(&self, points: &[SeenPoint], map_from_cloud: &Placement) -> Agreement {
        agreement_with(&self.outdoors.map, points, map_from_cloud)
    }
}

fn agreement_with(map: &KnownMap, points: &[SeenPoint], map_from_cloud: &Placement) -> Agreement {
    let (mut explained, mut clear, mut behind, mut in_free, mut scattered) = (0, 0, 0, 0, 0);
    let mut through: Vec<(i32, i32)> = Vec::new();
    for point in points {
        let (x, y) = map_from_cloud.apply(point.x_m, point.y_m);
        let place = map.at(x, y);
        let is_in_free =
            place.state == CellState::Free && place.distance_m > CONTRADICTED_M && !place.is_scattered;
        let is_explained = place.distance_m <= EXPLAINED_M;
        let passed = if is_in_free { None } else { seen_through(map, point, map_from_cloud) };
        explained += u32::from(is_explained);
        clear += u32::from(is_explained && passed.is_none());
        behind += u32::from(passed.is_some());
        in_free += u32::from(is_in_free);
        scattered += u32::from(place.is_scattered && !is_explained && passed.is_none());
        through.extend(passed);
    }
    through.sort_unstable();
    through.dedup();
    let through = through.len() as u32;
    // Points on ground and grass say nothing.
    let telling = (points.len() as u32 - scattered).max((TELLING_MIN * points.len() as f64) as u32).max(1);
    let share = |count: u32| f64::from(count) / f64::from(telling);
    Agreement {
        explained: share(explained),
        contradicted: share(in_free + through),
        clear: share(clear),
        behind: share(behind),
        through: share(through),
    }
}

/// The square of the map in which a beam to a point would have ended at something before it.
fn seen_through(map: &KnownMap, point: &SeenPoint, map_from_cloud: &Placement) -> Option<(i32, i32)> {
    let from = map_from_cloud.apply(point.from_x_m, point.from_y_m);
    let to = map_from_cloud.apply(point.x_m, point.y_m);
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let range_m = hypot(dx, dy);
    let steps = floor((range_m - BEFORE_M) / BEAM_STEP_M).max(0) as u32;
    let (dx, dy) = (dx / range_m * BEAM_STEP_M, dy / range_m * BEAM_STEP_M);
    let at = |step: u32| (from.0 + dx * f64::from(step), from.1 + dy * f64::from(step));
    // A beam that grazes a corner meets it in a step or two.
    let mut met = (2..steps).map(at).filter(|at| map.at(at.0, at.1).state == CellState::Occupied);
    let (first, _) = (met.next()?, met.next()?);
    let square = |metres: f64| floor(metres * (1.0 / THROUGH_M));
    Some((square(first.0), square(first.1)))
}

/// Sums over the points at one pose.
#[derive(Clone, Copy, Default)]
struct Sums {
    h: Symmetric,
    g: [f64; 3],
    inliers: u32,
}

impl Sums {
    /// The direction that the surfaces leave open, a unit vector, as along a bare corridor: what single cells of a wall seem to say of it
    /// is noise, and would pull a robot along bit by bit.
    fn open_direction(&self) -> Option<(f64, f64)> {
        let [xx, xy, _, yy, ..] = self.h;
        let (middle, half, spread) = (0.5 * (xx + yy), 0.5 * (xx - yy), hypot(0.5 * (xx - yy), xy));
        if middle - spread > OPEN_SHARE * (middle + spread) {
            return None;
        }
        // The axis of the larger eigenvalue is at half the angle of (half, xy); the smaller one's is across.
        let (sin, cos) = sin_cos(0.5 * atan2(xy, half));
        Some((-sin, cos))
    }

    /// The same without its information along a direction.
    fn without(mut self, direction: Option<(f64, f64)>) -> Self {
        let Some((dx, dy)) = direction else { return self };
        let across = |x: f64, y: f64| {
            let along = x * dx + y * dy;
            (x - along * dx, y - along * dy)
        };
        let [xx, xy, xt, yy, yt, tt] = self.h;
        // Columns, then rows, of the translation block.
        let ((ax, ay), (bx, by)) = (across(xx, xy), across(xy, yy));
        let ((xx, xy), (_, yy)) = (across(ax, bx), across(ay, by));
        let (xt, yt) = across(xt, yt);
        self.h = [xx, xy, xt, yy, yt, tt];
        (self.g[0], self.g[1]) = across(self.g[0], self.g[1]);
        self
    }
}

/// `h⁻¹ · g`; `None` when h has no inverse.
fn solved(h: &Symmetric, g: &[f64; 3]) -> Option<[f64; 3]> {
    Some(times(&inverse(h)?, g))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Point;

    /// A step of the wide search is farther from the pose than lines draw a fit.
    #[test]
    fn the_nearest_pose_is_where_points_lie_on_walls() {
        let mut map = KnownMap::of_width(200, 0.05, Point::default());
        for y in 0..200 {
            let is_wall = |x: usize| x == 20 || y == 30 || (x == 150 && y > 100);
            let state = |x: usize| if is_wall(x) { CellState::Occupied } else { CellState::Free };
            map.push_row((0..200).map(state));
        }
        let surroundings = Surroundings::new(map.measured());
        let truth = Placement::new(5.0, 5.0, 0.3);
        let on_walls = (0..60).flat_map(|k| {
            let along_m = 2.0 + 0.1 * f64::from(k);
            [(1.025, along_m), (along_m, 1.525), (7.525, 5.1 + 0.05 * f64::from(k))]
        });
        let seen = |(x, y)| {
            let (x_m, y_m) = truth.inverse().apply(x, y);
            SeenPoint { x_m, y_m, from_x_m: 0.0, from_y_m: 0.0 }
        };
        let points: Vec<SeenPoint> = on_walls.map(seen).collect();
        let place = Placement::new(5.2, 4.8, 0.31);
        let nearest = surroundings.nearest_outdoors(&points, place);
        assert!(nearest.distance_m(&truth) < 0.08 && nearest.turn_rad(&truth) < 0.008, "{nearest:?}");
    }
}
