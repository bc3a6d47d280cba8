//! `poseaudit tf`.

use std::io::{self, Write};
use std::path::PathBuf;
use std::str::FromStr;

use poseaudit::geometry::{Convention, Pose, xyz_of, xyzw_from_rotation};
use poseaudit::log::{self, ReadOptions};
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;
use poseaudit::run::{RobotSource, Run, RunOptions, TfPath};
use poseaudit::time::Stamp;
use serde_json::json;

use super::output::Format;
use super::progress::with_progress;
use super::{Outcome, fk, misuse, output};

/// The transform between two frames of a log, like tf2's lookup_transform
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit tf run.mcap base tool0 --at +3.5
  poseaudit tf run.mcap base tool0 --follow 2")]
pub struct Args {
    /// The log
    #[arg(value_name = "LOG")]
    log: PathBuf,

    /// The reference frame of the pose
    #[arg(value_name = "TARGET")]
    target: String,

    /// The frame whose pose is printed
    #[arg(value_name = "SOURCE")]
    source: String,

    /// Time: +S from the start of the log, or S since the epoch [default: the last time at which all
    /// transforms between the two are known]
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    at: Option<Time>,

    /// Print the whole run at this rate, Hz
    #[arg(long, value_name = "HZ", value_parser = parse_positive, conflicts_with = "at")]
    follow: Option<f64>,

    /// The robot, for transforms that are missing in the log
    #[arg(long = "robot", value_name = "FILE|NAME")]
    robots: Vec<RobotSource>,

    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Time {
    FromStart(f64),
    At(Stamp),
}

impl FromStr for Time {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "expected +S from the start, or seconds since the epoch".to_owned();
        let number = |text: &str| {
            let seconds = text.parse::<f64>().ok().filter(|seconds| seconds.is_finite());
            seconds.ok_or_else(expected)
        };
        if let Some(text) = text.strip_prefix('+') {
            return Ok(Self::FromStart(number(text)?));
        }
        if text.starts_with('-') {
            return Err(expected());
        }
        // `f64` has too few digits for epoch nanoseconds.
        let (whole, part) = text.split_once('.').unwrap_or((text, ""));
        let nanos = format!("{part:0<9}");
        let digits = whole
            .parse::<i64>()
            .ok()
            .zip(nanos.get(..9).and_then(|nanos| nanos.parse::<i64>().ok()));
        let (whole, nanos) = digits.ok_or_else(expected)?;
        Ok(Self::At(Stamp::from_nanos(whole.saturating_mul(1_000_000_000).saturating_add(nanos))))
    }
}

fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if rate > 0.0 && rate <= 1e4 => Ok(rate),
        _ => Err("expected a rate between 0 and 10000 Hz".to_owned()),
    }
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    PathRegistry::check_read_only([&args.log])?;
    let log = with_progress(|progress| {
        let options = ReadOptions { progress: Some(progress), ..ReadOptions::default() };
        log::open(std::slice::from_ref(&args.log), &options)
    })?;
    let options = RunOptions { robots: args.robots.clone(), ..RunOptions::default() };
    let run = Run::assemble(log, &options).map_err(|error| Trouble::from(&error))?;
    let path = run
        .tf
        .path(&args.target, &args.source, |_| true)
        .map_err(|error| misuse("tf", error, "see `poseaudit info` for the frames of the log"))?;
    if path.span().is_some_and(|(first, last)| first > last) {
        let what = "the transforms between the two are never all known at the same time";
        let remedy = "see `poseaudit info` for when each topic begins and ends";
        return Err(misuse(format!("{} → {}", args.target, args.source), what, remedy));
    }
    let start = run.span.map_or(run.origin, |(start, _)| start);
    let at = lookup_time(args, &path, start)?;
    let rows = TransformPrinter { args, path: &path, start };
    output::emit(None, |out| match args.follow {
        Some(rate_hz) => rows.print_rows(rate_hz, out),
        None => rows.print_one(at, out),
    })?;
    Ok(Outcome::Clean)
}

/// The time of `--at`, by default the last at which all transforms are known.
///
/// # Errors
/// If the transforms do not cover it; like tf2, poseaudit does not extrapolate.
fn lookup_time(args: &Args, path: &TfPath<'_>, start: Stamp) -> Result<Stamp, Trouble> {
    let at = args.at.map(|at| match at {
        Time::FromStart(seconds) => start.shifted(seconds),
        Time::At(stamp) => stamp,
    });
    let Some((first, last)) = path.span() else { return Ok(at.unwrap_or(start)) };
    let at = at.unwrap_or(last);
    if (first..=last).contains(&at) {
        return Ok(at);
    }
    // Rounded inwards: the printed times are covered.
    let from_s = (1e3 * first.seconds_since(start)).ceil() / 1e3;
    let to_s = (1e3 * last.seconds_since(start)).floor() / 1e3;
    let what = format!(
        "{:+.3} s is outside the log's transforms, which cover {:+.3} to {:+.3} s (epoch {} to {})",
        at.seconds_since(start),
        from_s + 0.0,
        to_s,
        epoch_text(first),
        epoch_text(last)
    );
    Err(misuse("--at", what, "choose a time between these"))
}

struct TransformPrinter<'a> {
    args: &'a Args,
    path: &'a TfPath<'a>,
    /// Start of the log.
    start: Stamp,
}

fn pose_origin(path: &TfPath<'_>, at: Stamp) -> &'static str {
    match path.span() {
        None => "static",
        Some(_) if path.is_sampled(at) => "as published",
        Some(_) => "interpolated",
    }
}

impl TransformPrinter<'_> {
    fn pose_at(&self, at: Stamp) -> io::Result<Pose> {
        self.path.pose_at(at).map_err(io::Error::other)
    }

    fn print_one(&self, at: Stamp, out: &mut dyn Write) -> io::Result<()> {
        let pose = self.pose_at(at)?;
        let origin = pose_origin(self.path, at);
        let age_s = self.path.newest_before(at).map(|newest| at.seconds_since(newest));
        if self.args.format == Format::Json {
            return self.print_json(at, &pose, out);
        }
        let (target, source) = (&self.args.target, &self.args.source);
        let from_start_s = at.seconds_since(self.start);
        write!(out, "{target} → {source} at {from_start_s:+.3} s ({}), {origin}", epoch_text(at))?;
        match age_s {
            Some(age_s) => {
                writeln!(out, "; the oldest sample it needs is {:.1} ms old", 1e3 * age_s)?
            }
            None => writeln!(out)?,
        }
        fk::write_pose(&pose, true, out)
    }

    fn print_rows(&self, rate_hz: f64, out: &mut dyn Write) -> io::Result<()> {
        let Some((first, last)) = self.path.span() else {
            return self.print_one(self.start, out);
        };
        if self.args.format == Format::Text {
            let [t, x, y, z] = ["t, s", "x, m", "y, m", "z, m"];
            let [roll, pitch, yaw] = ["roll, °", "pitch, °", "yaw, °"];
            writeln!(
                out,
                "{t:>10} {x:>10} {y:>10} {z:>10} {roll:>9} {pitch:>9} {yaw:>9}   quaternion x y z w"
            )?;
        }
        let rows = (last.seconds_since(first).max(0.0) * rate_hz) as u64 + 1;
        for row in 0..rows {
            let at = first.shifted(row as f64 / rate_hz).min(last);
            let pose = self.pose_at(at)?;
            if self.args.format == Format::Json {
                self.print_json(at, &pose, out)?;
                continue;
            }
            let [x, y, z] = xyz_of(&pose);
            let [roll, pitch, yaw] = Convention::RPY.numbers(&pose.rotation).map(f64::to_degrees);
            let [qx, qy, qz, qw] = xyzw_from_rotation(&pose.rotation);
            writeln!(
                out,
                "{:>10.3} {x:>10.5} {y:>10.5} {z:>10.5} {roll:>9.3} {pitch:>9.3} {yaw:>9.3}   \
                 {qx:.5} {qy:.5} {qz:.5} {qw:.5}",
                at.seconds_since(self.start)
            )?;
        }
        Ok(())
    }

    fn print_json(&self, at: Stamp, pose: &Pose, out: &mut dyn Write) -> io::Result<()> {
        let newest = self.path.newest_before(at);
        let row = json!({
            "target": self.args.target,
            "source": self.args.source,
            "stamp_ns": at.to_string(),
            "t_s": at.seconds_since(self.start),
            "age_s": newest.map(|newest| at.seconds_since(newest)),
            "how": pose_origin(self.path, at),
            "xyz_m": xyz_of(pose),
            "xyzw": xyzw_from_rotation(&pose.rotation),
            "rpy_rad": Convention::RPY.numbers(&pose.rotation),
            "matrix": fk::matrix(pose),
        });
        writeln!(out, "{row}")
    }
}

/// Epoch time with nanosecond digits.
fn epoch_text(at: Stamp) -> String {
    let nanos = at.nanos();
    format!("{}.{:09}", nanos.div_euclid(1_000_000_000), nanos.rem_euclid(1_000_000_000))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_from_the_start_or_since_the_epoch_to_the_nanosecond() {
        assert_eq!("+1.5".parse(), Ok(Time::FromStart(1.5)));
        let at = Stamp::from_nanos(1_780_000_000_123_456_789);
        assert_eq!("1780000000.123456789".parse(), Ok(Time::At(at)));
        assert_eq!(epoch_text(at), "1780000000.123456789");
        for wrong in ["now", "+x", "-100", "-0.5"] {
            assert!(wrong.parse::<Time>().is_err(), "{wrong}");
        }
    }
}
