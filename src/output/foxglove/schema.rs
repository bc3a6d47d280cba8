//! JSON schemas of `foxglove.Log` and `foxglove.SceneUpdate`, with the fields that Foxglove documents.

use serde_json::{Map, Value, json};

fn object<const N: usize>(fields: [(&str, Value); N]) -> Value {
    let fields: Map<String, Value> =
        fields.into_iter().map(|(name, field)| (name.to_owned(), field)).collect();
    json!({ "type": "object", "properties": fields })
}

fn list(items: &Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn of(kind: &str) -> Value {
    json!({ "type": kind })
}

fn time() -> Value {
    object([("sec", of("integer")), ("nsec", of("integer"))])
}

fn vector() -> Value {
    object(["x", "y", "z"].map(|axis| (axis, of("number"))))
}

fn pose() -> Value {
    let orientation = object(["x", "y", "z", "w"].map(|axis| (axis, of("number"))));
    object([("position", vector()), ("orientation", orientation)])
}

fn colour() -> Value {
    object(["r", "g", "b", "a"].map(|part| (part, of("number"))))
}

pub fn log() -> Value {
    object([
        ("timestamp", time()),
        ("level", of("integer")),
        ("message", of("string")),
        ("name", of("string")),
        ("file", of("string")),
        ("line", of("integer")),
    ])
}

pub fn scene() -> Value {
    let deletion = object([("timestamp", time()), ("type", of("integer")), ("id", of("string"))]);
    let pair = object([("key", of("string")), ("value", of("string"))]);
    let arrow = object([
        ("pose", pose()),
        ("shaft_length", of("number")),
        ("shaft_diameter", of("number")),
        ("head_length", of("number")),
        ("head_diameter", of("number")),
        ("color", colour()),
    ]);
    let body = object([("pose", pose()), ("size", vector()), ("color", colour())]);
    let cylinder = object([
        ("pose", pose()),
        ("size", vector()),
        ("bottom_scale", of("number")),
        ("top_scale", of("number")),
        ("color", colour()),
    ]);
    let line = object([
        ("type", of("integer")),
        ("pose", pose()),
        ("thickness", of("number")),
        ("scale_invariant", of("boolean")),
        ("points", list(&vector())),
        ("color", colour()),
        ("colors", list(&colour())),
        ("indices", list(&of("integer"))),
    ]);
    let triangles = object([
        ("pose", pose()),
        ("points", list(&vector())),
        ("color", colour()),
        ("colors", list(&colour())),
        ("indices", list(&of("integer"))),
    ]);
    let text = object([
        ("pose", pose()),
        ("billboard", of("boolean")),
        ("font_size", of("number")),
        ("scale_invariant", of("boolean")),
        ("color", colour()),
        ("text", of("string")),
    ]);
    let model = object([
        ("pose", pose()),
        ("scale", vector()),
        ("color", colour()),
        ("override_color", of("boolean")),
        ("url", of("string")),
        ("media_type", of("string")),
        ("data", of("string")),
    ]);
    let entity = object([
        ("timestamp", time()),
        ("frame_id", of("string")),
        ("id", of("string")),
        ("lifetime", time()),
        ("frame_locked", of("boolean")),
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
