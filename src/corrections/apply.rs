//! Applies corrections: latencies to the stamps of a log, everything else to the streams of a run.

use std::path::Path;

use super::corrections_file::{
    AxesCorrection, Corrections, FrameCorrection, JointOrder, TopicCorrection, encoding_of_error,
    is_same_topic,
};
use crate::diagnosis::{
    AxesError, IntendedEncoding, PoseEncoding, reinterpret_imu, reinterpret_poses,
};
use crate::finding::Unit;
use crate::geometry::{LengthScale, Misread, Pose, RotationEncoding, rotation_from_xyzw};
use crate::log::Log;
use crate::report::Trouble;
use crate::robot::JointKind;
use crate::run::{Arm, CoupledColumn, Declaration, JointStateCorrection, PoseSource, Role, Run};
use crate::stream::Orientations;
use crate::time::{nanos, seconds};

#[derive(Clone, Copy)]
pub(crate) struct GivenCorrections<'a> {
    pub corrections: &'a Corrections,
    pub file: &'a Path,
}

impl GivenCorrections<'_> {
    fn error(&self, what: String) -> Trouble {
        let remedy = "correct the name (see `poseaudit info`), or remove it from the file";
        Trouble::call(self.file.display(), what, remedy)
    }

    /// Subtracts latencies from header and receive stamps, so clock alignment is unaffected.
    ///
    /// # Errors
    /// If a topic is not in the log.
    pub fn correct_stamps(&self, log: &mut Log) -> Result<(), Trouble> {
        for correction in &self.corrections.topics {
            let name = &correction.name;
            let topic = log.topics.iter_mut().find(|topic| is_same_topic(&topic.name, name));
            let Some(topic) = topic else {
                return Err(self.error(format!("the log has no topic '{name}'")));
            };
            let (latency_s, skew) = (correction.latency_s, correction.skew);
            if latency_s.is_none() && skew.is_none() {
                continue;
            }
            let Some(columns) = &mut topic.columns else { continue };
            let about_s = correction.skew_about_s.unwrap_or_default();
            let lateness = |since_first: i64| {
                let grown_s = skew.map_or(0.0, |skew| skew * (seconds(since_first) - about_s));
                nanos(latency_s.unwrap_or(0.0) + grown_s)
            };
            columns.times_mut().into_iter().for_each(|times| times.shift_back(lateness));
        }
        Ok(())
    }

    /// Applies all corrections except latencies.
    ///
    /// # Errors
    /// If no arm has a joint, or if a correction does not apply to its topic.
    pub fn apply(&self, run: &mut Run, max_lag_s: f64) -> Result<(), Trouble> {
        self.correct_joints(run)?;
        for correction in &self.corrections.topics {
            let name = &correction.name;
            let streams = || run.streams.iter().filter(|stream| is_same_topic(&stream.topic, name));
            if streams().next().is_none() {
                continue;
            }
            // /tf as a whole is not a stream of poses.
            let of_poses = streams().filter(|stream| stream.role != Role::Tf);
            if self.corrects_poses(correction) && of_poses.count() > 1 {
                return Err(
                    self.error(format!("topic '{name}' contains the poses of several frames"))
                );
            }
            let mut unapplied = UnappliedParts::from_correction(correction);
            if let Some(unit) = correction.angle_unit {
                let given = run.declared.iter_mut().filter(|declared| declared.is_of(name));
                given.for_each(|declared| declared.angle = unit.is);
            }
            run.declared.extend(self.declaration(correction));
            for arm in 0..run.arms.len() {
                correct_poses(run, arm, correction, max_lag_s, &mut unapplied);
                correct_imus(run, arm, correction, max_lag_s, &mut unapplied);
            }
            correct_targets(run, correction, &mut unapplied);
            if let Some(what) = unapplied.first() {
                return Err(self.error(format!("{what} cannot be applied to topic '{name}'")));
            }
        }
        Ok(())
    }

    /// Encoding that a correction states for bare numbers.
    fn declaration(&self, correction: &TopicCorrection) -> Option<Declaration> {
        let TopicCorrection { name, convention, length_unit, angle_unit, .. } = correction;
        Some(Declaration {
            topic: name.clone(),
            place: self.file.display().to_string(),
            coding: RotationEncoding::Three((*convention)?),
            length: length_unit.map(|unit| unit.is).unwrap_or_default(),
            angle: angle_unit.map(|unit| unit.is).unwrap_or_default(),
            is_of_vendor: false,
        })
    }

    fn corrects_poses(&self, correction: &TopicCorrection) -> bool {
        let TopicCorrection { rotation, reference_from_stream, tip_from_stream, .. } = correction;
        let is_read = rotation.is_some() || correction.intended_encoding().is_some();
        is_read || reference_from_stream.is_some() || tip_from_stream.is_some()
    }

    fn correct_joints(&self, run: &mut Run) -> Result<(), Trouble> {
        if run.arms.is_empty() {
            return Ok(());
        }
        for joint in &self.corrections.joints {
            let is_meant = |arm: &Arm| {
                let is_robot = joint.robot.as_ref().is_none_or(|robot| arm.name == *robot);
                is_robot && arm.joint_names.contains(&joint.name)
            };
            if !run.arms.iter().any(is_meant) {
                return Err(self.error(format!("no arm of the log has a joint '{}'", joint.name)));
            }
        }
        let topics: Vec<String> = run.streams.iter().map(|stream| stream.topic.clone()).collect();
        for arm in &mut run.arms {
            let joint_correction = self.joint_correction(arm, &topics)?;
            if !joint_correction.is_identity() {
                arm.correct_joints(joint_correction);
            }
        }
        Ok(())
    }

    fn joint_correction(
        &self,
        arm: &Arm,
        topics: &[String],
    ) -> Result<JointStateCorrection, Trouble> {
        let mut joint_correction = JointStateCorrection::identity(arm.joint_names.len());
        let column = |name: &String| arm.joint_names.iter().position(|joint| joint == name);
        for correction in &self.corrections.topics {
            let is_of_topic = |column: usize| {
                let facts = arm.joint_sources.get(column);
                facts.is_some_and(|facts| is_same_topic(&topics[facts.stream], &correction.name))
            };
            if let Some(JointOrder { is, read_as }) = &correction.joint_order {
                for (is, read_as) in is.iter().zip(read_as) {
                    match (column(is), column(read_as)) {
                        (Some(is), Some(read_as)) => joint_correction.from[is] = read_as,
                        (None, None) => {}
                        (is_known, _) => {
                            let other = if is_known.is_some() { read_as } else { is };
                            return Err(self.error(format!(
                                "joint_order of '{}': no arm of the log has a joint '{other}'",
                                correction.name
                            )));
                        }
                    }
                }
            }
            if let Some(slip) = correction.angle_unit {
                for (index, name) in arm.joint_names.iter().enumerate() {
                    let joint = arm.robot.joint(name);
                    let is_prismatic =
                        joint.is_some_and(|joint| joint.kind == JointKind::Prismatic);
                    if is_of_topic(index) && !is_prismatic {
                        joint_correction.factor[index] = slip.factor();
                    }
                }
            }
        }
        for joint in &self.corrections.joints {
            let is_robot = joint.robot.as_ref().is_none_or(|robot| arm.name == *robot);
            if let (true, Some(column)) = (is_robot, column(&joint.name)) {
                let model = arm.robot.joint(&joint.name);
                let is_prismatic = model.is_some_and(|joint| joint.kind == JointKind::Prismatic);
                let is_other = if is_prismatic { joint.offset_rad } else { joint.offset_m };
                if is_other.is_some() {
                    let (does, key) =
                        if is_prismatic { ("slides", "offset_m") } else { ("turns", "offset_rad") };
                    let name = &joint.name;
                    return Err(self.error(format!("joint '{name}' {does}: its key is {key}")));
                }
                joint_correction.offset[column] =
                    joint.offset_rad.or(joint.offset_m).unwrap_or(0.0);
                joint_correction.factor[column] *= joint.factor.unwrap_or(1.0);
            }
        }
        for joint in &self.corrections.joints {
            let is_robot = joint.robot.as_ref().is_none_or(|robot| arm.name == *robot);
            let Some(coupling) = joint.coupling.as_ref().filter(|_| is_robot) else { continue };
            let Some(coupled) = column(&joint.name) else { continue };
            let by = column(&coupling.joint).ok_or_else(|| {
                let (name, other) = (&joint.name, &coupling.joint);
                self.error(format!("coupling of '{name}': its arm has no joint '{other}'"))
            })?;
            let factor = coupling.factor;
            joint_correction.couplings.push(CoupledColumn { column: coupled, by, factor });
        }
        Ok(joint_correction)
    }

    pub fn notes(&self) -> Vec<String> {
        let joints = self.corrections.joints.iter().map(|joint| {
            let turned = joint.offset_rad.map(|rad| Unit::Radian.show(rad));
            let offset = turned.or(joint.offset_m.map(|m| Unit::Metre.show(m)));
            let factor = joint.factor.map(|factor| format!("a factor of {factor:.5}"));
            let offset = offset.map(|offset| format!("an offset of {offset}"));
            let coupling = joint.coupling.as_ref();
            let coupling = coupling.map(|it| format!("{:.5} times {}", it.factor, it.joint));
            let parts: Vec<String> = factor.into_iter().chain(offset).chain(coupling).collect();
            format!("corrected: {} by {}", joint.name, parts.join(" and "))
        });
        let topics = self.corrections.topics.iter().map(|topic| {
            format!("corrected: {} by its {}", topic.name, topic.parts().join(", its "))
        });
        joints.chain(topics).collect()
    }
}

impl TopicCorrection {
    /// Encoding of the poses, if it differs from the logged one.
    fn intended_encoding(&self) -> Option<IntendedEncoding> {
        let encoding = self.rotation.and_then(encoding_of_error);
        let inverted = self.inverse == Some(true);
        let axes = self.axes.map_or(AxesError::NONE, |AxesCorrection { positions, rotations }| {
            AxesError { positions, rotations }
        });
        let is_any = encoding.is_some() || inverted || axes != AxesError::NONE;
        is_any.then_some(IntendedEncoding {
            encoding: encoding.unwrap_or(PoseEncoding::AsLogged),
            axes,
            is_inverted: inverted,
        })
    }

    fn parts(&self) -> Vec<String> {
        let frames = [
            (self.link_from_imu_xyzw.is_some(), "mount"),
            (self.reference_from_stream.is_some(), "reference frame"),
            (self.tip_from_stream.is_some(), "tool frame"),
            (self.hand_from_camera.is_some() || self.base_from_camera.is_some(), "camera's frame"),
            (self.joint_order.is_some(), "order of joints"),
            (self.inverse == Some(true), "direction"),
            (self.axes.is_some(), "axes"),
            (self.length_unit.is_some(), "unit of length"),
            (self.angle_unit.is_some(), "unit of angles"),
            (self.convention.is_some(), "convention"),
        ];
        let latency = self.latency_s.map(|s| format!("latency of {}", Unit::Second.show(s)));
        let skew =
            self.skew.map(|skew| format!("clock skew of {}", Unit::SecondPerSecond.show(skew)));
        let rotation = self.rotation.map(|slip| {
            let Misread { is, read_as } = Misread::<String>::from(slip);
            format!("rotation ({is} read as {read_as})")
        });
        let frames = frames.into_iter().filter(|(is_there, _)| *is_there);
        let frames = frames.map(|(_, name)| name.to_owned());
        latency.into_iter().chain(skew).chain(rotation).chain(frames).collect()
    }
}

/// Parts of a topic's correction to be applied.
struct UnappliedParts(Vec<&'static str>);

impl UnappliedParts {
    fn from_correction(correction: &TopicCorrection) -> Self {
        let parts = [
            ("length_unit", correction.length_unit.is_some()),
            ("angle_unit", correction.angle_unit.is_some()),
            ("convention", correction.convention.is_some()),
            ("rotation", correction.rotation.is_some()),
            ("inverse", correction.inverse == Some(true)),
            ("axes", correction.axes.is_some()),
            ("reference_from_stream", correction.reference_from_stream.is_some()),
            ("tip_from_stream", correction.tip_from_stream.is_some()),
            ("link_from_imu_xyzw", correction.link_from_imu_xyzw.is_some()),
            ("hand_from_camera", correction.hand_from_camera.is_some()),
            ("base_from_camera", correction.base_from_camera.is_some()),
        ];
        Self(parts.into_iter().filter(|(_, is_there)| *is_there).map(|(name, _)| name).collect())
    }

    fn mark_applied(&mut self, part: &str) {
        self.0.retain(|unapplied| *unapplied != part);
    }

    fn first(&self) -> Option<&'static str> {
        self.0.first().copied()
    }
}

fn correct_poses(
    run: &mut Run,
    arm: usize,
    correction: &TopicCorrection,
    max_lag_s: f64,
    unapplied: &mut UnappliedParts,
) {
    let is_joints = |facts: &crate::run::JointSource| {
        is_same_topic(&run.streams[facts.stream].topic, &correction.name)
    };
    if run.arms[arm].joint_sources.iter().any(is_joints) {
        unapplied.mark_applied("angle_unit");
    }
    for index in 0..run.arms[arm].poses.len() {
        let source = &run.arms[arm].poses[index];
        if !is_same_topic(&run.streams[source.stream].topic, &correction.name) {
            continue;
        }
        let mut corrected = source.clone();
        correct_units(&mut corrected, correction, unapplied);
        if let Some(intended) = correction.intended_encoding() {
            let (joints, stream) = (&run.arms[arm].joints, run.pose_stream(&corrected));
            let rotation_of = |frame: Option<FrameCorrection>| {
                frame.map(|frame| frame.pose().rotation).unwrap_or_default()
            };
            let reference = rotation_of(correction.reference_from_stream).inverse();
            let known = [reference, rotation_of(correction.tip_from_stream)];
            if let Some(track) = reinterpret_poses(joints, &stream, intended, known, max_lag_s) {
                ["rotation", "inverse", "axes"]
                    .into_iter()
                    .for_each(|part| unapplied.mark_applied(part));
                corrected.track = track;
            }
        }
        correct_frames(&mut corrected, correction, unapplied);
        run.arms[arm].poses[index] = corrected;
    }
}

fn correct_units(
    source: &mut PoseSource,
    correction: &TopicCorrection,
    unapplied: &mut UnappliedParts,
) {
    let track = &mut source.track;
    if let Some(slip) = correction.length_unit {
        unapplied.mark_applied("length_unit");
        track.xyz.iter_mut().for_each(|xyz| *xyz *= slip.factor());
        if let Some(declared) = &mut track.declared {
            let millimetres = Some(LengthScale::MILLIMETRE).filter(|unit| slip.is == *unit);
            declared.length = millimetres.unwrap_or_default();
        }
    }
    if let Some(slip) = correction.angle_unit {
        match (&mut track.orientation, &mut track.declared) {
            (Orientations::Numbers(numbers), _) => {
                unapplied.mark_applied("angle_unit");
                let factor = slip.factor();
                numbers.iter_mut().for_each(|numbers| *numbers = numbers.map(|n| n * factor));
            }
            (Orientations::Rotations(rotations), Some(declared)) => {
                if let Some(other) = &mut declared.in_other_angles {
                    unapplied.mark_applied("angle_unit");
                    std::mem::swap(rotations, other);
                    declared.angle = slip.is;
                }
            }
            (Orientations::Rotations(_), None) | (Orientations::Unset(_), _) => {}
        }
    }
    if let (Some(convention), Orientations::Numbers(numbers)) =
        (correction.convention, &track.orientation)
    {
        unapplied.mark_applied("convention");
        let rotations = numbers.iter().map(|&numbers| convention.rotation(numbers)).collect();
        track.orientation = Orientations::Rotations(rotations);
    }
    // A correction states the encoding of bare numbers, as a declaration does.
    let is_stated = correction.length_unit.is_some() || correction.convention.is_some();
    if is_stated && !matches!(track.orientation, Orientations::Numbers(_)) {
        track.declared.get_or_insert_default();
    }
}

fn correct_frames(
    source: &mut PoseSource,
    correction: &TopicCorrection,
    unapplied: &mut UnappliedParts,
) {
    let Orientations::Rotations(_) = source.track.orientation else { return };
    unapplied.mark_applied("reference_from_stream");
    unapplied.mark_applied("tip_from_stream");
    let before = correction.reference_from_stream.map(|frame| frame.pose()).unwrap_or_default();
    let after = correction.tip_from_stream.map(|frame| frame.pose().inverse()).unwrap_or_default();
    if before != Pose::identity() || after != Pose::identity() {
        source.track.transform(&before, &after);
    }
}

fn correct_imus(
    run: &mut Run,
    arm: usize,
    correction: &TopicCorrection,
    max_lag_s: f64,
    unapplied: &mut UnappliedParts,
) {
    for index in 0..run.arms[arm].imus.len() {
        let source = &run.arms[arm].imus[index];
        if !is_same_topic(&run.streams[source.stream].topic, &correction.name) {
            continue;
        }
        let mut corrected = source.clone();
        if let Some(rotation) = correction.link_from_imu_xyzw.and_then(rotation_from_xyzw) {
            unapplied.mark_applied("link_from_imu_xyzw");
            let logged = corrected.link_from_imu.unwrap_or_default();
            corrected.link_from_imu = Some(Pose::from_parts(logged.translation, rotation));
        }
        if let Some(encoding) = correction.rotation.and_then(encoding_of_error) {
            let stream = corrected.as_stream();
            let truths = reinterpret_imu(&run.arms[arm].joints, &stream, encoding, max_lag_s);
            if let Some(truths) = truths {
                unapplied.mark_applied("rotation");
                corrected.track.orientation = truths;
            }
        }
        run.arms[arm].imus[index] = corrected;
    }
}

fn correct_targets(run: &mut Run, correction: &TopicCorrection, unapplied: &mut UnappliedParts) {
    let [in_hand, in_base] = [correction.hand_from_camera, correction.base_from_camera]
        .map(|frame| frame.map(|frame| frame.pose()));
    if in_hand.is_none() && in_base.is_none() {
        return;
    }
    for target in &mut run.targets {
        if is_same_topic(&run.streams[target.stream].topic, &correction.name) {
            unapplied.mark_applied("hand_from_camera");
            unapplied.mark_applied("base_from_camera");
            for hand in &mut target.hands {
                (hand.hand_from_camera, hand.base_from_camera) = (in_hand, in_base);
            }
        }
    }
}
