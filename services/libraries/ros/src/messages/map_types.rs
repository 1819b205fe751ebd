//! Maps.

use super::{Header, Pose, Time, message};

message! {
    /// `nav_msgs/MapMetaData`.
    MapMetaData = "nav_msgs" {
        /// When the map was loaded.
        map_load_time: Time,
        /// Side of a cell, metres.
        resolution: f32,
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Of the lower left corner of the first cell.
        origin: Pose,
    }
}

message! {
    /// `nav_msgs/OccupancyGrid`.
    OccupancyGrid = "nav_msgs" {
        /// When, in which frame.
        header: Header,
        /// Size and place.
        info: MapMetaData,
        /// Row by row from below: −1 unknown, 0 free … 100 occupied.
        data: Vec<i8>,
    }
}
