use std::fmt::Write as _;
use std::path::Path;

use similar::TextDiff;

use super::collect::{
    CONVENTIONS_FILE, CORRECTIONS_FILE, CorrectedFinding, CorrectionPlan, JOINTS_FILE,
    LATENCIES_FILE, MODULE_FILE, OFFSETS_FILE, PATCHED_MODEL, TRANSFORMS_FILE,
};
use super::corrections_file::{CouplingCorrection, JointCorrection};
use super::frames::{escape_xml, model_stem};
use crate::geometry::CodeLine;
use crate::report::markdown::escape_prose;
use crate::report::{quote_line, sanitize};

const INDEX_FILE: &str = "corrections.md";

/// All files except the models.
pub(crate) const FIX_FILES: [&str; 8] = [
    INDEX_FILE, CORRECTIONS_FILE, OFFSETS_FILE, LATENCIES_FILE, CONVENTIONS_FILE, TRANSFORMS_FILE,
    JOINTS_FILE, MODULE_FILE,
];

/// A patched copy of the model at `source`, with its patch.
pub(crate) fn model_files(source: &Path) -> [String; 4] {
    let stem = model_stem(source);
    ["urdf", "toml", "urdf.patch", "toml.patch"].map(|ending| format!("{stem}.{ending}"))
}

impl CorrectionPlan {
    /// File names and contents.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![
            (INDEX_FILE.to_owned(), self.index()),
            (CORRECTIONS_FILE.to_owned(), self.corrections.to_text()),
        ];
        let mut add = |name: &str, text: Option<String>| {
            files.extend(text.map(|text| (name.to_owned(), text)));
        };
        add(OFFSETS_FILE, self.offsets());
        add(LATENCIES_FILE, self.latencies());
        add(CONVENTIONS_FILE, self.conventions());
        add(TRANSFORMS_FILE, self.transforms());
        add(JOINTS_FILE, self.joints());
        add(MODULE_FILE, self.module.clone());
        for model in &self.models {
            let (old, new) = (format!("a/{}", model.file), format!("b/{}", model.file));
            let diff = TextDiff::from_lines(&model.before, &model.after);
            let patch = diff.unified_diff().header(&old, &new).to_string();
            files.push((model.file.clone(), model.after.clone()));
            files.push((format!("{}.patch", model.file), patch));
        }
        files
    }

    fn index(&self) -> String {
        let mut text = "# Corrections\n\n".to_owned();
        if self.corrected.is_empty() {
            text += "No finding can be corrected by a file.\n";
        } else {
            text += "| finding | correction | in |\n|---|---|---|\n";
            for corrected in &self.corrected {
                let CorrectedFinding { finding, what, .. } = corrected;
                let (finding, what) = (escape_prose(finding), escape_prose(what));
                let _ = writeln!(
                    text,
                    "| {finding} | {what} | {} |",
                    self.file_names(corrected).join(", ")
                );
            }
        }
        if !self.uncorrected.is_empty() {
            text += "\n## Not in these files\n\n";
            for finding in &self.uncorrected {
                let _ = writeln!(
                    text,
                    "- {}: {}",
                    escape_prose(&finding.finding),
                    escape_prose(&finding.why)
                );
            }
        }
        text += "\n## The files\n\n";
        for (name, what) in self.descriptions() {
            let _ = writeln!(text, "- `{name}`: {what}");
        }
        text += "\nFiles not listed here are from an earlier run.\n";
        text += "\n## Try them\n\n";
        text += "`poseaudit audit LOG --corrections corrections.toml` applies them to the streams of the\n\
            log before the rules run: corrected findings should disappear.\n";
        if !self.models.is_empty() {
            text += "A patched model, passed with `--robot`, replaces the joint offsets: remove them from\n\
                `corrections.toml` and from any driver. The log's own /tf was published with the\n\
                unpatched model, so FRM001 will report it.\n";
        }
        for why in &self.unpatched {
            let why = escape_prose(why);
            let _ =
                writeln!(text, "\nNo patched model of {why}. `{OFFSETS_FILE}` holds the offsets.");
        }
        text
    }

    /// Files that correct a finding.
    fn file_names(&self, corrected: &CorrectedFinding) -> Vec<String> {
        let names = corrected.files.iter().flat_map(|&file| match file {
            PATCHED_MODEL => self.models.iter().map(|model| model.file.clone()).collect(),
            file => vec![file.to_owned()],
        });
        names.map(|name| format!("`{name}`")).collect()
    }

    fn descriptions(&self) -> Vec<(String, &'static str)> {
        let mut all =
            vec![(CORRECTIONS_FILE.to_owned(), "all corrections, for `audit --corrections`")];
        let mut add = |name: &str, what: &'static str, is_there: bool| {
            all.extend(is_there.then(|| (name.to_owned(), what)));
        };
        add(
            OFFSETS_FILE,
            "offsets, factors and couplings of the reported joint positions",
            !self.corrections.joints.is_empty(),
        );
        add(LATENCIES_FILE, "latency of each topic", self.latencies().is_some());
        add(
            CONVENTIONS_FILE,
            "lines of code that decode a topic correctly",
            !self.decodings.is_empty(),
        );
        add(TRANSFORMS_FILE, "frames as tf2_ros commands", !self.frames.is_empty());
        add(JOINTS_FILE, "the same frames as URDF joints", !self.frames.is_empty());
        let module =
            "offsets and delays of the dataset's columns as a Python module, with a LeRobot step";
        add(MODULE_FILE, module, self.module.is_some());
        for model in &self.models {
            add(&model.file, "the model with joint origins corrected by the offsets", true);
            add(
                &format!("{}.patch", model.file),
                "the changes to the model, for `patch -p1`",
                true,
            );
        }
        all
    }

    fn offsets(&self) -> Option<String> {
        if self.corrections.joints.is_empty() {
            return None;
        }
        let mut text = "\
# Zero offsets of joints: q_true = q_reported + offset (rad; m for a prismatic joint). A joint with a
# factor has q_true = factor * q_reported + offset. A joint that is coupled to another one, `with`, has
# with_factor times the position of that joint added.
# ci95 is the 95 % interval. Either add the offset to the reported position or use the patched model,
# not both.
joints:
"
        .to_owned();
        for joint in &self.corrections.joints {
            let JointCorrection {
                name,
                robot,
                factor,
                factor_ci95,
                offset_rad,
                offset_m,
                ci95,
                coupling,
            } = joint;
            let _ = writeln!(text, "  {}:", quote_line(name));
            if let Some(robot) = robot {
                let _ = writeln!(text, "    robot: {}", quote_line(robot));
            }
            for (key, offset) in
                [("factor", factor), ("offset_rad", offset_rad), ("offset_m", offset_m)]
            {
                if let Some(offset) = offset {
                    let _ = writeln!(text, "    {key}: {offset}");
                }
            }
            push_interval(&mut text, "factor_ci95", *factor_ci95);
            push_interval(&mut text, "ci95", *ci95);
            if let Some(CouplingCorrection { joint, factor, ci95 }) = coupling {
                let _ = writeln!(text, "    with: {}", quote_line(joint));
                let _ = writeln!(text, "    with_factor: {factor}");
                push_interval(&mut text, "with_factor_ci95", *ci95);
            }
        }
        Some(text)
    }

    fn latencies(&self) -> Option<String> {
        let topics = &self.corrections.topics;
        let late = topics.iter().filter(|topic| topic.latency_s.is_some() || topic.skew.is_some());
        let mut text = "\
# Latency of topics relative to the joint states, s. Positive is late: a sample stamped t was taken at
# t - latency_s, so subtract latency_s from the stamps. ci95 is the 95 % interval.
# A skew is the growth of the latency per second of stamp. The latency is latency_s (0 if not given)
# skew_about_s seconds after the first stamp of the run.
topics:
"
        .to_owned();
        let mut is_any = false;
        for topic in late {
            is_any = true;
            let _ = writeln!(text, "  {}:", quote_line(&topic.name));
            if let Some(latency_s) = topic.latency_s {
                let _ = writeln!(text, "    latency_s: {latency_s}");
                push_interval(&mut text, "ci95", topic.latency_ci95);
            }
            if let (Some(skew), Some(about_s)) = (topic.skew, topic.skew_about_s) {
                let _ = writeln!(text, "    skew: {skew}");
                push_interval(&mut text, "skew_ci95", topic.skew_ci95);
                let _ = writeln!(text, "    skew_about_s: {about_s}");
            }
        }
        is_any.then_some(text)
    }

    fn conventions(&self) -> Option<String> {
        if self.decodings.is_empty() {
            return None;
        }
        let mut text =
            "# Conventions\n\nChange only the line that converts numbers to poses.\n".to_owned();
        for coded in &self.decodings {
            let [finding, what] = [&coded.finding, &coded.what].map(|text| escape_prose(text));
            let _ = writeln!(text, "\n## {finding}\n\n{what}; {}\n", coded.names);
            for CodeLine { library, line } in coded.lines.iter().flatten() {
                let _ = writeln!(text, "- {library}: `{line}`");
            }
        }
        Some(text)
    }

    fn transforms(&self) -> Option<String> {
        if self.frames.is_empty() {
            return None;
        }
        let mut text = "#!/bin/sh\n# Static frames for tf2_ros; one process each.\n".to_owned();
        for frame in &self.frames {
            let comment = format!("{}: {}", frame.finding, frame.comment);
            let comment = sanitize(&comment);
            let _ = write!(text, "\n# {comment}\n{} &\n", frame.command());
        }
        text += "\nwait\n";
        Some(text)
    }

    fn joints(&self) -> Option<String> {
        if self.frames.is_empty() {
            return None;
        }
        let mut text = "<!-- Joints to add to a URDF. A new frame also needs a link: \
                        <link name=\"...\"/>. -->\n"
            .to_owned();
        for frame in &self.frames {
            let (finding, comment) = (escape_xml(&frame.finding), escape_xml(&frame.comment));
            let _ = write!(text, "\n<!-- {finding}: {comment} -->\n{}\n", frame.joint());
        }
        Some(text)
    }
}

fn push_interval(text: &mut String, key: &str, ci95: Option<[f64; 2]>) {
    if let Some([low, high]) = ci95 {
        let _ = writeln!(text, "    {key}: [{low}, {high}]");
    }
}
