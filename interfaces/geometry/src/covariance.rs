//! The covariance of a pose in SE(2), and how well the pose is known along its worst direction.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Symmetric 3 × 3 covariance of a pose (x, y, heading), upper triangle: m², m·rad, rad².
///
/// ```
/// use flockslam_geometry::Covariance;
///
/// // In a corridor along x: 2 m along it, 5 cm across.
/// let corridor = Covariance { xx: 4.0, yy: 0.0025, tt: 1e-4, ..Covariance::default() };
/// assert!((corridor.position_std_m() - 2.0).abs() < 1e-12);
/// assert!((Covariance::diagonal(0.3, 0.1).position_std_m() - 0.3).abs() < 1e-12);
/// ```
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Covariance {
    /// Variance of x, m².
    pub xx: f64,
    /// Covariance of x and y, m².
    pub xy: f64,
    /// Covariance of x and heading, m·rad.
    pub xt: f64,
    /// Variance of y, m².
    pub yy: f64,
    /// Covariance of y and heading, m·rad.
    pub yt: f64,
    /// Variance of heading, rad².
    pub tt: f64,
}

impl Covariance {
    /// Independent errors with these standard deviations.
    pub fn diagonal(sigma_xy_m: f64, sigma_heading_rad: f64) -> Self {
        let position = sigma_xy_m * sigma_xy_m;
        Self { xx: position, yy: position, tt: sigma_heading_rad * sigma_heading_rad, ..Self::default() }
    }

    /// Standard deviation of the position along the direction in which it is known worst, m.
    pub fn position_std_m(&self) -> f64 {
        let (middle, half) = ((self.xx + self.yy) / 2.0, (self.xx - self.yy) / 2.0);
        (middle + (half * half + self.xy * self.xy).sqrt()).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_direction_of_a_position_is_found_however_it_is_turned() {
        assert!((Covariance::diagonal(0.3, 0.1).position_std_m() - 0.3).abs() < 1e-12);
        // Axes of 2 m and 1 m, turned all the way round.
        for degrees in 0..360 {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            let turned = Covariance {
                xx: 4.0 * cos * cos + sin * sin,
                xy: 3.0 * sin * cos,
                yy: 4.0 * sin * sin + cos * cos,
                ..Covariance::default()
            };
            assert!((turned.position_std_m() - 2.0).abs() < 1e-12, "turned by {degrees}°");
        }
    }
}
