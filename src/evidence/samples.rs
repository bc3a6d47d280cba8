use super::{StreamEvidence, stream_evidence};
use crate::robot::JointKind;
use crate::run::{
    FrozenSpan, NormDefects, Outliers, PoseSource, RepeatedValues, Role, Run, Stream, tf_topics,
    with_key,
};
use crate::stream::Columns;

/// Unusable samples of a stream.
#[derive(Clone, Copy, Debug, Default)]
pub struct UnusableSampleEvidence {
    /// NaN, infinite or absurdly large.
    pub unusable: u64,
    /// Without an orientation, if others have one.
    pub unset: u64,
    /// With a wrong number of values.
    pub misfits: u64,
    /// List a joint twice with different positions.
    pub contradictory: u64,
    /// All samples.
    pub samples: u64,
}

/// Outliers of a stream.
#[derive(Clone, Debug)]
pub struct OutlierEvidence {
    /// Samples; of several poses, of the most frequent one.
    pub samples: usize,
    /// Joints or transforms with outliers.
    pub parts: Vec<Outliers>,
    /// Prismatic joints.
    pub sliding: Vec<String>,
}

/// Values repeated with new stamps while the arm moves.
#[derive(Clone, Debug)]
pub struct RepeatedValueEvidence {
    /// Repeats per transform, or of the stream.
    pub parts: Vec<RepeatedValues>,
    /// The topic name indicates deliberate repetition.
    pub is_latched: bool,
    /// Computed from repeated joint states, with their stamps.
    pub is_of_joints: bool,
}

/// Grouped by stream.
pub(super) fn norms(run: &Run) -> Vec<StreamEvidence<Vec<NormDefects>>> {
    let tf_topics = tf_topics(&run.streams);
    let has_rotations = |stream: &Stream| match &stream.columns {
        // Only a pose has a quaternion as four bare numbers.
        Some(Columns::Array(_)) => stream.role == Role::Pose,
        // Judged on their own topic.
        Some(Columns::Poses(_)) => {
            stream.role != Role::Ignored && !tf_topics.contains(&stream.topic)
        }
        _ => true,
    };
    let of_stream = |norms: &[NormDefects]| {
        let index = norms[0].stream;
        has_rotations(run.streams.get(index)?).then(|| stream_evidence(run, index, norms.to_vec()))
    };
    run.norm_defects.chunk_by(|a, b| a.stream == b.stream).filter_map(of_stream).collect()
}

pub(super) fn unusable(run: &Run) -> Vec<StreamEvidence<UnusableSampleEvidence>> {
    let is_asked =
        |stream: &Stream| matches!(stream.role, Role::Joints | Role::Pose | Role::Tf | Role::Imu);
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let unusable = |(index, stream): (usize, &Stream)| {
        let mut facts = UnusableSampleEvidence {
            unusable: stream.unusable(),
            ..UnusableSampleEvidence::default()
        };
        let mut joint = None;
        let kept: usize = stream.times().iter().map(|times| times.len()).sum();
        facts.samples = kept as u64 + facts.unusable;
        match &stream.columns {
            Some(Columns::Joints(joints)) => {
                let names = joints.joints.iter().map(|joint| joint.name.as_str());
                let of_arm = names.zip(&joints.unusable).filter(|(name, _)| {
                    let mut of_arms = run.arms.iter().flat_map(|arm| &arm.joint_sources);
                    run.arms.is_empty() || of_arms.any(|joint| joint.name == *name)
                });
                let worst = of_arm.max_by_key(|(_, count)| **count);
                facts.misfits = joints.wrong_length;
                facts.contradictory = joints.contradictory;
                facts.samples = kept as u64 + facts.misfits;
                facts.unusable = worst.map_or(0, |(_, count)| *count);
                joint = worst.filter(|_| facts.unusable > 0).map(|(name, _)| name.to_owned());
            }
            Some(Columns::Poses(_) | Columns::Transforms(_)) => {
                // Without any orientation, the part has no rotations.
                let own = with_key(&run.norm_defects, index, |norms| norms.stream).iter();
                let some = own.filter(|norms| norms.rows > 0);
                facts.unset = some.map(|norms| norms.unset as u64).sum();
            }
            Some(Columns::Array(array)) => {
                facts.misfits = array.wrong_length;
                facts.samples += facts.misfits;
            }
            _ => {}
        }
        let mut of = stream_evidence(run, index, facts);
        of.subject.joint = joint;
        of
    };
    streams.map(unusable).collect()
}

/// Streams of joint states, transforms and poses, and those with the role `other`.
fn measured_streams(run: &Run, other: Option<Role>) -> impl Iterator<Item = (usize, &Stream)> {
    let tf_topics = tf_topics(&run.streams);
    run.streams.iter().enumerate().filter(move |(_, stream)| match stream.role {
        Role::Joints | Role::Tf => true,
        // Judged on their own topic.
        Role::Pose => !tf_topics.contains(&stream.topic),
        role => Some(role) == other,
    })
}

pub(super) fn outliers(run: &Run) -> Vec<StreamEvidence<OutlierEvidence>> {
    let sliding: Vec<String> = run
        .arms
        .iter()
        .flat_map(|arm| arm.robot.joints())
        .filter(|joint| joint.kind == JointKind::Prismatic)
        .map(|joint| joint.name.clone())
        .collect();
    let strays = |(index, stream): (usize, &Stream)| {
        // Poses computed from rows of zeros are reported with these.
        let is_own = |found: &&Outliers| !found.are_zeros || stream.role == Role::Joints;
        let parts = with_key(&run.sample_filter.outliers, index, |strays| strays.stream);
        let found = OutlierEvidence {
            samples: stream.times().iter().map(|times| times.len()).max().unwrap_or(0),
            sliding: sliding.clone(),
            parts: parts.iter().filter(is_own).cloned().collect(),
        };
        stream_evidence(run, index, found)
    };
    measured_streams(run, None).map(strays).collect()
}

/// Frozen intervals of streams compared with an arm.
pub(super) fn frozen_intervals(run: &Run) -> Vec<StreamEvidence<Vec<FrozenSpan>>> {
    let mut all = run.frozen.clone();
    all.sort_by_key(|found| found.stream);
    let frozen = |index: usize| {
        let stream = run.streams.get(index)?;
        let times = with_key(&all, index, |found| found.stream);
        let is_asked = matches!(stream.role, Role::Pose | Role::Joints);
        if !is_asked && !times.iter().any(|found| found.is_whole_stream) {
            return None;
        }
        let mut found = stream_evidence(run, index, times.to_vec());
        if let Some(first) = times.first()
            && let [joint] = first.joints.as_slice()
            && times.iter().all(|span| span.joints == first.joints)
        {
            found.subject.joint = Some(joint.clone());
        }
        Some(found)
    };
    let joints = (0..run.streams.len()).filter(|&index| run.streams[index].role == Role::Joints);
    joints.chain(run.searched_for_frozen.iter().copied()).filter_map(frozen).collect()
}

pub(super) fn repeated_values(run: &Run) -> Vec<StreamEvidence<RepeatedValueEvidence>> {
    let of_stream = |index: usize| with_key(&run.sample_filter.repeated, index, |held| held.stream);
    let repeats = |index: usize| of_stream(index).iter().any(|held| held.is_deduplicated());
    let is_of_joints = |index: usize| {
        run.arms.iter().any(|arm| {
            let follows = |tf: &PoseSource| tf.stream == index && tf.stamps_copied;
            arm.tf.as_ref().is_ok_and(follows)
                && arm.joint_sources.iter().any(|joint| repeats(joint.stream))
        })
    };
    let held = |(index, stream): (usize, &Stream)| {
        let found = RepeatedValueEvidence {
            parts: of_stream(index).to_vec(),
            is_latched: stream.topic.to_lowercase().contains("latched"),
            is_of_joints: is_of_joints(index),
        };
        stream_evidence(run, index, found)
    };
    measured_streams(run, Some(Role::Imu)).map(held).collect()
}
