//! Errors of pose streams as CSV for PlotJuggler, and a layout that loads the file and plots each stream's
//! errors as logged, corrected, and their limit.
//!
//! | column | content |
//! |---|---|
//! | `time` | stamp, s since 1970 |
//! | `poseaudit/TOPIC/position_mm/…`, `…/rotation_deg/…` | `as_logged`, `corrected` and `limit` |
//!
//! Each row belongs to one stream; the cells of the others are empty, which PlotJuggler skips.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use maud::html;

use super::error_series::{ErrorRow, ErrorSeries, ErrorSize};
use super::{decimal_seconds, write_file};
use crate::audit::Audited;
use crate::finding::Finding;
use crate::places::PathRegistry;
use crate::report::Trouble;

const OPTION: &str = "--plotjuggler";

const TIME_COLUMN: &str = "time";

/// Registers the table and its layout.
pub fn register_outputs(path: &Path, places: &mut PathRegistry) {
    places.add_output(OPTION, path);
    places.add_output(OPTION, &layout_path(path));
}

/// `run.csv` has the layout `run.layout.xml`.
pub fn layout_path(path: &Path) -> PathBuf {
    path.with_extension("layout.xml")
}

impl Audited {
    /// Writes the errors of all pose streams, and the layout next to them.
    ///
    /// # Errors
    /// If a file cannot be written or would replace an input file.
    pub fn write_plotjuggler(&self, path: &Path) -> Result<(), Trouble> {
        self.read.check_with(|places| register_outputs(path, places))?;
        let remedy = "set --plotjuggler to a writable file";
        let streams = plotted_streams(self);
        let table =
            table(&streams).map_err(|error| Trouble::call(path.display(), error, remedy))?;
        write_file(path, table, remedy)?;
        write_file(&layout_path(path), layout(&streams, path), remedy)
    }
}

struct PlottedStream {
    /// Unique prefix of its columns.
    name: String,
    /// Name with the codes of its findings.
    title: String,
    errors: ErrorSeries,
}

fn plotted_streams(audited: &Audited) -> Vec<PlottedStream> {
    let Audited { report, run, evidence, .. } = audited;
    let has_several_arms = evidence.robots.len() > 1;
    let mut streams = Vec::new();
    for arm in &evidence.robots {
        for stream in &arm.poses {
            let topic = stream.topic().trim_start_matches('/');
            let name =
                if has_several_arms { format!("{}/{topic}", arm.name) } else { topic.to_owned() };
            // Findings of joints affect every stream of their arm.
            let affects = |finding: &&Finding| match finding.subject.topic.as_deref() {
                Some(topic) => topic == stream.topic(),
                None => finding.subject.arm().is_none_or(|own| *own == arm.name),
            };
            let affecting = report.findings.iter().filter(affects);
            let codes: BTreeSet<&str> = affecting.map(|finding| finding.code).collect();
            let codes = codes.into_iter().collect::<Vec<_>>().join(", ");
            let title = if codes.is_empty() { name.clone() } else { format!("{name}: {codes}") };
            let errors = ErrorSeries::new(stream, report, run.origin);
            streams.push(PlottedStream { name: column_name(&name), title, errors });
        }
    }
    streams
}

/// PlotJuggler does not unescape quotes.
fn column_name(name: &str) -> String {
    name.replace(|c: char| c == ',' || c == '"' || c.is_control(), "_")
}

#[derive(Clone, Copy)]
enum Quantity {
    Position,
    Rotation,
}

/// Curves of a plot, with their colours: red as logged, green after correction, grey for the limit.
const CURVES: [(&str, &str); 3] =
    [("as_logged", "#f0503c"), ("corrected", "#3cc86e"), ("limit", "#888888")];

impl Quantity {
    const ALL: [Self; 2] = [Self::Position, Self::Rotation];

    fn column(self, stream: &PlottedStream, curve: &str) -> String {
        let quantity = match self {
            Quantity::Position => "position_mm",
            Quantity::Rotation => "rotation_deg",
        };
        format!("poseaudit/{}/{quantity}/{curve}", stream.name)
    }

    fn title(self) -> &'static str {
        match self {
            Quantity::Position => "position error, mm",
            Quantity::Rotation => "rotation error, °",
        }
    }

    /// In the order of `CURVES`.
    fn values(self, errors: &ErrorSeries, row: &ErrorRow) -> [Option<f64>; 3] {
        let value = |size: &ErrorSize| match self {
            Quantity::Position => size.position_mm,
            Quantity::Rotation => size.rotation_deg,
        };
        let limit = match self {
            Quantity::Position => errors.position_limit_mm,
            Quantity::Rotation => errors.rotation_limit_deg,
        };
        [row.logged.as_ref().map(value), Some(value(&row.corrected)), limit]
    }
}

/// One row per sample, ordered by time.
fn table(streams: &[PlottedStream]) -> Result<Vec<u8>, csv::Error> {
    let columns = CURVES.len() * Quantity::ALL.len();
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = streams.iter().flat_map(|stream| {
        let columns = |quantity: Quantity| CURVES.map(|(curve, _)| quantity.column(stream, curve));
        Quantity::ALL.into_iter().flat_map(columns)
    });
    writer.write_record([TIME_COLUMN.to_owned()].into_iter().chain(header))?;
    let rows = streams.iter().enumerate();
    let rows = rows.flat_map(|(at, stream)| stream.errors.rows.iter().map(move |row| (at, row)));
    let mut rows: Vec<(usize, &ErrorRow)> = rows.collect();
    rows.sort_by_key(|(at, row)| (row.at, *at));
    for (at, row) in rows {
        let mut record = vec![String::new(); 1 + streams.len() * columns];
        record[0] = decimal_seconds(row.at);
        let values = Quantity::ALL.into_iter().flat_map(|it| it.values(&streams[at].errors, row));
        for (cell, value) in record[1 + at * columns..].iter_mut().zip(values) {
            *cell = value.map(|value| format!("{value:.6}")).unwrap_or_default();
        }
        writer.write_record(record)?;
    }
    writer.into_inner().map_err(|error| error.into_error().into())
}

/// A tab for each stream. The table is named relative to the layout.
fn layout(streams: &[PlottedStream], table: &Path) -> String {
    let table = table.file_name().unwrap_or_default().to_string_lossy();
    let plot = |stream: &PlottedStream, quantity: Quantity| {
        let has_values = |curve: usize| {
            let mut rows = stream.errors.rows.iter();
            rows.any(|row| quantity.values(&stream.errors, row)[curve].is_some())
        };
        let curves = CURVES.iter().enumerate().filter(|(at, _)| has_values(*at));
        html! {
            DockArea name=(format!("{} {}", stream.name, quantity.title())) {
                plot mode="TimeSeries" style="Lines" flip_x="false" flip_y="false" {
                    @for (_, (curve, colour)) in curves {
                        curve name=(quantity.column(stream, curve)) color=(colour) {}
                    }
                }
            }
        }
    };
    let root = html! {
        root {
            tabbed_widget name="Main Window" parent="main_window" {
                @for stream in streams {
                    Tab tab_name=(stream.title) containers="1" {
                        Container {
                            DockSplitter orientation="-" count="2" sizes="0.5;0.5" {
                                @for quantity in Quantity::ALL { (plot(stream, quantity)) }
                            }
                        }
                    }
                }
                currentTabIndex index="0" {}
            }
            use_relative_time_offset enabled="1" {}
            previouslyLoaded_Datafiles {
                fileInfo filename=(table) prefix="" {
                    plugin ID="DataLoad CSV" {
                        parameters time_axis=(TIME_COLUMN) delimiter="0" skip_rows="0" {}
                    }
                }
            }
        }
    };
    format!("<?xml version='1.0' encoding='UTF-8'?>\n{}\n", root.into_string())
}
