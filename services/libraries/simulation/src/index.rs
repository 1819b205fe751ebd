//! Line segments listed by the squares that they cross, for fast ray casting (Amanatides and Woo 1987).

use super::axis::Axis;
use flockslam_geometry::Point;

/// Side of a square, metres.
const SQUARE_M: f64 = 1.0;
/// Segments are listed in every square that they come this near to, metres: more than rounding can move a beam.
const MARGIN_M: f64 = 1e-6;
/// More squares than this are made larger instead.
const SQUARES_MAX: f64 = 1e6;

/// A straight piece of an outline.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub(super) start: Point,
    pub(super) along: Point,
    pub(super) surface: Surface,
}

/// What an outline is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Surface {
    /// Opaque, higher than any beam.
    #[default]
    Wall,
    /// A beam that meets it obliquely passes through.
    Glass,
    /// Opaque up to this height above the ground, metres: a beam may pass over it.
    Low(f32),
}

/// Segments listed by the squares of a grid, so that a beam meets only those on its way.
#[derive(Clone, Debug)]
pub(super) struct SegmentIndex {
    origin: Point,
    square_m: f64,
    columns: usize,
    rows: usize,
    /// Where the segments of each square begin in `listed`, and one more.
    starts: Vec<u32>,
    listed: Vec<Segment>,
}

impl SegmentIndex {
    pub(super) fn new(segments: &[Segment]) -> Self {
        let (low, high) = bounds(segments);
        let (width_m, height_m) = (high.x_m - low.x_m, high.y_m - low.y_m);
        let square_m = SQUARE_M.max((width_m * height_m / SQUARES_MAX).sqrt());
        let (columns, rows) = ((width_m / square_m) as usize + 1, (height_m / square_m) as usize + 1);
        let mut index = Self { origin: low, square_m, columns, rows, starts: Vec::new(), listed: Vec::new() };
        let mut squares = vec![Vec::new(); columns * rows];
        for segment in segments {
            index.squares_of(segment).for_each(|square| squares[square].push(*segment));
        }
        index.starts.push(0);
        for listed in squares {
            index.listed.extend(listed);
            index.starts.push(index.listed.len() as u32);
        }
        index
    }

    /// Distance to the nearest segment that a beam in `direction` (a unit vector) meets, metres; infinite when it meets none
    /// within about `max_m`. Walks from square to square (Amanatides and Woo 1987).
    pub(super) fn cast(&self, from: Point, direction: Point, max_m: f64) -> f64 {
        self.cast_where(from, direction, max_m, |_, _| true)
    }

    /// Like [`Self::cast`], but counts only hits that `returns` confirms: it is given the segment and its distance, metres.
    pub(super) fn cast_where(
        &self,
        from: Point,
        direction: Point,
        max_m: f64,
        returns: impl Fn(&Segment, f64) -> bool,
    ) -> f64 {
        let mut x = Axis::new((from.x_m - self.origin.x_m) / self.square_m, direction.x_m / self.square_m);
        let mut y = Axis::new((from.y_m - self.origin.y_m) / self.square_m, direction.y_m / self.square_m);
        let (mut nearest_m, mut entered_m) = (f64::INFINITY, 0.0);
        // What is found in a square may lie in a later one: only what is nearer than the next border is surely the first.
        while entered_m <= nearest_m.min(max_m) {
            if let Some(square) = self.square(x.cell, y.cell) {
                let listed = &self.listed[self.starts[square] as usize..self.starts[square + 1] as usize];
                for segment in listed {
                    let at_m = segment.cast(from, direction);
                    if at_m < nearest_m && returns(segment, at_m) {
                        nearest_m = at_m;
                    }
                }
            } else if x.leaves(self.columns) || y.leaves(self.rows) {
                break;
            }
            entered_m = if x.next_m < y.next_m { x.advance() } else { y.advance() };
        }
        nearest_m
    }

    fn square(&self, column: i64, row: i64) -> Option<usize> {
        let (column, row) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
        (column < self.columns && row < self.rows).then_some(row * self.columns + column)
    }

    /// Squares that the segment touches.
    fn squares_of(&self, segment: &Segment) -> impl Iterator<Item = usize> {
        let segment = *segment;
        let (low, high) = bounds(&[segment]);
        let at = |value: f64, origin: f64, count: usize| {
            (((value - origin) / self.square_m).floor().max(0.0) as usize).min(count - 1)
        };
        let columns = at(low.x_m - MARGIN_M, self.origin.x_m, self.columns)
            ..=at(high.x_m + MARGIN_M, self.origin.x_m, self.columns);
        let rows = at(low.y_m - MARGIN_M, self.origin.y_m, self.rows)
            ..=at(high.y_m + MARGIN_M, self.origin.y_m, self.rows);
        rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
            .filter(move |(column, row)| self.touches(&segment, *column, *row))
            .map(|(column, row)| row * self.columns + column)
    }

    /// Whether the line through the segment comes near the square (all of whose corners lie on one side otherwise).
    fn touches(&self, segment: &Segment, column: usize, row: usize) -> bool {
        let half_m = 0.5 * self.square_m + MARGIN_M;
        let centre = Point::new(
            self.origin.x_m + (column as f64 + 0.5) * self.square_m,
            self.origin.y_m + (row as f64 + 0.5) * self.square_m,
        );
        let off = cross(from_to(segment.start, centre), segment.along).abs();
        off <= half_m * (segment.along.x_m.abs() + segment.along.y_m.abs())
    }
}

impl Segment {
    /// A beam p + t·d meets a segment q + u·s where, with × the cross product, t = (q - p)×s / d×s and
    /// u = (q - p)×d / d×s. Returns t, or infinity when they do not meet.
    pub(super) fn cast(&self, from: Point, direction: Point) -> f64 {
        let offset = from_to(from, self.start);
        let inverse = 1.0 / cross(direction, self.along);
        let t = cross(offset, self.along) * inverse;
        let u = cross(offset, direction) * inverse;
        // A parallel beam gives an infinite or undefined u, and no hit.
        if (0.0..=1.0).contains(&u) && t >= 0.0 { t } else { f64::INFINITY }
    }
}

fn bounds(segments: &[Segment]) -> (Point, Point) {
    let ends = segments
        .iter()
        .flat_map(|s| [s.start, Point::new(s.start.x_m + s.along.x_m, s.start.y_m + s.along.y_m)]);
    let infinite = (Point::new(f64::INFINITY, f64::INFINITY), Point::new(-f64::INFINITY, -f64::INFINITY));
    ends.fold(infinite, |(low, high), end| {
        (
            Point::new(low.x_m.min(end.x_m), low.y_m.min(end.y_m)),
            Point::new(high.x_m.max(end.x_m), high.y_m.max(end.y_m)),
        )
    })
}

/// The vector from a to b.
pub(super) fn from_to(a: Point, b: Point) -> Point {
    Point::new(b.x_m - a.x_m, b.y_m - a.y_m)
}

fn cross(a: Point, b: Point) -> f64 {
    a.x_m * b.y_m - a.y_m * b.x_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn segments() -> impl Strategy<Value = Vec<Segment>> {
        let segment =
            (-9.0..9.0f64, -9.0..9.0f64, -6.0..6.0f64, -6.0..6.0f64).prop_map(|(x, y, u, v)| Segment {
                start: Point::new(x.round(), y),
                along: Point::new(u.round(), if u.abs() < 1.0 { v } else { v.round() }),
                surface: Surface::Wall,
            });
        proptest::collection::vec(segment, 1..40)
    }

    proptest! {
        /// Looking at the squares on the way finds to the bit what looking at all segments finds.
        #[test]
        fn the_index_leaves_nothing_out(
            segments in segments(), x in -12.0..12.0f64, y in -12.0..12.0f64, steps in 0..64i32, exact in any::<bool>()
        ) {
            let from = if exact { Point::new(x.round(), y.round()) } else { Point::new(x, y) };
            let (sin, cos) = (f64::from(steps) * std::f64::consts::TAU / 64.0).sin_cos();
            let direction = Point::new(cos, sin);
            let index = SegmentIndex::new(&segments);
            let brute = segments.iter().map(|s| s.cast(from, direction)).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(index.cast(from, direction, f64::INFINITY), brute);
            let near = index.cast(from, direction, 5.0);
            prop_assert!(near == brute || (near > 5.0 && brute > 5.0));
        }
    }
}
