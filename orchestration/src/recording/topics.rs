//! The topics of a recording, their names, and their JSON schemas.

use flockslam_messages::{Message, ScanHeader};
use flockslam_recordings::SET_RECORD_TYPE;
use serde_json::{Value, json};

/// A topic of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordTopic {
    /// Scans, in the frame of the laser.
    Scan,
    /// Poses in the map.
    Pose,
    /// Continuous poses in odom.
    OdomPose,
    /// How the frames lie to each other.
    Transforms,
    /// The grid that scans are matched to.
    Grid,
    /// Who moves.
    Tracks,
    /// Log lines.
    Log,
    /// Scans as they are on the bus: what a replay is made of. Only files have them.
    BusScan,
    /// What the stages have said and used: what a run as it was is made of. Only files have them.
    SetRecord,
}

impl RecordTopic {
    /// Those whose messages are JSON.
    pub const OF_JSON: [RecordTopic; 7] =
        [Self::Scan, Self::Pose, Self::OdomPose, Self::Transforms, Self::Grid, Self::Tracks, Self::Log];
    /// Number of all.
    pub const COUNT: usize = Self::OF_JSON.len() + 2;

    /// All topics.
    pub fn all() -> impl Iterator<Item = RecordTopic> {
        Self::OF_JSON.into_iter().chain([Self::BusScan, Self::SetRecord])
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scan => "/scan",
            Self::Pose => "/pose",
            Self::OdomPose => "/odom_pose",
            Self::Transforms => "/tf",
            Self::Grid => "/grid",
            Self::Tracks => "/tracks",
            Self::Log => "/log",
            Self::BusScan => "/flockslam/scan",
            Self::SetRecord => "/flockslam/set",
        }
    }

    /// Its place among [all](Self::all).
    pub fn place(self) -> usize {
        self as usize
    }

    /// Name of its schema.
    pub fn schema_name(self) -> &'static str {
        match self {
            Self::Scan => "foxglove.LaserScan",
            Self::Pose | Self::OdomPose => "foxglove.PoseInFrame",
            Self::Transforms => "foxglove.FrameTransform",
            Self::Grid => "foxglove.Grid",
            Self::Tracks => "foxglove.SceneUpdate",
            Self::Log => "foxglove.Log",
            Self::BusScan => ScanHeader::TYPE_NAME,
            Self::SetRecord => SET_RECORD_TYPE,
        }
    }

    /// Its schema, as JSON Schema; empty where its messages are not JSON.
    pub fn schema(self) -> String {
        let fields = match self {
            Self::Scan => json!({
                "timestamp": time(), "frame_id": text(), "pose": pose(), "start_angle": number(),
                "end_angle": number(), "ranges": numbers(), "intensities": numbers(),
            }),
            Self::Pose | Self::OdomPose => json!({ "timestamp": time(), "frame_id": text(), "pose": pose() }),
            Self::Transforms => json!({
                "timestamp": time(), "parent_frame_id": text(), "child_frame_id": text(),
                "translation": vector(), "rotation": quaternion(),
            }),
            Self::Grid => json!({
                "timestamp": time(), "frame_id": text(), "pose": pose(), "column_count": whole(),
                "cell_size": object("foxglove.Vector2", json!({ "x": number(), "y": number() })),
                "row_stride": whole(), "cell_stride": whole(),
                "fields": { "type": "array", "items": object("foxglove.PackedElementField", json!({
                    "name": text(), "offset": whole(), "type": { "type": "integer" },
                })) },
                "data": { "type": "string", "contentEncoding": "base64" },
            }),
            Self::Tracks => json!({ "deletions": list(deletion()), "entities": list(entity()) }),
            Self::Log => json!({
                "timestamp": time(), "level": { "type": "integer" }, "message": text(), "name": text(),
                "file": text(), "line": whole(),
            }),
            Self::BusScan | Self::SetRecord => return String::new(),
        };
        object(self.schema_name(), fields).to_string()
    }
}

fn object(title: &str, fields: Value) -> Value {
    json!({ "title": title, "type": "object", "properties": fields })
}

/// What is taken out of a scene.
fn deletion() -> Value {
    let fields = json!({ "timestamp": time(), "type": { "type": "integer" }, "id": text() });
    object("foxglove.SceneEntityDeletion", fields)
}

/// What is put into a scene: cylinders for bodies, arrows for where they go, texts for what else is known.
fn entity() -> Value {
    let colour =
        || object("foxglove.Color", json!({ "r": number(), "g": number(), "b": number(), "a": number() }));
    let arrow = json!({
        "pose": pose(), "shaft_length": number(), "shaft_diameter": number(), "head_length": number(),
        "head_diameter": number(), "color": colour(),
    });
    let cylinder = json!({
        "pose": pose(), "size": vector(), "bottom_scale": number(), "top_scale": number(), "color": colour(),
    });
    let label = json!({ "key": text(), "value": text() });
    let span = json!({ "sec": { "type": "integer" }, "nsec": whole() });
    object(
        "foxglove.SceneEntity",
        json!({
            "timestamp": time(), "frame_id": text(), "id": text(), "lifetime": object("duration", span),
            "frame_locked": { "type": "boolean" }, "metadata": list(object("foxglove.KeyValuePair", label)),
            "arrows": list(object("foxglove.ArrowPrimitive", arrow)), "cubes": list(json!({})), "spheres": list(json!({})),
            "cylinders": list(object("foxglove.CylinderPrimitive", cylinder)), "lines": list(json!({})),
            "triangles": list(json!({})), "texts": list(json!({})), "models": list(json!({})),
        }),
    )
}

fn list(items: Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn time() -> Value {
    let nanoseconds = json!({ "type": "integer", "minimum": 0, "maximum": 999_999_999 });
    object("time", json!({ "sec": whole(), "nsec": nanoseconds }))
}

fn pose() -> Value {
    object("foxglove.Pose", json!({ "position": vector(), "orientation": quaternion() }))
}

fn vector() -> Value {
    object("foxglove.Vector3", json!({ "x": number(), "y": number(), "z": number() }))
}

fn quaternion() -> Value {
    let fields = json!({ "x": number(), "y": number(), "z": number(), "w": number() });
    object("foxglove.Quaternion", fields)
}

fn numbers() -> Value {
    json!({ "type": "array", "items": number() })
}

fn number() -> Value {
    json!({ "type": "number" })
}

fn whole() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn text() -> Value {
    json!({ "type": "string" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_stand_at_their_places_and_schemas_bear_their_names() {
        assert!(RecordTopic::all().map(RecordTopic::place).eq(0..RecordTopic::COUNT));
        for topic in RecordTopic::OF_JSON {
            let schema: Value = serde_json::from_str(&topic.schema()).unwrap();
            assert_eq!(schema["title"], topic.schema_name());
            let stamped = match topic {
                RecordTopic::Tracks => &schema["properties"]["entities"]["items"],
                _ => &schema,
            };
            assert_eq!(stamped["properties"]["timestamp"]["title"], "time");
        }
    }
}
