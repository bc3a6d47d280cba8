//! JSON schemas: `foxglove.` ones with the fields that Foxglove documents, and those of poseaudit.

use serde_json::{Map, Value, json};

use super::{ERROR_SCHEMA, LOG_SCHEMA, SCENE_SCHEMA};

/// Schemas of an audit's messages, by name.
pub fn of_audit() -> [(&'static str, Value); 3] {
    [(LOG_SCHEMA, log()), (SCENE_SCHEMA, scene()), (ERROR_SCHEMA, error())]
}

pub fn by_name(name: &str) -> Option<Value> {
    of_audit().into_iter().find(|(own, _)| *own == name).map(|(_, schema)| schema)
}

fn object<const N: usize>(fields: [(&str, Value); N]) -> Value {
    let fields: Map<String, Value> =
        fields.into_iter().map(|(name, field)| (name.to_owned(), field)).collect();
    json!({ "type": "object", "properties": fields })
}

fn list(items: &Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn type_schema(kind: &str) -> Value {
    json!({ "type": kind })
}

fn time() -> Value {
    object([("sec", type_schema("integer")), ("nsec", type_schema("integer"))])
}

fn vector() -> Value {
    object(["x", "y", "z"].map(|axis| (axis, type_schema("number"))))
}

fn quaternion() -> Value {
    object(["x", "y", "z", "w"].map(|axis| (axis, type_schema("number"))))
}

fn pose() -> Value {
    object([("position", vector()), ("orientation", quaternion())])
}

fn colour() -> Value {
    object(["r", "g", "b", "a"].map(|part| (part, type_schema("number"))))
}

/// rad, rad/s; m, m/s for prismatic joints. Missing values have no field.
pub fn joint_states() -> Value {
    let joint = object([
        ("name", type_schema("string")),
        ("position", type_schema("number")),
        ("velocity", type_schema("number")),
    ]);
    object([("timestamp", time()), ("joints", list(&joint))])
}

pub fn pose_in_frame() -> Value {
    object([("timestamp", time()), ("frame_id", type_schema("string")), ("pose", pose())])
}

pub fn frame_transform() -> Value {
    object([
        ("timestamp", time()),
        ("parent_frame_id", type_schema("string")),
        ("child_frame_id", type_schema("string")),
        ("translation", vector()),
        ("rotation", quaternion()),
    ])
}

pub fn imu() -> Value {
    object([
        ("timestamp", time()),
        ("frame_id", type_schema("string")),
        ("orientation", quaternion()),
        ("angular_velocity", vector()),
        ("linear_acceleration", vector()),
    ])
}

/// Described by the names of the columns, if they have any.
pub fn numbers(names: &str) -> Value {
    let mut values = list(&type_schema("number"));
    if !names.is_empty() {
        values["description"] = json!(names);
    }
    object([("timestamp", time()), ("values", values)])
}

pub fn text() -> Value {
    object([("timestamp", time()), ("text", type_schema("string"))])
}

fn log() -> Value {
    object([
        ("timestamp", time()),
        ("level", type_schema("integer")),
        ("message", type_schema("string")),
        ("name", type_schema("string")),
        ("file", type_schema("string")),
        ("line", type_schema("integer")),
    ])
}

/// Millimetres and degrees, for plots. A limit that is switched off is null.
fn error() -> Value {
    object([
        ("timestamp", time()),
        ("robot", type_schema("string")),
        ("position_mm", type_schema("number")),
        ("rotation_deg", type_schema("number")),
        ("corrected_position_mm", type_schema("number")),
        ("corrected_rotation_deg", type_schema("number")),
        ("position_limit_mm", type_schema("number")),
        ("rotation_limit_deg", type_schema("number")),
    ])
}

fn scene() -> Value {
    let deletion = object([
        ("timestamp", time()),
        ("type", type_schema("integer")),
        ("id", type_schema("string")),
    ]);
    let pair = object([("key", type_schema("string")), ("value", type_schema("string"))]);
    let arrow = object([
        ("pose", pose()),
        ("shaft_length", type_schema("number")),
        ("shaft_diameter", type_schema("number")),
        ("head_length", type_schema("number")),
        ("head_diameter", type_schema("number")),
        ("color", colour()),
    ]);
    let body = object([("pose", pose()), ("size", vector()), ("color", colour())]);
    let cylinder = object([
        ("pose", pose()),
        ("size", vector()),
        ("bottom_scale", type_schema("number")),
        ("top_scale", type_schema("number")),
        ("color", colour()),
    ]);
    let line = object([
        ("type", type_schema("integer")),
        ("pose", pose()),
        ("thickness", type_schema("number")),
        ("scale_invariant", type_schema("boolean")),
        ("points", list(&vector())),
        ("color", colour()),
        ("colors", list(&colour())),
        ("indices", list(&type_schema("integer"))),
    ]);
    let triangles = object([
        ("pose", pose()),
        ("points", list(&vector())),
        ("color", colour()),
        ("colors", list(&colour())),
        ("indices", list(&type_schema("integer"))),
    ]);
    let text = object([
        ("pose", pose()),
        ("billboard", type_schema("boolean")),
        ("font_size", type_schema("number")),
        ("scale_invariant", type_schema("boolean")),
        ("color", colour()),
        ("text", type_schema("string")),
    ]);
    let model = object([
        ("pose", pose()),
        ("scale", vector()),
        ("color", colour()),
        ("override_color", type_schema("boolean")),
        ("url", type_schema("string")),
        ("media_type", type_schema("string")),
        ("data", type_schema("string")),
    ]);
    let entity = object([
        ("timestamp", time()),
        ("frame_id", type_schema("string")),
        ("id", type_schema("string")),
        ("lifetime", time()),
        ("frame_locked", type_schema("boolean")),
        ("metadata", list(&pair)),
        ("arrows", list(&arrow)),
        ("cubes", list(&body)),
        ("spheres", list(&body)),
        ("cylinders", list(&cylinder)),
        ("lines", list(&line)),
        ("triangles", list(&triangles)),
        ("texts", list(&text)),
        ("models", list(&model)),
    ]);
    object([("deletions", list(&deletion)), ("entities", list(&entity))])
}
