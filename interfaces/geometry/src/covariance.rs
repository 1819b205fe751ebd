use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Symmetric 3 × 3 covariance of a pose (x, y, heading), upper triangle: m², m·rad, rad².
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
}
