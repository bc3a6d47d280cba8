//! The streams of poses and IMUs: whose they are, and between which links.

use crate::geometry::Pose;
use crate::robot::LinkId;
use crate::stream::Columns;

use super::super::arm::{Anchor, Arm, ImuSource, PoseSource};
use super::super::declaration::Declaration;
use super::super::error::RunError;
use super::super::frozen::{Frozen, take_frozen};
use super::super::poses::{self, Stamped};
use super::super::role::{Place, PoseTopic, Role, Verdict, array_role, pose_role};
use super::super::streams::Stream;
use super::super::topics::{SaidRole, TopicSettings};
use super::super::witness::{PoseNames, Witness, witness_of};
use super::{Assembly, is_topic, not_so};

/// Between which links of an arm the poses of a stream are.
pub(super) struct Site {
    pub frame: Place,
    pub child: Place,
    pub base: Anchor,
    pub tip: Anchor,
    pub tip_named: bool,
    /// What of it needs saying.
    pub said: String,
}

impl Assembly<'_> {
    pub(super) fn assign_pose(&mut self, index: usize) -> Result<(), RunError> {
        let stream = &self.streams[index];
        let declared =
            self.options.declared.iter().find(|declared| is_topic(stream, &declared.topic));
        let unfit = declared.filter(|declared| !declared.fits(stream.columns.as_ref()));
        let declared = declared.filter(|_| unfit.is_none());
        let owner = self.owner(stream);
        let site = owner.map(|arm| self.site(&self.arms[arm], stream));
        let said = self.said_of(stream);
        let (mut role, mut reason) = self.role_of(stream, site.as_ref(), declared.is_some());
        if let Some(vendor) = said.and_then(|said| said.vendor.as_ref()) {
            reason += &format!("; {vendor}");
        }
        if unfit.is_some() {
            reason += ", but it holds other numbers, which are read as they are";
        }
        let is_wanted = matches!(role, Role::Pose | Role::Candidate { .. });
        let mut source = None;
        if let (true, Some(arm), Some(site)) = (is_wanted, owner, &site) {
            let mut frozen = Vec::new();
            let known = role == Role::Pose;
            match self.pose_source(index, &self.arms[arm], site, declared, (known, &mut frozen)) {
                Ok(found) => {
                    reason += &site.said;
                    let reference = match found.reference_known {
                        true => self.arms[arm].frame_of(site.base.link),
                        false => stream.frame_id.clone(),
                    };
                    let link = self.arms[arm].frame_of(site.tip.link);
                    let by_names = || {
                        witness_of(&PoseNames {
                            topic: &stream.topic,
                            type_name: &stream.type_name,
                            frame_id: &stream.frame_id,
                            child_frame_id: &stream.child_frame_id,
                            frame: site.frame,
                            stamps_copied: found.stamps_copied,
                        })
                    };
                    let set = said.and_then(|said| Some((said.witness?, said.place.clone())));
                    let witness = set.unwrap_or_else(by_names);
                    source = Some((arm, found, reference, link, witness));
                }
                Err(what)
                    if let Some(declared) = declared
                        && frozen.is_empty() =>
                {
                    return Err(not_so(declared, what));
                }
                Err(why) => (role, reason) = (Role::Unassigned, why),
            }
            self.watched.push(index);
            self.frozen.extend(frozen);
        } else if matches!(role, Role::Candidate { .. }) {
            role = Role::Unassigned;
            reason += ", and there is no arm that it could follow";
        }
        let stream = &mut self.streams[index];
        (stream.role, stream.reason) = (role, reason);
        if let Some((arm, source, reference, link, (witness, why))) = source {
            stream.reason += &format!("; witness: {}, by {why}", witness.name());
            (stream.arm, stream.witness) = (Some(arm), Some(witness));
            (stream.reference, stream.link) = (Some(reference), Some(link));
            self.arms[arm].poses.push(source);
        }
        Ok(())
    }

    /// What the caller says of the topic of a stream.
    fn said_of(&self, stream: &Stream) -> Option<&TopicSettings> {
        self.options.topics.iter().find(|said| said.is_of(&stream.topic))
    }

    pub(super) fn role_of(
        &self,
        stream: &Stream,
        site: Option<&Site>,
        is_declared: bool,
    ) -> Verdict {
        let said = self.said_of(stream).and_then(|said| Some((said.role?, &said.place)));
        if let Some((role, place)) = said
            && !self.is_transform(stream)
        {
            let said = format!("its role is set ({place})");
            match (&stream.columns, role) {
                (Some(Columns::Array(array)), SaidRole::Pose) => {
                    let (role, reason) = array_role(&stream.topic, array.width, true);
                    let is_pose = role == Role::Pose;
                    return if is_pose { (role, said) } else { (role, reason) };
                }
                (_, role) => return (role.role(), said),
            }
        }
        if let Some(Columns::Array(array)) = &stream.columns {
            return array_role(&stream.topic, array.width, is_declared);
        }
        let place = |frame: &str| if frame.is_empty() { Place::Unnamed } else { Place::Unknown };
        let verdict = pose_role(&PoseTopic {
            topic: &stream.topic,
            frame_id: &stream.frame_id,
            child_frame_id: &stream.child_frame_id,
            frame: site.map_or(place(&stream.frame_id), |site| site.frame),
            child: site.map_or(place(&stream.child_frame_id), |site| site.child),
            is_declared,
        });
        match verdict {
            // Many transforms start at the base: that alone says nothing.
            (Role::Candidate { .. }, _) if self.is_transform(stream) => (
                Role::Candidate { presumed: false },
                format!("'{}' is no link of the robot", stream.child_frame_id),
            ),
            verdict => verdict,
        }
    }

    /// Whether a stream of poses is a transform of a TF topic.
    pub(super) fn is_transform(&self, stream: &Stream) -> bool {
        self.streams.iter().any(|other| other.role == Role::Tf && other.topic == stream.topic)
    }

    /// The arm that a stream may belong to: the one that moves its child frame, else the one that
    /// has its frame, else the one whose robot's name is in the topic, else the first.
    pub(super) fn owner(&self, stream: &Stream) -> Option<usize> {
        let place = |arm: &Arm, frame: &str| arm.place(&self.tf, frame).0;
        let is_known =
            |arm: &&Arm| !matches!(place(arm, &stream.frame_id), Place::Unknown | Place::Unnamed);
        let moves = |arm: &Arm| place(arm, &stream.child_frame_id) == Place::MovingLink;
        let has_frame =
            |arm: &Arm| is_known(&arm) && self.arms.iter().filter(is_known).count() == 1;
        let is_named = |arm: &Arm| arm.namespace().is_some_and(|name| stream.topic.contains(name));
        let first = |fits: &dyn Fn(&Arm) -> bool| self.arms.iter().position(fits);
        first(&moves)
            .or_else(|| first(&has_frame))
            .or_else(|| first(&is_named))
            .or_else(|| first(&|_| true))
    }

    /// Between which links of `arm` a stream's poses are.
    pub(super) fn site(&self, arm: &Arm, stream: &Stream) -> Site {
        let (frame, frame_anchor) = arm.place(&self.tf, &stream.frame_id);
        let (child, child_anchor) = arm.place(&self.tf, &stream.child_frame_id);
        let still = |link: LinkId| Anchor { link, link_from_frame: Pose::identity() };
        let base = match frame {
            Place::Unnamed => still(arm.unnamed_base),
            _ => frame_anchor.unwrap_or(still(arm.base)),
        };
        // The caller's tip stands before a stream's own child frame, but a transform is of its child.
        let names_tip = child == Place::MovingLink && (!arm.tip_named || self.is_transform(stream));
        let child_tip = child_anchor.filter(|_| names_tip);
        let tip = child_tip.unwrap_or(still(arm.tip));
        let mut said = String::new();
        let sides = [(&stream.frame_id, frame_anchor), (&stream.child_frame_id, child_tip)];
        for (frame, anchor) in sides {
            let Some(anchor) = anchor else { continue };
            let link = arm.frame_of(anchor.link);
            if link != *frame {
                said += &format!("; '{frame}' is tied to '{link}' by static transforms");
            }
        }
        if child == Place::MovingLink && child_anchor.is_some_and(|anchor| anchor.link != tip.link)
        {
            said += &format!("; audited as '{}', which the caller named", arm.chain.tip_name());
        }
        let tip_named = arm.tip_named || child == Place::MovingLink;
        Site { frame, child, base, tip, tip_named, said }
    }

    /// The poses of a stream with the chain that predicts them, or why there are none.
    pub(super) fn pose_source(
        &self,
        index: usize,
        arm: &Arm,
        site: &Site,
        declared: Option<&Declaration>,
        (known, frozen): (bool, &mut Vec<Frozen>),
    ) -> Result<PoseSource, String> {
        let (chain, columns) =
            arm.chain_between(site.base.link, site.tip.link).ok_or_else(|| {
                let [base, tip] = [site.base.link, site.tip.link].map(|link| arm.frame_of(link));
                format!("no joint in the joint states moves '{tip}' against '{base}'")
            })?;
        let mut rows = self.timing.seen_rows(&self.streams, index, 0, 0.0);
        poses::thinned(&mut rows);
        let mut logged = match &self.streams[index].columns {
            Some(Columns::Poses(poses)) => {
                let [poses] = poses.as_slice() else {
                    return Err("it holds several poses".to_owned());
                };
                poses::from_poses(poses, &rows, declared, self.origin)?
            }
            Some(Columns::Array(array)) => poses::from_array(array, &rows, declared, self.origin)?,
            _ => return Err("it holds no poses".to_owned()),
        };
        let how = (known, self.options.max_latency_s);
        *frozen = take_frozen(index, &mut logged, &arm.joints, &columns, how);
        if frozen.iter().any(|frozen| frozen.whole) {
            return Err("it repeats one value while the arm moves".to_owned());
        }
        let Stamped { track, stamps } = logged;
        if track.t_s.len() < 2 {
            return Err("it has fewer than two usable samples".to_owned());
        }
        let (before, after) = (site.base.link_from_frame, site.tip.link_from_frame.inverse());
        Ok(PoseSource {
            stream: index,
            chain,
            columns,
            track: poses::reframed(track, &before, &after),
            reference_known: site.frame != Place::Unknown,
            stamps_copied: poses::are_copies(&stamps, &arm.joint_stamps),
            stamp_error_s: self.stamp_error_s(arm, index, 0),
            tip_named: site.tip_named,
        })
    }

    pub(super) fn assign_imu(&mut self, index: usize) {
        let stream = &self.streams[index];
        let Some(Columns::Imu(imu)) = &stream.columns else { return };
        let Some(owner) = self.owner(stream) else { return };
        let arm = &self.arms[owner];
        let (place, anchor) = arm.place(&self.tf, &stream.frame_id);
        let (carrier, link_from_imu, why) = match (place, anchor) {
            (Place::MovingLink, Some(anchor)) => {
                (anchor.link, Some(anchor.link_from_frame), "the arm moves its frame".to_owned())
            }
            (Place::StillLink | Place::Tied, _) => {
                let reason = format!("the arm does not move its frame '{}'", stream.frame_id);
                self.streams[index].reason = format!("inertial measurements; {reason}");
                return;
            }
            _ => {
                (arm.tip, None, "no frame says what carries it: taken to be at the tip".to_owned())
            }
        };
        if let Some(joint) = arm.unlogged_above(carrier) {
            let reason = format!("'{joint}', which moves it, is not in the joint states");
            self.streams[index].reason = format!("inertial measurements; {reason}");
            return;
        }
        let Some((chain, columns)) = arm.chain_between(arm.base, carrier) else { return };
        let rows = self.timing.seen_rows(&self.streams, index, 0, 0.0);
        let Stamped { track, stamps } = poses::from_imu(imu, &rows, self.origin);
        let source = ImuSource {
            stream: index,
            chain,
            columns,
            track,
            link_from_imu,
            stamps_copied: poses::are_copies(&stamps, &arm.joint_stamps),
            stamp_error_s: self.stamp_error_s(arm, index, 0),
        };
        let reason = format!("inertial measurements; {why}");
        let [reference, link] = [arm.base, carrier].map(|link| arm.frame_of(link));
        let stream = &mut self.streams[index];
        (stream.arm, stream.reason) = (Some(owner), reason);
        stream.witness = Some(Witness::External);
        (stream.reference, stream.link) = (Some(reference), Some(link));
        if source.track.t_s.len() > 1 {
            self.arms[owner].imus.push(source);
        }
    }
}
