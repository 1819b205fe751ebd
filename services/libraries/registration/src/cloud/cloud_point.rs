//! Points of scans in four bytes each.

/// A point of a scan in the robot's frame, in whole millimetres: four bytes, so that every scan of a run can
/// be kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PackedPoint {
    /// Millimetres forward.
    pub x_mm: i16,
    /// Millimetres to the left.
    pub y_mm: i16,
}

impl PackedPoint {
    /// The farthest coordinate that fits, metres.
    pub const REACH_M: f64 = 32.7;

    /// Packs a point given in metres; `None` when a coordinate is beyond [`Self::REACH_M`].
    pub fn from_metres(x_m: f64, y_m: f64) -> Option<Self> {
        let fits = x_m.abs() <= Self::REACH_M && y_m.abs() <= Self::REACH_M;
        fits.then(|| Self { x_mm: (x_m * 1000.0).round() as i16, y_mm: (y_m * 1000.0).round() as i16 })
    }

    /// Metres forward.
    #[inline]
    pub fn x_m(self) -> f64 {
        f64::from(self.x_mm) * 1e-3
    }

    /// Metres to the left.
    #[inline]
    pub fn y_m(self) -> f64 {
        f64::from(self.y_mm) * 1e-3
    }

    /// Squared distance from the robot, m².
    #[inline]
    pub fn squared_range_m2(self) -> f64 {
        self.x_m() * self.x_m() + self.y_m() * self.y_m()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_half_a_millimetre_and_refuses_what_does_not_fit() {
        let point = PackedPoint::from_metres(12.3456, -0.0004).unwrap();
        assert_eq!((point.x_mm, point.y_mm), (12_346, 0));
        assert!((point.x_m() - 12.346).abs() < 1e-9);
        assert_eq!(PackedPoint::from_metres(32.8, 0.0), None);
        assert_eq!(PackedPoint::from_metres(f64::NAN, 0.0), None);
    }
}
