//! Points in the plane and distances between them.

use crate::elementary::hypot;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A point in the plane, metres.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Point {
    /// Metres along x.
    pub x_m: f64,
    /// Metres along y.
    pub y_m: f64,
}

impl Point {
    /// The point at (x, y) metres.
    #[inline]
    pub const fn new(x_m: f64, y_m: f64) -> Self {
        Self { x_m, y_m }
    }

    /// Euclidean distance to `other`, metres.
    pub fn distance_m(self, other: Point) -> f64 {
        hypot(self.x_m - other.x_m, self.y_m - other.y_m)
    }

    /// Distance from the origin, metres.
    pub fn norm_m(self) -> f64 {
        hypot(self.x_m, self.y_m)
    }
}
