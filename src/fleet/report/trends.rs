use serde::Serialize;

use super::calendar::DAY_NS;
use super::{Whose, calendar};
use crate::checks;
use crate::diagnosis::{MIN_RUNS, Measured, RunEstimate, Trend, estimate_trend};
use crate::finding::Unit;
use crate::time::seconds;

/// Confidence, with Bonferroni correction over all series.
const SURE: f64 = 0.999;

/// Minimum total change, as a share of the rule's first threshold.
const MATERIAL: f64 = 0.1;

const DAY_S: f64 = 86_400.0;

#[derive(Clone, Debug)]
pub struct Series {
    pub code: String,
    pub name: String,
    /// SI symbol.
    pub unit: String,
    pub whose: Whose,
    pub points: Vec<Point>,
}

/// Value of one log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Position in the sequence.
    #[serde(flatten)]
    pub at: At,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Log.
    pub path: String,
}

/// Position of a log in a trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum At {
    /// Start, ns since 1970, decimal.
    #[serde(rename = "start_ns")]
    Time(#[serde(serialize_with = "decimal")] i64),
    /// Episode number in the path, for logs without calendar time.
    #[serde(rename = "episode")]
    Episode(usize),
}

impl At {
    /// Difference in seconds or episodes.
    pub fn since(self, first: Self) -> f64 {
        match (self, first) {
            (Self::Time(own), Self::Time(first)) => seconds(own - first),
            (Self::Episode(own), Self::Episode(first)) => own as f64 - first as f64,
            _ => 0.0,
        }
    }
}

fn decimal<S: serde::Serializer>(stamp: &i64, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(stamp)
}

/// Kind of trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Course {
    /// Linear increase or decrease.
    Creeps,
    /// Step between two runs.
    Stepped,
    /// Total change below the rule's first threshold.
    Steady,
    /// Undetermined.
    Untold,
}

impl Course {
    /// Whether a trend was found.
    pub const fn is_moving(self) -> bool {
        matches!(self, Course::Creeps | Course::Stepped)
    }

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Course::Creeps => "creeps",
            Course::Stepped => "stepped",
            Course::Steady => "steady",
            Course::Untold => "untold",
        }
    }
}

/// Value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Moved {
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
    pub whose: Whose,
    /// Kind of trend.
    pub course: Course,
    /// Logs with an estimate.
    pub logs: usize,
    /// Slope per day.
    pub rate_per_day: Option<Moved>,
    /// Slope per episode, without calendar time.
    pub rate_per_episode: Option<Moved>,
    /// Value at the middle of the runs.
    pub level: Option<Moved>,
    /// Standard deviation about the line beyond the runs' own intervals.
    pub spread: Option<f64>,
    /// Size of the step.
    pub step: Option<Moved>,
    /// Logs before and after the step, ns, decimal.
    pub step_between_ns: Option<[String; 2]>,
    /// Paths of these logs.
    pub step_between: Option<[String; 2]>,
    /// First threshold.
    pub figure: Option<f64>,
    /// When the threshold is reached, ns, decimal; the last log if it has been.
    pub reaches_figure_ns: Option<String>,
    /// Values in time order.
    pub points: Vec<Point>,
    /// Line at the first and last log.
    pub line: Option<[f64; 2]>,
}

/// Found trends first, undetermined ones last, then by code.
pub fn rows(series: Vec<Series>) -> Vec<TrendRow> {
    let asked = series.iter().filter(|one| one.points.len() >= MIN_RUNS).count();
    let mut rows: Vec<TrendRow> = series.into_iter().map(|one| row(one, asked)).collect();
    rows.sort_by(|a, b| (a.course, &a.code, &a.whose).cmp(&(b.course, &b.code, &b.whose)));
    rows
}

fn row(series: Series, asked: usize) -> TrendRow {
    let Series { code, name, unit, whose, mut points } = series;
    points.sort_by(|a, b| (a.at, &a.path).cmp(&(b.at, &b.path)));
    let first = points.first().map_or(At::Episode(0), |first| first.at);
    let origin_ns = match first {
        At::Time(first_ns) => Some(first_ns),
        At::Episode(_) => None,
    };
    let told: Vec<RunEstimate> =
        points.iter().map(|point| told(point, point.at.since(first))).collect();
    let last_s = told.last().map_or(0.0, |last| last.time_s);
    let figure = figure(&code, &unit);
    let found = estimate_trend(&told);
    let course = found.map_or(Course::Untold, |found| course(&found, figure, last_s, asked));
    let at = |found: &Trend, time_s: f64| {
        found.level.value + found.rate_per_s.value * (time_s - found.middle_s)
    };
    let stamp = |time_s: f64| Some((origin_ns? + crate::time::nanos(time_s)).to_string());
    let nearest = |time_s: f64| {
        let off = |point: &&Point| (point.at.since(first) - time_s).abs();
        let point = points.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        point.map_or_else(String::new, |point| point.path.clone())
    };
    let rate = |per: f64| found.map(|found| moved(&found.rate_per_s.scaled(per)));
    let step = found.and_then(|found| found.step).filter(|_| course == Course::Stepped);
    let reaches = found.zip(figure).filter(|_| course == Course::Creeps);
    TrendRow {
        logs: points.len(),
        course,
        rate_per_day: origin_ns.and_then(|_| rate(DAY_S)),
        rate_per_episode: if origin_ns.is_none() { rate(1.0) } else { None },
        level: found.map(|found| moved(&found.level)),
        spread: found.map(|found| found.spread),
        step: step.map(|step| moved(&step.height)),
        step_between_ns: step.and_then(|step| {
            let [from, to] = step.between_s.map(stamp);
            Some([from?, to?])
        }),
        step_between: step.map(|step| step.between_s.map(nearest)),
        figure,
        reaches_figure_ns: reaches.and_then(|(found, figure)| {
            let (now, rate) = (at(&found, last_s), found.rate_per_s.value);
            let left_s = ((figure * rate.signum() - now) / rate).max(0.0);
            let is_there = now.abs() >= figure;
            // `None` if too far away to represent.
            let left_s = if is_there { 0.0 } else { left_s };
            if left_s < 1e9 { stamp(last_s + left_s) } else { None }
        }),
        line: found.map(|found| [at(&found, 0.0), at(&found, last_s)]),
        code,
        name,
        unit,
        whose,
        points,
    }
}

/// Half a 95 % interval is 1.96 standard errors.
fn told(point: &Point, time_s: f64) -> RunEstimate {
    let [low, high] = point.ci95;
    RunEstimate { time_s, value: point.value, std_error: 0.5 * (high - low) / 1.959_964 }
}

fn moved(measured: &Measured) -> Moved {
    Moved { value: measured.value, ci95: measured.interval(0.95) }
}

fn course(found: &Trend, figure: Option<f64>, span_s: f64, asked: usize) -> Course {
    let confidence = 1.0 - (1.0 - SURE) / asked.max(1) as f64;
    let least = figure.map_or(0.0, |figure| MATERIAL * figure);
    let is_sure = |of: &Measured| {
        let [low, high] = of.interval(confidence);
        !(low..=high).contains(&0.0)
    };
    if let Some(step) = &found.step
        && is_sure(&step.height)
        && step.height.value.abs() >= least
    {
        return Course::Stepped;
    }
    let over_all = found.rate_per_s.scaled(span_s);
    if is_sure(&over_all) && over_all.value.abs() >= least {
        return Course::Creeps;
    }
    let [low, high] = over_all.interval(0.95);
    match figure {
        Some(figure) if low.abs().max(high.abs()) <= figure => Course::Steady,
        _ => Course::Untold,
    }
}

/// Warning threshold in this unit.
fn figure(code: &str, unit: &str) -> Option<f64> {
    let rule = checks::find(code).ok()?;
    let figures = rule.grade.thresholds();
    figures.iter().find(|figure| figure.unit.symbol() == unit).map(|figure| figure.warning)
}

impl TrendRow {
    /// Display unit.
    pub fn unit_of(&self) -> Unit {
        Unit::from_symbol(&self.unit, &self.name).unwrap_or(Unit::One)
    }

    fn shown(&self, moved: &Moved) -> String {
        self.unit_of().show_signed_within(moved.value, Some(moved.ci95))
    }

    /// Over 30 days or 100 episodes; smaller spans often need more digits than are shown.
    fn shown_rate(&self) -> Option<String> {
        const DAYS: f64 = 30.0;
        const EPISODES: f64 = 100.0;
        let (rate, times, of) = match (&self.rate_per_day, &self.rate_per_episode) {
            (Some(rate), _) => (rate, DAYS, "days"),
            (None, rate) => (rate.as_ref()?, EPISODES, "episodes"),
        };
        let value = rate.value * times;
        let shown = self.shown(&Moved { value, ci95: rate.ci95.map(|end| end * times) });
        Some(format!("{shown} in {times} {of}"))
    }

    /// One-line summary.
    pub fn says(&self) -> String {
        let unit = self.unit_of();
        match (self.course, self.shown_rate(), &self.step) {
            (Course::Creeps, Some(rate), _) => {
                let last = self.points.last().map(|last| last.at);
                let reached = match (&self.reaches_figure_ns, self.figure, last) {
                    (Some(when), Some(figure), Some(At::Time(last_ns))) => {
                        let when_ns: i64 = when.parse().unwrap_or_default();
                        let figure = unit.show(figure);
                        match when_ns - last_ns {
                            ..=0 => format!("; already beyond the rule's {figure}"),
                            left => format!(
                                "; reaches the rule's {figure} on {}, in {} days",
                                calendar::day(when_ns),
                                left / DAY_NS
                            ),
                        }
                    }
                    _ => String::new(),
                };
                format!("{rate} over {} logs{reached}", self.logs)
            }
            (Course::Stepped, _, Some(step)) => {
                let name = |path: &String| path.rsplit('/').next().unwrap_or(path).to_owned();
                let names = self.step_between.as_ref().map(|ends| ends.each_ref().map(name));
                let dates = self.step_between_ns.as_ref().map(|ends| {
                    let [from_ns, to_ns] =
                        ends.each_ref().map(|end| end.parse().unwrap_or_default());
                    calendar::apart(from_ns, to_ns).map(|date| format!(" ({date})"))
                });
                let [from, to] = dates.unwrap_or_default();
                let between =
                    names.map(|[before, after]| format!(" between {before}{from} and {after}{to}"));
                format!("{}{}", self.shown(step), between.unwrap_or_default())
            }
            (Course::Steady, Some(rate), _) => format!("{rate} over {} logs", self.logs),
            (_, Some(rate), _) => format!("{rate} over {} logs, not significant", self.logs),
            _ => format!(
                "{} logs with a date and an interval; at least {MIN_RUNS} needed",
                self.logs
            ),
        }
    }
}

/// Numbers in a path sort by value.
pub(super) fn natural(path: &str) -> Vec<(u64, String)> {
    let mut parts: Vec<(u64, String)> = Vec::new();
    for part in path.split_inclusive(|c: char| !c.is_ascii_digit()) {
        let digits = part.trim_end_matches(|c: char| !c.is_ascii_digit());
        parts.push((digits.parse().unwrap_or(0), part[digits.len()..].to_owned()));
    }
    parts
}
