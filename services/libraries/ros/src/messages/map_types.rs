//! Maps.

use super::{Header, Pose, PoseWithCovarianceStamped, Time, message, service};

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

message! {
    /// `map_msgs/OccupancyGridUpdate`: a rectangle of a map whose cells have changed.
    OccupancyGridUpdate = "map_msgs" {
        /// When, in which frame.
        header: Header,
        /// The first column of the rectangle.
        x: i32,
        /// Its first row.
        y: i32,
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Row by row from below, as in the map.
        data: Vec<i8>,
    }
}

/// `nav2_msgs/Particle`.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Particle {
    /// Where the robot may be.
    pub pose: Pose,
    /// Its weight in the belief.
    pub weight: f64,
}

message! {
    /// `nav2_msgs/ParticleCloud`.
    ParticleCloud = "nav2_msgs" {
        /// When, in the frame of the map.
        header: Header,
        /// Where the robot may be.
        particles: Vec<Particle>,
    }
}

service! {
    /// `nav2_msgs/SetInitialPose`.
    SetInitialPose = "nav2_msgs" / "SetInitialPose",
    SetInitialPoseRequest {
        /// An initial pose of the robot.
        pose: PoseWithCovarianceStamped,
    },
    SetInitialPoseResponse {
        /// Nothing is answered.
        structure_needs_at_least_one_member: u8,
    }
}

service! {
    /// `nav2_msgs/LoadMap`.
    LoadMap = "nav2_msgs" / "LoadMap",
    LoadMapRequest {
        /// Where from: a path or a `file://` address.
        map_url: String,
    },
    LoadMapResponse {
        /// The map; empty here.
        map: OccupancyGrid,
        /// 0 for success, 1 when there is no such map, 255 when something else is wrong.
        result: u8,
    }
}

service! {
    /// `nav_msgs/GetMap`.
    GetMap = "nav_msgs" / "GetMap",
    GetMapRequest {
        /// Nothing is asked.
        structure_needs_at_least_one_member: u8,
    },
    GetMapResponse {
        /// The map.
        map: OccupancyGrid,
    }
}
