//! Computes the data series of a report's plots.

mod finding_figures;

use rayon::prelude::*;

use super::figures::{
    EncodingScore, Figures, FrameEdge, FrameEdgeKind, ImuFigure, LatencyProfilePoint, PoseFigure,
    StreamGap, TimelineRow,
};
use crate::checks::encoding_names;
use crate::diagnosis::{
    EncodingEstimate, EstimateResult, LatencyProfile, Measured, PoseDistances, PoseEncoding,
    angular_speed_correlation, residual_by_latency,
};
use crate::evidence::{
    ArmEvidence, ImuEvidence, PoseEvidence, RunEvidence, StreamEvidence, frame_of_several,
};
use crate::finding::Finding;
use crate::geometry::Pose;
use crate::run::{Arm, Edge, EdgeKind, ImuSource, PoseSource, Rhythm, Run, Stream};
use crate::stream::{JointTrack, Orientations};
use crate::time::Stamp;

/// Maximum gaps per stream.
const MAX_GAPS: usize = 60;

/// Pose streams per arm that are plotted without a finding.
const MAX_STREAMS_WITHOUT_FINDING: usize = 16;

/// Which plots to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plots {
    All,
    /// Without the residual by latency, which takes as long as many steps of the audit.
    OverTime,
}

/// `corrected` returns an arm's corrected joint states.
pub(crate) fn build_figures(
    run: &Run,
    facts: &RunEvidence,
    corrected: impl Fn(&Arm, &ArmEvidence) -> JointTrack,
    findings: &[Finding],
    plots: Plots,
) -> Figures {
    let has_finding = |topic: &str| {
        let mut findings = findings.iter();
        findings.any(|found| found.subject.topic.as_deref() == Some(topic))
    };
    let clock = RunClock { run, start: run.span.map_or(run.origin, |(start, _)| start) };
    let mut figures = Figures {
        duration_s: run.span.map_or(0.0, |(start, end)| end.seconds_since(start)),
        timeline: timeline_rows(&clock),
        frames: frame_edges(run),
        of_findings: finding_figures::finding_figures(&clock, facts, findings),
        start: Some(clock.start),
        ..Figures::default()
    };
    for (arm, facts) in run.arms.iter().zip(&facts.robots) {
        let corrected = corrected(arm, facts);
        let streams: Vec<_> = arm.poses.iter().zip(&facts.poses).enumerate().collect();
        let drawn = streams.into_par_iter().filter_map(|(index, (source, stream))| {
            let is_drawn = index < MAX_STREAMS_WITHOUT_FINDING || has_finding(stream.topic());
            is_drawn.then(|| pose_figure(&clock, &corrected, source, (facts, stream), plots))
        });
        figures.poses.par_extend(drawn);
        for (source, stream) in arm.tf.iter().zip(&facts.tf) {
            // The publisher of the log's transforms uses uncorrected joint states.
            let joints = arm.recorded_joints.as_ref().unwrap_or(&arm.joints);
            let drawn = pose_figure(&clock, joints, source, (facts, stream), plots);
            figures.poses.push(PoseFigure { is_derived: true, ..drawn });
        }
        figures.imus.extend(imu_figures(&clock, &corrected, arm, facts));
    }
    figures
}

/// Seconds from the start of the run.
struct RunClock<'a> {
    run: &'a Run,
    start: Stamp,
}

impl RunClock<'_> {
    fn seconds_of_stamp(&self, stamp: Stamp) -> f64 {
        stamp.seconds_since(self.start)
    }

    /// Converts a time from the run's origin.
    fn seconds_from_origin(&self, t_s: f64) -> f64 {
        t_s + self.run.origin.seconds_since(self.start)
    }

    fn latency_profile(
        &self,
        profile: &EstimateResult<LatencyProfile>,
    ) -> Vec<LatencyProfilePoint> {
        let windows = profile.as_ref().map_or(&[][..], |profile| &profile.windows);
        let point = |&(t_s, latency): &(f64, Measured)| LatencyProfilePoint {
            t_s: self.seconds_from_origin(t_s),
            deviation_s: latency.value,
            half_width_s: latency.half_width(0.95),
        };
        windows.iter().map(point).collect()
    }
}

fn pose_figure(
    clock: &RunClock,
    joints: &JointTrack,
    source: &PoseSource,
    (arm, facts): (&ArmEvidence, &StreamEvidence<PoseEvidence>),
    plots: Plots,
) -> PoseFigure {
    let found = &facts.diagnosis;
    let aligned = &found.aligned;
    let mut before =
        if facts.reference_known { aligned.before() } else { PoseDistances::default() };
    // Nobody declared that bare numbers are metres.
    if let (true, false, Ok(Some(unit))) =
        (facts.is_undeclared, before.m.is_empty(), &found.length_unit)
    {
        let pairs = aligned.logged.iter().zip(&aligned.fk);
        let distance_m = |(logged, fk): (&Pose, &Pose)| {
            (unit.factor() * logged.translation.vector - fk.translation.vector).norm()
        };
        before.m = pairs.map(distance_m).collect();
    }
    let mut after = aligned.after();
    let stream = clock.run.pose_stream(source);
    if let Orientations::Unset(_) = stream.track.orientation {
        before.rad.clear();
        after.rad.clear();
    }
    let valley = match plots {
        Plots::All => residual_by_latency(joints, &stream, found),
        Plots::OverTime => Vec::new(),
    };
    PoseFigure {
        robot: arm.name.clone(),
        topic: facts.topic().to_owned(),
        is_derived: false,
        t_s: aligned.t_s.iter().map(|&t_s| clock.seconds_from_origin(t_s)).collect(),
        before_m: before.m,
        before_rad: before.rad,
        after_m: after.m,
        after_rad: after.rad,
        reach_m: aligned.reach_m(),
        at_m: aligned.fk.iter().map(|fk| fk.translation.vector.into()).collect(),
        residual_by_latency: valley
            .into_iter()
            .map(|at| [at.latency_s, at.rms_m, at.rms_rad])
            .collect(),
        latency_profile: clock.latency_profile(&found.latency_profile),
        encodings: encoding_scores(&found.encoding),
    }
}

fn encoding_scores(encoding: &EstimateResult<EncodingEstimate>) -> Vec<EncodingScore> {
    let Ok(encoding) = encoding else { return Vec::new() };
    let best = encoding_names(&encoding.best);
    let score = |(one, rms_rad): &(PoseEncoding, f64)| {
        let names = encoding_names(one);
        let is_best = names == best;
        EncodingScore {
            is_as_logged: matches!(one, PoseEncoding::AsLogged),
            is_best,
            actual: names.is,
            assumed: names.read_as,
            // The fit refined the best one.
            rms_rad: if is_best { encoding.best_rad } else { *rms_rad },
        }
    };
    encoding.ranked.iter().map(score).collect()
}

fn imu_figures(
    clock: &RunClock,
    joints: &JointTrack,
    arm: &Arm,
    facts: &ArmEvidence,
) -> Vec<ImuFigure> {
    /// Margin beyond twice the latency, s.
    const LATENCY_MARGIN_S: f64 = 0.08;
    let figure = |(source, imu): (&ImuSource, &StreamEvidence<ImuEvidence>)| {
        let found = &imu.diagnosis;
        let most_s =
            found.latency_s.as_ref().map(|latency| 2.0 * latency.value.abs() + LATENCY_MARGIN_S);
        let curve =
            most_s.map(|most_s| angular_speed_correlation(joints, &source.as_stream(), most_s));
        let (yaw_error, headings) = (found.yaw_error.iter(), found.headings.iter());
        ImuFigure {
            robot: facts.name.clone(),
            topic: imu.topic().to_owned(),
            yaw_error: yaw_error.map(|&(t_s, rad)| [clock.seconds_from_origin(t_s), rad]).collect(),
            headings: headings
                .map(|at| [clock.seconds_from_origin(at.t_s), at.imu_rad, at.fk_rad])
                .collect(),
            correlation_by_latency: curve
                .unwrap_or_default()
                .into_iter()
                .map(|peak| [peak.lag_s, peak.correlation])
                .collect(),
            latency_profile: clock.latency_profile(&found.latency_profile),
            encodings: encoding_scores(&found.encoding),
        }
    };
    arm.imus.iter().zip(&facts.imus).map(figure).collect()
}

fn timeline_rows(clock: &RunClock) -> Vec<TimelineRow> {
    let run = clock.run;
    let row = |(index, stream): (usize, &Stream)| {
        let rhythm = run.rhythms.iter().find(|rhythm| rhythm.stream == index);
        let (gaps, omitted) = stream_gaps(clock, rhythm);
        Some(TimelineRow {
            topic: stream.topic.clone(),
            frame: frame_of_several(stream),
            span_s: [clock.seconds_of_stamp(stream.start?), clock.seconds_of_stamp(stream.end?)],
            rate_hz: stream.rate_hz,
            count: stream.count,
            dropped: stream.dropped,
            gaps,
            omitted_gaps: omitted,
        })
    };
    run.streams.iter().enumerate().filter_map(row).collect()
}

/// The longest in time order, and the number of others.
fn stream_gaps(clock: &RunClock, rhythm: Option<&Rhythm>) -> (Vec<StreamGap>, usize) {
    let parts = rhythm.into_iter().flat_map(|rhythm| &rhythm.parts).filter(|part| part.is_audited);
    let holes = parts.flat_map(|part| &part.missing_rows);
    let mut gaps: Vec<StreamGap> = holes
        .map(|hole| StreamGap {
            span_s: [hole.span.start, hole.span.end].map(|stamp| clock.seconds_of_stamp(stamp)),
            missing: hole.count,
        })
        .collect();
    let length_s = |gap: &StreamGap| gap.span_s[1] - gap.span_s[0];
    gaps.sort_by(|a, b| length_s(b).total_cmp(&length_s(a)));
    let omitted = gaps.len().saturating_sub(MAX_GAPS);
    gaps.truncate(MAX_GAPS);
    gaps.sort_by(|a, b| a.span_s[0].total_cmp(&b.span_s[0]));
    (gaps, omitted)
}

fn frame_edges(run: &Run) -> Vec<FrameEdge> {
    let edge = |edge: &Edge| {
        let (parent, child) = run.tf.names(edge);
        FrameEdge {
            parent: parent.to_owned(),
            child: child.to_owned(),
            kind: match edge.kind {
                EdgeKind::Dynamic => FrameEdgeKind::Moving,
                EdgeKind::Static => FrameEdgeKind::Static,
                EdgeKind::Model => FrameEdgeKind::Model,
            },
        }
    };
    run.tf.edges().iter().map(edge).collect()
}
