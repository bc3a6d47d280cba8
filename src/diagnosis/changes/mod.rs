//! Changes in mid-run: a tool that slips, a base that is moved, a joint that loses its zero, numbers that
//! are coded otherwise from some moment on.
//!
//! One model over the whole run leaves a residual then that no cause explains. What changes does so
//! between two samples, where the stream jumps against the arm ([`jumps`]). The run is cut there, the
//! longest part is diagnosed by itself, and each other part against it: joints and poses with what the
//! longest part says taken off, so that the smallest explanation of what remains is what changed
//! (after Chow 1960). That is undone, and everything else is sought on the run as it would be had
//! nothing changed. Only if far less is left then was it a change.

mod found;
mod jumps;

use std::ops::Range;

use super::arm::diagnose_arm;
use super::proof::leaves_much;
use super::sampling::stream_lag_s;
use super::steady::straightened;
use super::{
    ArmDiagnosis, FrameEstimate, JointDiagnosis, PoseDiagnosis, PoseStream, Reading, Seen,
};
use ground::geometry::Pose;
use ground::stats::Measured;
use ground::stream::{JointTrack, Orientations, PoseTrack};

pub use found::{AmountChange, Change, FrameChange, JointChange, JointPatch};
use jumps::{Jump, jumps, strongest};

/// A part of the run has so many samples of some stream.
const PART_SAMPLES: usize = 20;
/// With the changes undone at most this share is left of what was.
const LEFT: f64 = 0.5;

/// The diagnosis of an arm whose streams or joints change in mid-run, of the run as it would be had
/// nothing changed; `None` where nothing does, or where that explains too little. `found` is what the
/// whole run says.
pub(super) fn without_changes(
    joints: &JointTrack,
    streams: &[PoseStream],
    slides: &[bool],
    found: &ArmDiagnosis,
    most_lag_s: f64,
) -> Option<ArmDiagnosis> {
    if !found.streams.iter().any(leaves_much) {
        return None;
    }
    let lags: Vec<f64> = streams
        .iter()
        .zip(&found.streams)
        .map(|(stream, found)| match &found.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(joints, stream, most_lag_s),
        })
        .collect();
    let run = Cut { joints, streams, slides, lags: &lags, most_lag_s };
    let moments = run.moments(found);
    let parts = run.parts(&moments);
    let kept = (0..parts.len()).max_by_key(|&part| run.samples(parts[part]))?;
    let kept = (parts.len() > 1).then(|| Kept::of(&run, parts[kept]))?;
    let others = parts.iter().filter(|part| **part != kept.span);
    let others: Vec<Other> = others.filter_map(|part| kept.other(&run, *part)).collect();
    let undone = kept.undone(&run, &others)?;
    let tracks = undone.tracks.iter().zip(streams);
    let changed: Vec<PoseStream> = tracks
        .map(|(track, stream)| PoseStream {
            track: track.as_ref().unwrap_or(stream.track),
            ..*stream
        })
        .collect();
    let mut after = diagnose_arm(&undone.joints, &changed, most_lag_s);
    if left_m(&after) > LEFT * left_m(found) {
        return None;
    }
    for (s, after) in after.streams.iter_mut().enumerate() {
        if undone.tracks[s].is_some() {
            kept.read_as(s, &others, after);
        }
    }
    let moment = |at_s: f64| moments.iter().find(|jump| jump.at_s == at_s);
    kept.tell(&run, &parts, &others, moment, &mut after);
    after.joints.patches = undone.patches;
    let is_told =
        !after.joints.changes.is_empty() || after.streams.iter().any(PoseDiagnosis::changes);
    is_told.then_some(after)
}

/// All that is left of an arm's streams, an angle counting at 0.3 m; a metre where one was not read.
fn left_m(found: &ArmDiagnosis) -> f64 {
    let left = |found: &PoseDiagnosis| match (&found.residual, &found.reading) {
        (Ok(residual), Ok(_)) => residual.together_m(),
        _ => 1.0,
    };
    found.streams.iter().map(left).sum()
}

/// A run that may be cut. Times of cuts are those of the joint states.
struct Cut<'a> {
    joints: &'a JointTrack,
    streams: &'a [PoseStream<'a>],
    slides: &'a [bool],
    /// By how much each stream is late, s.
    lags: &'a [f64],
    most_lag_s: f64,
}

/// A part of a run: from the one time on and before the other, s.
type Span = (f64, f64);

impl Cut<'_> {
    /// When streams jump, by the clock of the joint states.
    fn moments(&self, found: &ArmDiagnosis) -> Vec<Jump> {
        let of_stream = |s: usize| {
            let aligned = &found.streams[s].aligned;
            let jumps = jumps(self.joints, &self.streams[s], aligned, self.lags[s]).into_iter();
            jumps.map(move |jump| Jump { at_s: jump.at_s - self.lags[s], ..jump })
        };
        strongest((0..self.streams.len()).flat_map(of_stream).collect())
    }

    /// The parts between `moments` that are long enough; a shorter one goes with the one before it.
    fn parts(&self, moments: &[Jump]) -> Vec<Span> {
        let mut parts = Vec::new();
        let mut from_s = f64::NEG_INFINITY;
        for to_s in moments.iter().map(|jump| jump.at_s).chain([f64::INFINITY]) {
            if self.samples((from_s, to_s)) >= PART_SAMPLES {
                parts.push((from_s, to_s));
                from_s = to_s;
            } else if let Some((_, end_s)) = parts.last_mut().filter(|_| to_s.is_infinite()) {
                *end_s = to_s;
            }
        }
        parts
    }

    /// The rows of a stream in a part.
    fn rows(&self, stream: usize, (from_s, to_s): Span) -> Range<usize> {
        let (t_s, lag_s) = (&self.streams[stream].track.t_s, self.lags[stream]);
        let [from, to] = [from_s, to_s].map(|at_s| t_s.partition_point(|t_s| *t_s < at_s + lag_s));
        from..to
    }

    /// The most samples that any stream has in a part.
    fn samples(&self, span: Span) -> usize {
        (0..self.streams.len()).map(|s| self.rows(s, span).len()).max().unwrap_or(0)
    }

    fn joints_in(&self, (from_s, to_s): Span) -> JointTrack {
        let JointTrack { t_s, dof, q, qd } = self.joints;
        let [from, to] = [from_s, to_s].map(|at_s| t_s.partition_point(|t_s| *t_s < at_s));
        JointTrack {
            t_s: t_s[from..to].to_vec(),
            dof: *dof,
            q: q[from * dof..to * dof].to_vec(),
            qd: qd[from * dof..to * dof].to_vec(),
        }
    }

    fn tracks_in(&self, span: Span) -> Vec<PoseTrack> {
        let track = |s: usize| {
            let track = self.streams[s].track;
            let rows: Vec<(usize, f64)> =
                self.rows(s, span).map(|row| (row, track.t_s[row])).collect();
            straightened(track, &rows)
        };
        (0..self.streams.len()).map(track).collect()
    }

    /// The streams with other tracks.
    fn with<'a>(&'a self, tracks: &'a [PoseTrack]) -> Vec<PoseStream<'a>> {
        let with =
            |(stream, track): (&PoseStream<'a>, &'a PoseTrack)| PoseStream { track, ..*stream };
        self.streams.iter().zip(tracks).map(with).collect()
    }

    /// What a part says by itself.
    fn diagnose(&self, span: Span) -> (JointTrack, ArmDiagnosis) {
        let (joints, tracks) = (self.joints_in(span), self.tracks_in(span));
        let found = diagnose_arm(&joints, &self.with(&tracks), self.most_lag_s);
        (joints, found)
    }
}

/// The part of the run against which the others are held.
struct Kept {
    span: Span,
    found: ArmDiagnosis,
}

/// Another part.
struct Other {
    span: Span,
    /// What it says by itself.
    alone: ArmDiagnosis,
    /// What it says with what the kept part says taken off: what is other in it.
    beyond: ArmDiagnosis,
}

impl Kept {
    fn of(run: &Cut, span: Span) -> Self {
        Self { span, found: run.diagnose(span).1 }
    }

    /// What another part says; `None` where it cannot be held against this one.
    fn other(&self, run: &Cut, span: Span) -> Option<Other> {
        let (joints, alone) = run.diagnose(span);
        let joints = self.found.joints.corrected_joints(&joints, run.slides);
        let tracks: Vec<PoseTrack> = (0..run.streams.len())
            .map(|s| {
                let read = as_read(&alone.streams[s]);
                let taken = &self.found.streams[s].taken;
                with_poses(&alone.streams[s], read.map(|pose| taken.off(&pose)))
            })
            .collect();
        let known: Vec<PoseStream> = run
            .with(&tracks)
            .into_iter()
            .map(|stream| PoseStream { reference_known: true, ..stream })
            .collect();
        let beyond = diagnose_arm(&joints, &known, run.most_lag_s);
        Some(Other { span, alone, beyond })
    }

    /// Whether stream `s` is read otherwise in another part.
    fn is_reread(&self, s: usize, other: &Other) -> bool {
        let (own, its) = (&self.found.streams[s], &other.alone.streams[s]);
        let told = own.reading.is_ok() && its.reading.as_ref().is_ok_and(|its| its.is_told);
        told && reading_of(own) != reading_of(its)
    }

    /// The run as it would be had nothing changed; `None` where nothing did.
    fn undone(&self, run: &Cut, others: &[Other]) -> Option<Undone> {
        let mut joints = run.joints.clone();
        let mut patches = Vec::new();
        for other in others {
            let (from_s, to_s) = other.span;
            let map = joint_map(&self.found.joints, &other.beyond.joints, run);
            let own = map.into_iter().map(|(column, factor, offset)| JointPatch {
                column,
                from_s,
                to_s,
                factor,
                offset,
            });
            patches.extend(own);
        }
        patches.iter().for_each(|patch: &JointPatch| patch.apply(&mut joints));
        let tracks: Vec<Option<PoseTrack>> = (0..run.streams.len())
            .map(|s| {
                let moves = |other: &&Other| {
                    let beyond = &other.beyond.streams[s];
                    self.is_reread(s, other)
                        || is_chosen(&beyond.reference)
                        || is_chosen(&beyond.tool)
                };
                others.iter().any(|other| moves(&other)).then(|| self.track(s, others))
            })
            .collect();
        let is_changed = !patches.is_empty() || tracks.iter().any(Option::is_some);
        is_changed.then_some(Undone { joints, patches, tracks })
    }

    /// The poses of a stream as they are read, with what is other in other parts taken off.
    fn track(&self, s: usize, others: &[Other]) -> PoseTrack {
        let own = &self.found.streams[s];
        let mut parts = vec![(self.span, with_poses(own, as_read(own)))];
        for other in others {
            let beyond = &other.beyond.streams[s];
            let poses = as_read(beyond).map(|pose| own.taken.back(&beyond.taken.off(&pose)));
            parts.push((other.span, with_poses(beyond, poses)));
        }
        parts.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let mut parts = parts.into_iter().map(|(_, track)| track);
        let first = parts.next().unwrap_or_else(|| with_poses(own, as_read(own)));
        parts.fold(first, |mut all, part| {
            all.t_s.extend(part.t_s);
            all.xyz.extend(part.xyz);
            if let (Orientations::Rotations(all), Orientations::Rotations(part)) =
                (&mut all.orientation, part.orientation)
            {
                all.extend(part);
            }
            all
        })
    }

    /// Says of the diagnosis of a stream whose poses were read anew how its numbers are coded: as in
    /// this part, or where that is as logged as in the part in which they are not.
    fn read_as(&self, s: usize, others: &[Other], after: &mut PoseDiagnosis) {
        let own = &self.found.streams[s];
        let misread = others.iter().find(|other| self.is_reread(s, other));
        let by = match misread.filter(|_| is_as_logged(own)) {
            Some(first) => {
                let reading = reading_of(&first.alone.streams[s]);
                let same = others.iter().filter(|other| {
                    other.span == first.span
                        || (self.is_reread(s, other)
                            && reading_of(&other.alone.streams[s]) == reading)
                });
                after.coded_s = same.map(|other| other.span).reduce(|a, b| (a.0, b.1));
                &first.alone.streams[s]
            }
            None => {
                after.coded_s = misread.map(|_| self.span);
                own
            }
        };
        after.reading.clone_from(&by.reading);
        after.length.clone_from(&by.length);
        after.axes.clone_from(&by.axes);
        after.degrees = by.degrees;
        after.inverted = by.inverted;
        after.constant.clone_from(&by.constant);
    }

    /// Writes what changed and when into the diagnosis of the run without it.
    fn tell<'a>(
        &self,
        run: &Cut,
        parts: &[Span],
        others: &[Other],
        moment: impl Fn(f64) -> Option<&'a Jump>,
        after: &mut ArmDiagnosis,
    ) {
        let beyond = |span: &Span| others.iter().find(|other| other.span == *span);
        for pair in parts.windows(2) {
            let (before, next) = (beyond(&pair[0]), beyond(&pair[1]));
            let Some(jump) = moment(pair[1].0) else { continue };
            for (s, after) in after.streams.iter_mut().enumerate() {
                let own = &self.found.streams[s];
                let frames = |of: fn(&PoseDiagnosis) -> &Seen<FrameEstimate>| {
                    let of_part = |part: Option<&Other>| {
                        let found = part.and_then(|part| of(&part.beyond.streams[s]).as_ref().ok());
                        found.filter(|frame| frame.chosen).cloned()
                    };
                    (of_part(before), of_part(next), of(own).as_ref().ok())
                };
                let at = (jump.at_s + run.lags[s], jump.within_s);
                let known = run.streams[s].reference_known;
                let base = |own: Option<&FrameEstimate>, is_free: bool| {
                    own.filter(|own| own.chosen || is_free).cloned()
                };
                let (from, to, kept) = frames(|found| &found.tool);
                after.tool_changes.extend(frame_change(
                    at,
                    base(kept, false),
                    from,
                    to,
                    |kept, beyond| beyond * kept,
                ));
                let (from, to, kept) = frames(|found| &found.reference);
                after.reference_changes.extend(frame_change(
                    at,
                    base(kept, !known),
                    from,
                    to,
                    |kept, beyond| beyond * kept,
                ));
            }
            let at = (jump.at_s, jump.within_s);
            for column in 0..run.joints.dof {
                let zero = |part: Option<&Other>| {
                    let offset = part?.beyond.joints.offsets.get(column)?;
                    offset.offset.as_ref().ok().filter(|_| offset.chosen).copied()
                };
                let factor = |part: Option<&Other>| {
                    let scales = &part?.beyond.joints.scales;
                    Some(scales.iter().find(|scale| scale.column == column)?.factor)
                };
                let own = &self.found.joints.offsets.get(column);
                let own = own.filter(|own| own.chosen).and_then(|own| own.offset.as_ref().ok());
                let zero = amount_change(at, own, zero(before), zero(next), 0.0);
                let scales = &self.found.joints.scales;
                let own = scales.iter().find(|scale| scale.column == column);
                let own = own.map_or(1.0, |scale| scale.factor.value);
                let scaled = |part| factor(part).map(|factor: Measured| factor.scaled(own));
                let factor = amount_change(at, None, scaled(before), scaled(next), own);
                if zero.is_some() || factor.is_some() {
                    after.joints.changes.push(JointChange { column, zero, factor });
                }
            }
        }
    }
}

/// A run as it would be had nothing changed.
struct Undone {
    joints: JointTrack,
    patches: Vec<JointPatch>,
    /// The streams whose poses changed.
    tracks: Vec<Option<PoseTrack>>,
}

impl JointPatch {
    /// Makes the positions of the joint in this part those of the rest.
    pub(super) fn apply(&self, joints: &mut JointTrack) {
        let Self { column, from_s, to_s, factor, offset } = *self;
        let dof = joints.dof.max(1);
        let [from, to] = [from_s, to_s].map(|at_s| joints.t_s.partition_point(|t_s| *t_s < at_s));
        for row in from..to {
            let at = row * dof + column;
            joints.q[at] = factor * joints.q[at] + offset;
            joints.qd[at] *= factor;
        }
    }
}

/// What takes the positions of each joint that is other in a part to those of the rest: its column,
/// factor and offset. None where names or units are wrong beside it.
fn joint_map(kept: &JointDiagnosis, beyond: &JointDiagnosis, run: &Cut) -> Vec<(usize, f64, f64)> {
    let is_plain = |found: &JointDiagnosis| {
        found.reading.as_ref().is_ok_and(|reading| reading.permutation.is_none())
    };
    if !is_plain(beyond) || !is_plain(kept) {
        return Vec::new();
    }
    let dof = run.joints.dof;
    // The positions 0 and 1 of every joint, as the kept part corrects them, and as this one does then.
    let probe = JointTrack {
        t_s: vec![0.0, 1.0],
        dof,
        q: [vec![0.0; dof], vec![1.0; dof]].concat(),
        qd: vec![0.0; 2 * dof],
    };
    let mut once = kept.clone();
    once.patches.clear();
    let by_kept = once.corrected_joints(&probe, run.slides);
    let by_both = beyond.corrected_joints(&by_kept, run.slides);
    let map = |column: usize| {
        let at = |row: usize| {
            let at = row * dof + column;
            (by_kept.q[at], by_both.q[at])
        };
        let ((zero, zero_both), (one, one_both)) = (at(0), at(1));
        let factor = one - zero;
        (column, (one_both - zero_both) / factor, (zero_both - zero) / factor)
    };
    let is_other = |&(_, factor, offset): &(usize, f64, f64)| {
        let is_one = (factor - 1.0).abs() < 1e-12 && offset.abs() < 1e-12;
        factor.is_finite() && offset.is_finite() && !is_one
    };
    (0..dof).map(map).filter(is_other).collect()
}

/// How the numbers of a stream are coded.
fn reading_of(found: &PoseDiagnosis) -> (Option<String>, bool, bool, String) {
    let reading = found.reading.as_ref().ok().and_then(|reading| match &reading.best {
        Reading::AsLogged => None,
        other => Some(format!("{other:?}")),
    });
    let length = found.length.as_ref().ok().copied().flatten().map(|slip| slip.factor());
    (reading, found.inverted, found.degrees.is_some(), format!("{length:?} {:?}", found.axes))
}

fn is_as_logged(found: &PoseDiagnosis) -> bool {
    let as_logged = found.reading.as_ref().is_ok_and(|reading| reading.best.is_as_logged());
    as_logged
        && !found.inverted
        && found.degrees.is_none()
        && !matches!(found.length, Ok(Some(_)))
        && !matches!(found.axes, Ok(Some(_)))
}

fn is_chosen(frame: &Seen<FrameEstimate>) -> bool {
    frame.as_ref().is_ok_and(|frame| frame.chosen)
}

/// The poses of a stream's samples as they are read, in its reference, with nothing taken off.
fn as_read(found: &PoseDiagnosis) -> impl Iterator<Item = Pose> {
    found.aligned.corrected.iter().map(|pose| found.taken.back(pose))
}

/// Other poses at the stamps of a stream's samples.
fn with_poses(found: &PoseDiagnosis, poses: impl Iterator<Item = Pose>) -> PoseTrack {
    let (xyz, rotations): (Vec<_>, Vec<_>) =
        poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let orientation = match &found.reading {
        Ok(_) => Orientations::Rotations(rotations),
        Err(_) => Orientations::Unset(rotations.len()),
    };
    PoseTrack { t_s: found.aligned.t_s.clone(), xyz, orientation, declared: None }
}

/// The change of a frame from the one part to the next: `kept` is the frame of the kept part, `from` and
/// `to` what the parts have beyond it, and `total` what the two are together.
fn frame_change(
    (at_s, within_s): (f64, f64),
    kept: Option<FrameEstimate>,
    from: Option<FrameEstimate>,
    to: Option<FrameEstimate>,
    total: impl Fn(Pose, Pose) -> Pose,
) -> Option<FrameChange> {
    let surest = to.as_ref().or(from.as_ref())?;
    let pose_of =
        |frame: &Option<FrameEstimate>| frame.as_ref().map_or_else(Pose::identity, |f| f.pose);
    let turn = pose_of(&from).inv_mul(&pose_of(&to));
    let errors = [&kept, &from, &to].into_iter().flatten();
    let (length, angle) = errors.fold((0.0_f64, 0.0_f64), |(length, angle), frame| {
        (length.hypot(frame.translation_m.std_error), angle.hypot(frame.rotation_rad.std_error))
    });
    let both = from.is_some() && to.is_some();
    let size = |value: f64, std_error: f64, dof: f64| Measured { value, std_error, dof };
    let (length_m, angle_rad) = (turn.translation.vector.norm(), turn.rotation.angle());
    let by = FrameEstimate {
        pose: turn,
        translation_m: size(length_m, length, surest.translation_m.dof),
        rotation_rad: size(angle_rad, angle, surest.rotation_rad.dof),
        p_value: surest.p_value,
        chosen: true,
    };
    // Two parts that are other in the same way do not differ.
    let is_same = both && length_m < 4.0 * length + 1e-4 && angle_rad < 4.0 * angle + 1e-4;
    let base = kept.map_or_else(Pose::identity, |kept| kept.pose);
    (!is_same).then(|| Change {
        at_s,
        within_s,
        from: total(base, pose_of(&from)),
        to: total(base, pose_of(&to)),
        by,
    })
}

/// The change of a number from the one part to the next, `none` where a part has none of its own.
fn amount_change(
    (at_s, within_s): (f64, f64),
    kept: Option<&Measured>,
    from: Option<Measured>,
    to: Option<Measured>,
    none: f64,
) -> Option<AmountChange> {
    let surest = to.or(from)?;
    let value = |one: Option<Measured>| one.map_or(none, |one| one.value);
    let std_error = [kept.copied(), from, to]
        .into_iter()
        .flatten()
        .fold(0.0_f64, |sum, one| sum.hypot(one.std_error));
    let by = Measured { value: value(to) - value(from), std_error, ..surest };
    let base = kept.map_or(0.0, |kept| kept.value);
    let is_same = from.is_some() && to.is_some() && by.value.abs() < 4.0 * by.std_error + 1e-5;
    (!is_same).then(|| Change {
        at_s,
        within_s,
        from: base + value(from),
        to: base + value(to),
        by,
    })
}
