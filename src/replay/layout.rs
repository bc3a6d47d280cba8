//! How the viewer lays the recording out: the arm beside the plots, the words below.

use re_sdk_types::blueprint::components::{LoopMode, PanelState, PlayState};
use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView, Tabs,
    TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};

use super::plots::Plot;
use super::recorder::SINCE_ORIGIN;
use super::{Replay, ReplayArm, words};

/// The layout; several arms are tabs. The viewer plays the run over and over.
pub fn blueprint(replay: &Replay) -> Blueprint {
    let arms: Vec<ContainerLike> = replay.arms.iter().map(arm).collect();
    let text: [ContainerLike; 2] = [
        TextDocumentView::new("report").with_origin(words::REPORT).into(),
        TextLogView::new("findings on the time line").with_origin(words::FINDINGS).into(),
    ];
    let text = Horizontal::new(text).with_column_shares([3.0, 2.0]);
    let root = match arms.is_empty() {
        true => text.into(),
        false => ContainerLike::from(
            Vertical::new([Tabs::new(arms).into(), text.into()]).with_row_shares([5.0, 2.0]),
        ),
    };
    Blueprint::new(root)
        .with_auto_views(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(
            TimePanel::new()
                .with_state(PanelState::Collapsed)
                .with_timeline(SINCE_ORIGIN)
                .with_play_state(PlayState::Playing)
                .with_loop_mode(LoopMode::All),
        )
}

/// The scene of one arm beside its plots.
fn arm(arm: &ReplayArm) -> ContainerLike {
    let scene = Spatial3DView::new(arm.name)
        .with_origin(arm.entity())
        .with_contents(["$origin/**", "- $origin/plots/**"]);
    let plots = Plot::ALL.into_iter().filter(|plot| plot.has_data(arm)).map(|plot| {
        let view = TimeSeriesView::new(plot.title()).with_origin(plot.entity(arm));
        ContainerLike::from(view)
    });
    let plots: Vec<ContainerLike> = plots.collect();
    if plots.is_empty() {
        return scene.into();
    }
    Horizontal::new([scene.into(), Vertical::new(plots).into()])
        .with_name(arm.name)
        .with_column_shares([3.0, 2.0])
        .into()
}
