//! Combines joints with the same fault into one finding.

use crate::checks::SubjectResult;
use crate::evidence::ArmEvidence;
use crate::finding::Subject;

/// Groups (joint index, fault) pairs of equal fault, in the order of their first member.
pub fn group_equal<T>(
    faults: Vec<(usize, T)>,
    is_same: impl Fn(&T, &T) -> bool,
) -> Vec<Vec<(usize, T)>> {
    let mut groups: Vec<Vec<(usize, T)>> = Vec::new();
    for fault in faults {
        let known = groups.iter_mut().find(|group| is_same(&group[0].1, &fault.1));
        match known {
            Some(group) => group.push(fault),
            None => groups.push(vec![fault]),
        }
    }
    groups
}

/// The joint, or the topic if there are several joints.
pub fn group_subject(arm: &ArmEvidence, topic: &str, joints: &[usize]) -> Subject {
    let topic = arm.topic(topic);
    match joints {
        [joint] => Subject { joint: arm.joint(*joint).joint, ..topic },
        _ => topic,
    }
}

/// Number of joints; empty for one joint, which is the subject.
pub fn group_prefix(arm: &ArmEvidence, joints: &[usize]) -> String {
    match joints.len() {
        1 => String::new(),
        count if count == arm.joints.len() => "all joints: ".to_owned(),
        count => format!("{count} joints: "),
    }
}

pub fn with_joint_names(
    judged: SubjectResult,
    arm: &ArmEvidence,
    joints: &[usize],
) -> SubjectResult {
    let name = |joint: &usize| arm.joints.get(*joint).map(|joint| joint.name.clone());
    match joints {
        [_] => judged,
        _ => judged.with_evidence("joints", joints.iter().filter_map(name).collect::<Vec<_>>()),
    }
}
