use re_log_types::EntityPath;
use re_sdk_types::archetypes::{Arrows3D, Boxes3D, LineStrips3D, TransformAxes3D};
use re_sdk_types::components::{FillMode, LineStrip3D, Radius};

use super::row_times::RowTimes;
use super::scene::{
    ARM_RGB, RECORDED_RGB, drawn_rows, positions, radius, static_transform, transforms,
};
use super::timeline_writer::{TimelineWriter, entity_path};
use super::{MAX_ROWS, PoseState, ReplayArm, ReplayCause, ReplayStream, StreamKind};
use crate::geometry::{Pose, xyz_of};
use crate::stats::thin;

const ERROR_RGB: [u8; 3] = [250, 190, 60];

pub(super) fn draw_tip(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let kept = drawn_rows(&arm.corrected);
    let pose = |&row: &usize| arm.chain.forward(&positions(arm, &arm.corrected, row));
    let times = writer.joint_times(arm, &kept);
    let moved = PoseTrack { times, poses: kept.iter().map(pose).collect() };
    let label = format!("{} by FK", arm.chain.tip_name());
    let fill = FillMode::MajorWireframe;
    let tool = Tool { label: &label, is_named: false, rgb: ARM_RGB, fill };
    tool.draw(writer, &entity_path(&["arms", arm.name, "tip"]), &moved, size_m)
}

/// Draws a stream's tool with trail and error.
pub(super) fn draw(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let reference = entity_path(&["arms", arm.name, stream.topic]);
    writer.log_static(&reference, &static_transform(&stream.base_from_reference))?;
    for state in PoseState::drawn_states(stream) {
        let moved = PoseTrack::new(writer, arm, stream, state, state.poses(stream));
        let rgb = state.rgb(stream.kind);
        let fill = match (stream.kind, state) {
            (StreamKind::Tf, _) => FillMode::MajorWireframe,
            (StreamKind::Pose, PoseState::Logged) => FillMode::Solid,
            (StreamKind::Pose, PoseState::Corrected) => FillMode::TransparentFillMajorWireframe,
        };
        let is_named = stream.kind == StreamKind::Pose;
        let tool = Tool { label: &arm.label(stream, state), is_named, rgb, fill };
        tool.draw(writer, &reference.join(&entity_path(&[state.entity()])), &moved, size_m)?;
        if stream.kind == StreamKind::Pose {
            let path = reference.join(&entity_path(&[&format!("{}_trail", state.entity())]));
            draw_trail(writer, &path, &moved, rgb)?;
        }
    }
    if stream.kind == StreamKind::Tf {
        return Ok(());
    }
    let by_fk = PoseTrack::new(writer, arm, stream, PoseState::Logged, &stream.aligned.fk);
    draw_trail(writer, &reference.join(&entity_path(&["fk_trail"])), &by_fk, RECORDED_RGB)?;
    if !stream.reference_known {
        return Ok(());
    }
    let logged = PoseTrack::new(writer, arm, stream, PoseState::Logged, &stream.aligned.logged);
    draw_errors(
        writer,
        &reference.join(&entity_path(&["error"])),
        &by_fk,
        &logged,
        magnification(arm),
        size_m,
    )
}

struct PoseTrack {
    times: RowTimes,
    poses: Vec<Pose>,
}

impl PoseTrack {
    /// A logged pose is at its stamp and receive time; a corrected pose at its time of measurement.
    fn new(
        writer: &TimelineWriter,
        arm: &ReplayArm<'_>,
        stream: &ReplayStream<'_>,
        state: PoseState,
        poses: &[Pose],
    ) -> Self {
        let (late_s, received) = match state {
            PoseState::Corrected => (stream.latency_s, &arm.received),
            PoseState::Logged => (0.0, &stream.received),
        };
        let kept = thin::even_rows(poses.len(), MAX_ROWS);
        let stamps = kept.iter().map(|&row| writer.stamp(stream.aligned.t_s[row]).shifted(-late_s));
        Self {
            times: writer.row_times(arm, received, stamps),
            poses: kept.iter().map(|&row| poses[row]).collect(),
        }
    }
}

/// Box from the frame's origin along z, wider along x than along y, so that every rotation is visible.
struct Tool<'a> {
    label: &'a str,
    /// The label is always shown, not only on hover.
    is_named: bool,
    rgb: [u8; 3],
    fill: FillMode,
}

impl Tool<'_> {
    fn draw(
        &self,
        writer: &TimelineWriter,
        path: &EntityPath,
        moved: &PoseTrack,
        size_m: f64,
    ) -> Result<(), ReplayCause> {
        let half = [0.05, 0.02, 0.08].map(|part| part * size_m);
        let body = Boxes3D::from_centers_and_half_sizes([[0.0, 0.0, half[2]]], [half])
            .with_colors([self.rgb])
            .with_fill_mode(self.fill)
            .with_labels([self.label])
            .with_show_labels(self.is_named);
        writer.log_static(path, &body)?;
        writer.log_static(path, &TransformAxes3D::new((0.2 * size_m) as f32))?;
        let columns = transforms(&moved.poses).columns_of_unit_batches()?;
        writer.log_columns(path, &moved.times, columns)
    }
}

fn draw_trail(
    writer: &TimelineWriter,
    path: &EntityPath,
    moved: &PoseTrack,
    rgb: [u8; 3],
) -> Result<(), ReplayCause> {
    let strip = LineStrips3D::new([LineStrip3D::from_iter(moved.poses.iter().map(xyz_of))])
        .with_colors([rgb])
        .with_radii([Radius::new_ui_points(1.0)]);
    writer.log_static(path, &strip)
}

/// From FK to the logged position, magnified by `times`.
fn draw_errors(
    writer: &TimelineWriter,
    path: &EntityPath,
    by_fk: &PoseTrack,
    logged: &PoseTrack,
    times: f64,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let style = Arrows3D::update_fields()
        .with_colors([ERROR_RGB])
        .with_radii([radius(0.005 * size_m)])
        .with_labels([format!("error × {times}")])
        .with_show_labels(false);
    writer.log_static(path, &style)?;
    let pairs = by_fk.poses.iter().zip(&logged.poses);
    let vectors = pairs
        .map(|(fk, logged)| times * (logged.translation.vector - fk.translation.vector))
        .map(|vector| <[f64; 3]>::from(vector).map(|part| part as f32));
    let origins = by_fk.poses.iter().map(|pose| xyz_of(pose).map(|part| part as f32));
    let arrows = Arrows3D::update_fields().with_vectors(vectors).with_origins(origins);
    writer.log_columns(path, &logged.times, arrows.columns_of_unit_batches()?)
}

pub(super) fn magnification(arm: &ReplayArm<'_>) -> f64 {
    /// Length of an arrow, as a fraction of the arm's reach.
    const MAX_ARROW_RATIO: f64 = 0.25;
    /// Smallest magnified error, m.
    const MIN_MAGNIFIED_M: f64 = 1e-3;
    let measured =
        arm.streams.iter().filter(|it| it.kind == StreamKind::Pose && it.reference_known);
    let errors = measured.flat_map(|stream| stream.aligned.before().m);
    let longest_m = errors.fold(0.0, f64::max);
    // A healthy run has no visible errors.
    if longest_m < MIN_MAGNIFIED_M {
        return 1.0;
    }
    largest_factor(longest_m, MAX_ARROW_RATIO * arm.chain.max_reach_m())
}

/// Largest of 1, 10, 100 and 1000 that scales a length to at most `most_m`, else 1.
fn largest_factor(length_m: f64, most_m: f64) -> f64 {
    let fits = |times: &f64| times * length_m <= most_m;
    [1000.0, 100.0, 10.0].into_iter().find(fits).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::largest_factor;

    #[test]
    fn only_small_errors_are_magnified() {
        for (longest_m, times) in
            [(2.0, 1.0), (0.15, 1.0), (0.02, 10.0), (0.001, 100.0), (1e-5, 1000.0), (0.0, 1000.0)]
        {
            assert_eq!(largest_factor(longest_m, 0.2), times, "{longest_m}");
        }
    }
}
