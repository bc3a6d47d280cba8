//! Combines joints with the same fault into one finding.

use crate::checks::SubjectResult;
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
pub fn group_subject(topic: &Subject, names: &[&str], joints: &[usize]) -> Subject {
    let joint = match joints {
        [joint] => names.get(*joint).map(|name| (*name).to_owned()),
        _ => None,
    };
    Subject { joint, ..topic.clone() }
}

/// Number of joints; empty for one joint, which is the subject.
pub fn group_prefix(names: &[&str], joints: &[usize]) -> String {
    match joints.len() {
        0 | 1 => String::new(),
        count if count == names.len() => "all joints: ".to_owned(),
        count => format!("{count} joints: "),
    }
}

pub fn with_joint_names(judged: SubjectResult, names: &[&str], joints: &[usize]) -> SubjectResult {
    match joints {
        [] | [_] => judged,
        _ => {
            let own = joints.iter().filter_map(|&joint| names.get(joint).copied());
            judged.with_evidence("joints", own.collect::<Vec<_>>())
        }
    }
}
