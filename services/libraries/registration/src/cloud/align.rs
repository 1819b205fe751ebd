//! Point-to-line refinement of a pose by Gauss–Newton (Censi 2008). Takes the moments of a submap, the points of a scan and
//! a guess, gives the pose with its information matrix and share of inliers.

use super::line_batch::{Sums, Weighing, sums};
use super::{MomentGrid, PackedPoint, Placement};

/// Of a quick fit steps shorter than this end the first half and the second, metres and radians …
const QUICK_STEPS: [(f64, f64); 2] = [(1e-3, 2e-4), (2e-4, 3e-5)];
/// … and of any other the second.
const LAST_STEP: (f64, f64) = (1e-4, 1e-5);

/// How a cloud is fitted to a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignSettings {
    /// Gauss–Newton steps.
    pub iterations: u32,
    /// Points farther from their line than this are not used in the first half of the steps, metres.
    pub gate_wide_m: f64,
    /// The same for the second half, metres.
    pub gate_m: f64,
    /// Scale of the Cauchy kernel, metres.
    pub kernel_m: f64,
    /// Pull towards the guess per m² (and per rad², through [`Self::prior_lever_m`]), on a scale where all
    /// points together weigh one. It decides along directions in which the points say nothing.
    pub prior: f64,
    /// Length that makes a turn comparable with a shift in the prior, metres.
    pub prior_lever_m: f64,
    /// Whether it ends where it hardly moves: enough for a pose that nothing else is measured from. Where points leave a direction nearly
    /// open short steps may still lead far.
    pub is_quick: bool,
}

impl Default for AlignSettings {
    fn default() -> Self {
        Self {
            iterations: 8,
            gate_wide_m: 0.3,
            gate_m: 0.15,
            kernel_m: 0.05,
            prior: 0.002,
            prior_lever_m: 2.0,
            is_quick: false,
        }
    }
}

/// Where a cloud fits, and how well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// The fitted pose.
    pub placement: Placement,
    /// `Σ w J Jᵀ / Σ 1` over all points at the fitted pose, upper triangle (xx, xy, xθ, yy, yθ, θθ),
    /// translation in the grid's axes, rotation about the robot.
    pub information: [f64; 6],
    /// Share of the points that lie within the gate of a line.
    pub inliers: f64,
    /// Root mean square distance of those from their line, metres.
    pub spread_m: f64,
}

/// Fits clouds to grids by Gauss–Newton on the distance of a point to its line (Censi 2008, with lines from a
/// grid in place of neighbours in the last scan).
///
/// ```
/// use flockslam_registration::cloud::{Aligner, MomentGrid, PackedPoint, Placement};
///
/// // The walls of a room of 6 × 4 m, as they are seen from a place.
/// let room = |at: Placement| -> Vec<PackedPoint> {
///     let walls = (0..=200).map(|i| f64::from(i) / 200.0).flat_map(|share| {
///         let (x, y) = (6.0 * share - 3.0, 4.0 * share - 2.0);
///         [(x, -2.0), (x, 2.0), (-3.0, y), (3.0, y)]
///     });
///     let seen = walls.map(|(x, y)| at.inverse().apply(x, y));
///     seen.filter_map(|(x, y)| PackedPoint::from_metres(x, y)).collect()
/// };
/// let mut grid = MomentGrid::default();
/// grid.add(&Placement::IDENTITY, &room(Placement::IDENTITY));
///
/// let (truth, guess) = (Placement::new(0.4, -0.3, 0.7), Placement::new(0.45, -0.33, 0.72));
/// let found = Aligner::default().align(&mut grid, &room(truth), guess).unwrap();
/// assert!(found.placement.distance_m(&truth) < 0.003 && found.inliers > 0.95);
/// ```
#[derive(Default)]
pub struct Aligner {
    settings: AlignSettings,
}

impl Aligner {
    /// An aligner with these settings.
    pub fn new(settings: AlignSettings) -> Self {
        Self { settings }
    }

    /// Fits `points` (in the robot's frame) to `grid`, from `guess`. `None` when not one point meets a line.
    pub fn align(
        &self,
        grid: &mut MomentGrid,
        points: &[PackedPoint],
        guess: Placement,
    ) -> Option<Alignment> {
        let settings = &self.settings;
        let mut at = guess;
        let (mut step, mut last) = (0, None);
        while step < settings.iterations {
            let is_wide = 2 * step < settings.iterations;
            let gate_m = if is_wide { settings.gate_wide_m } else { settings.gate_m };
            let normal = self.sum(grid, points, at, gate_m);
            if normal.inliers == 0 {
                return None;
            }
            let Some(delta) = self.step(&normal, points.len(), at, guess) else { break };
            at = Placement::new(at.x_m + delta[0], at.y_m + delta[1], at.heading_rad + delta[2]);
            step += 1;
            let is_over = match (settings.is_quick, is_wide) {
                (true, _) => is_short(delta, QUICK_STEPS[usize::from(!is_wide)]),
                (false, true) => false,
                (false, false) => is_short(delta, LAST_STEP),
            };
            match (is_over, is_wide) {
                (true, true) => step = settings.iterations.div_ceil(2),
                (true, false) => {
                    // So near it is the same.
                    last = settings.is_quick.then_some(normal);
                    break;
                }
                (false, _) => {}
            }
        }
        let normal = last.unwrap_or_else(|| self.sum(grid, points, at, settings.gate_m));
        let share = 1.0 / points.len() as f64;
        (normal.inliers > 0).then(|| Alignment {
            placement: at,
            information: normal.h.map(|h| h * share),
            inliers: f64::from(normal.inliers) * share,
            spread_m: (normal.squared / f64::from(normal.inliers)).sqrt(),
        })
    }

    fn sum(&self, grid: &mut MomentGrid, points: &[PackedPoint], at: Placement, gate_m: f64) -> Sums {
        sums(grid, points, &at, Weighing { gate_m, kernel_m: self.settings.kernel_m })
    }

    /// The Gauss–Newton step with the prior towards the guess.
    fn step(&self, normal: &Sums, points: usize, at: Placement, guess: Placement) -> Option<[f64; 3]> {
        let share = 1.0 / points as f64;
        let prior = self.settings.prior;
        let prior_turn = prior * self.settings.prior_lever_m * self.settings.prior_lever_m;
        let mut h = normal.h.map(|v| v * share);
        h[0] += prior;
        h[3] += prior;
        h[5] += prior_turn;
        let turn = flockslam_geometry::wrap_angle(at.heading_rad - guess.heading_rad);
        let g = [
            normal.g[0] * share + prior * (at.x_m - guess.x_m),
            normal.g[1] * share + prior * (at.y_m - guess.y_m),
            normal.g[2] * share + prior_turn * turn,
        ];
        let delta = solve(&h, &g)?;
        Some([-delta[0].clamp(-0.3, 0.3), -delta[1].clamp(-0.3, 0.3), -delta[2].clamp(-0.2, 0.2)])
    }
}

fn is_short(delta: [f64; 3], (step_m, step_rad): (f64, f64)) -> bool {
    delta[0] * delta[0] + delta[1] * delta[1] < step_m * step_m && delta[2].abs() < step_rad
}

/// Solves the symmetric positive definite 3 × 3 system h·x = g by Cholesky; `None` when it is not.
fn solve(h: &[f64; 6], g: &[f64; 3]) -> Option<[f64; 3]> {
    let l00 = h[0].sqrt();
    let (l10, l20) = (h[1] / l00, h[2] / l00);
    let l11 = (h[3] - l10 * l10).sqrt();
    let l21 = (h[4] - l20 * l10) / l11;
    let l22 = (h[5] - l20 * l20 - l21 * l21).sqrt();
    let y0 = g[0] / l00;
    let y1 = (g[1] - l10 * y0) / l11;
    let y2 = (g[2] - l20 * y0 - l21 * y1) / l22;
    let x2 = y2 / l22;
    let x1 = (y1 - l21 * x2) / l11;
    let x0 = (y0 - l10 * x1 - l20 * x2) / l00;
    // A negative pivot has become NaN.
    (x0.is_finite() && x1.is_finite() && x2.is_finite()).then_some([x0, x1, x2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The walls of a 6 × 4 m room, seen from `at`.
    pub fn room(at: &Placement) -> Vec<PackedPoint> {
        let mut points = Vec::new();
        let mut put = |x: f64, y: f64| {
            let (x, y) = at.inverse().apply(x, y);
            points.extend(PackedPoint::from_metres(x, y));
        };
        for i in 0..=200 {
            let t = f64::from(i) / 200.0;
            put(-3.0 + 6.0 * t, -2.0);
            put(-3.0 + 6.0 * t, 2.0);
            put(-3.0, -2.0 + 4.0 * t);
            put(3.0, -2.0 + 4.0 * t);
        }
        points
    }

    proptest! {
        #[test]
        fn finds_back_to_the_true_pose(dx in -0.08..0.08f64, dy in -0.08..0.08f64, turn in -0.03..0.03f64) {
            let mut grid = MomentGrid::default();
            grid.add(&Placement::IDENTITY, &room(&Placement::IDENTITY));
            let truth = Placement::new(0.4, -0.3, 0.7);
            let guess = Placement::new(0.4 + dx, -0.3 + dy, 0.7 + turn);
            let found = Aligner::default().align(&mut grid, &room(&truth), guess).unwrap();
            prop_assert!(found.placement.distance_m(&truth) < 0.003, "{found:?}");
            prop_assert!(found.placement.turn_rad(&truth) < 0.001 && found.inliers > 0.95);
        }
    }

    /// A wall of 0.12 m, from a room below it and from one above it, with a wall on the left and one on the right.
    #[test]
    fn the_other_face_of_a_wall_is_not_the_wall() {
        let seen = |at: &Placement, face_y: f64| -> Vec<_> {
            let line = |i: i32| f64::from(i) * 0.02 - 2.0;
            let face = (0..=200).map(|i| (line(i), face_y));
            let sides = (0..=100)
                .flat_map(|i| [(-2.0, face_y), (2.0, face_y)].map(|(x, y)| (x, y + away(i, face_y))));
            let away_from_lidar = face.chain(sides);
            let back = at.inverse();
            away_from_lidar
                .map(|(x, y)| back.apply(x, y))
                .filter_map(|(x, y)| PackedPoint::from_metres(x, y))
                .collect()
        };
        fn away(i: i32, face_y: f64) -> f64 {
            // The rooms lie on the sides of the wall that their faces look to.
            if face_y < 0.0 { -0.02 * f64::from(i) } else { 0.02 * f64::from(i) }
        }
        let (below, above) = (Placement::new(0.2, -1.5, 1.2), Placement::new(-0.1, 1.4, -0.4));
        let mut grid = MomentGrid::default();
        grid.add(&below, &seen(&below, -0.06));
        let points = seen(&above, 0.06);
        let found = Aligner::default().align(&mut grid, &points, above);
        // The side walls are in line with those of the other room; nothing else is the same.
        assert!(found.is_none_or(|found| found.inliers < 0.1), "{found:?}");
        grid.add(&above, &points);
        let found = Aligner::default().align(&mut grid, &points, above).unwrap();
        assert!(found.placement.distance_m(&above) < 0.002 && found.inliers > 0.9, "{found:?}");
    }

    #[test]
    fn a_corridor_keeps_the_guess_along_itself() {
        let wall =
            |y: f64| (0..300).filter_map(move |i| PackedPoint::from_metres(f64::from(i) * 0.05 - 7.5, y));
        let points: Vec<_> = wall(1.0).chain(wall(-1.0)).collect();
        let mut grid = MomentGrid::default();
        grid.add(&Placement::IDENTITY, &points);
        let found = Aligner::default().align(&mut grid, &points, Placement::new(0.5, 0.05, 0.01)).unwrap();
        assert!((found.placement.x_m - 0.5).abs() < 0.02 && found.placement.y_m.abs() < 0.002, "{found:?}");
        assert!(found.information[0] < 0.01 * found.information[3]);
    }
}
