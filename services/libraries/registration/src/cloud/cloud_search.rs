//! Branch and bound for the pose of a cloud in a window (Olson 2009; Hess et al. 2016). Takes a pooled field and points,
//! gives the best pose and its score.

use super::{MomentGrid, Placement, PooledField};

/// A search window: a square and a range of headings around a guess.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Half the side of the square, metres.
    pub reach_m: f64,
    /// Half the range of headings, radians.
    pub turn_rad: f64,
}

/// A pose found by a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The pose, to about a cell.
    pub placement: Placement,
    /// Mean over the points of exp(-d²/2σ²).
    pub score: f64,
}

/// The best pose of a cloud within a window, by branch and bound over translations and a sweep over headings
/// (Olson 2009; Hess et al. 2016). Keeps its buffers between searches.
#[derive(Default)]
pub struct Searcher {
    headings: Vec<f64>,
    points: Vec<(f64, f64)>,
    cells: Vec<(i16, i16)>,
    open: Vec<Branch>,
    sums_max: Option<u64>,
    gave_up: bool,
}

/// A square of translations at one heading, with the bound on its sum.
#[derive(Clone, Copy, Default)]
struct Branch {
    bound: u32,
    heading: u32,
    dx: i32,
    dy: i32,
}

/// Squares beside each other that are looked at together.
const ALONG: usize = 8;

/// Level to start from: squares of about a quarter of the reach.
fn top_level(reach: i32) -> usize {
    let quarter = (reach / 4).max(1);
    (quarter.ilog2() as usize).clamp(2, 6)
}

impl Searcher {
    /// A searcher that gives up after looking at this many squares: in a corridor, where a cloud fits nearly as well all
    /// along, an exact search evaluates almost every pose.
    pub fn bounded(sums_max: u64) -> Self {
        Self { sums_max: Some(sums_max), ..Self::default() }
    }

    /// Whether the last search ended before it had looked everywhere.
    pub fn gave_up(&self) -> bool {
        self.gave_up
    }

    /// Looks for the cloud `points` (metres, its own frame) in `field` around `guess`, and gives the best
    /// pose if its score reaches `score_min`. `exclude` takes out the neighbourhood of a pose: what is left
    /// is its runner-up.
    pub fn best(
        &mut self,
        field: &PooledField,
        points: &[(f64, f64)],
        guess: Placement,
        window: Window,
        score_min: f64,
        exclude: Option<(Placement, Window)>,
    ) -> Option<Found> {
        self.rotate_all(points, guess, window);
        let count = points.len();
        let reach = (window.reach_m / MomentGrid::CELL_M).ceil() as i32;
        let full = 255.0 * count as f64;
        let mut search = Descent {
            field,
            cells: &self.cells,
            count,
            reach,
            best: Branch { bound: ((score_min * full).ceil() as u32).max(1) - 1, ..Branch::default() },
            excluded: None,
            sums_left: self.sums_max.unwrap_or(u64::MAX),
        };
        search.excluded =
            exclude.map(|(around, apart)| Excluded { around, apart, guess, headings: &self.headings });
        let level = top_level(reach).min(field.top());
        self.open.clear();
        for heading in 0..self.headings.len() as u32 {
            search.open_squares(level, heading, &mut self.open);
        }
        // Equal bounds keep the order in which they were opened: the result does not depend on the sort.
        self.open.sort_by_key(|branch| std::cmp::Reverse(branch.bound));
        let mut found = false;
        for branch in &self.open {
            if branch.bound <= search.best.bound {
                break;
            }
            found |= search.descend(level, *branch);
        }
        self.gave_up = search.sums_left == 0;
        let Branch { bound, heading, dx, dy } = search.best;
        found.then(|| Found {
            placement: shifted(guess, self.headings[heading as usize], dx, dy),
            score: f64::from(bound) / full,
        })
    }

    /// Works out the cells of all points at all headings of the window, the guess's own first.
    fn rotate_all(&mut self, points: &[(f64, f64)], guess: Placement, window: Window) {
        let far = points.iter().map(|&(x, y)| x * x + y * y).fold(0.0, |sum, v| sum + v)
            / points.len().max(1) as f64;
        // Turning by a step moves a point at one and a half times the root mean square range by about a cell.
        let step = (MomentGrid::CELL_M / (1.5 * far.sqrt()).max(1.0)).clamp(0.004, 0.03);
        let steps = (window.turn_rad / step).ceil() as i32;
        self.headings.clear();
        self.cells.clear();
        mix(points, &mut self.points);
        for i in 0..=2 * steps {
            // 0, 1, -1, 2, -2 …: among equals the heading nearest to the guess wins.
            let signed = if i % 2 == 1 { (i + 1) / 2 } else { -(i / 2) };
            let turn = f64::from(signed) * step;
            let at = Placement::new(guess.x_m, guess.y_m, guess.heading_rad + turn);
            self.headings.push(turn);
            self.cells.extend(self.points.iter().map(|&(x, y)| {
                let (x, y) = at.apply(x, y);
                (PooledField::cell(x) as i16, PooledField::cell(y) as i16)
            }));
        }
    }
}

/// The points in an order in which those beside each other are far apart: a few of them tell soon that a square holds nothing.
fn mix(points: &[(f64, f64)], mixed: &mut Vec<(f64, f64)>) {
    let stride = (points.len() as f64).sqrt().ceil().max(1.0) as usize;
    mixed.clear();
    mixed.extend((0..stride).flat_map(|first| points.iter().skip(first).step_by(stride)));
}

/// The guess, turned and shifted by whole cells.
fn shifted(guess: Placement, turn: f64, dx: i32, dy: i32) -> Placement {
    let cell = MomentGrid::CELL_M;
    Placement::new(
        guess.x_m + f64::from(dx) * cell,
        guess.y_m + f64::from(dy) * cell,
        guess.heading_rad + turn,
    )
}

/// A neighbourhood that a search leaves out.
struct Excluded<'a> {
    around: Placement,
    apart: Window,
    guess: Placement,
    headings: &'a [f64],
}

/// One search that descends the pyramid.
struct Descent<'a> {
    field: &'a PooledField,
    cells: &'a [(i16, i16)],
    count: usize,
    reach: i32,
    best: Branch,
    excluded: Option<Excluded<'a>>,
    sums_left: u64,
}

impl Descent<'_> {
    fn cells_at(&self, heading: u32) -> &[(i16, i16)] {
        &self.cells[heading as usize * self.count..(heading as usize + 1) * self.count]
    }

    fn open_squares(&mut self, level: usize, heading: u32, open: &mut Vec<Branch>) {
        let stride = 1 << level;
        for dy in (-self.reach..=self.reach).step_by(stride) {
            for first in (-self.reach..=self.reach).step_by(ALONG * stride) {
                if self.sums_left == 0 {
                    return;
                }
                let enough = self.best.bound + 1;
                let [bounds] = self.field.sums::<ALONG, 1>(level, self.cells_at(heading), first, dy, enough);
                for (dx, bound) in (first..=self.reach).step_by(stride).zip(bounds) {
                    let bound = self.allowed(bound);
                    if bound > self.best.bound {
                        open.push(Branch { bound, heading, dx, dy });
                    }
                }
            }
        }
    }

    /// Counts a square that was looked at, and gives its bound; 0, which no search follows, when the work allowed is done.
    fn allowed(&mut self, bound: u32) -> u32 {
        let is_allowed = self.sums_left > 0;
        self.sums_left -= u64::from(is_allowed);
        if is_allowed { bound } else { 0 }
    }

    /// Searches a square; true when it holds a new best.
    fn descend(&mut self, level: usize, branch: Branch) -> bool {
        if level == 0 {
            let better = branch.bound > self.best.bound && !self.is_excluded(&branch);
            if better {
                self.best = branch;
            }
            return better;
        }
        if self.sums_left == 0 {
            return false;
        }
        let half = 1 << (level - 1);
        let (cells, enough) = (self.cells_at(branch.heading), self.best.bound + 1);
        let bounds = self.field.sums::<2, 2>(level - 1, cells, branch.dx, branch.dy, enough);
        let mut children = [Branch::default(); 4];
        for (i, child) in children.iter_mut().enumerate() {
            let (dx, dy) = (branch.dx + half * (i as i32 & 1), branch.dy + half * (i as i32 >> 1));
            let inside = dx <= self.reach && dy <= self.reach;
            let bound = if inside { self.allowed(bounds[i >> 1][i & 1]) } else { 0 };
            *child = Branch { bound, heading: branch.heading, dx, dy };
        }
        children.sort_by_key(|branch| std::cmp::Reverse(branch.bound));
        let mut found = false;
        for child in children {
            if child.bound > self.best.bound {
                found |= self.descend(level - 1, child);
            }
        }
        found
    }

    fn is_excluded(&self, branch: &Branch) -> bool {
        self.excluded.as_ref().is_some_and(|excluded| {
            let at =
                shifted(excluded.guess, excluded.headings[branch.heading as usize], branch.dx, branch.dy);
            at.distance_m(&excluded.around) < excluded.apart.reach_m
                && at.turn_rad(&excluded.around) < excluded.apart.turn_rad
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An L-shaped room's outline, a point every 5 cm.
    fn outline() -> Vec<(f64, f64)> {
        let corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (2.5, 3.0), (2.5, 5.0), (0.0, 5.0), (0.0, 0.0)];
        let mut points = Vec::new();
        for pair in corners.windows(2) {
            let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
            let length = f64::abs(x1 - x0) + f64::abs(y1 - y0);
            let steps = (length / 0.05) as i32;
            points.extend(
                (0..steps)
                    .map(|i| f64::from(i) / f64::from(steps))
                    .map(|t| (x0 + t * (x1 - x0), y0 + t * (y1 - y0))),
            );
        }
        points
    }

    fn seen_from(at: Placement) -> Vec<(f64, f64)> {
        let back = at.inverse();
        outline().iter().step_by(3).map(|&(x, y)| back.apply(x, y)).collect()
    }

    #[test]
    fn finds_the_pose_in_a_wide_window() {
        let field = PooledField::new(&outline());
        let mut searcher = Searcher::default();
        for (i, truth) in [(2.0, 1.5, 0.4), (1.0, 4.0, -2.0), (5.0, 1.0, 3.0)].into_iter().enumerate() {
            let truth = Placement::new(truth.0, truth.1, truth.2);
            let guess =
                Placement::new(truth.x_m + 3.3, truth.y_m - 2.1, truth.heading_rad + 0.5 - 0.3 * i as f64);
            let window = Window { reach_m: 5.0, turn_rad: 0.7 };
            let found = searcher.best(&field, &seen_from(truth), guess, window, 0.5, None).unwrap();
            assert!(
                found.placement.distance_m(&truth) < 0.11 && found.placement.turn_rad(&truth) < 0.03,
                "{found:?}"
            );
            assert!(found.score > 0.7);
            let apart = Window { reach_m: 0.5, turn_rad: 0.17 };
            let exclude = Some((found.placement, apart));
            let second = searcher.best(&field, &seen_from(truth), guess, window, 0.85 * found.score, exclude);
            assert_eq!(second, None, "an L-shaped room is unambiguous");
        }
    }

    #[test]
    fn agrees_with_trying_every_pose() {
        let field = PooledField::new(&outline());
        let cloud = seen_from(Placement::new(2.0, 1.5, 0.4));
        let window = Window { reach_m: 1.0, turn_rad: 0.0 };
        let guess = Placement::new(2.43, 1.12, 0.41);
        let found = Searcher::default().best(&field, &cloud, guess, window, 0.1, None).unwrap();
        let cells: Vec<_> = cloud.iter().map(|&(x, y)| guess.apply(x, y)).collect();
        let cells: Vec<_> =
            cells.iter().map(|&(x, y)| (PooledField::cell(x) as i16, PooledField::cell(y) as i16)).collect();
        let tried = (-10..=10).flat_map(|dy| (-10..=10).map(move |dx| (dx, dy)));
        let most = tried.map(|(dx, dy)| field.sums::<1, 1>(0, &cells, dx, dy, 0)[0][0]).max().unwrap();
        assert!((found.score - f64::from(most) / (255.0 * cells.len() as f64)).abs() < 1e-12);
    }

    #[test]
    fn gives_nothing_where_nothing_fits() {
        let field = PooledField::new(&[(0.0, 0.0), (9.0, 9.0)]);
        let window = Window { reach_m: 1.0, turn_rad: 0.1 };
        assert_eq!(
            Searcher::default().best(&field, &outline(), Placement::IDENTITY, window, 0.5, None),
            None
        );
    }
}
