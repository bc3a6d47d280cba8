//! Data series of plots for single findings.

use super::RunClock;
use crate::diagnosis::{CommandDiagnosis, PoseSeries, rates, vibration_path};
use crate::evidence::{ArmEvidence, HandEyeEvidence, ImuEvidence, RunEvidence, StreamEvidence};
use crate::finding::{Cause, Finding, Picture, Subject};
use crate::geometry::{
    Pose, Rotation, Vec3, angle_between, rotation_from_rotvec, rotvec_from_rotation,
};
use crate::report::figures::{FindingFigure, JointFigure};
use crate::run::{Arm, ImuSource, ReferenceContent, TargetSource};
use crate::stream::JointTrack;

/// Points per plane.
const MAX_POINTS: usize = 400;
/// Speed of a joint at rest, rad/s or m/s.
const MAX_REST_SPEED: f64 = 5e-3;

/// Plots, each with the index of its finding.
pub(super) fn finding_figures(
    clock: &RunClock,
    facts: &RunEvidence,
    findings: &[Finding],
) -> Vec<(usize, FindingFigure)> {
    let figure = |(index, finding): (usize, &Finding)| {
        let picture = match finding.cause {
            Cause::Pictured(picture) => picture,
            Cause::ImuMount(_) => Picture::ImuAxes,
            Cause::CameraMount { .. } => Picture::HandEye,
            _ => return None,
        };
        let found = FigureSource { clock, facts, subject: &finding.subject };
        Some((index, found.build(picture)?))
    };
    findings.iter().enumerate().filter_map(figure).collect()
}

struct FigureSource<'a> {
    clock: &'a RunClock<'a>,
    facts: &'a RunEvidence,
    subject: &'a Subject,
}

impl<'a> FigureSource<'a> {
    fn build(&self, picture: Picture) -> Option<FindingFigure> {
        match picture {
            Picture::Vibration => self.vibration(),
            Picture::HandEye => self.hand_eye(),
            Picture::Line => self.line(),
            Picture::RestError => self.rest_errors(),
            Picture::RotationNorm => self.rotation_norms(),
            Picture::ImuAxes => self.imu_axes(),
            Picture::Gyro => self.gyro(),
            Picture::Tilt => self.tilt(),
            Picture::Joint => self.joint().map(FindingFigure::Joint),
            Picture::Stream => None,
        }
    }

    fn arm(&self) -> Option<(&'a Arm, &'a ArmEvidence)> {
        let arms = self.clock.run.arms.iter().zip(&self.facts.robots);
        let is_its = |name: &str| self.subject.arm().is_none_or(|robot| robot == name);
        arms.into_iter().find(|(_, facts)| is_its(&facts.name))
    }

    fn topic(&self) -> &'a str {
        self.subject.topic.as_deref().unwrap_or_default()
    }

    fn vibration(&self) -> Option<FindingFigure> {
        let (arm, facts) = self.arm()?;
        let own = facts.vibrations.iter().find(|shake| shake.subject == *self.subject)?;
        let at_s = own.vibration.as_ref().ok()?.at_s;
        let mut streams = arm.poses.iter().zip(&facts.poses);
        let seen = match streams.find(|(_, of)| of.topic() == self.topic()) {
            Some((source, _)) => {
                let track = &source.track;
                vibration_path(&track.t_s, |row| track.xyz[row], at_s)
            }
            None => {
                let track = &arm.joints;
                let tip = |row: usize| {
                    arm.chain.forward(&track.positions_at(row, &arm.columns)).translation.vector
                };
                vibration_path(&track.t_s, tip, at_s)
            }
        }?;
        let trace = seen.trace.into_iter().map(|[t_s, m]| [self.clock.seconds_from_origin(t_s), m]);
        Some(FindingFigure::Vibration { spectrum: seen.spectrum, trace: trace.collect() })
    }

    fn hand_eye(&self) -> Option<FindingFigure> {
        let is_its = |of: &&HandEyeEvidence| of.topic == self.topic();
        let mut own = self.facts.hand_eyes.iter().filter(is_its);
        let found = own.clone().find(|of| of.subject() == *self.subject).or_else(|| own.next())?;
        let best = found.diagnosis.best();
        let each = best.map_or(&[][..], |best| best.closure.each.as_slice());
        let each = each.iter().map(|&(t_s, m, rad)| [self.clock.seconds_from_origin(t_s), m, rad]);
        let run = self.clock.run;
        let is_seen = |target: &&TargetSource| {
            let stream = &run.streams[target.stream];
            stream.topic == found.topic && stream.child_frame_id == found.target
        };
        let series = run.targets.iter().find(is_seen).map(|it| PoseSeries::from_track(&it.track));
        let poses = series.flatten().map_or_else(Vec::new, |series| series.poses);
        let step = poses.len().div_ceil(MAX_POINTS).max(1);
        let seen = poses.iter().step_by(step).map(|pose| pose.translation.vector.into());
        Some(FindingFigure::HandEye {
            closures: each.collect(),
            directions: view_directions(&poses),
            positions: seen.collect(),
        })
    }

    fn commands(&self) -> Option<(&'a ReferenceContent, &'a CommandDiagnosis)> {
        let (_, facts) = self.arm()?;
        let own = facts.references.iter().find(|of| of.topic() == self.topic())?;
        let run = self.clock.run;
        let is_its = |source: &&crate::run::ReferenceSource| {
            run.streams[source.stream].topic == self.topic()
        };
        let source = run.references.iter().find(is_its)?;
        Some((source.content.as_ref().ok()?, own.diagnosis.as_ref().ok()?.as_ref().ok()?))
    }

    fn line(&self) -> Option<FindingFigure> {
        /// Time appended for the tip at the end of a line, s.
        const LAG_AFTER_END_S: f64 = 0.5;
        let (arm, _) = self.arm()?;
        let (content, found) = self.commands()?;
        let size = |line: &crate::diagnosis::CommandedLine| {
            let witnesses = line.deviations.iter().flatten();
            let off_m = witnesses.map(|by| by.distance_m.norm.value).fold(0.0, f64::max);
            off_m.max(0.1 * line.command_rad)
        };
        let line = found.lines.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let by_kinematics = PoseSeries::from_joints(&arm.joints, &arm.chain, &arm.columns);
        let tip = chord_deviation(&by_kinematics, line.from_s, line.to_s + LAG_AFTER_END_S);
        let command = match content {
            ReferenceContent::Poses { track, .. } => PoseSeries::from_track(track),
            ReferenceContent::Joints { .. } => None,
        };
        let command = command.map(|series| chord_deviation(&series, line.from_s, line.to_s));
        Some(FindingFigure::Line { tip, command: command.unwrap_or_default() })
    }

    fn rest_errors(&self) -> Option<FindingFigure> {
        let (_, found) = self.commands()?;
        let gaps = found.rest_errors.iter().find(|gaps| !gaps.is_empty())?;
        let both = |pose: &Pose| -> [f64; 3] { pose.translation.vector.into() };
        Some(FindingFigure::RestErrors(
            gaps.iter().map(|gap| [both(&gap.commanded), both(&gap.measured)]).collect(),
        ))
    }

    fn rotation_norms(&self) -> Option<FindingFigure> {
        let mut own = self.facts.norms.iter().filter(|of| of.topic() == self.topic());
        let parts = own.next()?;
        let worst = parts.iter().max_by(|a, b| a.largest.total_cmp(&b.largest))?;
        let rows = self.clock.run.defect_series(worst).into_iter();
        Some(FindingFigure::RotationNorms(
            rows.map(|(at, off)| [self.clock.seconds_of_stamp(at), off]).collect(),
        ))
    }

    fn imu(&self) -> Option<(&'a Arm, &'a ImuSource, &'a StreamEvidence<ImuEvidence>)> {
        let (arm, facts) = self.arm()?;
        let mut imus = arm.imus.iter().zip(&facts.imus);
        imus.find(|(_, of)| of.topic() == self.topic()).map(|(source, of)| (arm, source, of))
    }

    fn imu_axes(&self) -> Option<FindingFigure> {
        let (_, _, of) = self.imu()?;
        let columns = |rotation: Rotation| {
            [0, 1, 2].map(|axis| <[f64; 3]>::from(rotation * Vec3::ith(axis, 1.0)))
        };
        Some(FindingFigure::ImuAxes {
            link: of.link.clone(),
            estimated: columns(of.diagnosis.link_from_imu?),
            logged: of.link_from_imu.map(columns),
        })
    }

    fn gyro(&self) -> Option<FindingFigure> {
        /// Minimum samples at rest.
        const MIN_REST_SAMPLES: usize = 20;
        let (arm, source, of) = self.imu()?;
        let track = &source.track;
        let rate = |row: usize| {
            let [x, y, z] = <[f64; 3]>::from(track.gyro[row]);
            [self.clock.seconds_from_origin(track.t_s[row]), x, y, z]
        };
        let rows = 0..track.t_s.len().min(track.gyro.len());
        let resting = are_at_rest(&arm.joints, &track.t_s);
        let rests: Vec<[f64; 4]> = rows.clone().filter(|&row| resting[row]).map(rate).collect();
        let at_rest = rests.len() >= MIN_REST_SAMPLES;
        let rates = if at_rest { rests } else { rows.map(rate).collect() };
        let bias = of.diagnosis.gyro_bias.as_ref().ok().map(|bias| bias.vector_rad_s.into());
        Some(FindingFigure::Gyro { rates, is_at_rest: at_rest, bias })
    }

    fn tilt(&self) -> Option<FindingFigure> {
        let (arm, source, _) = self.imu()?;
        let track = &source.track;
        let resting = are_at_rest(&arm.joints, &track.t_s);
        let rows = 0..track.t_s.len().min(track.accel.len()).min(track.orientation.len());
        let rows: Vec<usize> = rows.filter(|&row| resting[row]).collect();
        let up = |&row: &usize| {
            let up = (track.orientation[row] * track.accel[row]).try_normalize(1e-9)?;
            Some([up.x.asin(), up.y.asin()])
        };
        let step = rows.len().div_ceil(MAX_POINTS).max(1);
        Some(FindingFigure::Tilt(rows.iter().step_by(step).filter_map(up).collect()))
    }

    /// Joint of the subject, or the arm's first joint.
    fn joint(&self) -> Option<JointFigure> {
        /// Differentiation window, s.
        const WINDOW_S: f64 = 0.05;
        let (arm, facts) = self.arm()?;
        let named = |name: &str| self.subject.joint.as_deref() == Some(name);
        let at = facts.joints.iter().position(|joint| named(&joint.name)).unwrap_or(0);
        let (joint, &column) = (facts.joints.get(at)?, arm.columns.get(at)?);
        let samples = self.clock.run.joint_samples(&arm.joint_sources);
        let own = samples.get(column)?;
        let has_velocity = own.velocity.iter().any(|velocity| velocity.is_finite());
        Some(JointFigure {
            joint: joint.name.clone(),
            is_prismatic: joint.is_prismatic,
            t_s: own.t_s.iter().map(|&t_s| self.clock.seconds_from_origin(t_s)).collect(),
            position: own.position.to_vec(),
            velocity: if has_velocity { own.velocity.to_vec() } else { Vec::new() },
            differentiated: rates(&own.t_s, &own.position, WINDOW_S),
            limits: [joint.limits.lower, joint.limits.upper],
            max_speed: joint.limits.velocity,
        })
    }
}

fn are_at_rest(joints: &JointTrack, t_s: &[f64]) -> Vec<bool> {
    let mut sequence = joints.sequence();
    let rests = |&t_s: &f64| {
        sequence.at(t_s).is_some_and(|(_, qd)| qd.iter().all(|speed| speed.abs() < MAX_REST_SPEED))
    };
    t_s.iter().map(rests).collect()
}

/// As angles about two axes normal to the mean direction, rad.
fn view_directions(camera_from_target: &[Pose]) -> Vec<[f64; 2]> {
    let step = camera_from_target.len().div_ceil(MAX_POINTS).max(1);
    let seen = camera_from_target.iter().step_by(step);
    let seen: Vec<Vec3> =
        seen.filter_map(|pose| pose.inverse().translation.vector.try_normalize(1e-9)).collect();
    let Some(mean) = seen.iter().sum::<Vec3>().try_normalize(1e-9) else { return Vec::new() };
    let first = Vec3::ith(mean.iamin(), 1.0).cross(&mean).normalize();
    let second = mean.cross(&first);
    let place = |view: &Vec3| {
        let across = view - mean * view.dot(&mean);
        let angle = view.dot(&mean).clamp(-1.0, 1.0).acos();
        let unit = across.try_normalize(1e-12).unwrap_or_default();
        [angle * unit.dot(&first), angle * unit.dot(&second)]
    };
    seen.iter().map(place).collect()
}

/// Deviation of the poses between two times from the line and slerp between their ends: position along the
/// line in m, deviations in m and rad.
fn chord_deviation(series: &PoseSeries, from_s: f64, to_s: f64) -> Vec<[f64; 3]> {
    let first = series.t_s.partition_point(|t_s| *t_s < from_s);
    let last = series.t_s.partition_point(|t_s| *t_s <= to_s);
    let poses = series.poses.get(first..last).unwrap_or_default();
    let (Some(from), Some(to)) = (poses.first(), poses.last()) else { return Vec::new() };
    let chord = to.translation.vector - from.translation.vector;
    let length = chord.norm().max(f64::MIN_POSITIVE);
    let turn = rotvec_from_rotation(&(from.rotation.inverse() * to.rotation));
    let place = |pose: &Pose| {
        let since = pose.translation.vector - from.translation.vector;
        let along = since.dot(&chord) / length;
        let part = (along / length).clamp(0.0, 1.0);
        let even = from.rotation * rotation_from_rotvec(turn * part);
        let off = (since - chord * (along / length)).norm();
        [along, off, angle_between(&pose.rotation, &even)]
    };
    let mut rows: Vec<[f64; 3]> = poses.iter().map(place).collect();
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose;

    #[test]
    fn a_bow_deviates_from_its_chord_and_a_line_does_not() {
        let way = |bow_m: f64| PoseSeries {
            t_s: (0..=10).map(f64::from).collect(),
            poses: (0..=10)
                .map(|at| {
                    let part = f64::from(at) / 10.0;
                    let off = bow_m * 4.0 * part * (1.0 - part);
                    let turned = rotation_from_rotvec(Vec3::new(0.0, 0.0, part));
                    pose(Vec3::new(0.5 * part, off, 0.2).into(), turned)
                })
                .collect(),
        };
        let most =
            |rows: &[[f64; 3]], part: usize| rows.iter().map(|row| row[part]).fold(0.0, f64::max);
        let bowed = chord_deviation(&way(0.01), 0.0, 10.0);
        assert!((most(&bowed, 1) - 0.01).abs() < 1e-9 && most(&bowed, 2) < 1e-7, "{bowed:?}");
        assert!((most(&bowed, 0) - 0.5).abs() < 1e-12 && bowed.len() == 11);
        assert!(most(&chord_deviation(&way(0.0), 0.0, 10.0), 1) < 1e-12);
        assert!(chord_deviation(&way(0.0), 20.0, 30.0).is_empty());
    }

    #[test]
    fn view_directions_are_angles_about_their_mean() {
        let from = |angle: f64| {
            let target_from_camera =
                pose(Vec3::new(angle.sin(), 0.0, angle.cos()).into(), Rotation::identity());
            target_from_camera.inverse()
        };
        let seen = view_directions(&[from(-0.3), from(0.3)]);
        let apart = ((seen[0][0] - seen[1][0]).powi(2) + (seen[0][1] - seen[1][1]).powi(2)).sqrt();
        assert!((apart - 0.6).abs() < 1e-9, "{seen:?}");
    }
}
