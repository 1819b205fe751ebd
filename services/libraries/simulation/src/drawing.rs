//! Draws floor plans from walls, rectangles and rounds.

use super::floor_plan::{FloorPlan, Outline};
use super::index::Surface;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{cos, sin, sin_cos};
use std::f64::consts::TAU;

/// Thickness of walls, metres.
pub(super) const WALL_M: f64 = 0.2;

/// A floor plan while it is drawn. Lengths are metres; the lower left corner is the origin.
#[derive(Clone, Debug)]
pub(super) struct Drawing {
    size_m: (f64, f64),
    outlines: Vec<Outline>,
    /// What the next outlines are made of.
    surface: Surface,
}

impl Drawing {
    /// An empty sheet.
    pub(super) fn new(size_m: (f64, f64)) -> Self {
        Self { size_m, outlines: Vec::new(), surface: Surface::Wall }
    }

    /// The next outlines are made of this.
    pub(super) fn made_of(&mut self, surface: Surface) -> &mut Self {
        self.surface = surface;
        self
    }

    /// A wall along an axis: x and y of both ends of its centre line.
    pub(super) fn wall(&mut self, [x0, y0, x1, y1]: [f64; 4]) {
        let half = WALL_M / 2.0;
        let (west, east, south, north) =
            (x0.min(x1) - half, x0.max(x1) + half, y0.min(y1) - half, y0.max(y1) + half);
        let corners = [(west, south), (east, south), (east, north), (west, north)];
        self.outline(corners.map(|(x, y)| Point::new(x, y)).to_vec());
    }

    /// The four walls around the sheet.
    pub(super) fn outer_walls(&mut self) {
        let (width, height) = self.size_m;
        self.wall([0.0, 0.0, width, 0.0]);
        self.wall([width, 0.0, width, height]);
        self.wall([0.0, height, width, height]);
        self.wall([0.0, 0.0, 0.0, height]);
    }

    /// A rectangle: centre x and y, length, width, and its turn in degrees.
    pub(super) fn rectangle(&mut self, [x, y, length, width, turn_deg]: [f64; 5]) {
        self.outline(rectangle_corners([x, y, length, width, turn_deg]).to_vec());
    }

    /// A pillar, a trunk or a round table: centre and radius.
    pub(super) fn round(&mut self, [x, y, radius]: [f64; 3]) {
        let corner = |i: u32| f64::from(i) * TAU / 8.0;
        let corners = (0..8)
            .map(corner)
            .map(|angle| Point::new(x + radius * cos(angle), y + radius * sin(angle)))
            .collect();
        self.outline(corners);
    }

    fn outline(&mut self, corners: Vec<Point>) {
        self.outlines.push(Outline { corners, surface: self.surface });
    }

    /// The plan, with the points that its tour visits.
    pub(super) fn finish(self, tour: &[[f64; 2]]) -> FloorPlan {
        let way_points = tour.iter().map(|[x, y]| Point::new(*x, *y)).collect();
        FloorPlan::new(self.size_m, &self.outlines, way_points)
    }
}

/// Corners of a rectangle: centre x and y, length, width, and its turn in degrees.
pub(super) fn rectangle_corners([x, y, length, width, turn_deg]: [f64; 5]) -> [Point; 4] {
    let (sin, cos) = sin_cos(turn_deg.to_radians());
    [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
        .map(|(u, v)| (u * length, v * width))
        .map(|(u, v)| Point::new(x + cos * u - sin * v, y + sin * u + cos * v))
}
