//! Joints with the same fault are one finding.

use crate::checks::Judged;
use crate::evidence::ArmEvidence;
use crate::finding::Subject;

/// What is wrong with the joints at these places, sorted into those that have the same, in the order of
/// their first.
pub fn alike<T>(faults: Vec<(usize, T)>, is_same: impl Fn(&T, &T) -> bool) -> Vec<Vec<(usize, T)>> {
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

/// The subject of one finding on the joints at these places of a topic: the joint, or the topic where
/// there are several.
pub fn subject(arm: &ArmEvidence, topic: &str, joints: &[usize]) -> Subject {
    let topic = arm.topic(topic);
    match joints {
        [joint] => Subject { joint: arm.joint(*joint).joint, ..topic },
        _ => topic,
    }
}

/// Who they are in a message, before what they do: nothing of one, which is the subject.
pub fn prefix(arm: &ArmEvidence, joints: &[usize]) -> String {
    match joints.len() {
        1 => String::new(),
        count if count == arm.joints.len() => "all joints: ".to_owned(),
        count => format!("{count} joints: "),
    }
}

/// Lists several joints by name in the evidence.
pub fn listed(judged: Judged, arm: &ArmEvidence, joints: &[usize]) -> Judged {
    let name = |joint: &usize| arm.joints.get(*joint).map(|joint| joint.name.clone());
    match joints {
        [_] => judged,
        _ => judged.with_evidence("joints", joints.iter().filter_map(name).collect::<Vec<_>>()),
    }
}
