//! The place that is the best at one search after the other. What a robot sees changes as it drives on, so that a place which merely looks
//! like it stays the best for some metres only.

use crate::place_search::is_same;
use flockslam_registration::cloud::Placement;

/// The best place of the last search.
#[derive(Clone, Copy, Debug)]
struct Leading {
    map_from_odom: Placement,
    /// The way until it was the best first, metres.
    since_m: f64,
}

/// Since when the best place has been the best.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LeadingPlace(Option<Leading>);

impl LeadingPlace {
    /// Takes the best place of a search, where the robot is by the front end, and its way until then, metres. Gives over how much of that the
    /// place has been the best, metres.
    pub(crate) fn after(&mut self, best: &Placement, odom_from_base: &Placement, way_m: f64) -> f64 {
        // The front end may have drifted since the last search, not since the first.
        let map_from_odom = best.compose(odom_from_base.inverse());
        let is_as_before = |last: &Leading| is_same(&last.map_from_odom.compose(*odom_from_base), best);
        let since_m = self.0.filter(is_as_before).map_or(way_m, |last| last.since_m);
        self.0 = Some(Leading { map_from_odom, since_m });
        way_m - since_m
    }

    /// A search has found no place.
    pub(crate) fn end(&mut self) {
        self.0 = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_leads_for_as_long_as_no_other_is_the_best_though_odometry_drifts() {
        let mut leading = LeadingPlace::default();
        let search = |leading: &mut LeadingPlace, step: i32, off_m: f64| {
            let way_m = f64::from(step);
            // Odometry is too short by a tenth.
            let odom = Placement::new(0.9 * way_m, 0.0, 0.0);
            leading.after(&Placement::new(20.0 + way_m, 5.0 + off_m, 0.0), &odom, way_m)
        };
        let leads_m: Vec<f64> = (0..12).map(|step| search(&mut leading, step, 0.0)).collect();
        assert_eq!(leads_m, (0..12).map(f64::from).collect::<Vec<_>>());
        assert_eq!(search(&mut leading, 12, 30.0), 0.0, "another place");
        assert_eq!(search(&mut leading, 13, 30.0), 1.0);
        leading.end();
        assert_eq!(search(&mut leading, 14, 30.0), 0.0, "nothing was found in between");
    }
}
