//! Worlds made of the pixels of a map picture, and the reasons for which there is no simulation.

use super::axis::Axis;
use super::planner::PlanningGrid;
use flockslam_geometry::Point;

/// Cells of the planner are at least this large, metres.
const PLANNING_CELL_M: f64 = 0.1;
/// A pixel darker than this is not free (nav2 trinary maps with free_thresh 0.196: unknown, 205, is not free).
const FREE_GREY: u8 = 206;

/// Why there is no simulation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A setting is out of its range.
    #[error("simulation.{0}")]
    Setting(&'static str),
    /// The pixels do not fill the picture.
    #[error("a picture of {width} × {height} pixels came with {found}")]
    PixelCount {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Pixels that came.
        found: usize,
    },
    /// The size of a pixel makes no sense.
    #[error("a pixel of {0} m is not a map's")]
    Resolution(f64),
    /// No free space that is wide enough.
    #[error("the world has no free space that a robot could drive through")]
    NoRoom,
}

/// A world of square pixels: what is not known to be free is solid.
#[derive(Clone, Debug)]
pub struct ImageWorld {
    width: usize,
    height: usize,
    resolution_m: f64,
    /// One bit for each pixel, row by row, the lowest y first.
    solid: Vec<u64>,
}

impl ImageWorld {
    /// A world from the grey values of a nav2 map picture (254 free, 205 unknown, 0 occupied), row by row from the top as
    /// pictures are stored. The world's origin is the lower left corner; a pixel is `resolution_m` metres wide.
    ///
    /// # Errors
    /// When the number of pixels does not fit the size, or the resolution is not between 1 mm and 10 m.
    pub fn from_grey(
        width: usize,
        height: usize,
        resolution_m: f64,
        pixels: &[u8],
    ) -> Result<Self, SimulationError> {
        if width.checked_mul(height) != Some(pixels.len()) || pixels.is_empty() {
            return Err(SimulationError::PixelCount { width, height, found: pixels.len() });
        }
        if !(1e-3..=10.0).contains(&resolution_m) {
            return Err(SimulationError::Resolution(resolution_m));
        }
        let rows_upward = pixels.chunks_exact(width).rev();
        let mut solid = vec![0; pixels.len().div_ceil(64)];
        for (index, _) in rows_upward.flatten().enumerate().filter(|(_, grey)| **grey < FREE_GREY) {
            solid[index / 64] |= 1 << (index % 64);
        }
        Ok(Self { width, height, resolution_m, solid })
    }

    /// Walks from pixel to pixel along the beam (Amanatides and Woo 1987) to the face of the first solid one.
    pub(super) fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        let mut x = Axis::new(from.x_m / self.resolution_m, direction.x_m / self.resolution_m);
        let mut y = Axis::new(from.y_m / self.resolution_m, direction.y_m / self.resolution_m);
        let mut distance_m = 0.0;
        while distance_m <= max_m {
            if self.is_solid(x.cell, y.cell)? {
                return Some(distance_m);
            }
            distance_m = if x.next_m < y.next_m { x.advance() } else { y.advance() };
        }
        None
    }

    /// `None` outside of the picture.
    fn is_solid(&self, x: i64, y: i64) -> Option<bool> {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        (x < self.width && y < self.height).then(|| self.is_set(y * self.width + x))
    }

    fn is_set(&self, index: usize) -> bool {
        self.solid[index / 64] >> (index % 64) & 1 != 0
    }

    pub(super) fn planning_grid(&self) -> PlanningGrid {
        let pixels_per_cell = (PLANNING_CELL_M / self.resolution_m - 1e-6).ceil().max(1.0) as usize;
        // A rim of solid cells keeps the robot inside.
        let cells = |pixels: usize| pixels.div_ceil(pixels_per_cell) + 1;
        let (width, height) = (cells(self.width), cells(self.height));
        let mut solid = vec![false; width * height];
        for index in (0..self.width * self.height).filter(|index| self.is_set(*index)) {
            let (x, y) = (index % self.width / pixels_per_cell, index / self.width / pixels_per_cell);
            solid[y * width + x] = true;
        }
        PlanningGrid::new(width, height, self.resolution_m * pixels_per_cell as f64, solid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of 4 × 3 m with a pillar, 0.1 m pixels.
    fn room() -> ImageWorld {
        let grey = |(x, row): (usize, usize)| {
            let pillar = (20..22).contains(&x) && (9..11).contains(&row);
            if x == 0 || x == 39 || row == 0 || row == 29 || pillar { 0 } else { 254 }
        };
        let pixels: Vec<u8> = (0..40 * 30).map(|i| grey((i % 40, i / 40))).collect();
        ImageWorld::from_grey(40, 30, 0.1, &pixels).unwrap()
    }

    #[test]
    fn beams_end_at_the_faces_of_pixels() {
        let world = room();
        let from = Point::new(1.0, 1.0);
        for (x, y, expected_m) in [(1.0, 0.0, 2.9), (-1.0, 0.0, 0.9), (0.0, 1.0, 1.9), (0.0, -1.0, 0.9)] {
            let found_m = world.cast(from, Point::new(x, y), 10.0).unwrap();
            assert!((found_m - expected_m).abs() < 1e-9, "{x} {y}: {found_m}");
        }
        // The pillar stands in rows 9 and 10 from the top: y from 1.9 to 2.1 m.
        let diagonal = Point::new(0.5f64.sqrt(), 0.5f64.sqrt());
        assert!(
            (world.cast(Point::new(1.05, 1.0), diagonal, 10.0).unwrap() - 0.95 * 2.0f64.sqrt()).abs() < 1e-9
        );
        assert_eq!(world.cast(from, Point::new(1.0, 0.0), 2.0), None);
        assert_eq!(world.cast(Point::new(-1.0, 1.0), Point::new(1.0, 0.0), 2.0), None);
    }

    #[test]
    fn pictures_that_do_not_fit_are_refused() {
        assert!(matches!(ImageWorld::from_grey(3, 3, 0.1, &[0; 8]), Err(SimulationError::PixelCount { .. })));
        assert!(matches!(ImageWorld::from_grey(0, 3, 0.1, &[]), Err(SimulationError::PixelCount { .. })));
        assert!(matches!(ImageWorld::from_grey(1, 1, f64::NAN, &[0]), Err(SimulationError::Resolution(_))));
    }
}
