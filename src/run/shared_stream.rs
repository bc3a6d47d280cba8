//! Resolves streams and transforms of several possible arms, and leader arms.

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
    /// Assigns a contested stream to the arm that it follows, or to none.
    pub fn assign_shared_stream(&mut self, shared: &SharedStream, winner: Option<usize>) {
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
            self.unassign(*stream, reason);
            let why = NotAuditedReason::WhoseArm { arms: names };
            self.not_audited.push(NotAudited { stream: *stream, reason: why });
            return;
        };
        for (index, arm) in
            self.arms.iter_mut().enumerate().filter(|(index, _)| *index != candidate.arm)
        {
            if candidates.iter().any(|candidate| candidate.arm == index) {
                arm.poses.retain(|source| source.stream != *stream);
            }
        }
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

    /// Removes a stream from its arm, with its findings.
    pub fn unassign(&mut self, stream: usize, reason: String) {
        for arm in &mut self.arms {
            arm.poses.retain(|source| source.stream != stream);
        }
        self.not_audited.retain(|unaudited| unaudited.stream != stream);
        let Some(stream) = self.streams.get_mut(stream) else { return };
        (stream.role, stream.reason) = (Role::Unassigned, reason);
        (stream.arm, stream.reference, stream.link, stream.source_kind) = (None, None, None, None);
    }

    /// Unassigns a stream, and records the reason.
    pub fn exclude(&mut self, stream: usize, why: NotAuditedReason, reason: String) {
        self.unassign(stream, reason);
        self.not_audited.push(NotAudited { stream, reason: why });
    }
}
