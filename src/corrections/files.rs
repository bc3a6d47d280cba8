//! The files that hold what mends a system.

use std::fmt::Write as _;
use std::path::Path;

use similar::TextDiff;

use super::collect::{
    CONVENTIONS, CORRECTIONS, JOINTS, LATENCIES, MODEL, MODULE, Mended, Mending, OFFSETS,
    TRANSFORMS,
};
use super::file::JointCorrection;
use super::frames::{in_xml, model_stem};
use crate::geometry::CodeLine;
use crate::report::markdown::prose;
use crate::report::{quoted, tame};

/// The file that says what the others are.
const INDEX: &str = "corrections.md";

/// All files but those of the models.
pub(crate) const FIX_FILES: [&str; 8] =
    [INDEX, CORRECTIONS, OFFSETS, LATENCIES, CONVENTIONS, TRANSFORMS, JOINTS, MODULE];

/// The files that a patched copy of the model at `source` may be, and the patch.
pub(crate) fn model_files(source: &Path) -> [String; 4] {
    let stem = model_stem(source);
    ["urdf", "toml", "urdf.patch", "toml.patch"].map(|ending| format!("{stem}.{ending}"))
}

impl Mending {
    /// The files, each with its text.
    pub fn files(&self) -> Vec<(String, String)> {
        let mut files = vec![
            (INDEX.to_owned(), self.index()),
            (CORRECTIONS.to_owned(), self.corrections.to_text()),
        ];
        let mut add = |name: &str, text: Option<String>| {
            files.extend(text.map(|text| (name.to_owned(), text)));
        };
        add(OFFSETS, self.offsets());
        add(LATENCIES, self.latencies());
        add(CONVENTIONS, self.conventions());
        add(TRANSFORMS, self.transforms());
        add(JOINTS, self.joints());
        add(MODULE, self.module.clone());
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
        if self.mended.is_empty() {
            text += "Nothing was found that a file could mend.\n";
        } else {
            text += "| finding | what is wrong | in |\n|---|---|---|\n";
            for mended in &self.mended {
                let Mended { finding, what, .. } = mended;
                let (finding, what) = (prose(finding), prose(what));
                let _ =
                    writeln!(text, "| {finding} | {what} | {} |", self.names(mended).join(", "));
            }
        }
        if !self.open.is_empty() {
            text += "\n## Not in these files\n\n";
            for left in &self.open {
                let _ = writeln!(text, "- {}: {}", prose(&left.finding), prose(&left.why));
            }
        }
        text += "\n## The files\n\n";
        for (name, what) in self.descriptions() {
            let _ = writeln!(text, "- `{name}`: {what}");
        }
        text += "\nFiles not listed here are left over from an earlier run.\n";
        text += "\n## To try them\n\n";
        text += "`poseaudit audit LOG --corrections corrections.toml` applies them to the streams of the\n\
                 log before it judges anything: corrected findings should disappear.\n";
        if !self.models.is_empty() {
            text += "A patched model, given with `--robot`, stands in the place of the joint offsets: take\n\
                     these out of `corrections.toml` then, and out of any driver. What the log's own /tf\n\
                     was published with is the model before the patch, which FRM001 will say.\n";
        }
        for why in &self.unpatched {
            let why = prose(why);
            let _ = writeln!(text, "\nNo patched model of {why}. `{OFFSETS}` holds the offsets.");
        }
        text
    }

    /// The files that hold what mends a finding.
    fn names(&self, mended: &Mended) -> Vec<String> {
        let names = mended.files.iter().flat_map(|&file| match file {
            MODEL => self.models.iter().map(|model| model.file.clone()).collect(),
            file => vec![file.to_owned()],
        });
        names.map(|name| format!("`{name}`")).collect()
    }

    fn descriptions(&self) -> Vec<(String, &'static str)> {
        let mut all = vec![(
            CORRECTIONS.to_owned(),
            "all of it for a program; `audit --corrections` takes it back",
        )];
        let mut add = |name: &str, what: &'static str, is_there: bool| {
            all.extend(is_there.then(|| (name.to_owned(), what)));
        };
        add(
            OFFSETS,
            "what must be added to each joint's reported position",
            !self.corrections.joints.is_empty(),
        );
        add(LATENCIES, "how late each topic is", self.latencies().is_some());
        add(CONVENTIONS, "the lines of code that read a topic rightly", !self.codes.is_empty());
        add(TRANSFORMS, "frames as commands of tf2_ros", !self.frames.is_empty());
        add(JOINTS, "the same frames as joints of a URDF", !self.frames.is_empty());
        let module =
            "offsets and delays of the dataset's columns in Python, also as a LeRobot step";
        add(MODULE, module, self.module.is_some());
        for model in &self.models {
            add(&model.file, "the model, its joints' origins turned by the offsets", true);
            add(&format!("{}.patch", model.file), "what was changed in it, for `patch -p1`", true);
        }
        all
    }

    fn offsets(&self) -> Option<String> {
        if self.corrections.joints.is_empty() {
            return None;
        }
        let mut text = "\
# Zero offsets of joints: q_true = q_reported + offset (rad; m of a joint that slides). A joint with a
# factor has q_true = factor * q_reported + offset.
# ci95 is the 95 % interval. Add the offset where the position is reported, or use the patched model,
# not both.
joints:
"
        .to_owned();
        for joint in &self.corrections.joints {
            let JointCorrection { name, robot, factor, factor_ci95, offset_rad, offset_m, ci95 } =
                joint;
            let _ = writeln!(text, "  {}:", quoted(name));
            if let Some(robot) = robot {
                let _ = writeln!(text, "    robot: {}", quoted(robot));
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
        }
        Some(text)
    }

    fn latencies(&self) -> Option<String> {
        let topics = &self.corrections.topics;
        let late = topics.iter().filter(|topic| topic.latency_s.is_some() || topic.skew.is_some());
        let mut text = "\
# Latency of topics against the joint states, s. Positive is late: what is stamped t was true at
# t - latency_s, so take latency_s off the stamps. ci95 is the 95 % interval.
# A skew says by how much the latency grows with each second of stamp; it is latency_s (0 where that is
# not given) skew_about_s seconds after the first stamp of the run.
topics:
"
        .to_owned();
        let mut is_any = false;
        for topic in late {
            is_any = true;
            let _ = writeln!(text, "  {}:", quoted(&topic.name));
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
        if self.codes.is_empty() {
            return None;
        }
        let mut text =
            "# Conventions\n\nChange the line that turns numbers into poses, and nothing \
                        after it.\n"
                .to_owned();
        for coded in &self.codes {
            let [finding, what] = [&coded.finding, &coded.what].map(|text| prose(text));
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
        let mut text =
            "#!/bin/sh\n# Frames that do not move, for tf2_ros; one process each.\n".to_owned();
        for frame in &self.frames {
            let comment = format!("{}: {}", frame.finding, frame.comment);
            let comment = tame(&comment);
            let _ = write!(text, "\n# {comment}\n{} &\n", frame.command());
        }
        text += "\nwait\n";
        Some(text)
    }

    fn joints(&self) -> Option<String> {
        if self.frames.is_empty() {
            return None;
        }
        let mut text =
            "<!-- Joints to put into a URDF. A frame that is new needs its link besides: \
                        <link name=\"...\"/>. -->\n"
                .to_owned();
        for frame in &self.frames {
            let (finding, comment) = (in_xml(&frame.finding), in_xml(&frame.comment));
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
