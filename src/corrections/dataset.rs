//! Python module that corrects a dataset's columns, for loaders and as a LeRobot processor step.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::corrections_file::Corrections;
use crate::report::{Report, quote_line};
use crate::run::{Role, Run};
use crate::stream::Columns;

/// Topics of these containers are columns with the same name.
const WHOLE_COLUMNS: [&str; 6] = ["npy", "npz", "parquet", "hdf5", "zarr", "tfrecord"];

#[derive(Default)]
struct ColumnCorrections {
    /// Factor and offset per number, in the logged unit.
    numbers: BTreeMap<String, BTreeMap<usize, [f64; 2]>>,
    /// Latency per column, s.
    latency_s: BTreeMap<String, f64>,
    /// Joints that need the numbers of others.
    coupled: Vec<String>,
}

/// `None` if the files are not a dataset, or if a loader cannot correct any finding.
pub(super) fn python_module(
    report: &Report,
    run: &Run,
    corrections: &Corrections,
) -> Option<String> {
    let is_dataset = |container: &str| WHOLE_COLUMNS.contains(&container);
    if !report.log.files.iter().all(|file| is_dataset(file.container)) {
        return None;
    }
    let mut columns = ColumnCorrections::default();
    for stream in run.streams.iter().filter(|stream| stream.role == Role::Joints) {
        let Some(Columns::Joints(joints)) = &stream.columns else { continue };
        let degrees = if joints.converted_from_degrees { 1_f64.to_radians() } else { 1.0 };
        for (number, joint) in joints.joints.iter().enumerate() {
            let own = corrections.joints.iter().find(|own| own.name == joint.name);
            let Some(own) = own else { continue };
            if own.coupling.is_some() {
                columns.coupled.push(own.name.clone());
                continue;
            }
            // Position = scale * number + from.
            let [scale, from] = joints.conversions.get(number).copied().unwrap_or([degrees, 0.0]);
            let factor = own.factor.unwrap_or(1.0);
            let offset = match own.offset_rad {
                Some(offset) => (factor * from + offset - from) / scale,
                None => own.offset_m.unwrap_or(0.0),
            };
            let (column, at) = match stream.cells.get(number).and_then(|cell| split_index(cell)) {
                Some(place) => place,
                None => (stream.topic.clone(), number),
            };
            columns.numbers.entry(column).or_default().insert(at, [factor, offset]);
        }
    }
    let late = corrections.topics.iter().filter(|topic| topic.skew.is_none());
    columns.latency_s = late.filter_map(|own| Some((own.name.clone(), own.latency_s?))).collect();
    columns.text()
}

/// Splits `NAME[AT]`.
fn split_index(cell: &str) -> Option<(String, usize)> {
    let (column, at) = cell.strip_suffix(']')?.rsplit_once('[')?;
    Some((column.to_owned(), at.parse().ok()?))
}

impl ColumnCorrections {
    fn text(&self) -> Option<String> {
        if self.numbers.is_empty() && self.latency_s.is_empty() {
            return None;
        }
        let mut text = MODULE_HEADER.to_owned();
        for joint in &self.coupled {
            let joint = quote_line(joint);
            let _ = writeln!(
                text,
                "\n# Not corrected here: {joint} is coupled to another joint (corrections.toml)."
            );
        }
        text += "\n# Column: {number: (factor, offset)}; true = factor * logged + offset, in the unit of the column.\n";
        text += "NUMBERS = {\n";
        for (column, numbers) in &self.numbers {
            let all: Vec<String> = numbers
                .iter()
                .map(|(number, [factor, offset])| format!("{number}: ({factor:?}, {offset:?})"))
                .collect();
            let _ = writeln!(text, "    {}: {{{}}},", quote_line(column), all.join(", "));
        }
        text += "}\n\n# Column: latency in s.\nLATE_S = {\n";
        for (column, latency_s) in &self.latency_s {
            let _ = writeln!(text, "    {}: {latency_s:?},", quote_line(column));
        }
        Some(text + "}\n" + MODULE_FUNCTIONS)
    }
}

const MODULE_HEADER: &str = r#""""Corrections of a dataset's columns by poseaudit. The data are not modified.

    from dataset_step import correct, delta_timestamps, shifted

    frame = correct(frame)                       # a dict of arrays or tensors by column; numbers last
    LeRobotDataset(repo_id, delta_timestamps=delta_timestamps(fps))   # late columns are read later
    episode = shifted(episode, fps)              # the same for whole episodes as arrays, rows first
    DataProcessorPipeline([CorrectColumns(), ...])                    # a step of LeRobot's processors
"""

import numpy
"#;

const MODULE_FUNCTIONS: &str = r#"

def correct(frame):
    """Return a copy of the frame, or frames, with the numbers in NUMBERS corrected."""
    frame = dict(frame)
    for column, numbers in NUMBERS.items():
        if column in frame:
            values = frame[column]
            values = values.clone() if hasattr(values, "clone") else numpy.array(values, dtype=float)
            for number, (factor, offset) in numbers.items():
                values[..., number] = factor * values[..., number] + offset
            frame[column] = values
    return frame


def delta_timestamps(fps):
    """Argument for LeRobotDataset: each late column is read later by its latency, rounded to frames."""
    return {column: [round(late_s * fps) / fps] for column, late_s in LATE_S.items()}


def shifted(episode, fps):
    """Return an episode with its late columns moved by whole rows; all are cut to the common rows."""
    rows = {column: round(LATE_S.get(column, 0.0) * fps) for column in episode}
    first, last = max(0, -min(rows.values())), max(0, max(rows.values()))
    count = min(len(values) for values in episode.values()) - first - last
    return {column: values[first + rows[column]:][:count] for column, values in episode.items()}


try:
    from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry
except ImportError:
    pass
else:

    @ProcessorStepRegistry.register("poseaudit_correct_columns")
    class CorrectColumns(ObservationProcessorStep):
        """Apply `correct` before normalization."""

        def observation(self, observation):
            return correct(observation)

        def transform_features(self, features):
            return features
"#;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_corrections_become_python() {
        assert_eq!(ColumnCorrections::default().text(), None);
        let mut columns = ColumnCorrections::default();
        let numbers = BTreeMap::from([(2, [1.0, 0.5]), (4, [-1.0, 0.0])]);
        columns.numbers.insert("observation.state".to_owned(), numbers);
        columns.latency_s.insert("observation.\"pose".to_owned(), 0.06);
        let text = columns.text().expect("a module");
        assert!(text.contains("\n    \"observation.state\": {2: (1.0, 0.5), 4: (-1.0, 0.0)},\n"));
        assert!(text.contains("\n    \"observation.\\\"pose\": 0.06,\n"));
        columns.coupled.push("j3".to_owned());
        let text = columns.text().expect("a module");
        assert!(text.contains("\n# Not corrected here: \"j3\" is coupled to another"), "{text}");
        // Python does not have `\u{…}` escapes.
        columns.latency_s.insert("a\u{202e}\u{1}b".to_owned(), 0.5);
        let text = columns.text().expect("a module");
        assert!(text.contains("\n    \"a\\u202e\\u0001b\": 0.5,\n"), "{text}");
    }
}
