//! Services that maps and measurements are handled with: those of slam_toolbox, nav2 and std_srvs.

use super::{InitialPose, service};

service! {
    /// `std_srvs/Trigger`.
    Trigger = "std_srvs" / "Trigger",
    TriggerRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    TriggerResponse {
        /// Whether it was done.
        success: bool,
        /// Or why not.
        message: String,
    }
}

service! {
    /// `std_srvs/Empty`.
    Empty = "std_srvs" / "Empty",
    EmptyRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    EmptyResponse {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    }
}

service! {
    /// `std_srvs/SetBool`.
    SetBool = "std_srvs" / "SetBool",
    SetBoolRequest {
        /// On or off.
        data: bool,
    },
    SetBoolResponse {
        /// Whether it was done.
        success: bool,
        /// Or why not.
        message: String,
    }
}

service! {
    /// `slam_toolbox/SaveMap`.
    ToolboxSaveMap = "slam_toolbox" / "SaveMap",
    ToolboxSaveMapRequest {
        /// Path without an ending.
        name: String,
    },
    ToolboxSaveMapResponse {
        /// 0 for success, 1 when there is no map, else 255.
        result: u8,
    }
}

service! {
    /// `slam_toolbox/SerializePoseGraph`.
    SerializePoseGraph = "slam_toolbox" / "SerializePoseGraph",
    SerializePoseGraphRequest {
        /// Where to.
        filename: String,
    },
    SerializePoseGraphResponse {
        /// 0 for success, else 255.
        result: u8,
    }
}

service! {
    /// `slam_toolbox/DeserializePoseGraph`.
    DeserializePoseGraph = "slam_toolbox" / "DeserializePoseGraph",
    DeserializePoseGraphRequest {
        /// Where from.
        filename: String,
        /// How to begin: 0 unset, 1 at the first node, 2 at the pose, 3 localizing at the pose.
        match_type: i8,
        /// Where the robot is in the map.
        initial_pose: InitialPose,
    },
    DeserializePoseGraphResponse {
        /// 0 for success, 3 when the file cannot be read, else 255.
        result: u8,
    }
}

service! {
    /// `slam_toolbox/Pause`: each call toggles.
    TogglePause = "slam_toolbox" / "Pause",
    TogglePauseRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    TogglePauseResponse {
        /// Whether it was done.
        status: bool,
    }
}

service! {
    /// `slam_toolbox/ClearQueue`.
    ClearQueue = "slam_toolbox" / "ClearQueue",
    ClearQueueRequest {
        /// Of no meaning.
        structure_needs_at_least_one_member: u8,
    },
    ClearQueueResponse {
        /// Whether it was done.
        status: bool,
    }
}

service! {
    /// `slam_toolbox/Reset`.
    Reset = "slam_toolbox" / "Reset",
    ResetRequest {
        /// Whether measurements are paused from then on.
        pause_new_measurements: bool,
    },
    ResetResponse {
        /// 0 for success.
        result: u8,
    }
}

service! {
    /// `nav2_msgs/SaveMap`.
    NavigationSaveMap = "nav2_msgs" / "SaveMap",
    NavigationSaveMapRequest {
        /// Whose map; of no meaning here.
        map_topic: String,
        /// Path without an ending.
        map_url: String,
        /// Of the picture.
        image_format: String,
        /// Of the picture's cells.
        map_mode: String,
        /// Below this share of black a cell is free.
        free_thresh: f32,
        /// Above it, occupied.
        occupied_thresh: f32,
    },
    NavigationSaveMapResponse {
        /// Whether it was done.
        result: bool,
    }
}
