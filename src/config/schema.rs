//! JSON schema of the config, for editors.

use schemars::generate::SchemaSettings;

use super::file::ConfigFile;

/// The schema as JSON, with a trailing newline.
pub fn schema() -> String {
    let settings = SchemaSettings::draft07();
    let schema = settings.into_generator().into_root_schema_for::<ConfigFile>();
    let mut text = serde_json::to_string_pretty(&schema).expect("a schema is JSON");
    text.push('\n');
    text
}
