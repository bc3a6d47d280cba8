//! Line plot: JSON for the browser, and a table of the same values.

use maud::{Markup, html};
use serde_json::{Value, json};

use crate::finding::Unit;
use crate::stats::thin;

const TABLE_ROWS: usize = 20;

#[derive(Clone, Debug, Default)]
pub struct Plot {
    pub title: &'static str,
    pub robot: String,
    /// Plotted stream.
    pub stream: String,
    /// One sentence, also the alternative text.
    pub caption: String,
    /// Ascending.
    pub x: Vec<f64>,
    /// Name and unit.
    pub x_label: &'static str,
    /// Name and unit.
    pub y_label: &'static str,
    pub series: Vec<PlotSeries>,
    /// The vertical axis starts at zero.
    pub from_zero: bool,
    pub mark: Option<PlotMark>,
    pub limits: Vec<PlotLimit>,
    /// The vertical axis includes the limits, however small the values.
    pub shows_limits: bool,
    pub style: PlotStyle,
}

#[derive(Clone, Debug)]
pub struct PlotLimit {
    /// In the unit of its axis.
    pub at: f64,
    pub is_vertical: bool,
    /// Empty if another limit is labelled.
    pub label: String,
}

impl PlotLimit {
    /// Both signs of a limit in SI units; `factor` converts to the unit of the plot.
    pub fn signed(limit: Option<f64>, unit: Unit, factor: f64) -> Vec<Self> {
        let label = limit.map_or(String::new(), |limit| format!("limit ±{}", unit.show(limit)));
        let ends =
            limit.into_iter().flat_map(|limit| [(-limit, String::new()), (limit, label.clone())]);
        ends.map(|(at, label)| Self { at: at * factor, is_vertical: false, label }).collect()
    }

    /// Limit of a quantity that is never negative, or of its largest magnitude.
    pub fn upper(limit: Option<f64>, unit: Unit, factor: f64) -> Vec<Self> {
        let limit = limit.map(|limit| Self {
            at: limit * factor,
            is_vertical: false,
            label: format!("limit {}", unit.show(limit)),
        });
        limit.into_iter().collect()
    }
}

/// One value per `x`.
#[derive(Clone, Debug)]
pub struct PlotSeries {
    pub label: String,
    pub role: SeriesRole,
    pub values: Vec<f64>,
    /// Half-width of each value's interval; may be empty.
    pub half_widths: Vec<f64>,
}

impl PlotSeries {
    /// Without intervals.
    pub fn new(
        label: impl Into<String>,
        role: SeriesRole,
        values: impl IntoIterator<Item = f64>,
    ) -> Self {
        let values = values.into_iter().collect();
        Self { label: label.into(), role, values, half_widths: Vec::new() }
    }
}

/// Determines the colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesRole {
    /// As logged.
    Before,
    /// After correcting all findings.
    After,
    /// Measured amount.
    Amount,
    /// Reference of an amount, or a fitted line.
    Reference,
    /// Limit that varies.
    Limit,
}

impl SeriesRole {
    pub const fn name(self) -> &'static str {
        match self {
            SeriesRole::Before => "before",
            SeriesRole::After => "after",
            SeriesRole::Amount => "amount",
            SeriesRole::Reference => "beside",
            SeriesRole::Limit => "limit",
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlotStyle {
    /// Line with breaks at gaps of the log.
    #[default]
    Time,
    /// Continuous line.
    Curve,
    Points,
    /// Amounts as points, other series as lines.
    AmountPoints,
}

#[derive(Clone, Debug)]
pub struct PlotMark {
    pub at: f64,
    pub interval: Option<[f64; 2]>,
    pub label: String,
}

impl Plot {
    /// Identifies plots of the same data.
    pub fn key(&self) -> (&'static str, String, String) {
        (self.title, self.robot.clone(), self.stream.clone())
    }

    pub fn is_empty(&self) -> bool {
        self.x.len() < 2 || self.series.is_empty()
    }

    /// Placeholder of the plot, a note if it is thinned, and a table of its values. Names the stream unless
    /// it is `known` from the context.
    pub fn markup(&self, id: &str, known: Option<&str>, most_rows: usize) -> Markup {
        let rows = self.decimated_rows(most_rows).len();
        html! {
            figure .picture {
                figcaption {
                    strong { (self.title) }
                    @if known != Some(self.stream.as_str()) { " " span .of { (self.stream) } }
                    span .says { (self.caption) }
                }
                p .unit aria-hidden="true" { (self.y_label) }
                div .plot data-plot=(id) tabindex="0" role="img"
                    aria-label={ (self.title) ", " (self.stream) ". " (self.caption) " Arrow keys read values out." } {}
                p .readout role="status" aria-live="polite" {}
                @if rows < self.x.len() {
                    p .note {
                        "min/max of " (self.x.len()) " samples, " (rows) " drawn"
                    }
                }
                details .values {
                    summary { "Values" }
                    (self.table())
                }
            }
        }
    }

    pub fn json(&self, most_rows: usize) -> Value {
        let rows = self.decimated_rows(most_rows);
        let longest = self.max_step();
        let broken = |values: &[f64], round: fn(f64) -> f64| -> Vec<Value> {
            let mut all = Vec::with_capacity(rows.len());
            for (at, &row) in rows.iter().enumerate() {
                if at > 0 && self.is_gap(rows[at - 1], row, longest) {
                    all.push(Value::Null);
                }
                all.push(json!(round(values[row])));
            }
            all
        };
        let mut x = broken(&self.x, round_to_decimals);
        // A null between two positions breaks the line.
        for at in 1..x.len().saturating_sub(1) {
            if let (true, Some(a), Some(b)) =
                (x[at].is_null(), x[at - 1].as_f64(), x[at + 1].as_f64())
            {
                x[at] = json!(round_to_decimals(0.5 * (a + b)));
            }
        }
        let series = self.series.iter().map(|series| {
            json!({
                "label": series.label,
                "role": series.role.name(),
                "values": broken(&series.values, round_to_digits),
                "half": (!series.half_widths.is_empty())
                    .then(|| broken(&series.half_widths, round_to_digits)),
                "points": self.has_points(series),
            })
        });
        let mark = self
            .mark
            .as_ref()
            .map(|mark| json!({ "at": mark.at, "interval": mark.interval, "label": mark.label }));
        let limits = self.limits.iter().map(
            |limit| json!({ "at": limit.at, "along": limit.is_vertical, "label": limit.label }),
        );
        json!({
            "x": x,
            "x_label": self.x_label,
            "y_label": self.y_label,
            "zero": self.from_zero,
            "shows_limits": self.shows_limits,
            "mark": mark,
            "limits": limits.collect::<Vec<_>>(),
            "series": series.collect::<Vec<_>>(),
        })
    }

    fn has_points(&self, series: &PlotSeries) -> bool {
        match self.style {
            PlotStyle::Time | PlotStyle::Curve => false,
            PlotStyle::Points => true,
            PlotStyle::AmountPoints => series.role == SeriesRole::Amount,
        }
    }

    fn decimated_rows(&self, most_rows: usize) -> Vec<usize> {
        let series: Vec<&[f64]> = self.series.iter().map(|one| one.values.as_slice()).collect();
        thin::extreme_rows(&series, most_rows)
    }

    fn is_gap(&self, before: usize, after: usize, longest: f64) -> bool {
        // Rows in between may be omitted.
        let step = |row: usize| self.x[row + 1] - self.x[row];
        self.style == PlotStyle::Time && (before..after).any(|row| step(row) > longest)
    }

    fn max_step(&self) -> f64 {
        /// Share of the whole axis.
        const MAX_STEP_RATIO: f64 = 0.02;
        /// Median steps: a larger fraction for a short stream.
        const MAX_MEDIAN_STEPS: f64 = 5.0;
        let whole = self.x.last().zip(self.x.first()).map_or(0.0, |(last, first)| last - first);
        let mut steps: Vec<f64> = self.x.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let median = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        (MAX_STEP_RATIO * whole).max(MAX_MEDIAN_STEPS * median)
    }

    fn table(&self) -> Markup {
        let stretch = self.x.len().div_ceil(TABLE_ROWS).max(1);
        let starts = (0..self.x.len()).step_by(stretch);
        let ranges: Vec<_> =
            starts.map(|start| start..(start + stretch).min(self.x.len())).collect();
        let ends = |values: &[f64]| {
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            if least == most {
                format_value(least)
            } else {
                format!("{} – {}", format_value(least), format_value(most))
            }
        };
        html! {
            div .scroll tabindex="0" role="region" aria-label={ "Values of " (self.title) } {
                table {
                    caption { "Minimum and maximum of each interval" }
                    thead {
                        tr {
                            th scope="col" { (self.x_label) }
                            @for series in &self.series {
                                th scope="col" { (series.label) ", " (self.y_label) }
                            }
                        }
                    }
                    tbody {
                        @for range in &ranges {
                            tr {
                                th scope="row" { (ends(&self.x[range.clone()])) }
                                @for series in &self.series {
                                    td { (ends(&series.values[range.clone()])) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Four decimals.
fn round_to_decimals(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// Five digits.
fn round_to_digits(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

/// Three digits; a dash if not finite.
fn format_value(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let size = value.abs();
    let decimals = if size >= 100.0 {
        1
    } else if size >= 1.0 {
        2
    } else if size >= 1e-3 || size == 0.0 {
        4
    } else {
        return format!("{value:.1e}");
    };
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(rows: usize, step: impl Fn(usize) -> f64) -> Plot {
        let values = (0..rows).map(|row| if row == rows / 3 { 7.5 } else { 1.0 });
        Plot {
            x: (0..rows).map(step).collect(),
            series: vec![PlotSeries::new("error", SeriesRole::Before, values)],
            ..Plot::default()
        }
    }

    #[test]
    fn a_long_series_is_decimated_and_keeps_its_peak() {
        let plot = plot(100_000, |row| row as f64 * 0.01);
        let json = plot.json(1000);
        let values = json["series"][0]["values"].as_array().expect("values");
        assert!(values.len() <= 1000 && values.contains(&json!(7.5)), "{}", values.len());
        assert_eq!(json["x"].as_array().map(Vec::len), Some(values.len()));
        assert!(plot.markup("p", None, 1000).into_string().contains("min/max of 100000 samples"));
        assert!(!plot.markup("p", None, 200_000).into_string().contains("min/max of"));
    }

    #[test]
    fn a_short_series_breaks_only_at_its_gap() {
        let breaks = |plot: Plot| {
            let json = plot.json(1000);
            let values = json["series"][0]["values"].as_array().expect("values");
            values.iter().filter(|value| value.is_null()).count()
        };
        assert_eq!(breaks(plot(30, |row| row as f64)), 0);
        assert_eq!(breaks(plot(30, |row| if row < 10 { row as f64 } else { row as f64 + 6.0 })), 1);
    }

    #[test]
    fn non_finite_values_are_dashes() {
        assert_eq!([f64::NAN, f64::INFINITY, 1.5].map(format_value), ["–", "–", "1.50"]);
    }

    #[test]
    fn a_line_breaks_at_gaps_of_the_log() {
        let silent = plot(200, |row| if row < 100 { row as f64 } else { row as f64 + 500.0 });
        let json = silent.json(1000);
        let values = json["series"][0]["values"].as_array().expect("values");
        assert_eq!(values.iter().filter(|value| value.is_null()).count(), 1);
        let x: Vec<f64> =
            json["x"].as_array().expect("places").iter().filter_map(Value::as_f64).collect();
        assert!(x.len() == 201 && x.is_sorted(), "{}", x.len());
        let curve = Plot { style: PlotStyle::Curve, ..silent };
        assert_eq!(curve.json(1000)["x"].as_array().map(Vec::len), Some(200));
    }
}
