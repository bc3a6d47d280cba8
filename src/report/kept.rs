//! A report as it was kept: read back from its JSON.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::{Report, SCHEMA, Trouble, TroubleKind};

impl Report {
    /// The report in the file at `path`.
    ///
    /// # Errors
    /// If it cannot be read, or is no report of this schema.
    pub fn from_file(path: &Path) -> Result<Self, Trouble> {
        let trouble = |place: String, what: String| Trouble {
            kind: TroubleKind::Call,
            what,
            place,
            remedy: "make one with `poseaudit audit LOG --format json --output FILE`".to_owned(),
        };
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
                return Err(trouble(place, format!("no report: its schema is not `{SCHEMA}`")));
            }
        }
        // Once more from the text: only that knows the lines.
        serde_json::from_slice(&text)
            .map_err(|error| trouble(at(&error), format!("no report: {error}")))
    }
}
