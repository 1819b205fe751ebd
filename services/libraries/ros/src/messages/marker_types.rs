//! Shapes that viewers draw, and lines of a log.

use super::{Header, Pose, Time, Vector3, message};
use serde::{Deserialize, Serialize};

/// `std_msgs/ColorRGBA`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Color {
    /// Red, 0 … 1, as the others.
    pub r: f32,
    /// Green.
    pub g: f32,
    /// Blue.
    pub b: f32,
    /// 1: nothing shines through.
    pub a: f32,
}

/// `sensor_msgs/CompressedImage`: no marker of this node has one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    header: Header,
    format: String,
    data: Vec<u8>,
}

/// `visualization_msgs/MeshFile`: no marker of this node has one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshFile {
    filename: String,
    data: Vec<u8>,
}

/// `visualization_msgs/Marker`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// When, in which frame.
    pub header: Header,
    /// What it is one of …
    pub ns: String,
    /// … and which: a later marker with the same name and number replaces it.
    pub id: i32,
    /// One of the shapes.
    #[serde(rename = "type")]
    pub shape: i32,
    /// 0 to draw it, or one of the actions.
    pub action: i32,
    /// Where.
    pub pose: Pose,
    /// How large, metres.
    pub scale: Vector3,
    /// Its colour.
    pub color: Color,
    /// Seconds and nanoseconds after which it is taken away; 0 and 0 for never.
    pub lifetime: (i32, u32),
    /// It moves with its frame.
    pub frame_locked: bool,
    /// Of lines and lists.
    pub points: Vec<Vector3>,
    /// One for each point, or none.
    pub colors: Vec<Color>,
    /// Not used.
    pub texture_resource: String,
    /// Not used.
    pub texture: Texture,
    /// Not used.
    pub uv_coordinates: Vec<[f32; 2]>,
    /// Of a text.
    pub text: String,
    /// Not used.
    pub mesh_resource: String,
    /// Not used.
    pub mesh_file: MeshFile,
    /// Not used.
    pub mesh_use_embedded_materials: bool,
}

impl Marker {
    /// A shape: an arrow along x.
    pub const ARROW: i32 = 0;
    /// A shape: a cylinder along z.
    pub const CYLINDER: i32 = 3;
    /// A shape: a line through all points.
    pub const LINE_STRIP: i32 = 4;
    /// A shape: a line for each two points.
    pub const LINE_LIST: i32 = 5;
    /// A shape: a sphere at each point.
    pub const SPHERE_LIST: i32 = 7;
    /// A shape: a text that faces the viewer.
    pub const TEXT: i32 = 9;
    /// An action: takes away all markers that came on the topic.
    pub const DELETE_ALL: i32 = 3;
}

message! {
    /// `visualization_msgs/MarkerArray`.
    MarkerArray = "visualization_msgs" {
        /// The markers.
        markers: Vec<Marker>,
    }
}

message! {
    /// `rcl_interfaces/Log`: a line of a log.
    Log = "rcl_interfaces" {
        /// When.
        stamp: Time,
        /// 10 debug, 20 info, 30 warning, 40 error.
        level: u8,
        /// Who.
        name: String,
        /// What.
        msg: String,
        /// Where in the program: its file …
        file: String,
        /// … its function …
        function: String,
        /// … its line.
        line: u32,
    }
}
