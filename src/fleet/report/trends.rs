use std::collections::BTreeMap;

use serde::Serialize;

use super::calendar::DAY_NS;
use super::{FleetSubject, calendar};
use crate::checks;
use crate::diagnosis::{MIN_RUNS, Measured, RunEstimate, Trend, estimate_trend};
use crate::finding::Unit;
use crate::time::seconds;

/// Confidence, with Bonferroni correction over all series.
const CONFIDENCE: f64 = 0.999;

/// Minimum total change, as a share of the rule's first threshold.
const MIN_CHANGE_PER_THRESHOLD: f64 = 0.1;

const DAY_S: f64 = 86_400.0;

#[derive(Clone, Debug)]
pub struct EstimateSeries {
    pub code: String,
    pub name: String,
    /// SI symbol.
    pub unit: String,
    pub subject: FleetSubject,
    pub points: Vec<TrendPoint>,
}

/// Value of one log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrendPoint {
    /// Position in the sequence.
    #[serde(flatten)]
    pub at: TrendPosition,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Log.
    pub path: String,
}

/// Position of a log in a trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum TrendPosition {
    /// Start, ns since 1970, decimal.
    #[serde(rename = "start_ns")]
    Time(#[serde(serialize_with = "serialize_decimal")] i64),
    /// Episode number in the path, for logs without calendar time.
    #[serde(rename = "episode")]
    Episode(usize),
}

impl TrendPosition {
    /// Difference in seconds or episodes.
    pub fn elapsed_since(self, first: Self) -> f64 {
        match (self, first) {
            (Self::Time(own), Self::Time(first)) => seconds(own - first),
            (Self::Episode(own), Self::Episode(first)) => own as f64 - first as f64,
            _ => 0.0,
        }
    }
}

fn serialize_decimal<S: serde::Serializer>(stamp: &i64, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(stamp)
}

/// Kind of trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TrendKind {
    /// Linear increase or decrease.
    Creeps,
    /// Step between two runs.
    Stepped,
    /// Total change below the rule's first threshold.
    Steady,
    /// Undetermined.
    #[serde(rename = "untold")]
    Undetermined,
}

impl TrendKind {
    /// Whether a trend was found.
    pub const fn is_trend(self) -> bool {
        matches!(self, TrendKind::Creeps | TrendKind::Stepped)
    }

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            TrendKind::Creeps => "creeps",
            TrendKind::Stepped => "stepped",
            TrendKind::Steady => "steady",
            TrendKind::Undetermined => "not determined",
        }
    }
}

/// Value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrendValue {
    /// SI; rates per day.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// Trend of an estimate over the logs.
#[derive(Clone, Debug, Serialize)]
pub struct TrendRow {
    /// Rule.
    pub code: String,
    /// Estimate.
    pub name: String,
    /// SI symbol.
    pub unit: String,
    /// Subject.
    #[serde(flatten)]
    pub subject: FleetSubject,
    /// Kind of trend.
    #[serde(rename = "course")]
    pub kind: TrendKind,
    /// Logs with an estimate.
    pub logs: usize,
    /// Slope per day.
    pub rate_per_day: Option<TrendValue>,
    /// Slope per episode, without calendar time.
    pub rate_per_episode: Option<TrendValue>,
    /// Value at the middle of the runs.
    pub level: Option<TrendValue>,
    /// Standard deviation about the line beyond the runs' own intervals.
    pub spread: Option<f64>,
    /// Size of the step.
    pub step: Option<TrendValue>,
    /// Logs before and after the step, ns, decimal.
    pub step_between_ns: Option<[String; 2]>,
    /// Paths of these logs.
    pub step_between: Option<[String; 2]>,
    /// First threshold.
    #[serde(rename = "figure")]
    pub threshold: Option<f64>,
    /// When the threshold is reached, ns, decimal; the last log if it has been.
    #[serde(rename = "reaches_figure_ns")]
    pub reaches_threshold_ns: Option<String>,
    /// Values in time order.
    pub points: Vec<TrendPoint>,
    /// Line at the first and last log.
    pub line: Option<[f64; 2]>,
}

/// Found trends first, undetermined ones last, then by code.
pub fn trend_rows(series: Vec<EstimateSeries>) -> Vec<TrendRow> {
    let series_count = series.iter().filter(|one| one.points.len() >= MIN_RUNS).count();
    let mut rows: Vec<TrendRow> =
        series.into_iter().map(|one| trend_row(one, series_count)).collect();
    rows.sort_by(|a, b| (a.kind, &a.code, &a.subject).cmp(&(b.kind, &b.code, &b.subject)));
    rows
}

fn trend_row(series: EstimateSeries, series_count: usize) -> TrendRow {
    let EstimateSeries { code, name, unit, subject, mut points } = series;
    points.sort_by(|a, b| (a.at, &a.path).cmp(&(b.at, &b.path)));
    let first = points.first().map_or(TrendPosition::Episode(0), |first| first.at);
    let origin_ns = match first {
        TrendPosition::Time(first_ns) => Some(first_ns),
        TrendPosition::Episode(_) => None,
    };
    let estimates: Vec<RunEstimate> =
        points.iter().map(|point| run_estimate(point, point.at.elapsed_since(first))).collect();
    let last_s = estimates.last().map_or(0.0, |last| last.time_s);
    let threshold = first_threshold(&code, &unit);
    let trend = estimate_trend(&estimates);
    let kind = trend.map_or(TrendKind::Undetermined, |trend| {
        classify_trend(&trend, threshold, last_s, series_count)
    });
    let at = |trend: &Trend, time_s: f64| {
        trend.level.value + trend.rate_per_s.value * (time_s - trend.middle_s)
    };
    let stamp = |time_s: f64| Some((origin_ns? + crate::time::nanos(time_s)).to_string());
    let nearest = |time_s: f64| {
        let off = |point: &&TrendPoint| (point.at.elapsed_since(first) - time_s).abs();
        let point = points.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        point.map_or_else(String::new, |point| point.path.clone())
    };
    let rate = |per: f64| trend.map(|trend| trend_value(&trend.rate_per_s.scaled(per)));
    let step = trend.and_then(|trend| trend.step).filter(|_| kind == TrendKind::Stepped);
    let reaches = trend.zip(threshold).filter(|_| kind == TrendKind::Creeps);
    TrendRow {
        logs: points.len(),
        kind,
        rate_per_day: origin_ns.and_then(|_| rate(DAY_S)),
        rate_per_episode: if origin_ns.is_none() { rate(1.0) } else { None },
        level: trend.map(|trend| trend_value(&trend.level)),
        spread: trend.map(|trend| trend.spread),
        step: step.map(|step| trend_value(&step.height)),
        step_between_ns: step.and_then(|step| {
            let [from, to] = step.between_s.map(stamp);
            Some([from?, to?])
        }),
        step_between: step.map(|step| step.between_s.map(nearest)),
        threshold,
        reaches_threshold_ns: reaches.and_then(|(trend, threshold)| {
            let (now, rate) = (at(&trend, last_s), trend.rate_per_s.value);
            let remaining_s = ((threshold * rate.signum() - now) / rate).max(0.0);
            let is_there = now.abs() >= threshold;
            // `None` if too far away to represent.
            let remaining_s = if is_there { 0.0 } else { remaining_s };
            if remaining_s < 1e9 { stamp(last_s + remaining_s) } else { None }
        }),
        line: trend.map(|trend| [at(&trend, 0.0), at(&trend, last_s)]),
        code,
        name,
        unit,
        subject,
        points,
    }
}

/// Half a 95 % interval is 1.96 standard errors.
fn run_estimate(point: &TrendPoint, time_s: f64) -> RunEstimate {
    let [low, high] = point.ci95;
    RunEstimate { time_s, value: point.value, std_error: 0.5 * (high - low) / 1.959_964 }
}

fn trend_value(measured: &Measured) -> TrendValue {
    TrendValue { value: measured.value, ci95: measured.interval(0.95) }
}

fn classify_trend(
    trend: &Trend,
    threshold: Option<f64>,
    span_s: f64,
    series_count: usize,
) -> TrendKind {
    let confidence = 1.0 - (1.0 - CONFIDENCE) / series_count.max(1) as f64;
    let least = threshold.map_or(0.0, |threshold| MIN_CHANGE_PER_THRESHOLD * threshold);
    let is_sure = |of: &Measured| {
        let [low, high] = of.interval(confidence);
        !(low..=high).contains(&0.0)
    };
    if let Some(step) = &trend.step
        && is_sure(&step.height)
        && step.height.value.abs() >= least
    {
        return TrendKind::Stepped;
    }
    let over_all = trend.rate_per_s.scaled(span_s);
    if is_sure(&over_all) && over_all.value.abs() >= least {
        return TrendKind::Creeps;
    }
    let [low, high] = over_all.interval(0.95);
    match threshold {
        Some(threshold) if low.abs().max(high.abs()) <= threshold => TrendKind::Steady,
        _ => TrendKind::Undetermined,
    }
}

/// Warning threshold in this unit.
fn first_threshold(code: &str, unit: &str) -> Option<f64> {
    let rule = checks::find(code).ok()?;
    let figures = rule.grade.thresholds();
    figures
        .iter()
        .find(|threshold| threshold.unit.symbol() == unit)
        .map(|threshold| threshold.warning)
}

impl TrendRow {
    /// Display unit.
    pub fn display_unit(&self) -> Unit {
        Unit::from_symbol(&self.unit, &self.name).unwrap_or(Unit::One)
    }

    fn format_value(&self, value: &TrendValue) -> String {
        self.display_unit().show_signed_within(value.value, Some(value.ci95))
    }

    /// Over 30 days or 100 episodes; smaller spans often need more digits than are shown.
    fn format_rate(&self) -> Option<String> {
        const RATE_DAYS: f64 = 30.0;
        const RATE_EPISODES: f64 = 100.0;
        let (rate, times, of) = match (&self.rate_per_day, &self.rate_per_episode) {
            (Some(rate), _) => (rate, RATE_DAYS, "days"),
            (None, rate) => (rate.as_ref()?, RATE_EPISODES, "episodes"),
        };
        let value = rate.value * times;
        let shown =
            self.format_value(&TrendValue { value, ci95: rate.ci95.map(|end| end * times) });
        Some(format!("{shown} in {times} {of}"))
    }

    /// One-line summary.
    pub fn summary(&self) -> String {
        let unit = self.display_unit();
        match (self.kind, self.format_rate(), &self.step) {
            (TrendKind::Creeps, Some(rate), _) => {
                let last = self.points.last().map(|last| last.at);
                let reached = match (&self.reaches_threshold_ns, self.threshold, last) {
                    (Some(when), Some(threshold), Some(TrendPosition::Time(last_ns))) => {
                        let when_ns: i64 = when.parse().unwrap_or_default();
                        let threshold = unit.show(threshold);
                        match when_ns - last_ns {
                            ..=0 => format!("; already beyond the rule's {threshold}"),
                            left => format!(
                                "; reaches the rule's {threshold} on {}, in {} days",
                                calendar::format_day(when_ns),
                                left / DAY_NS
                            ),
                        }
                    }
                    _ => String::new(),
                };
                format!("{rate} over {} logs{reached}", self.logs)
            }
            (TrendKind::Stepped, _, Some(step)) => {
                let name = |path: &String| path.rsplit('/').next().unwrap_or(path).to_owned();
                let names = self.step_between.as_ref().map(|ends| ends.each_ref().map(name));
                let dates = self.step_between_ns.as_ref().map(|ends| {
                    let [from_ns, to_ns] =
                        ends.each_ref().map(|end| end.parse().unwrap_or_default());
                    calendar::format_distinct(from_ns, to_ns).map(|date| format!(" ({date})"))
                });
                let [from, to] = dates.unwrap_or_default();
                let between =
                    names.map(|[before, after]| format!(" between {before}{from} and {after}{to}"));
                format!("{}{}", self.format_value(step), between.unwrap_or_default())
            }
            (TrendKind::Steady, Some(rate), _) => format!("{rate} over {} logs", self.logs),
            (_, Some(rate), _) => format!("{rate} over {} logs, not significant", self.logs),
            _ => format!(
                "{} logs with a date and an interval; at least {MIN_RUNS} needed",
                self.logs
            ),
        }
    }
}

/// Undetermined estimates of each rule: those in too few logs, and those with an insignificant change.
pub(super) fn undetermined_by_rule(rows: &[TrendRow]) -> BTreeMap<&str, [usize; 2]> {
    let mut by_rule: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.kind == TrendKind::Undetermined) {
        by_rule.entry(&row.code).or_default()[usize::from(row.level.is_some())] += 1;
    }
    by_rule
}

/// `8 not determined: not significant`; with several reasons, `560 not determined: 552 in fewer than 4
/// dated logs, 8 not significant`. Empty if all are determined.
pub(super) fn undetermined_text([too_few, insignificant]: [usize; 2]) -> String {
    let few = format!("in fewer than {MIN_RUNS} dated logs");
    let reasons = match [too_few, insignificant] {
        [0, 0] => return String::new(),
        [0, _] => "not significant".to_owned(),
        [_, 0] => few,
        _ => format!("{too_few} {few}, {insignificant} not significant"),
    };
    format!("{} not determined: {reasons}", too_few + insignificant)
}

/// `2 found, 46 steady, 560 not determined: 552 in fewer than 4 dated logs, 8 not significant`.
pub(super) fn counts_text(rows: &[TrendRow]) -> String {
    if rows.is_empty() {
        return "not checked: the logs have no estimate with an interval".to_owned();
    }
    let found = rows.iter().filter(|row| row.kind.is_trend()).count();
    let steady = rows.iter().filter(|row| row.kind == TrendKind::Steady).count();
    let undetermined = undetermined_by_rule(rows).into_values();
    let undetermined = undetermined.fold([0, 0], |all, one| [all[0] + one[0], all[1] + one[1]]);
    let mut parts = vec![format!("{found} found"), format!("{steady} steady")];
    parts.push(undetermined_text(undetermined));
    parts.retain(|part| !part.is_empty());
    parts.join(", ")
}

/// Numbers in a path sort by value.
pub(super) fn natural_sort_key(path: &str) -> Vec<(u64, String)> {
    let mut parts: Vec<(u64, String)> = Vec::new();
    for part in path.split_inclusive(|c: char| !c.is_ascii_digit()) {
        let digits = part.trim_end_matches(|c: char| !c.is_ascii_digit());
        parts.push((digits.parse().unwrap_or(0), part[digits.len()..].to_owned()));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: &str = "LAT001";

    /// Latencies of one topic, a day apart.
    fn series(topic: &str, values_s: &[f64], half_width_s: f64) -> EstimateSeries {
        let point = |(day, value): (usize, &f64)| TrendPoint {
            at: TrendPosition::Time(calendar::FIRST_CALENDAR_NS + day as i64 * DAY_NS),
            value: *value,
            ci95: [value - half_width_s, value + half_width_s],
            path: format!("{day}.mcap"),
        };
        EstimateSeries {
            code: RULE.to_owned(),
            name: "latency".to_owned(),
            unit: "s".to_owned(),
            subject: FleetSubject { topic: Some(topic.to_owned()), ..FleetSubject::default() },
            points: values_s.iter().enumerate().map(point).collect(),
        }
    }

    #[test]
    fn undetermined_trends_are_counted_with_their_reason() {
        assert!(counts_text(&[]).starts_with("not checked"));
        let steady = series("/steady", &[0.0, 1e-6, 0.0, 1e-6, 0.0, 1e-6], 1e-5);
        let few = series("/few", &[0.0, 1e-3, 2e-3], 1e-5);
        let noisy = series("/noisy", &[0.0, 9e-3, -9e-3, 0.0, 9e-3, -9e-3], 1e-3);
        let text = |all: &[&EstimateSeries]| {
            counts_text(&trend_rows(all.iter().map(|&one| one.clone()).collect()))
        };
        assert_eq!(text(&[&steady]), "0 found, 1 steady");
        assert_eq!(
            text(&[&steady, &few]),
            "0 found, 1 steady, 1 not determined: in fewer than 4 dated logs"
        );
        assert_eq!(
            text(&[&few, &few, &noisy]),
            "0 found, 0 steady, 3 not determined: 2 in fewer than 4 dated logs, 1 not significant"
        );
    }
}
