//! Foxglove layout: the scene, plots of the errors with their limits, and the findings as text.

use serde_json::{Value, json};

use super::{LOG_TOPIC, SCENE_TOPIC};

/// Layout for these error topics; the scene is drawn in `frame`.
pub fn layout(error_topics: &[String], frame: Option<&str>) -> Value {
    json!({
        "configById": {
            "3D!scene": {
                "followTf": frame,
                "followMode": "follow-pose",
                "topics": { SCENE_TOPIC: { "visible": true } },
            },
            "Plot!position": plot("Position error, mm", error_topics, "position", "mm"),
            "Plot!rotation": plot("Rotation error, °", error_topics, "rotation", "deg"),
            "RosOut!findings": {
                "topicToRender": LOG_TOPIC,
                "minLogLevel": 1,
                "searchTerms": [],
                "foxglovePanelTitle": "Findings",
            },
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": { "speed": 1 },
        "layout": split("row", json!("3D!scene"), split(
            "column",
            json!("Plot!position"),
            split("column", json!("Plot!rotation"), json!("RosOut!findings"), 50),
            34,
        ), 50),
    })
}

fn split(direction: &str, first: Value, second: Value, percentage: u8) -> Value {
    json!({
        "direction": direction,
        "first": first,
        "second": second,
        "splitPercentage": percentage,
    })
}

/// Errors as logged and after correction of all topics, and their common limit.
fn plot(title: &str, topics: &[String], quantity: &str, unit: &str) -> Value {
    let path = |topic: &str, field: &str, label: String| {
        json!({
            "value": format!("{}.{field}", quote_topic(topic)),
            "enabled": true,
            "timestampMethod": "receiveTime",
            "label": label,
        })
    };
    let errors = topics.iter().flat_map(|topic| {
        let stream = topic.trim_start_matches("/poseaudit/error");
        [
            path(topic, &format!("{quantity}_{unit}"), format!("{stream} as logged")),
            path(topic, &format!("corrected_{quantity}_{unit}"), format!("{stream} corrected")),
        ]
    });
    let limit = topics
        .first()
        .map(|topic| path(topic, &format!("{quantity}_limit_{unit}"), "limit".to_owned()));
    json!({
        "paths": errors.chain(limit).collect::<Vec<_>>(),
        "minYValue": 0,
        "showLegend": true,
        "legendDisplay": "floating",
        "showXAxisLabels": true,
        "showYAxisLabels": true,
        "isSynced": true,
        "xAxisVal": "timestamp",
        "foxglovePanelTitle": title,
    })
}

/// Quotes a topic name in a message path if it has special characters.
fn quote_topic(topic: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/_-".contains(c);
    match topic.chars().all(is_plain) {
        true => topic.to_owned(),
        false => Value::from(topic).to_string(),
    }
}
