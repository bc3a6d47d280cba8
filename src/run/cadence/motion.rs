//! Detects whether the arm moved in a span.

use std::borrow::Cow;
use std::sync::Arc;

use crate::diagnosis::value_range;
use crate::run::arm::Arm;
use crate::run::joints::{JointTopic, SortedSamples};
use crate::time::Stamp;

pub(super) struct ArmMotion<'a> {
    pub joints: Vec<Positions<'a>>,
}

pub(super) type Positions<'a> = (Arc<[Stamp]>, Cow<'a, [f64]>);

impl<'a> ArmMotion<'a> {
    pub(super) fn new(topics: &[JointTopic<'a>], arms: &[Arm]) -> Self {
        let of_an_arm = |name: &str| {
            arms.is_empty()
                || arms.iter().any(|arm| arm.joint_names.iter().any(|joint| joint == name))
        };
        let mut joints = Vec::new();
        for topic in topics {
            let stamps: Arc<[Stamp]> = topic.rows.iter().map(|(stamp, _)| *stamp).collect();
            let in_order = topic.is_in_order();
            for joint in topic.columns.joints.iter().filter(|joint| of_an_arm(&joint.name)) {
                if in_order && joint.position.iter().all(|q| q.is_finite()) {
                    joints.push((Arc::clone(&stamps), Cow::Borrowed(joint.position.as_slice())));
                    continue;
                }
                let SortedSamples { stamps, position, .. } =
                    SortedSamples::from_topic(topic, &joint.name);
                joints.push((stamps.into(), position.into()));
            }
        }
        Self { joints }
    }

    /// Whether a joint moved between two times; `None` if joint states cover less than half of the span.
    pub(super) fn moves(&self, start: Stamp, end: Stamp) -> Option<bool> {
        /// Minimum joint motion, rad or m: above noise, below 0.1 s of a working arm.
        const MIN_MOTION: f64 = 5e-3;
        let mut covered = false;
        for (stamps, position) in &self.joints {
            let from = stamps.partition_point(|&stamp| stamp <= start).saturating_sub(1);
            let to =
                stamps.partition_point(|&stamp| stamp < end).min(stamps.len().saturating_sub(1));
            let (Some(first), Some(last)) = (stamps.get(from), stamps.get(to)) else { continue };
            let shared_s = (*last).min(end).seconds_since((*first).max(start));
            if from >= to || 2.0 * shared_s < end.seconds_since(start) {
                continue;
            }
            covered = true;
            if value_range(position[from..=to].iter().copied()) > MIN_MOTION {
                return Some(true);
            }
        }
        covered.then_some(false)
    }
}
