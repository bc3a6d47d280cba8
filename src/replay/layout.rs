//! How the viewer opens a recording: the scene left, the plots right, the text below.

use re_sdk_types::blueprint::archetypes::{
    EyeControls3D, PlotLegend, TextLogColumns, TimePanelBlueprint,
};
use re_sdk_types::blueprint::components::{Corner2D, LoopMode, PanelState, PlayState};
use re_sdk_types::blueprint::datatypes::{TextLogColumn, TextLogColumnKind};
use re_sdk_types::blueprint::views::{
    Spatial3DView, TextDocumentView, TextLogView, TimeSeriesView,
};
use rerun::{RecordingStream, RecordingStreamResult};

use super::blueprint::{Blueprint, Part};
use super::plots::Quantity;
use super::{APPLICATION, Replay, ReplayArm, page, scene, tape};

/// From where an arm is looked at, in its base, as parts of its reach.
const EYE: [f64; 3] = [0.9, -1.1, 0.8];
/// What is looked at.
const TARGET: [f64; 3] = [0.0, 0.0, 0.3];

/// Sends the layout of a recording, which the viewer then plays over and over.
pub(super) fn send(replay: &Replay<'_>, recording: &RecordingStream) -> RecordingStreamResult<()> {
    let blueprint = Blueprint::new(APPLICATION)?;
    let text = text(&blueprint)?;
    let arms = replay.arms.iter().map(|arm| of_arm(arm, &blueprint));
    let root = match arms.collect::<RecordingStreamResult<Vec<_>>>()?.as_slice() {
        [] => text,
        [arm] => blueprint.column(&[*arm, text], &[7.0, 3.0])?,
        arms => blueprint.column(&[blueprint.tabs(arms)?, text], &[7.0, 3.0])?,
    };
    let time = TimePanelBlueprint::new()
        .with_state(PanelState::Collapsed)
        .with_timeline(tape::RUN)
        .with_play_state(PlayState::Playing)
        .with_loop_mode(LoopMode::All);
    blueprint.send(root, &time, recording)
}

fn of_arm(arm: &ReplayArm<'_>, blueprint: &Blueprint) -> RecordingStreamResult<Part> {
    let scene = blueprint.view::<Spatial3DView>(arm.name, &scene::root(arm.name))?;
    // Not left to the viewer: a fault may have put what was logged a kilometre away.
    let reach_m = arm.chain.max_reach_m();
    let eye = EyeControls3D::new()
        .with_position(EYE.map(|part| part * reach_m))
        .with_look_target(TARGET.map(|part| part * reach_m))
        .with_eye_up([0.0, 0.0, 1.0]);
    blueprint.set(scene, &eye)?;
    let mut plots = Vec::new();
    for (quantity, is_there) in [
        (Quantity::Position, !arm.streams.is_empty()),
        (Quantity::Rotation, !arm.streams.is_empty()),
        (Quantity::Yaw, !arm.imus.is_empty()),
    ] {
        if is_there {
            let plot =
                blueprint.view::<TimeSeriesView>(quantity.title(), &quantity.root(arm.name))?;
            blueprint.set(plot, &PlotLegend::new().with_corner(Corner2D::LeftTop))?;
            plots.push(plot);
        }
    }
    if plots.is_empty() {
        return Ok(scene);
    }
    let plots = blueprint.column(&plots, &vec![1.0; plots.len()])?;
    blueprint.row(&[scene, plots], &[3.0, 2.0])
}

/// The report beside the findings on the time line.
fn text(blueprint: &Blueprint) -> RecordingStreamResult<Part> {
    let report = blueprint.view::<TextDocumentView>("report", &page::report())?;
    let findings = blueprint.view::<TextLogView>("findings", &page::findings())?;
    let columns = [TextLogColumnKind::LogLevel, TextLogColumnKind::Body];
    let columns = columns.map(|kind| TextLogColumn { kind, visible: true.into() });
    blueprint.set(findings, &TextLogColumns::new().with_text_log_columns(columns))?;
    blueprint.row(&[report, findings], &[1.0, 1.0])
}
