//! JSON schemas: `foxglove.Log` and `foxglove.SceneUpdate` with the fields that Foxglove documents, and
//! `poseaudit.Error`.

use serde_json::{Map, Value, json};

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

fn pose() -> Value {
    let orientation = object(["x", "y", "z", "w"].map(|axis| (axis, type_schema("number"))));
    object([("position", vector()), ("orientation", orientation)])
}

fn colour() -> Value {
    object(["r", "g", "b", "a"].map(|part| (part, type_schema("number"))))
}

pub fn log() -> Value {
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
pub fn error() -> Value {
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

pub fn scene() -> Value {
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
