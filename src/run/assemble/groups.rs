//! Groups joint state topics by arm; two arms may use the same joint names.

use std::collections::HashSet;

use super::super::joints::{JointTopic, JointTopics, SortedSamples};
use super::super::namespace::{Namespace, NamespaceMatch};
use super::super::streams::Stream;
use super::super::velocities::root_mean_square;
use crate::stats::thin::thinned;
use crate::time::Stamp;

/// Joint state topics in which each name refers to a single joint.
pub(super) struct JointStateGroup<'a> {
    pub joints: JointTopics<'a>,
    pub namespace: Namespace,
}

const MAX_SAMPLES: usize = 200;
/// Maximum spread of a joint at rest, rad or m.
const MAX_REST_SPREAD: f64 = 0.01;
/// Maximum difference between two measurements of one joint, as a share of its motion.
const MAX_DIFFERENCE_SHARE: f64 = 0.01;

/// Groups topics of one robot. Topics with different positions for the same joint name belong to different
/// arms. A topic without a shared joint, such as a rail, joins the group that its name matches, or all.
pub(super) fn group_joint_topics<'a>(
    streams: &[Stream],
    topics: Vec<JointTopic<'a>>,
    origin: Stamp,
) -> Vec<JointStateGroup<'a>> {
    let name = |topic: &JointTopic<'_>| streams[topic.stream].topic.clone();
    let mut ranked: Vec<usize> = (0..topics.len()).collect();
    ranked.sort_by_key(|&index| std::cmp::Reverse(topics[index].columns.joints.len()));
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut alone: Vec<usize> = Vec::new();
    for index in ranked {
        let kin = |members: &Vec<usize>| {
            let known = members.iter().map(|&other| {
                let names = [&topics[other], &topics[index]].map(name);
                relation(&topics[other], &topics[index], are_siblings(&names[0], &names[1]))
            });
            known.max().unwrap_or(Relation::Unrelated)
        };
        let relations: Vec<Relation> = groups.iter().map(kin).collect();
        let is = |wanted: Relation| relations.iter().position(|found| *found == wanted);
        match (is(Relation::SameArm), is(Relation::DifferentArms)) {
            (Some(group), _) => groups[group].push(index),
            (None, Some(_)) => groups.push(vec![index]),
            (None, None) if groups.is_empty() => groups.push(vec![index]),
            (None, None) => alone.push(index),
        }
    }
    let heads: Vec<String> = groups.iter().map(|members| name(&topics[members[0]])).collect();
    let namespaces = Namespace::from_names(&heads);
    for index in alone {
        let claims: Vec<NamespaceMatch> = namespaces
            .iter()
            .map(|namespace| namespace.match_names([name(&topics[index]).as_str()]))
            .collect();
        let is_claimed = claims.contains(&NamespaceMatch::Own);
        for (members, claim) in groups.iter_mut().zip(claims) {
            if !is_claimed || claim == NamespaceMatch::Own {
                members.push(index);
            }
        }
    }
    let group = |(mut members, namespace): (Vec<usize>, Namespace)| {
        // In the order of the log.
        members.sort_unstable();
        let topics = members.into_iter().map(|index| topics[index].clone()).collect();
        JointStateGroup { joints: JointTopics::new(topics, origin), namespace }
    };
    groups.into_iter().zip(namespaces).map(group).collect()
}

fn are_siblings(a: &str, b: &str) -> bool {
    let namespace = |topic: &str| -> Vec<String> {
        let mut parts: Vec<String> =
            topic.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        parts.pop();
        parts
    };
    let (a, b) = (namespace(a), namespace(b));
    !a.starts_with(&b) && !b.starts_with(&a)
}

/// From the weakest evidence to the strongest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Relation {
    Unrelated,
    SameArm,
    DifferentArms,
}

/// One joint in two topics, at some stamps of the second; the first is interpolated.
struct JointComparison {
    a: Vec<f64>,
    b: Vec<f64>,
    /// Share of the second topic's values that occur in the first.
    copied: f64,
}

fn relation(a: &JointTopic<'_>, b: &JointTopic<'_>, siblings: bool) -> Relation {
    let names = a.columns.joints.iter().map(|joint| &joint.name);
    let shared: Vec<&String> =
        names.filter(|name| a.has_joint(name) && b.has_joint(name)).take(8).collect();
    if shared.is_empty() {
        return Relation::Unrelated;
    }
    let beside: Vec<JointComparison> =
        shared.iter().filter_map(|name| compare_joint(a, b, name)).collect();
    let mean = |values: &dyn Fn(&JointComparison) -> f64| {
        beside.iter().map(values).sum::<f64>() / beside.len().max(1) as f64
    };
    // Relays repeat values, even with other stamps.
    let copied = if beside.is_empty() { 1.0 } else { mean(&|joint| joint.copied) };
    let moved = mean(&|joint| spread(&joint.a).max(spread(&joint.b)));
    let apart = |joint: &JointComparison| -> Vec<f64> {
        joint.a.iter().zip(&joint.b).map(|(a, b)| a - b).collect()
    };
    let gap = mean(&|joint| root_mean_square(&apart(joint)));
    let about_mean = mean(&|joint| spread(&apart(joint)));
    let is_one = match (moved < MAX_REST_SPREAD, siblings) {
        _ if copied > 0.9 => true,
        (true, siblings) => !siblings && gap < MAX_REST_SPREAD,
        (false, true) => gap < 0.1 * MAX_DIFFERENCE_SHARE * moved,
        // Two readouts of one joint may have different zeros.
        (false, false) => about_mean < MAX_DIFFERENCE_SHARE * moved,
    };
    if is_one { Relation::SameArm } else { Relation::DifferentArms }
}

fn compare_joint(a: &JointTopic<'_>, b: &JointTopic<'_>, name: &str) -> Option<JointComparison> {
    let (a, b) = (SortedSamples::from_topic(a, name), SortedSamples::from_topic(b, name));
    let bits: HashSet<u32> = a.position.iter().map(|q| (*q as f32).to_bits()).collect();
    let mut both = JointComparison { a: Vec::new(), b: Vec::new(), copied: 0.0 };
    for row in thinned(0..b.stamps.len(), MAX_SAMPLES) {
        let (stamp, value) = (b.stamps[row], b.position[row]);
        let right = a.stamps.partition_point(|&other| other < stamp);
        let left = right.saturating_sub(usize::from(a.stamps.get(right) != Some(&stamp)));
        let (Some(&before), Some(&after)) = (a.stamps.get(left), a.stamps.get(right)) else {
            continue;
        };
        if before > stamp {
            continue;
        }
        let span_s = after.seconds_since(before);
        let part = if span_s > 0.0 { stamp.seconds_since(before) / span_s } else { 0.0 };
        both.a.push(a.position[left] + part * (a.position[right] - a.position[left]));
        both.b.push(value);
        both.copied += f64::from(u8::from(bits.contains(&(value as f32).to_bits())));
    }
    both.copied /= both.b.len().max(1) as f64;
    (!both.b.is_empty()).then_some(both)
}

fn spread(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    root_mean_square(&values.iter().map(|v| v - mean).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parent_namespace_is_no_sibling() {
        assert!(are_siblings("/left/joint_states", "/right/joint_states"));
        assert!(!are_siblings("/joint_states", "/right/joint_states"));
        assert!(!are_siblings("/joint_states", "/joint_states_raw"));
        assert!(are_siblings("/cell/r1/joint_states", "/cell/r2/joint_states"));
    }
}
