//! Streams and transforms that several arms may claim, which of them gets each, and arms that only lead.

use super::Run;
use super::arm::NoTf;
use super::role::Role;
use super::streams::Stream;
use super::targets::HandKind;
use super::unaudited::{Unaudited, WhyNot};

/// A stream that several arms may claim.
#[derive(Clone, Debug)]
pub struct Contest {
    /// Index of the stream.
    pub stream: usize,
    /// What each would have it be.
    pub claims: Vec<Claimant>,
}

/// An arm that a stream may be of, and what it is then.
#[derive(Clone, Debug)]
pub struct Claimant {
    /// Index of the arm.
    pub arm: usize,
    /// The frame that its poses are then audited in.
    pub(super) reference: String,
    /// The frame whose poses they are then.
    pub(super) link: String,
}

impl Claimant {
    /// Makes a stream this arm's.
    pub(super) fn give(&self, stream: &mut Stream) {
        stream.arm = Some(self.arm);
        (stream.reference, stream.link) = (Some(self.reference.clone()), Some(self.link.clone()));
    }
}

impl Run {
    /// Gives the stream of a contest to the arm that it follows; to none where the motion does not tell.
    pub fn award(&mut self, contest: &Contest, winner: Option<usize>) {
        let Contest { stream, claims } = contest;
        let names = claims.iter().filter_map(|claim| Some(self.arms.get(claim.arm)?.name.clone()));
        let names: Vec<String> = names.collect();
        let claim = claims.iter().find(|claim| Some(claim.arm) == winner);
        let Some(claim) = claim else {
            let reason = format!("it may be of {}, and the motion cannot tell", names.join(" or "));
            self.unassign(*stream, reason);
            let why = WhyNot::WhoseArm { arms: names };
            self.unaudited.push(Unaudited { stream: *stream, why });
            return;
        };
        for (index, arm) in
            self.arms.iter_mut().enumerate().filter(|(index, _)| *index != claim.arm)
        {
            if claims.iter().any(|claim| claim.arm == index) {
                arm.poses.retain(|source| source.stream != *stream);
            }
        }
        let Some(awarded) = self.streams.get_mut(*stream) else { return };
        claim.give(awarded);
        if let Some(arm) = self.arms.get(claim.arm) {
            awarded.reason += &format!("; of {}, by its motion", arm.name);
        }
    }

    /// Leaves transforms that stand for several arms to the one that they lie on.
    pub fn award_transforms(&mut self, claimants: &[usize], winner: usize) {
        let arm = self.arms[winner].name.clone();
        for &loser in claimants.iter().filter(|&&index| index != winner) {
            self.arms[loser].tf = Err(NoTf::OfAnotherArm { arm: arm.clone() });
        }
    }

    /// Makes the joint states of arm `index` commands: they do by `lead_s` before `of` what it then does.
    pub fn settle_leading_arm(&mut self, index: usize, of: &str, lead_s: f64) {
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

    /// Takes a stream from its arm, and what was said of it.
    pub fn unassign(&mut self, stream: usize, reason: String) {
        for arm in &mut self.arms {
            arm.poses.retain(|source| source.stream != stream);
        }
        self.unaudited.retain(|unaudited| unaudited.stream != stream);
        let Some(stream) = self.streams.get_mut(stream) else { return };
        (stream.role, stream.reason) = (Role::Unassigned, reason);
        (stream.arm, stream.reference, stream.link, stream.witness) = (None, None, None, None);
    }

    /// What the run could not audit of a stream, beside what is known already.
    pub fn leave_out(&mut self, stream: usize, why: WhyNot, reason: String) {
        self.unassign(stream, reason);
        self.unaudited.push(Unaudited { stream, why });
    }
}
