//! LeRobot datasets, v2 and v3: a folder with `meta/info.json` and `data/*/*.parquet`.
//!
//! The metadata provides the rate, the names of the numbers and the robot type. Videos are not read.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::{MAX_METADATA_BYTES, Table};
use crate::LogError;
use crate::containment::{Containment, LINK_LEADS_OUTSIDE};
use crate::files::LogInput;

const INFO_PATH: &str = "meta/info.json";
/// Folders above `data/chunk-000/file-000.parquet` to search.
const MAX_PARENTS: usize = 4;
/// Files per audit.
const MAX_FILES: usize = 100;

#[derive(Clone, Debug, Default)]
pub(super) struct Dataset {
    pub rate_hz: Option<f64>,
    pub robot: Option<String>,
    pub features: BTreeMap<String, Feature>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Feature {
    dtype: String,
    /// Declared numbers per row.
    width: Option<usize>,
    names: Vec<String>,
    /// Counts from the description; one per kind.
    pub described_counts: Vec<usize>,
}

#[derive(Deserialize)]
struct Info {
    #[serde(default)]
    fps: Option<f64>,
    #[serde(default)]
    robot_type: Option<String>,
    #[serde(default)]
    features: BTreeMap<String, RawFeature>,
}

#[derive(Deserialize)]
struct RawFeature {
    #[serde(default)]
    dtype: String,
    #[serde(default)]
    shape: Vec<u64>,
    #[serde(default)]
    names: Value,
}

/// Whether a folder is a LeRobot dataset.
pub fn is_dataset(folder: &Path) -> bool {
    folder.join(INFO_PATH).is_file()
}

/// The LeRobot dataset that contains a file.
pub fn enclosing_dataset(file: &Path) -> Option<PathBuf> {
    file.ancestors().skip(1).take(MAX_PARENTS).find(|folder| is_dataset(folder)).map(Path::to_owned)
}

/// Whether episodes share the data file, as in v3; in v2 each file is named after its episode.
pub(super) fn is_shared_file(file: &Path) -> bool {
    let is_numbered =
        file.file_name().is_some_and(|name| name.to_string_lossy().starts_with("file-"));
    is_numbered && enclosing_dataset(file).is_some()
}

/// # Errors
/// If the dataset has no data files, or more than one audit can take.
pub(crate) fn dataset_files(folder: &Path) -> Result<Vec<LogInput>, LogError> {
    let refused = |cause| LogError::Directory { path: folder.to_owned(), cause };
    let mut files = Vec::new();
    let chunks = fs::read_dir(folder.join("data"))
        .map_err(|source| LogError::io(&folder.join("data"), source))?;
    for chunk in chunks.filter_map(Result::ok) {
        let inside = fs::read_dir(chunk.path()).into_iter().flatten().filter_map(Result::ok);
        files.extend(
            inside
                .map(|entry| entry.path())
                .filter(|path| path.extension().is_some_and(|end| end == "parquet")),
        );
    }
    files.sort();
    match files.len() {
        0 => Err(refused("of a dataset without data files")),
        1..=MAX_FILES => Ok(files.into_iter().map(LogInput::bag_file).collect()),
        _ => Err(refused(
            "of a dataset with more than 100 data files: `poseaudit fleet` audits each episode",
        )),
    }
}

/// From the nearest parent folder with `meta/info.json`, or why it cannot be read.
pub(super) fn enclosing_metadata(path: &Path) -> Option<Result<Dataset, String>> {
    let folder = enclosing_dataset(path)?;
    Some(read_metadata(&folder, &folder.join(INFO_PATH)).and_then(|text| parse_info(&text)))
}

/// Refuses files that a link places outside the folder.
pub(super) fn read_metadata(folder: &Path, path: &Path) -> Result<String, String> {
    let refused = |what: &dyn std::fmt::Display| Err(format!("{}: {what}", path.display()));
    if !Containment::new(folder).holds(path) {
        return refused(&LINK_LEADS_OUTSIDE);
    }
    match fs::metadata(path) {
        Ok(metadata) if metadata.len() > MAX_METADATA_BYTES => {
            refused(&format!("it has {} bytes; the limit is {MAX_METADATA_BYTES}", metadata.len()))
        }
        Ok(_) => fs::read_to_string(path).or_else(|error| refused(&error)),
        Err(error) => refused(&error),
    }
}

fn parse_info(text: &str) -> Result<Dataset, String> {
    let Info { fps, robot_type, features } = serde_json::from_str(text)
        .map_err(|error| format!("{INFO_PATH} cannot be read: {error}"))?;
    let features = features.into_iter().map(|(name, RawFeature { dtype, shape, names })| {
        let width = shape.iter().try_fold(1_u64, |all, side| all.checked_mul(*side));
        let width =
            width.and_then(|width| usize::try_from(width).ok()).filter(|_| !shape.is_empty());
        (name, Feature { dtype, names: flatten_names(&names), ..Feature::with_width(width) })
    });
    Ok(Dataset {
        rate_hz: fps.filter(super::is_rate),
        robot: robot_type.filter(|robot| !robot.is_empty()),
        features: features.collect(),
    })
}

/// Names in a list, or in the lists of a table such as `{"motors": […]}`.
fn flatten_names(value: &Value) -> Vec<String> {
    match value {
        Value::String(name) => vec![name.clone()],
        Value::Array(all) => all.iter().flat_map(flatten_names).collect(),
        Value::Object(all) => all.values().flat_map(flatten_names).collect(),
        _ => Vec::new(),
    }
}

impl Feature {
    pub fn with_width(width: Option<usize>) -> Self {
        Self { width, ..Self::default() }
    }
}

impl Dataset {
    /// Rather than images or text.
    pub fn is_numeric(&self, column: &str) -> bool {
        let of =
            |feature: &Feature| !["image", "video", "string"].contains(&feature.dtype.as_str());
        self.features.get(column).is_none_or(of)
    }

    /// Numbers per row.
    pub fn width(&self, column: &str) -> Option<usize> {
        self.features.get(column)?.width
    }

    pub fn describe(&self, table: &mut Table) {
        table.rate_hz = self.rate_hz.or(table.rate_hz);
        for column in &mut table.columns {
            let Some(feature) = self.features.get(&column.name) else { continue };
            if feature.names.len() == column.width && column.width > 1 {
                column.parts.clone_from(&feature.names);
            }
        }
    }

    /// Contradictions between the declarations and the numbers.
    pub fn contradictions(&self, episodes: &[(String, Table)]) -> Vec<String> {
        let Some((_, table)) = episodes.first() else { return Vec::new() };
        let mut found = Vec::new();
        for (name, feature) in &self.features {
            let column = table.columns.iter().find(|column| column.name == *name);
            let Some(column) = column else { continue };
            if let Some(width) = feature.width.filter(|width| *width != column.width) {
                found.push(format!(
                    "`{name}` is declared with {width} numbers per row but has {}",
                    column.width
                ));
            }
            let counted: usize =
                feature.described_counts.iter().fold(0, |all, own| all.saturating_add(*own));
            if counted > 0 && counted != column.width {
                let counts: Vec<String> =
                    feature.described_counts.iter().map(usize::to_string).collect();
                found.push(format!(
                    "`{name}` is described as {} = {counted} numbers per row but has {}",
                    counts.join(" + "),
                    column.width
                ));
            }
            let named = feature.names.len();
            if named > 1 && named != column.width {
                found.push(format!(
                    "`{name}` has {} numbers per row, but {named} names are declared",
                    column.width
                ));
            }
        }
        found
    }
}
