//! Resolves streams and transforms of several possible arms, and leader arms.

use std::collections::{HashMap, HashSet};

use super::Run;
use super::arm::TfUnavailable;
use super::not_audited::{NotAudited, NotAuditedReason};
use super::role::Role;
use super::streams::Stream;
use super::targets::HandKind;

/// A stream that may belong to several arms.
#[derive(Clone, Debug)]
pub struct SharedStream {
    /// Index of the stream.
    pub stream: usize,
    /// Its frames, for each candidate arm.
    pub candidates: Vec<CandidateArm>,
    /// Whether names and frames identify the first candidate.
    pub is_named: bool,
}

/// A candidate arm, and the stream's frames for it.
#[derive(Clone, Debug)]
pub struct CandidateArm {
    /// Index of the arm.
    pub arm: usize,
    /// Reference frame of the poses.
    pub(super) reference: String,
    /// Frame whose poses they are.
    pub(super) link: String,
}

impl CandidateArm {
    pub(super) fn assign(&self, stream: &mut Stream) {
        stream.arm = Some(self.arm);
        (stream.reference, stream.link) = (Some(self.reference.clone()), Some(self.link.clone()));
    }
}

impl Run {
    /// Assigns contested streams to the arms that they follow, or to none.
    pub(super) fn assign_shared_streams(&mut self, decided: &[(SharedStream, Option<usize>)]) {
        let winners: HashMap<usize, Option<usize>> =
            decided.iter().map(|(shared, winner)| (shared.stream, *winner)).collect();
        for (index, arm) in self.arms.iter_mut().enumerate() {
            arm.poses.retain(|source| {
                winners.get(&source.stream).is_none_or(|winner| *winner == Some(index))
            });
        }
        let is_open = |unaudited: &NotAudited| winners.get(&unaudited.stream) == Some(&None);
        self.not_audited.retain(|unaudited| !is_open(unaudited));
        for (shared, winner) in decided {
            self.set_arm_of_shared_stream(shared, *winner);
        }
    }

    fn set_arm_of_shared_stream(&mut self, shared: &SharedStream, winner: Option<usize>) {
        let SharedStream { stream, candidates, is_named } = shared;
        let names = candidates
            .iter()
            .filter_map(|candidate| Some(self.arms.get(candidate.arm)?.name.clone()));
        let names: Vec<String> = names.collect();
        let candidate = candidates.iter().find(|candidate| Some(candidate.arm) == winner);
        let Some(candidate) = candidate else {
            let reason = format!(
                "it may belong to {}, and the motion does not distinguish them",
                names.join(" or ")
            );
            self.clear_role(*stream, reason);
            let why = NotAuditedReason::WhoseArm { arms: names };
            self.not_audited.push(NotAudited { stream: *stream, reason: why });
            return;
        };
        let is_first = candidates.first().is_some_and(|first| first.arm == candidate.arm);
        if *is_named && is_first {
            return;
        }
        let Some(awarded) = self.streams.get_mut(*stream) else { return };
        candidate.assign(awarded);
        if let Some(arm) = self.arms.get(candidate.arm) {
            awarded.reason += &format!("; belongs to {}, by its motion", arm.name);
        }
        if let ([named, ..], true) = (names.as_slice(), *is_named) {
            let arm = self.arms[candidate.arm].name.clone();
            let why = NotAuditedReason::OtherArm { named: named.clone(), arm };
            self.not_audited.push(NotAudited { stream: *stream, reason: why });
        }
    }

    /// Assigns contested transforms to the arm that they follow.
    pub fn assign_shared_transforms(&mut self, candidates: &[usize], winner: usize) {
        let arm = self.arms[winner].name.clone();
        for &loser in candidates.iter().filter(|&&index| index != winner) {
            self.arms[loser].tf = Err(TfUnavailable::OfAnotherArm { arm: arm.clone() });
        }
    }

    /// Turns arm `index` into commands that lead `of` by `lead_s`.
    pub fn resolve_leading_arm(&mut self, index: usize, of: &str, lead_s: f64) {
        self.arms.remove(index);
        for stream in self.streams.iter_mut().filter(|stream| stream.arm == Some(index)) {
            stream.reason += &format!("; they lead {of} by {:.0} ms: a leader arm", 1e3 * lead_s);
            (stream.role, stream.arm) = (Role::Reference, None);
        }
        let moved = |arm: &mut usize| {
            let stays = *arm != index;
            *arm -= usize::from(*arm > index);
            stays
        };
        self.streams.iter_mut().filter_map(|stream| stream.arm.as_mut()).for_each(|arm| {
            moved(arm);
        });
        self.references.retain_mut(|source| moved(&mut source.arm));
        for target in &mut self.targets {
            target.hands.retain_mut(|hand| match &mut hand.kind {
                HandKind::Joints { arm, .. } => moved(arm),
                _ => true,
            });
        }
    }

    /// Removes the sources and findings of `candidates` that were resolved to other roles.
    pub(super) fn remove_rejected(&mut self, candidates: &[usize]) {
        let is_pose = |stream: &usize| self.streams[*stream].role == Role::Pose;
        let rejected = candidates.iter().copied().filter(|stream| !is_pose(stream)).collect();
        self.remove_sources(&rejected);
    }

    /// Makes a stream unassigned. [`Run::remove_sources`] must follow.
    pub(super) fn clear_role(&mut self, stream: usize, reason: String) {
        let Some(stream) = self.streams.get_mut(stream) else { return };
        (stream.role, stream.reason) = (Role::Unassigned, reason);
        (stream.arm, stream.reference, stream.link, stream.source_kind) = (None, None, None, None);
    }

    /// Removes the pose sources and findings of `streams`.
    pub(super) fn remove_sources(&mut self, streams: &HashSet<usize>) {
        for arm in &mut self.arms {
            arm.poses.retain(|source| !streams.contains(&source.stream));
        }
        self.not_audited.retain(|unaudited| !streams.contains(&unaudited.stream));
    }

    /// Unassigns streams, and records the reasons: for the report, and of the role.
    pub(super) fn exclude(&mut self, excluded: Vec<(NotAudited, String)>) {
        let streams = excluded.iter().map(|(unaudited, _)| unaudited.stream).collect();
        self.remove_sources(&streams);
        for (unaudited, reason) in excluded {
            self.clear_role(unaudited.stream, reason);
            self.not_audited.push(unaudited);
        }
    }
}
