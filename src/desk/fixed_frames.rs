//! Fixed frames at the ends of an arm, and other axis conventions (`frames.toml`), that may separate two
//! poses.

use std::sync::LazyLock;

use serde::Deserialize;

use crate::geometry::{Axes, Pose, angle_between, pose};
use crate::robot::{LinkId, Robot, catalogue, nearest};

use super::error::DeskError;

/// Tolerance, m and rad.
const TOLERANCE: f64 = 1e-6;

/// Declared frames of a pose.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameNames {
    /// Reference frame.
    pub parent: Option<String>,
    /// Frame whose pose is given.
    pub child: Option<String>,
}

impl FrameNames {
    /// Checks the frames, apart from prefixes, against the links of `robot`, or of all catalogue arms.
    ///
    /// # Errors
    /// If a frame is not a link; names the closest.
    pub fn check(&self, robot: Option<&Robot>) -> Result<(), DeskError> {
        let robots: Vec<&Robot> = match robot {
            Some(robot) => vec![robot],
            None => catalogue::entries().collect(),
        };
        let links =
            || robots.iter().flat_map(|robot| robot.links().map(|link| robot.link_name(link)));
        for name in [&self.parent, &self.child].into_iter().flatten() {
            if links().any(|link| is_same_name(name, link)) {
                continue;
            }
            let nearest = nearest(name, links()).first().map(|&near| near.to_owned());
            return Err(DeskError::Frame { name: name.clone(), nearest });
        }
        Ok(())
    }
}

/// Whether the names match apart from a prefix.
fn is_same_name(given: &str, frame: &str) -> bool {
    let prefix = given.strip_suffix(frame);
    prefix.is_some_and(|prefix| prefix.is_empty() || prefix.ends_with(['/', '_', '-', '.']))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameTable {
    frames: Vec<FramePairEntry>,
    turns: Vec<AxesEntry>,
    worlds: Vec<World>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FramePairEntry {
    end: String,
    arm: String,
    arms: String,
    from: String,
    to: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AxesEntry {
    ends: Vec<String>,
    who: String,
    from: String,
    to: String,
    /// Axes of `to` in terms of `from`.
    axes: String,
}

/// World axes of an engine, a tracker or a format.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct World {
    /// Its user.
    pub who: String,
    /// In terms of ROS axes (REP 103).
    #[serde(deserialize_with = "deserialize_axes")]
    pub axes: Axes,
}

fn deserialize_axes<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Axes, D::Error> {
    String::deserialize(from)?.parse().map_err(serde::de::Error::custom)
}

/// Fixed to each other at one end of common arms.
struct FixedPair {
    is_base: bool,
    /// Makers.
    arms: String,
    from: String,
    to: String,
    from_to: Pose,
}

static TABLE: LazyLock<FrameTable> = LazyLock::new(|| {
    toml::from_str(include_str!("frames.toml")).expect("the embedded table is valid")
});

/// Most common first.
pub(super) fn worlds() -> &'static [World] {
    &TABLE.worlds
}

static PAIRS: LazyLock<Vec<FixedPair>> = LazyLock::new(|| {
    let pairs = TABLE.frames.iter().map(|frames| {
        let arm = catalogue::find(&frames.arm).expect("the embedded table names arms");
        let link = |name: &str| arm.link(name).expect("the embedded table names links");
        let from_to = arm.fixed_transform(link(&frames.from), link(&frames.to));
        FixedPair {
            is_base: frames.end == "base",
            from_to: from_to.expect("the frames of the embedded table are fixed"),
            arms: frames.arms.clone(),
            from: frames.from.clone(),
            to: frames.to.clone(),
        }
    });
    pairs.collect()
});

static TURNS: LazyLock<Vec<FixedPair>> = LazyLock::new(|| {
    let turned = |turn: &'static AxesEntry| {
        let axes: Axes = turn.axes.parse().expect("the embedded table names axes");
        turn.ends.iter().map(move |end| FixedPair {
            is_base: end == "base",
            from_to: pose([0.0; 3], axes.conjugator().inverse()),
            arms: turn.who.clone(),
            from: turn.from.clone(),
            to: turn.to.clone(),
        })
    };
    TABLE.turns.iter().flat_map(turned).collect()
});

/// Frames of two poses at one end, and the constant transform between them.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedFrame {
    /// Frame of the first pose.
    pub frame_a: String,
    /// Frame of the other pose.
    pub frame_b: String,
    /// Makers of such arms.
    pub arms: String,
    /// At the base `but_from_is`, at the tip `is_from_but`.
    pub transform: Pose,
    /// Whether the caller named both.
    pub is_declared: bool,
    /// Whether this changes axes (world, camera, body) instead of arm frames.
    pub is_turn: bool,
    /// Frames with the same transform, such as `tool0 → flange of Universal Robots`.
    pub also: Vec<String>,
}

impl FixedFrame {
    /// Whether the transform is its own inverse and the frames are not named.
    pub fn is_either_way(&self) -> bool {
        !self.is_declared && is_same(&(self.transform * self.transform), &Pose::identity())
    }
}

/// Candidate constant transforms between two poses of one arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameCandidates {
    /// Frames at the base.
    pub base: Vec<FixedFrame>,
    /// Frames at the tip.
    pub tip: Vec<FixedFrame>,
}

impl FrameCandidates {
    /// Candidates for `robot`, or for common arms; `is` and `but` are the declared frames.
    pub fn from_robot(robot: Option<&Robot>, is: &FrameNames, but: &FrameNames) -> Self {
        let mut found = Self::default();
        match robot {
            Some(robot) => {
                let named = |end: &Option<String>| robot.link(end.as_deref()?);
                let base = named(&robot.default_base).unwrap_or_else(|| robot.root());
                let tip = named(&robot.default_tip).or_else(|| robot.leaf_links().last());
                push_fixed_to(robot, base, true, &mut found.base);
                if let Some(tip) = tip {
                    push_fixed_to(robot, tip, false, &mut found.tip);
                }
                found.push(&TURNS, true);
            }
            None => {
                found.push(&TURNS, true);
                found.push(&PAIRS, false);
            }
        }
        merge_equal_frames(&mut found.base, [is.parent.as_deref(), but.parent.as_deref()]);
        merge_equal_frames(&mut found.tip, [is.child.as_deref(), but.child.as_deref()]);
        found
    }

    fn push(&mut self, pairs: &[FixedPair], is_turn: bool) {
        for pair in pairs {
            let end = if pair.is_base { &mut self.base } else { &mut self.tip };
            let names = [pair.from.as_str(), &pair.to];
            push_both(&pair.arms, names, pair.from_to, (pair.is_base, is_turn), end);
        }
    }
}

fn push_fixed_to(robot: &Robot, end: LinkId, is_base: bool, found: &mut Vec<FixedFrame>) {
    let mut fixed: Vec<LinkId> =
        robot.links().filter(|link| robot.fixed_transform(end, *link).is_some()).collect();
    // Prefer common pose frames among those with equal transforms.
    let ends =
        [&robot.default_base, &robot.controller_base, &robot.default_tip, &robot.controller_tip];
    fixed.sort_by_key(|link| {
        let name = robot.link_name(*link);
        !name.ends_with("flange") && !ends.into_iter().flatten().any(|end| end == name)
    });
    for (at, &from) in fixed.iter().enumerate() {
        for &to in &fixed[at + 1..] {
            if let Some(from_to) = robot.fixed_transform(from, to) {
                let names = [from, to].map(|link| robot.link_name(link));
                push_both(&robot.name, names, from_to, (is_base, false), found);
            }
        }
    }
}

fn push_both(
    arms: &str,
    [from, to]: [&str; 2],
    from_to: Pose,
    (is_base, is_turn): (bool, bool),
    found: &mut Vec<FixedFrame>,
) {
    for (first, second, transform) in [(from, to, from_to), (to, from, from_to.inverse())] {
        let (is, but) = if is_base { (second, first) } else { (first, second) };
        found.push(FixedFrame {
            frame_a: is.to_owned(),
            frame_b: but.to_owned(),
            arms: arms.to_owned(),
            transform,
            is_declared: false,
            is_turn,
            also: Vec::new(),
        });
    }
}

/// Marks named frames, drops identities, and merges equal transforms.
fn merge_equal_frames(frames: &mut Vec<FixedFrame>, [is, but]: [Option<&str>; 2]) {
    let meets =
        |given: Option<&str>, frame: &str| given.is_some_and(|given| is_same_name(given, frame));
    for frame in frames.iter_mut() {
        frame.is_declared = meets(is, &frame.frame_a) && meets(but, &frame.frame_b);
    }
    // Stable: other frames keep their order.
    frames.sort_by_key(|frame| !frame.is_declared);
    let mut kept: Vec<FixedFrame> = Vec::new();
    for frame in frames.drain(..) {
        match kept.iter_mut().find(|known| is_same(&known.transform, &frame.transform)) {
            // Its own inverse: listed in one direction only.
            Some(known) if known.frame_a == frame.frame_b && known.frame_b == frame.frame_a => {}
            Some(known) => {
                let told = |is: &str, but: &str| format!("{is} → {but} ({})", frame.arms);
                if !known.also.contains(&told(&frame.frame_b, &frame.frame_a)) {
                    known.also.push(told(&frame.frame_a, &frame.frame_b));
                }
            }
            None if is_same(&frame.transform, &Pose::identity()) => {}
            None => kept.push(frame),
        }
    }
    *frames = kept;
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    (a.translation.vector - b.translation.vector).norm() < TOLERANCE
        && angle_between(&a.rotation, &b.rotation) < TOLERANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{pose, rotation_from_rpy};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn names(parent: &str, child: &str) -> FrameNames {
        FrameNames { parent: Some(parent.to_owned()), child: Some(child.to_owned()) }
    }

    #[test]
    fn declared_frames_come_first() {
        let robot = catalogue::find("ur10e").unwrap();
        let found = FrameCandidates::from_robot(
            Some(robot),
            &names("base", "flange"),
            &names("base_link", "l/tool0"),
        );
        let half_turn = pose([0.0; 3], rotation_from_rpy([0.0, 0.0, PI]));
        assert!(found.base[0].is_declared && is_same(&found.base[0].transform, &half_turn));
        let flange_from_tool0 = pose([0.0; 3], rotation_from_rpy([FRAC_PI_2, 0.0, FRAC_PI_2]));
        let tip = &found.tip[0];
        assert!(tip.is_declared && is_same(&tip.transform, &flange_from_tool0), "{tip:?}");
        assert_eq!((tip.frame_a.as_str(), tip.frame_b.as_str()), ("flange", "tool0"));
    }

    #[test]
    fn unknown_frames_are_rejected_with_the_nearest_link() {
        let robot = catalogue::find("ur10e");
        assert_eq!(names("base", "left_tool0").check(robot), Ok(()));
        assert_eq!(names("base_link", "fr3_link8").check(None), Ok(()));
        let said = names("base", "tol0").check(robot).unwrap_err().to_string();
        assert_eq!(said, "`tol0` is not a link of an arm: did you mean `tool0`?");
        assert!(names("base", "fr3_link8").check(robot).is_err());
    }

    #[test]
    fn without_an_arm_common_frames_are_tried_in_both_directions() {
        let found =
            FrameCandidates::from_robot(None, &FrameNames::default(), &FrameNames::default());
        assert_eq!(found.base.iter().filter(|base| !base.is_turn).count(), 1);
        let is_tried = |is: &str, but: &str, arms: &str| {
            found.tip.iter().any(|tip| {
                (tip.frame_a.as_str(), tip.frame_b.as_str(), tip.arms.as_str()) == (is, but, arms)
            })
        };
        assert!(is_tried("flange", "tool0", "Universal Robots"));
        assert!(is_tried("tool0", "flange", "Universal Robots"));
        assert!(is_tried("flange", "tool0", "ROS-Industrial, as ABB"));
    }
}
