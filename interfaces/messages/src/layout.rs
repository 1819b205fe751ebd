//! The message of a new layout: the correction of the front end after a closed submap.

use crate::message::message;
use flockslam_geometry::Pose;

message! {
    /// What sync-manager concluded after a closed submap, as far as the front end needs it; the whole layout lies in
    /// the store.
    pub struct LayoutHeader = "flockslam/layout/v2" {
        /// The new correction of the front end.
        pub map_from_odom: Pose,
        /// Cold start that it belongs to.
        pub epoch: u32,
        /// Submap after whose closing it was computed: finished up to and including this one.
        pub submap: u32,
        /// Counts the layouts of this epoch from 1.
        pub revision: u32,
        /// Loop closures in force.
        pub closures: u32,
        /// The newest chain of submaps that it knows.
        pub chain: u32,
        /// 1 when closures connect that chain with the map; 0 while its place in the map is a guess.
        pub attached: u32,
    }
}
