//! The errors of the simulated lidar and wheels.

/// Errors of lidar and wheels: by default those of a usual robot, for tests others.
#[derive(Clone, Debug, PartialEq)]
pub struct Errors {
    /// Standard deviation of a range, metres.
    pub range_sigma_m: f64,
    /// Constant error of all ranges, metres.
    pub range_bias_m: f64,
    /// Share of the beams at the edge of something that give a range between the near and the far surface.
    pub mixed_pixel_share: f64,
    /// Share of the beams that come back without a return (+Inf).
    pub dropout_share: f64,
    /// Standard deviation of the constant relative errors of the odometry's distances and turns.
    pub odometry_scale_error: f64,
    /// Random walk of odometry: metres and degrees (standard deviation) over one metre of driving.
    pub odometry_walk: [f64; 2],
    /// Constant drift of the heading, degrees per metre of driving; its sign is drawn.
    pub heading_drift_deg_m: f64,
}

impl Default for Errors {
    /// What small rotating lidars and wheels on a floor have.
    fn default() -> Self {
        Self {
            range_sigma_m: 0.01,
            range_bias_m: 0.005,
            mixed_pixel_share: 0.2,
            dropout_share: 0.01,
            odometry_scale_error: 0.02,
            odometry_walk: [0.01, 0.5],
            heading_drift_deg_m: 0.0,
        }
    }
}

impl Errors {
    /// A laser scanner of longer range, and good wheels on rough ground that drift to one side.
    pub fn outdoors() -> Self {
        Self {
            range_sigma_m: 0.02,
            odometry_scale_error: 0.01,
            odometry_walk: [0.02, 0.3],
            heading_drift_deg_m: 0.01,
            ..Self::default()
        }
    }

    /// A lidar without errors on wheels that have some.
    pub fn without_lidar() -> Self {
        Self::default().of_wheels()
    }

    /// Only those of the wheels.
    pub(super) fn of_wheels(self) -> Self {
        Self { range_sigma_m: 0.0, range_bias_m: 0.0, mixed_pixel_share: 0.0, dropout_share: 0.0, ..self }
    }
}
