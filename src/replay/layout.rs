//! How the viewer opens a recording: the scene left, the plots right, the text below.

use re_sdk_types::blueprint::components::PanelState;
use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView, Tabs,
    TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};

use super::plots::Quantity;
use super::{Replay, ReplayArm, page, scene, tape};

/// The blueprint of a recording.
pub(super) fn blueprint(replay: &Replay<'_>) -> Blueprint {
    let text = Horizontal::new([
        TextDocumentView::new("report").with_origin(page::report()).into(),
        TextLogView::new("findings").with_origin(page::findings()).into(),
    ]);
    let root: ContainerLike = match replay.arms.as_slice() {
        [] => text.into(),
        [arm] => Vertical::new([of_arm(arm), text.into()]).with_row_shares([7.0, 3.0]).into(),
        arms => Vertical::new([Tabs::new(arms.iter().map(of_arm)).into(), text.into()])
            .with_row_shares([7.0, 3.0])
            .into(),
    };
    Blueprint::new(root)
        .with_auto_views(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(
            TimePanel::new().with_state(PanelState::Collapsed).with_timeline(tape::RUN),
        )
}

fn of_arm(arm: &ReplayArm<'_>) -> ContainerLike {
    let scene = Spatial3DView::new(arm.name).with_origin(scene::root(arm.name));
    let plots: Vec<ContainerLike> = [
        (Quantity::Position, !arm.streams.is_empty()),
        (Quantity::Rotation, !arm.streams.is_empty()),
        (Quantity::Yaw, !arm.imus.is_empty()),
    ]
    .into_iter()
    .filter(|&(_, is_there)| is_there)
    .map(|(quantity, _)| {
        TimeSeriesView::new(quantity.title()).with_origin(quantity.root(arm.name)).into()
    })
    .collect();
    if plots.is_empty() {
        return scene.into();
    }
    Horizontal::new([scene.into(), Vertical::new(plots).into()])
        .with_name(arm.name)
        .with_column_shares([3.0, 2.0])
        .into()
}
