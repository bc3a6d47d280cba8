//! Features of an RLDS dataset, from `features.json` next to its TFRecord files.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::lerobot::{Dataset, Feature, read_metadata};
use super::tfrecord::STEP_PREFIX;
use super::{MAX_DEPTH, rate_in};

const FEATURES: &str = "features.json";
const INFO: &str = "dataset_info.json";

pub(crate) fn metadata_files(path: &Path) -> Vec<PathBuf> {
    [FEATURES, INFO].map(|name| path.with_file_name(name)).into()
}

/// `None` if there is no `features.json`.
pub(super) fn declared_dataset(path: &Path) -> Option<Result<Dataset, String>> {
    let json = |name: &str| -> Option<Result<Value, String>> {
        let file = path.with_file_name(name);
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = parent.unwrap_or(Path::new("."));
        let parsed = |text: String| {
            serde_json::from_str(&text).map_err(|error| format!("{name} cannot be read: {error}"))
        };
        file.symlink_metadata().is_ok().then(|| read_metadata(folder, &file).and_then(parsed))
    };
    let features = json(FEATURES)?;
    let rate_hz = json(INFO).and_then(Result::ok).and_then(|info| rate_in(&info));
    Some(features.map(|features| {
        let mut dataset = Dataset { rate_hz, ..Dataset::default() };
        add_features(&features, "", MAX_DEPTH, &mut dataset);
        dataset
    }))
}

/// Element counts in a description such as `[7x joint angles, 2x gripper position]`.
fn counts(description: &str) -> Vec<usize> {
    let inside = description.split_once('[').and_then(|(_, rest)| rest.split_once(']'));
    let parts = inside.map_or("", |(inside, _)| inside).split(',');
    let counts: Option<Vec<usize>> =
        parts.map(|part| part.trim().split_once("x ")?.0.parse().ok()).collect();
    counts.unwrap_or_default()
}

fn add_features(feature: &Value, path: &str, deep: usize, dataset: &mut Dataset) {
    if let Some(shape) = feature.get("tensor").map(|tensor| tensor.get("shape")) {
        let sides = shape.and_then(|shape| shape.get("dimensions")).and_then(Value::as_array);
        let side = |value: &Value| value.as_str().map_or(value.as_u64(), |text| text.parse().ok());
        let sides = sides.into_iter().flatten().map(side);
        let mut width = sides.map(|side| side.and_then(|side| usize::try_from(side).ok()));
        let width = width.try_fold(1_usize, |all, side| all.checked_mul(side?));
        if let Some(name) = path.strip_prefix(STEP_PREFIX) {
            let description =
                feature.get("description").and_then(Value::as_str).unwrap_or_default();
            let mut own = Feature::with_width(width);
            own.described_counts = counts(description);
            dataset.features.insert(name.to_owned(), own);
        }
    }
    // The steps of an episode are a sequence.
    let own =
        feature.get("sequence").and_then(|sequence| sequence.get("feature")).unwrap_or(feature);
    let inside = own.get("featuresDict").and_then(|all| all.get("features"));
    for (name, feature) in inside.and_then(Value::as_object).into_iter().flatten() {
        let path = if path.is_empty() { name.clone() } else { format!("{path}/{name}") };
        if deep > 0 {
            add_features(feature, &path, deep - 1, dataset);
        }
    }
}
