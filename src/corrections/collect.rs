//! From the findings of an audit to what mends them.

use serde_json::Value;

use super::code::{self, Lines};
use super::file::{AxesCorrection, Corrections, FrameCorrection, JointOrder, RotationSlip, Slip};
use super::files::{model_stem, slug};
use super::frames::{FixedFrame, rounded};
use crate::checks::Facts;
use crate::diagnosis::Reading;
use crate::finding::{Estimate, Finding, Unit};
use crate::geometry::{
    AngleUnit, Axes, Convention, LengthScale, Pose, QuaternionSlip, pose, rotation_from_xyzw,
};
use crate::report::{Report, StreamRow};
use crate::run::{Arm, Run};
use crate::stream::Orientations;

/// All that mends what an audit found, and what is found that nothing here mends.
pub(crate) struct Mending {
    /// What an audit takes back.
    pub corrections: Corrections,
    pub(super) codes: Vec<Coded>,
    pub(super) frames: Vec<FixedFrame>,
    pub(super) models: Vec<Patched>,
    /// Why a model with joint offsets is not patched.
    pub(super) unpatched: Vec<String>,
    pub(super) mended: Vec<Mended>,
    pub(super) open: Vec<Left>,
}

/// How the numbers of a topic must be read.
pub(super) struct Coded {
    pub finding: String,
    /// What is wrong, in words.
    pub what: String,
    /// What names the code uses for the numbers of the log.
    pub names: String,
    pub lines: Option<Lines>,
}

/// A model's text, and the same changed.
pub(super) struct Patched {
    pub file: String,
    pub before: String,
    pub after: String,
}

/// A finding that files mend.
pub(super) struct Mended {
    pub finding: String,
    pub what: String,
    pub files: Vec<&'static str>,
}

/// A finding that no file mends.
pub(super) struct Left {
    pub finding: String,
    pub why: String,
}

pub(super) const CORRECTIONS: &str = "corrections.toml";
pub(super) const OFFSETS: &str = "joint_offsets.yaml";
pub(super) const LATENCIES: &str = "latency.yaml";
pub(super) const CONVENTIONS: &str = "conventions.md";
pub(super) const TRANSFORMS: &str = "static_transforms.sh";
pub(super) const JOINTS: &str = "fixed_joints.xml";
/// Stands for the patched model, whose name is that of the model.
pub(super) const MODEL: &str = "the patched model";

/// What a finding is mended by, in words, and in which files; or why by nothing.
type Taken = Result<(String, Vec<&'static str>), String>;

impl Mending {
    /// What mends the findings of `report`, which is on `run`, or has it as its segment `main`.
    pub fn of(report: &Report, run: &Run, facts: &Facts, main: usize) -> Self {
        let mut mending = Self {
            corrections: Corrections::default(),
            codes: Vec::new(),
            frames: Vec::new(),
            models: Vec::new(),
            unpatched: Vec::new(),
            mended: Vec::new(),
            open: Vec::new(),
        };
        let source = Source { report, run, facts };
        for finding in &report.findings {
            let label = label(finding);
            let taken = match segment(finding) {
                Some(number) if number != main as u64 + 1 => {
                    Err("it is of another segment of the run than the longest".to_owned())
                }
                of => mending.take(&source, finding, of.is_some()),
            };
            match taken {
                Ok((what, files)) => mending.mended.push(Mended { finding: label, what, files }),
                Err(why) => mending.open.push(Left { finding: label, why }),
            }
        }
        mending.patch_models(run);
        mending
    }

    fn take(&mut self, source: &Source<'_>, finding: &Finding, is_of_segment: bool) -> Taken {
        match finding.code {
            "ZER001" => self.take_zero(source, finding),
            "LAT001" => self.take_latency(source, finding),
            "LAT002" if !is_of_segment => self.take_skew(source, finding),
            "ORD001" | "ORD002" | "ORD003" => self.take_rotation(source, finding),
            "ORD004" | "ORD008" if finding.subject.joint.is_some() => {
                self.take_joint_unit(source, finding)
            }
            "ORD004" | "ORD008" => self.take_unit(source, finding),
            "ORD009" => self.take_scale(source, finding),
            "ORD010" => self.take_axes(source, finding),
            "ORD005" => self.take_order(finding),
            "ORD007" => match &finding.estimate {
                Some(Estimate::Slip { is, read_as, .. }) => {
                    Ok((format!("the DH table is {is}, not {read_as}"), vec![MODEL]))
                }
                _ => Err(nothing()),
            },
            "FRM002" | "FRM003" => self.take_frame(source, finding),
            "YAW003" => self.take_mount(source, finding),
            "HEC001" => self.take_camera(source, finding),
            "MDL001" => {
                match finding.evidence.more.get("fits").and_then(|fits| fits["robot"].as_str()) {
                    Some(robot) => Ok((format!("audit with `--robot {robot}`"), Vec::new())),
                    None => Err(finding.fix.clone()),
                }
            }
            _ => Err(finding.fix.clone()),
        }
    }

    fn take_zero(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let (value, unit, ci95) = amount(finding)?;
        let name = finding.subject.joint.clone().ok_or_else(nothing)?;
        let robot = source.robot_of(finding, &name);
        let slides = unit == Unit::Metre.symbol();
        let joint = self.corrections.joint(&name, robot);
        (joint.offset_rad, joint.offset_m) =
            if slides { (None, Some(value)) } else { (Some(value), None) };
        joint.ci95 = ci95;
        let unit = if slides { Unit::Metre } else { Unit::Radian };
        Ok((format!("offset of {}", unit.show(value)), vec![OFFSETS, MODEL, CORRECTIONS]))
    }

    /// A joint whose numbers alone are of another unit.
    fn take_joint_unit(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let Some(Estimate::Slip { is, read_as, .. }) = &finding.estimate else {
            return Err(nothing());
        };
        let name = finding.subject.joint.clone().ok_or_else(nothing)?;
        let robot = source.robot_of(finding, &name);
        let factor = match is.as_ref() {
            "deg" => AngleUnit::Degree.in_rad(),
            "cm" => 1e-2,
            _ => LengthScale::MILLIMETRE.in_m(),
        };
        self.corrections.joint(&name, robot).factor = Some(factor);
        Ok((format!("{is} read as {read_as}"), vec![OFFSETS, CORRECTIONS]))
    }

    /// Joints that have a scale of their own.
    fn take_scale(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let topic = finding.subject.topic.clone().ok_or_else(nothing)?;
        let of_topic = source.facts.robots.iter().filter(|arm| arm.joints_topic == topic);
        let is_meant = |name: &str| finding.subject.joint.as_deref().is_none_or(|own| own == name);
        let mut shown = None;
        for arm in of_topic.filter(|arm| finding.subject.robot.as_ref() == Some(&arm.name)) {
            for scale in &arm.diagnosis.scales {
                let Some(joint) = arm.joints.get(scale.column) else { continue };
                if !is_meant(&joint.name) {
                    continue;
                }
                let robot = source.robot_of(finding, &joint.name);
                let own = self.corrections.joint(&joint.name, robot);
                own.factor = Some(scale.factor.value);
                own.factor_ci95 = Unit::One.interval95(&scale.factor);
                if scale.is_coded() && scale.offset != 0.0 {
                    let offset = Some(scale.offset);
                    (own.offset_rad, own.offset_m) =
                        if joint.prismatic { (None, offset) } else { (offset, None) };
                }
                shown = shown.or(Some(scale.factor.value));
            }
        }
        let factor = shown.ok_or_else(nothing)?;
        Ok((format!("factor of {factor:.5}"), vec![OFFSETS, CORRECTIONS]))
    }

    fn take_latency(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let (value, _, ci95) = amount(finding)?;
        let topic = source.lone_topic(finding)?;
        let mut copies = Vec::new();
        if let Some(arm) = source.facts.robots.iter().find(|arm| arm.joints_topic == topic) {
            // Who copies the joints' stamps is as late as they are.
            let poses = arm.poses_and_tf().filter(|(stream, _)| !stream.independent);
            copies.extend(poses.map(|(stream, _)| stream.topic.clone()));
            let imus = arm.imus.iter().filter(|(imu, _)| !imu.independent);
            copies.extend(imus.map(|(imu, _)| imu.topic.clone()));
        }
        let mut what = format!("latency of {}", Unit::Second.show(value));
        if !copies.is_empty() {
            what += &format!(", with {} whose stamps are copies", copies.join(" and "));
        }
        let own = self.corrections.topic(&topic);
        own.latency_s = Some(own.latency_s.unwrap_or(0.0) + value);
        own.latency_ci95 = ci95;
        for copy in copies {
            let copy = self.corrections.topic(&copy);
            copy.latency_s = Some(copy.latency_s.unwrap_or(0.0) + value);
            copy.latency_ci95 = copy.latency_ci95.or(ci95);
        }
        Ok((what, vec![LATENCIES, CORRECTIONS]))
    }

    fn take_skew(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let (value, _, ci95) = amount(finding)?;
        let topic = source.lone_topic(finding)?;
        let (start, end) = finding.start_ns.zip(finding.end_ns).ok_or_else(nothing)?;
        let own = self.corrections.topic(&topic);
        (own.skew, own.skew_ci95) = (Some(value), ci95);
        own.skew_about_s = Some(0.5 * end.seconds_since(start));
        let what = format!("clock skew of {}", Unit::SecondPerSecond.show(value));
        Ok((what, vec![LATENCIES, CORRECTIONS]))
    }

    /// Takes what bare numbers were read as, so that frames can be applied to them.
    fn take_numbers(&mut self, source: &Source<'_>, finding: &Finding, form: &str) -> Taken {
        let text = |name: &str| finding.evidence.more.get(name).and_then(Value::as_str);
        let (length, angle) = text("length_unit").zip(text("angle_unit")).ok_or_else(nothing)?;
        let topic = source.lone_topic(finding)?;
        let correction = self.corrections.topic(&topic);
        if length != "m" {
            let slip = Slip { is: length.parse()?, read_as: LengthScale::METRE };
            correction.length_unit = Some(slip);
        }
        match form.parse::<Convention>() {
            Ok(convention) => {
                correction.convention = Some(convention);
                if angle == "deg" {
                    let slip = Slip { is: AngleUnit::Degree, read_as: AngleUnit::Radian };
                    correction.angle_unit = Some(slip);
                }
            }
            Err(_) => {
                let slip = QuaternionSlip::WxyzReadAsXyzw;
                correction.rotation = Some(RotationSlip::Quaternion(slip));
            }
        }
        Ok((format!("bare numbers are {form}, {length}, {angle}"), vec![CORRECTIONS]))
    }

    fn take_rotation(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        if let Some(Estimate::Slip { name: "reading", is, .. }) = &finding.estimate {
            return self.take_numbers(source, finding, is);
        }
        let (is, read_as) = match &finding.estimate {
            Some(Estimate::Convention { is, read_as, .. }) => (is.as_str(), read_as.as_str()),
            Some(Estimate::Slip { is, read_as, .. }) => (is.as_ref(), read_as.as_ref()),
            _ => return Err(nothing()),
        };
        let slip = Slip { is: is.to_owned(), read_as: read_as.to_owned() };
        let slip = RotationSlip::try_from(slip)?;
        let topic = source.lone_topic(finding)?;
        let (names, lines) = match slip {
            RotationSlip::Misread(misreading) => {
                let labels = code::labels(misreading.is).join(", ");
                (
                    format!("{labels}: the numbers in their order, rad"),
                    code::of_numbers(misreading.is),
                )
            }
            RotationSlip::Quaternion(slip) => {
                ("n: the four numbers in their order".to_owned(), code::of_quaternion(slip))
            }
            RotationSlip::Transposed => {
                ("rotation: as it is read now".to_owned(), code::inverse_rotation())
            }
            RotationSlip::Inverted => ("pose: as it is read now".to_owned(), code::inverse_pose()),
        };
        let what = format!("{is} read as {read_as}");
        self.code(finding, &what, names, Some(lines));
        if source.is_tf(&topic) {
            return Ok((what + " (where the transforms are published)", vec![CONVENTIONS]));
        }
        let correction = self.corrections.topic(&topic);
        match (slip, correction.rotation) {
            // A pose that is inverted besides is inverted once its numbers are read rightly.
            (RotationSlip::Inverted, Some(_)) => correction.inverse = Some(true),
            (slip, Some(RotationSlip::Inverted)) => {
                (correction.rotation, correction.inverse) = (Some(slip), Some(true));
            }
            (slip, _) => correction.rotation = Some(slip),
        }
        Ok((what, vec![CONVENTIONS, CORRECTIONS]))
    }

    fn take_axes(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let axes = |name: &str| -> Result<Axes, String> {
            finding.evidence.more.get(name).and_then(Value::as_str).ok_or_else(nothing)?.parse()
        };
        let (positions, rotations) = (axes("positions")?, axes("rotations")?);
        let topic = source.lone_topic(finding)?;
        let what = format!("positions are in {positions}, rotations in {rotations}");
        if source.is_tf(&topic) {
            return Err(finding.fix.clone());
        }
        self.corrections.topic(&topic).axes = Some(AxesCorrection { positions, rotations });
        Ok((what, vec![CORRECTIONS]))
    }

    fn take_unit(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let Some(Estimate::Slip { is, read_as, .. }) = &finding.estimate else {
            return Err(nothing());
        };
        let (is, read_as) = (is.as_ref(), read_as.as_ref());
        let topic = source.lone_topic(finding)?;
        let what = format!("{is} read as {read_as}");
        let is_angle = matches!(is, "deg" | "rad");
        let (names, lines) = match is_angle {
            true => ("angles: the numbers as they are", code::angles(is == "deg")),
            false => {
                let slip: Slip<LengthScale> = Slip { is: is.parse()?, read_as: read_as.parse()? };
                ("xyz: the position as it is read now", code::lengths(slip.factor()))
            }
        };
        self.code(finding, &what, names.to_owned(), Some(lines));
        if source.is_tf(&topic) {
            return Ok((what + " (where the transforms are published)", vec![CONVENTIONS]));
        }
        let correction = self.corrections.topic(&topic);
        if is_angle {
            let unit = |name| if name == "deg" { AngleUnit::Degree } else { AngleUnit::Radian };
            correction.angle_unit = Some(Slip { is: unit(is), read_as: unit(read_as) });
        } else {
            correction.length_unit = Some(Slip { is: is.parse()?, read_as: read_as.parse()? });
        }
        Ok((what, vec![CONVENTIONS, CORRECTIONS]))
    }

    fn take_order(&mut self, finding: &Finding) -> Taken {
        let Some(Estimate::Order { is, read_as, .. }) = &finding.estimate else {
            return Err(nothing());
        };
        let topic = finding.subject.topic.clone().ok_or_else(nothing)?;
        let order = JointOrder { is: is.clone(), read_as: read_as.clone() };
        self.corrections.topic(&topic).joint_order = Some(order);
        let what = "the positions stand in another order than the names".to_owned();
        let names = format!("the names in the order of the numbers: {}", is.join(", "));
        self.code(finding, &what, names, None);
        Ok((what, vec![CONVENTIONS, CORRECTIONS]))
    }

    fn take_frame(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let found = pose_of(finding.evidence.more.get("pose")).ok_or_else(nothing)?;
        let topic = source.lone_topic(finding)?;
        let parent = finding.subject.frame.clone().ok_or_else(nothing)?;
        let child = format!("{parent}_of_{}", slug(&topic));
        let is_reference = finding.code == "FRM002";
        let convention = source.convention_of_numbers(&topic);
        let correction = self.corrections.topic(&topic);
        let (what, comment) = match is_reference {
            true => {
                correction.reference_from_stream = Some(FrameCorrection::from(&found));
                let comment = format!("the frame that {topic} is in: make it its frame_id");
                (format!("{topic} is in a frame of its own, {child}"), comment)
            }
            false => {
                correction.tip_from_stream = Some(FrameCorrection::from(&found));
                let comment =
                    format!("the frame whose poses {topic} holds: make it its child frame");
                (format!("{topic} is of a frame of its own, {child}"), comment)
            }
        };
        correction.convention = correction.convention.or(convention);
        self.frames.push(FixedFrame {
            finding: label(finding),
            comment,
            parent,
            child,
            pose: found,
        });
        Ok((what, vec![TRANSFORMS, JOINTS, CORRECTIONS]))
    }

    fn take_mount(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let q_xyzw =
            numbers::<4>(finding.evidence.more.get("link_from_imu")).ok_or_else(nothing)?;
        let rotation = rotation_from_xyzw(q_xyzw).ok_or_else(nothing)?;
        let topic = source.lone_topic(finding)?;
        let row = source.row(&topic).ok_or_else(nothing)?;
        let (parent, child) = row.link.clone().zip(row.frame_id.clone()).ok_or_else(nothing)?;
        let logged = source.run.arms.iter().flat_map(|arm| &arm.imus);
        let mut logged = logged.filter(|imu| source.run.streams[imu.stream].topic == topic);
        let logged = logged.next().and_then(|imu| imu.link_from_imu).unwrap_or_default();
        let pose = Pose::from_parts(logged.translation, rotation);
        self.corrections.topic(&topic).link_from_imu_xyzw = Some(q_xyzw);
        let what = format!("{child} is turned otherwise in {parent}");
        self.frames.push(FixedFrame {
            finding: label(finding),
            comment: format!(
                "in the place of the static transform to {child}; its position is the log's"
            ),
            parent,
            child,
            pose,
        });
        Ok((what, vec![TRANSFORMS, JOINTS, CORRECTIONS]))
    }

    fn take_camera(&mut self, source: &Source<'_>, finding: &Finding) -> Taken {
        let evidence = &finding.evidence.more;
        let is_mount =
            matches!(&finding.estimate, Some(Estimate::Frame { name: "mount error", .. }));
        let pose = pose_of(evidence.get("pose")).filter(|_| is_mount);
        let pose = pose.ok_or_else(|| finding.fix.clone())?;
        let topic = source.lone_topic(finding)?;
        let child = source.row(&topic).and_then(|row| row.frame_id.clone()).ok_or_else(nothing)?;
        let text = |key: &str| evidence.get(key).and_then(Value::as_str).unwrap_or_default();
        let (pose_in, mount) = (text("pose_in"), text("mount"));
        let parent = pose_in.strip_suffix(" by FK").or(pose_in.strip_suffix(" by /tf"));
        let parent = match (parent, source.row(pose_in)) {
            (Some(parent), _) => parent.to_owned(),
            (None, Some(stream)) => stream.child_frame_id.clone().ok_or_else(nothing)?,
            (None, None) => pose_in.to_owned(),
        };
        let correction = self.corrections.topic(&topic);
        let frame = Some(FrameCorrection::from(&pose));
        match mount {
            "camera in hand" => correction.hand_from_camera = frame,
            "camera fixed" => correction.base_from_camera = frame,
            _ => {
                return Err("the motion does not tell whether the camera is in the hand".to_owned());
            }
        }
        let what = format!("{child} is elsewhere in {parent}");
        self.frames.push(FixedFrame {
            finding: label(finding),
            comment: format!("in the place of the static transform to {child}"),
            parent,
            child,
            pose,
        });
        Ok((what, vec![TRANSFORMS, JOINTS, CORRECTIONS]))
    }

    fn code(&mut self, finding: &Finding, what: &str, names: String, lines: Option<Lines>) {
        let (finding, what) = (label(finding), what.to_owned());
        self.codes.push(Coded { finding, what, names, lines });
    }

    /// Takes the joint offsets into the texts of the models.
    fn patch_models(&mut self, run: &Run) {
        let mut done: Vec<&Arm> = Vec::new();
        for arm in &run.arms {
            if done.iter().any(|other| other.robot == arm.robot) {
                continue;
            }
            done.push(arm);
            // One description may hold several arms.
            let names: Vec<&String> = run
                .arms
                .iter()
                .filter(|other| other.robot == arm.robot)
                .flat_map(|other| &other.joint_names)
                .collect();
            let offsets: Vec<(&str, f64)> = self
                .corrections
                .joints
                .iter()
                .filter(|joint| names.contains(&&joint.name))
                .filter(|joint| joint.robot.as_ref().is_none_or(|robot| *robot == arm.name))
                .filter_map(|joint| {
                    Some((joint.name.as_str(), joint.offset_rad.or(joint.offset_m)?))
                })
                .collect();
            match (arm.robot.text_with_offsets(&offsets), arm.robot.text()) {
                (Ok(after), Some(before)) if after != before => {
                    let file = self.model_name(arm, before);
                    self.models.push(Patched { file, before: before.to_owned(), after });
                }
                (Err(why), _) if !offsets.is_empty() => {
                    self.unpatched.push(format!("{}: {why}", arm.name));
                }
                _ => {}
            }
        }
    }

    /// A name for the file of a patched model: that of its source, where it has one.
    fn model_name(&self, arm: &Arm, text: &str) -> String {
        let extension = if text.trim_start_matches('\u{feff}').trim_start().starts_with('<') {
            "urdf"
        } else {
            "toml"
        };
        let stem = model_stem(std::path::Path::new(&arm.robot.source));
        let plain = format!("{stem}.{extension}");
        match self.models.iter().any(|model| model.file == plain) {
            false => plain,
            true => format!("{stem}-{}.{extension}", self.models.len() + 1),
        }
    }
}

/// What findings are read with.
struct Source<'a> {
    report: &'a Report,
    run: &'a Run,
    facts: &'a Facts,
}

impl Source<'_> {
    fn row(&self, topic: &str) -> Option<&StreamRow> {
        self.report.streams.iter().find(|row| row.topic == topic)
    }

    /// The topic of a finding, which holds one stream.
    fn lone_topic(&self, finding: &Finding) -> Result<String, String> {
        let topic = finding.subject.topic.clone().ok_or_else(nothing)?;
        let streams = self.report.streams.iter().filter(|row| row.topic == topic).count();
        match streams {
            0 | 1 => Ok(topic),
            _ => Err(format!("{topic} holds several streams, which no correction tells apart")),
        }
    }

    /// The robot of a finding on a joint, where several have a joint of that name.
    fn robot_of(&self, finding: &Finding, joint: &str) -> Option<String> {
        let arms =
            self.run.arms.iter().filter(|arm| arm.joint_names.iter().any(|own| own == joint));
        finding.subject.robot.clone().filter(|_| arms.count() > 1)
    }

    fn is_tf(&self, topic: &str) -> bool {
        self.row(topic).is_some_and(|row| row.role == "tf")
    }

    /// The convention that the bare numbers of a topic turned out to be in.
    fn convention_of_numbers(&self, topic: &str) -> Option<Convention> {
        let arms = self.run.arms.iter().zip(&self.facts.robots);
        let mut streams =
            arms.flat_map(|(arm, facts)| arm.poses.iter().zip(&facts.diagnosis.streams));
        let (source, found) =
            streams.find(|(source, _)| self.run.streams[source.stream].topic == topic)?;
        let is_numbers = matches!(source.track.orientation, Orientations::Numbers(_));
        match found.reading.as_ref().ok()?.best {
            Reading::Numbers(convention) if is_numbers => Some(convention),
            _ => None,
        }
    }
}

/// The code of a finding, and what it is on.
fn label(finding: &Finding) -> String {
    match finding.subject.label() {
        "" => finding.code.to_owned(),
        on => format!("{} on {on}", finding.code),
    }
}

fn segment(finding: &Finding) -> Option<u64> {
    finding.evidence.more.get("segment")?["number"].as_u64()
}

fn nothing() -> String {
    "the finding holds no amount that could be applied".to_owned()
}

/// The value of an amount, its unit and its interval.
fn amount(finding: &Finding) -> Result<(f64, &'static str, Option<[f64; 2]>), String> {
    match finding.estimate {
        Some(Estimate::Amount { value, unit, ci95, .. }) if value.is_finite() => {
            Ok((rounded(value), unit, ci95.map(|ends| ends.map(rounded))))
        }
        _ => Err(nothing()),
    }
}

fn numbers<const N: usize>(value: Option<&Value>) -> Option<[f64; N]> {
    let all: Option<Vec<f64>> = value?.as_array()?.iter().map(Value::as_f64).collect();
    all?.try_into().ok()
}

fn pose_of(value: Option<&Value>) -> Option<Pose> {
    let xyz = numbers::<3>(value?.get("xyz"))?;
    Some(pose(xyz, rotation_from_xyzw(numbers::<4>(value?.get("quaternion_xyzw"))?)?))
}
