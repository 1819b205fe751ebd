//! Worlds made of line segments: ray casting in them, and the grid that ways are planned on.

use super::index::{Segment, SegmentIndex, Surface, from_to};
use super::outdoors::Outdoors;
use super::planner::PlanningGrid;
use flockslam_geometry::Point;

/// Cells of the planner, metres: indoors, and outdoors where there is more room.
const PLANNING_CELLS_M: (f64, f64) = (0.1, 0.25);
/// Low things up to this height are no obstacle, metres.
const STEP_M: f32 = 0.2;

/// A closed outline and what it is made of.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    pub(super) corners: Vec<Point>,
    pub(super) surface: Surface,
}

/// A world made of line segments.
#[derive(Clone, Debug)]
pub struct FloorPlan {
    size_m: (f64, f64),
    segments: Vec<Segment>,
    index: SegmentIndex,
    way_points: Vec<Point>,
    outdoors: Option<Outdoors>,
}

impl FloorPlan {
    /// A world of closed outlines. The robot stays between the origin and `size_m`.
    pub(super) fn new(size_m: (f64, f64), outlines: &[Outline], way_points: Vec<Point>) -> Self {
        let segments: Vec<_> = outlines.iter().flat_map(sides).collect();
        let index = SegmentIndex::new(&segments);
        Self { size_m, segments, index, way_points, outdoors: None }
    }

    /// The same plan on uneven ground, with plants.
    pub(super) fn outdoors(self, outdoors: Outdoors) -> Self {
        Self { outdoors: Some(outdoors), ..self }
    }

    /// What is there besides the outlines, if the plan is outdoors.
    pub(super) fn open_air(&self) -> Option<&Outdoors> {
        self.outdoors.as_ref()
    }

    /// Distance to what a beam in `direction` hits first and that `returns` confirms: see [`SegmentIndex::cast_where`].
    pub(super) fn cast_where(
        &self,
        from: Point,
        direction: Point,
        max_m: f64,
        returns: impl Fn(&Segment, f64) -> bool,
    ) -> f64 {
        self.index.cast_where(from, direction, max_m, returns)
    }

    /// Distance to what a beam in `direction` hits first.
    pub(super) fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        let nearest_m = self.index.cast(from, direction, max_m);
        (nearest_m <= max_m).then_some(nearest_m)
    }

    pub(super) fn way_points(&self) -> &[Point] {
        &self.way_points
    }

    pub(super) fn planning_grid(&self) -> PlanningGrid {
        let cell_m = if self.outdoors.is_some() { PLANNING_CELLS_M.1 } else { PLANNING_CELLS_M.0 };
        let cells = |metres: f64| (metres / cell_m).ceil() as usize + 1;
        let (width, height) = (cells(self.size_m.0), cells(self.size_m.1));
        let mut solid = vec![false; width * height];
        let plants = self.outdoors.iter().flat_map(Outdoors::outlines);
        let stands =
            |segment: &Segment| !matches!(segment.surface, Surface::Low(height_m) if height_m <= STEP_M);
        for segment in self.segments.iter().copied().chain(plants).filter(stands) {
            let steps = (segment.along.norm_m() / (0.3 * cell_m)).ceil() as usize;
            for step in 0..=steps {
                let share = step as f64 / steps as f64;
                let x = (segment.start.x_m + share * segment.along.x_m) / cell_m;
                let y = (segment.start.y_m + share * segment.along.y_m) / cell_m;
                if x >= 0.0 && y >= 0.0 && (x as usize) < width && (y as usize) < height {
                    solid[y as usize * width + x as usize] = true;
                }
            }
        }
        PlanningGrid::new(width, height, cell_m, solid)
    }

    /// Distance from a point to the nearest wall or piece of furniture, metres.
    #[cfg(test)]
    pub(super) fn distance_m(&self, point: Point) -> f64 {
        let to_segment = |segment: &Segment| {
            let offset = Point::new(point.x_m - segment.start.x_m, point.y_m - segment.start.y_m);
            let dot = offset.x_m * segment.along.x_m + offset.y_m * segment.along.y_m;
            let share = (dot / segment.along.norm_m().powi(2)).clamp(0.0, 1.0);
            offset.distance_m(Point::new(share * segment.along.x_m, share * segment.along.y_m))
        };
        self.segments.iter().map(to_segment).fold(f64::INFINITY, f64::min)
    }
}

/// The sides of an outline, which is closed.
pub(super) fn sides(outline: &Outline) -> impl Iterator<Item = Segment> {
    let Outline { corners, surface } = outline;
    let ends = corners.iter().cycle().skip(1);
    corners.iter().zip(ends).map(|(start, end)| Segment {
        start: *start,
        along: from_to(*start, *end),
        surface: *surface,
    })
}

#[cfg(test)]
mod tests {
    use crate::built_in::office;
    use flockslam_geometry::Point;
    use std::f64::consts::TAU;

    #[test]
    fn beams_end_at_the_faces_of_walls() {
        let plan = office();
        let from = Point::new(7.0, 6.8);
        let east = Point::new(1.0, 0.0);
        assert_eq!(plan.cast(from, Point::new(0.0, -1.0), 20.0), Some(6.8 - 6.1));
        assert!((plan.cast(from, east, 40.0).unwrap() - (29.9 - 7.0)).abs() < 1e-9);
        assert_eq!(plan.cast(from, east, 12.0), None);
    }

    #[test]
    fn no_beam_leaves_the_building() {
        let plan = office();
        for point in plan.way_points() {
            for i in 0..720 {
                let (sin, cos) = (f64::from(i) * TAU / 720.0 + 1e-3).sin_cos();
                assert!(plan.cast(*point, Point::new(cos, sin), 40.0).is_some(), "{point:?} {i}");
            }
        }
    }
}
