use super::code::{self, CodeLines};
use super::context::{
    CorrectionContext, finding_label, misinterpretation_text, no_value, value_with_interval,
};
use super::corrections_file::{
    AxesCorrection, Corrections, CouplingCorrection, FrameCorrection, JointOrder, TopicCorrection,
};
use super::dataset;
use super::frames::{FixedFrame, model_stem, slug};
use crate::evidence::RunEvidence;
use crate::finding::{Cause, Finding, JointScaleCorrection, Unit};
use crate::geometry::{
    AngleUnit, LengthScale, Misread, Pose, QuaternionOrderError, Rotation, RotationEncoding,
    RotationError, xyzw_from_rotation,
};
use crate::report::Report;
use crate::run::{Arm, Run};
use crate::stats::Measured;

/// Corrections for the findings of an audit, and the findings without one.
#[derive(Default)]
pub(crate) struct CorrectionPlan {
    /// Corrections for an audit.
    pub corrections: Corrections,
    pub(super) decodings: Vec<DecodingCode>,
    pub(super) frames: Vec<FixedFrame>,
    pub(super) models: Vec<PatchedModel>,
    /// Module that corrects the columns of a dataset.
    pub(super) module: Option<String>,
    /// Why models with joint offsets are not patched.
    pub(super) unpatched: Vec<String>,
    pub(super) corrected: Vec<CorrectedFinding>,
    pub(super) uncorrected: Vec<UncorrectedFinding>,
}

pub(super) struct DecodingCode {
    pub finding: String,
    /// Description of the fault.
    pub what: String,
    /// Variable names for the logged numbers.
    pub names: String,
    pub lines: Option<CodeLines>,
}

/// Model text before and after the patch.
pub(super) struct PatchedModel {
    pub file: String,
    pub before: String,
    pub after: String,
}

pub(super) struct CorrectedFinding {
    pub finding: String,
    pub what: String,
    pub files: Vec<&'static str>,
}

pub(super) struct UncorrectedFinding {
    pub finding: String,
    pub why: String,
}

pub(super) const CORRECTIONS_FILE: &str = "corrections.toml";
pub(super) const OFFSETS_FILE: &str = "joint_offsets.yaml";
/// Corrects the columns of a dataset.
pub(super) const MODULE_FILE: &str = "dataset_step.py";
pub(super) const LATENCIES_FILE: &str = "latency.yaml";
pub(super) const CONVENTIONS_FILE: &str = "conventions.md";
pub(super) const TRANSFORMS_FILE: &str = "static_transforms.sh";
pub(super) const JOINTS_FILE: &str = "fixed_joints.xml";
/// Placeholder for the patched model, which is named after the original.
pub(super) const PATCHED_MODEL: &str = "the patched model";

/// For corrections in the publisher of /tf.
const PUBLISHER_SUFFIX: &str = " (in the publisher of the transforms)";

/// Correction and its files, or why it is missing.
type CorrectionResult = Result<(String, Vec<&'static str>), String>;

impl CorrectionPlan {
    /// `report` covers `run`, alone or as segment `main`.
    pub fn from_findings(report: &Report, run: &Run, evidence: &RunEvidence, main: usize) -> Self {
        let mut plan = Self::default();
        let context = CorrectionContext { report, run, evidence };
        for finding in &report.findings {
            let label = finding_label(finding);
            let result = match finding.segment {
                Some(other) if other != main => {
                    Err("it belongs to a segment of the run other than the longest".to_owned())
                }
                _ => plan.add_correction(&context, finding),
            };
            match result {
                Ok((what, files)) => {
                    plan.corrected.push(CorrectedFinding { finding: label, what, files })
                }
                Err(why) => plan.uncorrected.push(UncorrectedFinding { finding: label, why }),
            }
        }
        plan.patch_models(run);
        plan.module = dataset::python_module(report, run, &plan.corrections);
        plan
    }

    fn add_correction(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
    ) -> CorrectionResult {
        match &finding.cause {
            Cause::JointZero { offset, is_prismatic } => {
                self.add_zero_offset(context, finding, offset, *is_prismatic)
            }
            Cause::JointUnit(factor) => {
                let name = finding.subject.joint.clone().ok_or_else(no_value)?;
                let robot = context.robot_of(finding, &name);
                self.corrections.joint(&name, robot).factor = Some(*factor);
                Ok((misinterpretation_text(finding)?, vec![OFFSETS_FILE, CORRECTIONS_FILE]))
            }
            Cause::JointScale(joints) => self.add_joint_scale(context, finding, joints),
            Cause::JointCoupling { with, factor } => {
                let (value, ci95) = value_with_interval(Unit::One, factor)?;
                let name = finding.subject.joint.clone().ok_or_else(no_value)?;
                let robot = context.robot_of(finding, &name);
                self.corrections.joint(&name, robot).coupling =
                    Some(CouplingCorrection { joint: with.clone(), factor: value, ci95 });
                let what = format!("{value:.5} times {with} is added");
                Ok((what, vec![OFFSETS_FILE, CORRECTIONS_FILE]))
            }
            Cause::JointOrder { is, read_as } => {
                let topic = finding.subject.topic.clone().ok_or_else(no_value)?;
                let order = JointOrder { is: is.clone(), read_as: read_as.clone() };
                self.corrections.topic(&topic).joint_order = Some(order);
                let what = "the positions are in a different order than the names".to_owned();
                let names = format!("names in the order of the numbers: {}", is.join(", "));
                self.add_code(finding, &what, names, None);
                Ok((what, vec![CONVENTIONS_FILE, CORRECTIONS_FILE]))
            }
            Cause::DhConvention(is) => {
                let what = format!("the DH table is {}, not {}", is.name(), is.other().name());
                Ok((what, vec![PATCHED_MODEL]))
            }
            Cause::OtherRobot(robot) => Ok((format!("audit with `--robot {robot}`"), Vec::new())),
            Cause::Latency(latency) => self.add_latency(context, finding, latency),
            // The clock rate of one segment does not apply to the next.
            Cause::ClockSkew(_) if finding.segment.is_some() => Err(finding.fix.clone()),
            Cause::ClockSkew(skew) => {
                let (value, ci95) = value_with_interval(Unit::SecondPerSecond, skew)?;
                let topic = context.single_topic(finding)?;
                let (start, end) = finding.start_ns.zip(finding.end_ns).ok_or_else(no_value)?;
                let own = self.corrections.topic(&topic);
                (own.skew, own.skew_ci95) = (Some(value), ci95);
                own.skew_about_s = Some(0.5 * end.seconds_since(start));
                let what = format!("clock skew of {}", Unit::SecondPerSecond.show(value));
                Ok((what, vec![LATENCIES_FILE, CORRECTIONS_FILE]))
            }
            Cause::Rotation(slip) => self.add_rotation(context, finding, *slip),
            Cause::InferredEncoding { coding, length, angle } => {
                self.add_encoding(context, finding, *coding, *length, *angle)
            }
            Cause::AngleUnit(unit) => {
                let lines = code::convert_angles(unit.is == AngleUnit::Degree);
                let names = "angles: the numbers as logged";
                let is_of = |topic: &mut TopicCorrection| topic.angle_unit = Some(*unit);
                self.add_unit(context, finding, (names, lines), is_of)
            }
            Cause::LengthUnit(unit) => {
                let lines = code::scale_lengths(unit.factor());
                let names = "xyz: the position as currently decoded";
                let is_of = |topic: &mut TopicCorrection| topic.length_unit = Some(*unit);
                self.add_unit(context, finding, (names, lines), is_of)
            }
            Cause::Axes { positions, rotations } => {
                let (positions, rotations) = (*positions, *rotations);
                let topic = context.single_topic(finding)?;
                if context.is_tf(&topic) {
                    return Err(finding.fix.clone());
                }
                let axes = AxesCorrection { positions, rotations };
                self.corrections.topic(&topic).axes = Some(axes);
                let what = format!("positions are in {positions}, rotations in {rotations}");
                Ok((what, vec![CORRECTIONS_FILE]))
            }
            Cause::ReferenceFrame(pose) => self.add_frame(context, finding, pose, true),
            Cause::ToolFrame(pose) => self.add_frame(context, finding, pose, false),
            Cause::ImuMount(rotation) => self.add_imu_mount(context, finding, rotation),
            Cause::CameraMount { in_hand, parent, pose } => {
                self.add_camera_mount(context, finding, *in_hand, parent.as_ref(), pose)
            }
            Cause::RadialScale
            | Cause::Compliance
            | Cause::UnexplainedResidual
            | Cause::Disagreement { .. }
            | Cause::UnreadOrientations
            | Cause::VaryingLatency
            | Cause::ParameterChange
            | Cause::TfDisagrees
            | Cause::YawDrift(_)
            | Cause::YawJump
            | Cause::FrameTree
            | Cause::Stamps
            | Cause::Pictured(_)
            | Cause::Other => Err(finding.fix.clone()),
        }
    }

    fn add_zero_offset(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        offset: &Measured,
        is_prismatic: bool,
    ) -> CorrectionResult {
        let unit = if is_prismatic { Unit::Metre } else { Unit::Radian };
        let (value, ci95) = value_with_interval(unit, offset)?;
        let name = finding.subject.joint.clone().ok_or_else(no_value)?;
        let robot = context.robot_of(finding, &name);
        let joint = self.corrections.joint(&name, robot);
        joint.set_offset(value, is_prismatic);
        joint.ci95 = ci95;
        Ok((
            format!("offset of {}", unit.show(value)),
            vec![OFFSETS_FILE, PATCHED_MODEL, CORRECTIONS_FILE],
        ))
    }

    fn add_joint_scale(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        joints: &[JointScaleCorrection],
    ) -> CorrectionResult {
        for scaling in joints {
            let robot = context.robot_of(finding, &scaling.joint);
            let own = self.corrections.joint(&scaling.joint, robot);
            own.factor = Some(scaling.factor.value);
            own.factor_ci95 = Unit::One.interval95(&scaling.factor);
            if let Some(offset) = scaling.offset {
                own.set_offset(offset, scaling.is_prismatic);
            }
        }
        let factor = joints.first().ok_or_else(no_value)?.factor.value;
        Ok((format!("factor of {factor:.5}"), vec![OFFSETS_FILE, CORRECTIONS_FILE]))
    }

    fn add_latency(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        latency: &Measured,
    ) -> CorrectionResult {
        let (value, ci95) = value_with_interval(Unit::Second, latency)?;
        let topic = context.single_topic(finding)?;
        let mut copies = Vec::new();
        if let Some(arm) = context.evidence.robots.iter().find(|arm| arm.joints_topic == topic) {
            // Streams that copy the joints' stamps share their latency.
            let poses = arm.poses_and_tf().filter(|stream| !stream.has_independent_stamps);
            copies.extend(poses.map(|stream| stream.topic().to_owned()));
            let imus = arm.imus.iter().filter(|imu| !imu.has_independent_stamps);
            copies.extend(imus.map(|imu| imu.topic().to_owned()));
        }
        let mut what = format!("latency of {}", Unit::Second.show(value));
        if !copies.is_empty() {
            what += &format!(", with {}, whose stamps are copies", copies.join(" and "));
        }
        let own = self.corrections.topic(&topic);
        own.latency_s = Some(own.latency_s.unwrap_or(0.0) + value);
        own.latency_ci95 = ci95;
        for copy in copies {
            let copy = self.corrections.topic(&copy);
            copy.latency_s = Some(copy.latency_s.unwrap_or(0.0) + value);
            copy.latency_ci95 = copy.latency_ci95.or(ci95);
        }
        Ok((what, vec![LATENCIES_FILE, CORRECTIONS_FILE]))
    }

    /// Frames cannot be applied to bare numbers without it.
    fn add_encoding(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        coding: RotationEncoding,
        length: LengthScale,
        angle: AngleUnit,
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let correction = self.corrections.topic(&topic);
        if length != LengthScale::METRE {
            correction.length_unit = Some(Misread { is: length, read_as: LengthScale::METRE });
        }
        match coding {
            RotationEncoding::Three(convention) => {
                correction.convention = Some(convention);
                if angle == AngleUnit::Degree {
                    let slip = Misread { is: angle, read_as: AngleUnit::Radian };
                    correction.angle_unit = Some(slip);
                }
            }
            _ => {
                let slip = QuaternionOrderError::WxyzReadAsXyzw;
                correction.rotation = Some(RotationError::Quaternion(slip));
            }
        }
        let what = format!("bare numbers are {coding}, {length}, {}", angle.symbol());
        Ok((what, vec![CORRECTIONS_FILE]))
    }

    fn add_rotation(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        slip: RotationError,
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let (names, lines) = match slip {
            RotationError::Misread(misreading) => {
                let labels = code::variable_names(misreading.is).join(", ");
                (
                    format!("{labels}: the numbers in logged order, rad"),
                    code::decode_numbers(misreading.is),
                )
            }
            RotationError::Quaternion(slip) => {
                ("n: the four numbers in logged order".to_owned(), code::decode_quaternion(slip))
            }
            RotationError::Transposed => {
                ("rotation: as currently decoded".to_owned(), code::invert_rotation())
            }
            RotationError::Inverted => {
                ("pose: as currently decoded".to_owned(), code::invert_pose())
            }
        };
        let Misread { is, read_as } = Misread::<String>::from(slip);
        let what = format!("{is} read as {read_as}");
        self.add_code(finding, &what, names, Some(lines));
        if context.is_tf(&topic) {
            return Ok((what + PUBLISHER_SUFFIX, vec![CONVENTIONS_FILE]));
        }
        let correction = self.corrections.topic(&topic);
        match (slip, correction.rotation) {
            // Inverted after decoding.
            (RotationError::Inverted, Some(_)) => correction.inverse = Some(true),
            (slip, Some(RotationError::Inverted)) => {
                (correction.rotation, correction.inverse) = (Some(slip), Some(true));
            }
            (slip, _) => correction.rotation = Some(slip),
        }
        Ok((what, vec![CONVENTIONS_FILE, CORRECTIONS_FILE]))
    }

    /// `set` corrects the topic.
    fn add_unit(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        (names, lines): (&str, CodeLines),
        set: impl Fn(&mut TopicCorrection),
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let what = misinterpretation_text(finding)?;
        self.add_code(finding, &what, names.to_owned(), Some(lines));
        if context.is_tf(&topic) {
            return Ok((what + PUBLISHER_SUFFIX, vec![CONVENTIONS_FILE]));
        }
        set(self.corrections.topic(&topic));
        Ok((what, vec![CONVENTIONS_FILE, CORRECTIONS_FILE]))
    }

    /// Corrects the reference frame (`is_reference`) or the tool frame.
    fn add_frame(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        found: &Pose,
        is_reference: bool,
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let parent = finding.subject.frame.clone().ok_or_else(no_value)?;
        let child = new_frame(&parent, &topic);
        let convention = context.convention_of_numbers(&topic);
        let correction = self.corrections.topic(&topic);
        let frame = Some(FrameCorrection::from(found));
        let (what, comment) = if is_reference {
            correction.reference_from_stream = frame;
            let comment = format!("reference frame of {topic}: use it as its frame_id");
            (format!("{topic} has a different reference frame, {child}"), comment)
        } else {
            correction.tip_from_stream = frame;
            let usage = match context.has_child_frame(&topic) {
                true => "use it as its child_frame_id",
                false => "add its joint to the description, and name it with --tip",
            };
            let comment = format!("frame whose poses {topic} contains: {usage}");
            (format!("{topic} has a different tool frame, {child}"), comment)
        };
        correction.convention = correction.convention.or(convention);
        self.add_fixed_frame(finding, comment, [parent, child], *found);
        Ok((what, vec![TRANSFORMS_FILE, JOINTS_FILE, CORRECTIONS_FILE]))
    }

    fn add_imu_mount(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        rotation: &Rotation,
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let row = context.stream_row(&topic).ok_or_else(no_value)?;
        let (parent, child) = row.link.clone().zip(row.frame_id.clone()).ok_or_else(no_value)?;
        let logged = context.run.arms.iter().flat_map(|arm| &arm.imus);
        let mut logged = logged.filter(|imu| context.run.streams[imu.stream].topic == topic);
        let logged = logged.next().and_then(|imu| imu.link_from_imu).unwrap_or_default();
        let pose = Pose::from_parts(logged.translation, *rotation);
        let correction = self.corrections.topic(&topic);
        correction.link_from_imu_xyzw = Some(xyzw_from_rotation(rotation));
        let (child, usage) = mounted_frame(&parent, child, &topic);
        let what = format!("orientation of {child} in {parent}");
        let comment = format!("{usage}; the position is the log's");
        self.add_fixed_frame(finding, comment, [parent, child], pose);
        Ok((what, vec![TRANSFORMS_FILE, JOINTS_FILE, CORRECTIONS_FILE]))
    }

    fn add_camera_mount(
        &mut self,
        context: &CorrectionContext<'_>,
        finding: &Finding,
        in_hand: Option<bool>,
        parent: Option<&String>,
        pose: &Pose,
    ) -> CorrectionResult {
        let topic = context.single_topic(finding)?;
        let child =
            context.stream_row(&topic).and_then(|row| row.frame_id.clone()).ok_or_else(no_value)?;
        let parent = parent.cloned().ok_or_else(no_value)?;
        let correction = self.corrections.topic(&topic);
        let frame = Some(FrameCorrection::from(pose));
        match in_hand {
            Some(true) => correction.hand_from_camera = frame,
            Some(false) => correction.base_from_camera = frame,
            None => {
                return Err(
                    "the motion does not determine whether the camera is mounted on the hand"
                        .to_owned(),
                );
            }
        }
        let (child, comment) = mounted_frame(&parent, child, &topic);
        let what = format!("pose of {child} in {parent}");
        self.add_fixed_frame(finding, comment, [parent, child], *pose);
        Ok((what, vec![TRANSFORMS_FILE, JOINTS_FILE, CORRECTIONS_FILE]))
    }

    fn add_fixed_frame(
        &mut self,
        finding: &Finding,
        comment: String,
        [parent, child]: [String; 2],
        pose: Pose,
    ) {
        let finding = finding_label(finding);
        self.frames.push(FixedFrame { finding, comment, parent, child, pose });
    }

    fn add_code(&mut self, finding: &Finding, what: &str, names: String, lines: Option<CodeLines>) {
        let (finding, what) = (finding_label(finding), what.to_owned());
        self.decodings.push(DecodingCode { finding, what, names, lines });
    }

    fn patch_models(&mut self, run: &Run) {
        let mut done: Vec<&Arm> = Vec::new();
        for arm in &run.arms {
            if done.iter().any(|other| other.robot == arm.robot) {
                continue;
            }
            done.push(arm);
            // One description may contain several arms.
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
                    self.models.push(PatchedModel { file, before: before.to_owned(), after });
                }
                (Err(why), _) if !offsets.is_empty() => {
                    self.unpatched.push(format!("{}: {why}", arm.name));
                }
                _ => {}
            }
        }
    }

    /// Name of its source, if any.
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

/// Frame for a stream whose logged frame, at `parent`, is wrong.
fn new_frame(parent: &str, topic: &str) -> String {
    format!("{parent}_of_{}", slug(topic))
}

/// Frame of a sensor that is mounted on `parent`, and how to use it. It is new if messages name `parent` itself, because
/// no transform leads from a frame to itself.
fn mounted_frame(parent: &str, frame_id: String, topic: &str) -> (String, String) {
    if frame_id == parent {
        return (new_frame(parent, topic), format!("frame of {topic}: use it as its frame_id"));
    }
    let usage = format!("replaces the static transform to {frame_id}");
    (frame_id, usage)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_in_the_frame_of_its_link_gets_a_new_frame() {
        let of = |frame_id: &str| mounted_frame("tool0", frame_id.to_owned(), "/imu/data");
        let (frame, usage) = of("tool0");
        assert_eq!(frame, "tool0_of_imu_data");
        assert_eq!(usage, "frame of /imu/data: use it as its frame_id");
        let (frame, usage) = of("imu_link");
        assert_eq!(frame, "imu_link");
        assert_eq!(usage, "replaces the static transform to imu_link");
    }
}
