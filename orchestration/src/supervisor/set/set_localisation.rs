//! Requests to a localizing set while it runs.

use super::{ProcessSet, SetError};
use crate::supervisor::ModeStatus;
use flockslam_geometry::Pose;
use flockslam_messages::LocalisationOrder;
use flockslam_results::SetMode;

impl ProcessSet {
    /// Whether it localizes in a known map.
    pub fn localizes(&self) -> bool {
        self.set.options.localizes
    }

    /// What it does with its map, as far as it knows itself.
    pub(super) fn mode_status(&self) -> ModeStatus {
        let mode = SetMode { localizes: self.localizes(), ..SetMode::default() };
        ModeStatus { name: mode.name().to_owned(), ..ModeStatus::default() }
    }

    /// The stages go on in this mode: those that run see the mode among the results, those that start in the set's file.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn change_mode(&mut self, mode: &SetMode) -> Result<(), SetError> {
        let failed = |error: flockslam_results::ResultsError| {
            SetError::Stage(flockslam_stage::StageError::file(SetMode::file(&self.runtime.results()), error))
        };
        mode.write(&self.runtime.results()).map_err(failed)?;
        self.set.options.localizes = mode.localizes;
        Ok(self.set.write(&self.runtime.configuration())?)
    }

    /// Lets sync-manager look for the robot in the known map anew.
    ///
    /// # Errors
    /// When the set makes a map, or the bus refuses.
    pub fn relocalize(&self, near: Option<[f64; 5]>) -> Result<(), String> {
        if !self.set.options.localizes {
            return Err(
                "this set makes a map: `flockslam mode localize`, or start it with --localize MAP".to_owned()
            );
        }
        let order =
            near.map_or_else(LocalisationOrder::default, |[x_m, y_m, heading_rad, sigma_m, sigma_rad]| {
                LocalisationOrder { map_from_base: Pose::new(x_m, y_m, heading_rad), sigma_m, sigma_rad }
            });
        self.localisation_orders.send(&order).map_err(|error| error.to_string())
    }
}
