//! Config template of `poseaudit init`: the settings found in a log, and on request all others as comments
//! with their defaults.

use std::fmt::Write as _;
use std::path::Path;

use crate::checks::{self, Threshold};
use crate::finding::{CheckRow, Unit};
use crate::report::{Report, RobotRow, StreamRow, quote_line, sanitize};
use crate::robot::catalogue;
use crate::run::RoleSetting;

/// Config that does not change the audit of the log of `report`; later logs are checked against it.
/// Settings that would change it (naming a tip is a claim) are comments. These and the defaults are only
/// listed in `all`.
pub fn template(report: &Report, all: bool) -> String {
    let mut out = Template { text: String::new(), all };
    out.head(report);
    out.robots(&report.robots);
    out.options();
    out.columns(report);
    out.streams(report);
    if all {
        out.ignores();
        out.rules();
    }
    out.text
}

/// Keys in `[columns]`.
const COLUMN_KEYS: [&str; 4] = ["joints", "joint_commands", "pose", "pose_commands"];

struct Template {
    text: String,
    /// Also the keys that are not set.
    all: bool,
}

impl Template {
    fn line(&mut self, text: &str) {
        self.text += text;
        self.text.push('\n');
    }

    fn set(&mut self, key: &str, value: &str, remark: &str) {
        let setting = format!("{key} = {value}");
        match remark.is_empty() {
            true => self.line(&setting),
            false => {
                let remark = one_line(remark);
                let _ = writeln!(self.text, "{setting:<33} # {remark}");
            }
        }
    }

    /// Commented out; only in a complete template.
    fn unset(&mut self, key: &str, value: &str, remark: &str) {
        if self.all {
            self.set(&format!("# {key}"), value, remark);
        }
    }

    fn head(&mut self, report: &Report) {
        let files = report.log.files.iter().map(|file| file_name(&file.path));
        let files = files.collect::<Vec<_>>().join(" ");
        let _ = writeln!(self.text, "# Settings for the robot and its topics, from {files}.");
        self.line(
            "#\n\
             # Use it with `poseaudit audit LOG --config poseaudit.toml`; it is not loaded automatically.\n\
             # Command-line options override it, and paths are relative to this file.",
        );
        self.line(match self.all {
            true => {
                "# Commented keys are defaults, or claims that nobody has made yet. docs/config.md explains\n\
                 # each key. `poseaudit init --schema --output poseaudit.schema.json` writes the schema with\n\
                 # which editors complete and check this file, if this is its first line:\n\
                 # #:schema ./poseaudit.schema.json\n"
            }
            false => {
                "# `poseaudit init LOG --all` also lists all other keys with their defaults.\n"
            }
        });
    }

    fn robots(&mut self, robots: &[RobotRow]) {
        match robots {
            [only] => self.robot(only),
            [] => self.unset("robot", "\"my_arm.urdf\"", "no arm was found"),
            several => {
                for robot in several {
                    self.line(&format!("# {}: {}", one_line(&robot.name), one_line(&robot.source)));
                }
                self.line("# For several arms, a table: robot = { left_ = \"ur5e\", right_ = \"arm.urdf\" }");
            }
        }
        self.unset(
            "calibration",
            "\"calibration.yaml\"",
            "written by calibrate, or for a UR extracted by ur_calibration",
        );
        self.unset(
            "joint_map",
            "{ iiwa_joint_1 = \"lbr_A1\" }",
            "log joint names to model joint names",
        );
    }

    fn robot(&mut self, RobotRow { name, source, base, tip, .. }: &RobotRow) {
        match source.starts_with("the catalogue") && catalogue::find(name).is_some() {
            true => self.set("robot", &quote_line(name), source),
            false => self.unset("robot", &quote_line(name), source),
        }
        self.set("base", &quote_line(base), "first link of the chain");
        self.unset(
            "tip",
            &quote_line(tip),
            "last link of the chain; if set, an offset from it is a fault",
        );
    }

    fn options(&mut self) {
        self.unset("stamp", "\"header\"", "or \"log\", \"publish\"");
        self.unset("max_latency", "\"5 s\"", "larger offsets are reported as clock errors");
        self.unset("fail_on", "\"warning\"", "or \"error\", \"inconclusive\", \"never\"");
        self.unset(
            "require",
            "[\"LAT001\", \"ZER001\"]",
            "rules that must not be inconclusive; default: none",
        );
        self.unset("select", "[\"LAT\", \"ZER001\"]", "evaluate only these rules; default: all");
    }

    fn columns(&mut self, report: &Report) {
        let told = || report.streams.iter().filter(|stream| !stream.columns.is_empty());
        if told().next().is_none() {
            return;
        }
        let before = self.text.len();
        self.line("\n# Contents of the columns.\n[columns]");
        let head = self.text.len();
        match &report.log.time_column {
            Some(column) => self.set("time", &quote_line(column), "by its numbers"),
            None => {
                self.unset("time", "\"timestamp\"", "or rate_hz = 50, if there is no time column");
            }
        }
        let mut last = "";
        for stream in told() {
            let (arm, key) = stream.topic.rsplit_once('/').unwrap_or(("", &stream.topic));
            let value = match stream.columns.as_slice() {
                [only] => quote_line(only),
                several => {
                    let all: Vec<String> = several.iter().map(|name| quote_line(name)).collect();
                    format!("[{}]", all.join(", "))
                }
            };
            let by_names = ["by name", "by the name"].iter().any(|by| stream.reason.contains(by));
            if COLUMN_KEYS.contains(&key) && !by_names {
                if arm != last {
                    let _ = writeln!(self.text, "\n[columns.arm.{}]", quote_line(arm));
                    last = arm;
                }
                self.set(key, &value, "");
                if key == "joints" && !stream.joint_lines.is_empty() {
                    let each = |at: usize| {
                        let all: Vec<f64> =
                            stream.joint_lines.iter().map(|line| line[at]).collect();
                        format!("{all:?}")
                    };
                    self.set("joint_factors", &each(0), "rad = factor * number + offset");
                    self.set("joint_offsets", &each(1), "");
                }
            } else if stream.role == RoleSetting::Joints.name() {
                self.unset("joints", &value, "by their names");
            } else if stream.role == RoleSetting::Pose.name() {
                self.unset("pose", &value, "by their names");
            }
        }
        // A table without keys says nothing.
        if self.text.len() == head {
            self.text.truncate(before);
        }
    }

    fn streams(&mut self, report: &Report) {
        let mut known: Vec<&str> = Vec::new();
        for stream in &report.streams {
            if known.contains(&stream.topic.as_str()) {
                continue;
            }
            known.push(&stream.topic);
            match RoleSetting::ALL.into_iter().find(|role| role.name() == stream.role) {
                Some(role) if role != RoleSetting::Ignored => self.stream(report, stream, role),
                _ if !self.all => {}
                _ => {
                    self.text.push('\n');
                    let _ = writeln!(self.text, "# {}: {}", stream.role, one_line(&stream.reason));
                    let _ = writeln!(self.text, "# [stream.{}]", quote_line(&stream.topic));
                    self.unset("role", "\"pose\"", "if it is one");
                }
            }
        }
    }

    fn stream(&mut self, report: &Report, stream: &StreamRow, role: RoleSetting) {
        let name = role.name();
        let _ = writeln!(self.text, "\n# {}", one_line(&stream.reason));
        let _ = writeln!(self.text, "[stream.{}]", quote_line(&stream.topic));
        self.set("role", &quote_line(name), "");
        let is_expected = matches!(
            role,
            RoleSetting::Joints | RoleSetting::Pose | RoleSetting::Tf | RoleSetting::Imu
        );
        if let Some(rate_hz) = stream.rate_hz.filter(|rate_hz| is_expected && *rate_hz > 0.0) {
            self.set("rate_hz", &round_rate(rate_hz), "");
        }
        if role != RoleSetting::Pose {
            return;
        }
        if let Some(witness) = stream.source_kind {
            self.set("witness", &quote_line(witness), "");
        }
        let frame = stream.frame_id.as_ref().or(stream.reference.as_ref());
        if let Some(frame) = frame {
            self.unset("frame", &quote_line(frame), "reference frame of its poses");
        }
        if let Some(link) = &stream.link {
            self.unset("link", &quote_line(link), "if set, an offset from it is a fault");
        }
        let is_its = |row: &&CheckRow| row.subject.topic.as_ref() == Some(&stream.topic);
        let mut rows = report.checks.iter().filter(is_its);
        let found = rows.find_map(|row| row.estimate.as_ref()?.convention());
        let coding = match found {
            Some((is, _)) => is,
            None if stream.type_name.contains("Array") => "rotvec",
            None => "quat:xyzw",
        };
        self.unset("convention", &quote_line(coding), "if set, what contradicts it is a fault");
        self.unset("units", "[\"m\", \"rad\"]", "with a convention or a vendor");
        self.unset("vendor", "\"ur\"", "or kuka, fanuc, abb, …: convention and units of a vendor");
    }

    fn ignores(&mut self) {
        self.line("\n# Known findings that do not count; the report lists them with the reason.");
        self.line("# [[ignore]]");
        self.unset("code", "\"LAT001\"", "a rule, or the leading letters of a family");
        self.unset("topic", "\"/tcp_pose\"", "or joint, frame, robot; without any of them, all");
        self.unset("reason", "\"the driver's delay, known since March\"", "");
    }

    fn rules(&mut self) {
        self.line("\n# Thresholds of the rules; `poseaudit explain CODE` describes them.");
        for rule in checks::registry() {
            let _ = writeln!(self.text, "\n# {}.\n# [rules.{}]", rule.summary(), rule.code);
            let thresholds = rule.grade.thresholds();
            if thresholds.is_empty() {
                let _ = writeln!(self.text, "# severity = {}", quote_line(&rule.grade.to_string()));
            } else {
                self.unset("warning", &amounts(thresholds, |threshold| threshold.warning), "");
                self.unset("error", &amounts(thresholds, |threshold| threshold.error), "");
            }
            for limit in rule.limits {
                self.unset(limit.key, &amount(limit.unit, limit.value), limit.what);
            }
        }
    }
}

fn amounts(thresholds: &[Threshold], of: fn(&Threshold) -> f64) -> String {
    let shown: Vec<String> =
        thresholds.iter().map(|threshold| amount(threshold.unit, of(threshold))).collect();
    match shown.as_slice() {
        [one] => one.clone(),
        several => format!("[{}]", several.join(", ")),
    }
}

fn amount(unit: Unit, value: f64) -> String {
    match unit {
        Unit::One => format!("{value}"),
        unit => quote_line(&unit.show(value)),
    }
}

fn round_rate(rate_hz: f64) -> String {
    let digits = 2 - rate_hz.log10().floor() as i32;
    let step = 10f64.powi(-digits);
    let rounded = (rate_hz / step).round() * step;
    format!("{rounded:.*}", usize::try_from(digits.max(1)).unwrap_or(1))
}

/// Removes line breaks and control characters.
fn one_line(text: &str) -> String {
    sanitize(&text.split_whitespace().collect::<Vec<_>>().join(" ")).into_owned()
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    one_line(&name.to_string_lossy())
}
