//! What a set that localizes is asked while it runs.

use super::ProcessSet;
use flockslam_geometry::Pose;
use flockslam_messages::LocalisationOrder;

impl ProcessSet {
    /// Whether it localizes in a known map.
    pub fn localizes(&self) -> bool {
        self.set.options.localizes
    }

    /// Lets sync-manager look for the robot in the known map anew.
    ///
    /// # Errors
    /// When the set makes a map, or the bus refuses.
    pub fn relocalize(&self, near: Option<[f64; 5]>) -> Result<(), String> {
        if !self.set.options.localizes {
            return Err("this set makes a map: start it with --localize MAP to localize".to_owned());
        }
        let order =
            near.map_or_else(LocalisationOrder::default, |[x_m, y_m, heading_rad, sigma_m, sigma_rad]| {
                LocalisationOrder { map_from_base: Pose::new(x_m, y_m, heading_rad), sigma_m, sigma_rad }
            });
        self.localisation_orders.send(&order).map_err(|error| error.to_string())
    }
}
