use std::fs;
use std::path::Path;

use serde_json::Value;

use super::{Report, SCHEMA, Trouble};

impl Report {
    /// Reads a report.
    ///
    /// # Errors
    /// If it cannot be read, or has another schema.
    pub fn from_file(path: &Path) -> Result<Self, Trouble> {
        let remedy = "make one with `poseaudit audit LOG --format json --output FILE`";
        let trouble = |place: String, what: String| Trouble::call(place, what, remedy);
        let place = path.display().to_string();
        let text = fs::read(path)
            .map_err(|error| trouble(place.clone(), format!("it cannot be read: {error}")))?;
        let at = |error: &serde_json::Error| match error.line() {
            0 => place.clone(),
            line => format!("{place}:{line}"),
        };
        let whole: Value = serde_json::from_slice(&text)
            .map_err(|error| trouble(at(&error), format!("no JSON: {error}")))?;
        match whole.get("schema").and_then(Value::as_str) {
            Some(SCHEMA) => {}
            Some(other) => {
                let what = format!("its schema is `{other}`, expected `{SCHEMA}`");
                return Err(trouble(place, what));
            }
            None => {
                return Err(trouble(place, format!("not a report: its schema is not `{SCHEMA}`")));
            }
        }
        // Only parsing the text reports line numbers.
        serde_json::from_slice(&text)
            .map_err(|error| trouble(at(&error), format!("not a report: {error}")))
    }
}
