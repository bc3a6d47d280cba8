//! Initial layout: the scene on the left, the worst finding on the right, time spans of all findings below.

use re_log_types::EntityPath;
use re_sdk_types::blueprint::archetypes::{
    Background, EyeControls3D, LineGrid3D, PlotLegend, TextLogColumns, TimePanelBlueprint,
};
use re_sdk_types::blueprint::components::{
    AbsoluteTimeRange, BackgroundKind, Corner2D, LoopMode, PanelState, PlayState,
};
use re_sdk_types::blueprint::datatypes::{TextLogColumn, TextLogColumnKind};
use re_sdk_types::blueprint::views::{
    BarChartView, Spatial3DView, StateTimelineView, TextDocumentView, TextLogView, TimeSeriesView,
};
use re_sdk_types::components::Color;
use re_sdk_types::datatypes;

use super::blueprint::{Blueprint, LayoutPart};
use super::chunk_writer::ChunkWriter;
use super::finding_views::{self, ViewKind};
use super::plots::{self, PlotQuantity};
use super::{
    Recording, Replay, ReplayArm, ReplayCause, ReplayImu, findings, page, scene, timeline_writer,
    tools,
};
use crate::finding::Finding;
use crate::geometry::Vec3;
use crate::time::Stamp;

/// Tabs for findings.
const MAX_TABS: usize = 8;
const GROUND_RGB: [u8; 3] = [20, 23, 28];
const GRID_RGBA: [u8; 4] = [90, 100, 115, 90];

/// The viewer plays in a loop. Scenes of a layer also contain the log.
pub(super) fn draw(
    replay: &Replay<'_>,
    chunks: &ChunkWriter,
    wanted: &Recording,
) -> Result<(), ReplayCause> {
    let blueprint = Blueprint::new(chunks);
    let is_layer = wanted.base.is_some();
    let arms = replay.arms.iter().map(|arm| scene_view(arm, is_layer, &blueprint));
    let arms = arms.collect::<Result<Vec<_>, ReplayCause>>()?;
    let proof = verdict_views(replay, &blueprint)?;
    let above = match arms.as_slice() {
        [] => proof,
        [arm] => blueprint.row(&[*arm, proof], &[5.0, 4.0])?,
        arms => {
            // Arm of the worst finding.
            let first = replay.report.findings.first().and_then(|it| replay.arm_of(it));
            let is_first = |arm: &ReplayArm<'_>| Some(arm.name) == first.map(|arm| arm.name);
            let first = replay.arms.iter().position(is_first).unwrap_or(0);
            blueprint.row(&[blueprint.tabs(arms, first)?, proof], &[5.0, 4.0])?
        }
    };
    let root = match replay.report.findings.len() {
        0 => above,
        // Height per lane.
        lanes => blueprint.column(
            &[above, timeline_panel(&blueprint)?],
            &[10.0, (1.2 + 0.55 * lanes as f32).min(5.0)],
        )?,
    };
    blueprint.finish(root, &time_panel(replay, wanted.timeline))
}

/// Plays the run, or the shorter time span of the worst finding, on a timeline of stamps if one is named.
fn time_panel(replay: &Replay<'_>, stamps: Option<&str>) -> TimePanelBlueprint {
    /// Longer spans, as a fraction of the run, are replaced by the run.
    const MAX_SPAN_RATIO: f64 = 0.8;
    /// Margin before and after the span, s.
    const SPAN_MARGIN_S: f64 = 0.5;
    let panel = TimePanelBlueprint::new()
        .with_state(PanelState::Collapsed)
        .with_timeline(stamps.unwrap_or(timeline_writer::RUN_TIMELINE))
        .with_play_state(PlayState::Playing);
    let (first, last) = replay.span;
    let worst = replay.report.findings.first().map(|finding| replay.span_of(finding));
    let part = worst.map(|(start, end)| {
        (start.shifted(-SPAN_MARGIN_S).max(first), end.shifted(SPAN_MARGIN_S).min(last))
    });
    let is_part = |&(start, end): &(Stamp, Stamp)| {
        start < end && end.seconds_since(start) < MAX_SPAN_RATIO * last.seconds_since(first)
    };
    match part.filter(is_part) {
        Some((start, end)) => {
            let origin = if stamps.is_some() { 0 } else { replay.origin.nanos() };
            let nanos = |stamp: Stamp| stamp.nanos().saturating_sub(origin);
            let range = datatypes::AbsoluteTimeRange {
                min: datatypes::TimeInt(nanos(start)),
                max: datatypes::TimeInt(nanos(end)),
            };
            let selection = AbsoluteTimeRange(range);
            panel.with_time_selection(selection).with_loop_mode(LoopMode::Selection)
        }
        None => panel.with_loop_mode(LoopMode::All),
    }
}

/// The arm, and in a layer all entities of the log that are connected to its base.
fn scene_view(
    arm: &ReplayArm<'_>,
    is_layer: bool,
    blueprint: &Blueprint<'_>,
) -> Result<LayoutPart, ReplayCause> {
    /// Viewing direction.
    const VIEW_DIRECTION: Vec3 = Vec3::new(0.72, -0.88, 0.5);
    /// Viewing distance as a multiple of the scene's radius.
    const VIEW_DISTANCE_RATIO: f64 = 1.8;
    let factor = tools::magnification(arm);
    let name = match factor {
        1.0 => arm.name.to_owned(),
        factor => format!("{}, errors × {factor}", arm.name),
    };
    /// The audit has other views for these entities.
    const LAYER_RULES: [&str; 8] = [
        "+ /**", "- /arms/**", "- /errors/**", "- /joints/**", "- /proof/**", "- /findings/**",
        "- /spans/**", "- /report/**",
    ];
    let mut rules = vec!["$origin/**"];
    rules.extend(LAYER_RULES.iter().filter(|_| is_layer));
    let root = scene::arm_root(arm.name);
    let view = blueprint.view_of::<Spatial3DView>(&name, &root, rules)?;
    // A fault may place logged poses a kilometre away.
    let (middle, radius_m) = scene::bounding_sphere(arm);
    let eye = middle + VIEW_DIRECTION.normalize() * VIEW_DISTANCE_RATIO * radius_m.max(0.1);
    let eye = EyeControls3D::new()
        .with_position(<[f64; 3]>::from(eye))
        .with_look_target(<[f64; 3]>::from(middle))
        .with_eye_up([0.0, 0.0, 1.0]);
    blueprint.set(view, &eye)?;
    let ground = Background::new(BackgroundKind::SolidColor).with_color(GROUND_RGB);
    blueprint.set(view, &ground)?;
    let [red, green, blue, alpha] = GRID_RGBA;
    let grid = LineGrid3D::new().with_color(Color::from_unmultiplied_rgba(red, green, blue, alpha));
    blueprint.set(view, &grid)?;
    Ok(view)
}

/// Verdict with the worst finding, one tab per finding, then all errors of each arm.
fn verdict_views(
    replay: &Replay<'_>,
    blueprint: &Blueprint<'_>,
) -> Result<LayoutPart, ReplayCause> {
    /// Plots below the verdict.
    const PLOTS_BELOW_VERDICT: usize = 1;
    let mut parts = vec![blueprint.view::<TextDocumentView>("report", &page::report())?];
    parts.extend(finding_plots(replay, 0, PLOTS_BELOW_VERDICT, blueprint)?);
    let shares = [4.0, 3.0].into_iter().cycle().take(parts.len()).collect::<Vec<f32>>();
    let mut tabs = vec![blueprint.page(&replay.report.verdict.to_string(), &parts, &shares)?];
    for (index, finding) in replay.report.findings.iter().take(MAX_TABS).enumerate() {
        let mut parts =
            vec![blueprint.view::<TextDocumentView>("what is wrong", &findings::page(index))?];
        parts.extend(finding_plots(replay, index, usize::MAX, blueprint)?);
        let mut shares = vec![3.0; parts.len()];
        shares[0] = 4.0;
        tabs.push(blueprint.page(finding.code, &parts, &shares)?);
    }
    for arm in &replay.arms {
        let mut plots = Vec::new();
        for (quantity, is_there) in [
            (PlotQuantity::Position, !arm.streams.is_empty()),
            (PlotQuantity::Rotation, !arm.streams.is_empty()),
            (PlotQuantity::Yaw, arm.imus.iter().any(ReplayImu::has_yaw)),
        ] {
            if is_there {
                plots.push(plot_view(quantity.title(), &quantity.root(arm.name), blueprint)?);
            }
        }
        let name = match replay.arms.len() {
            1 => "errors".to_owned(),
            _ => format!("errors of {}", arm.name),
        };
        if !plots.is_empty() {
            tabs.push(blueprint.page(&name, &plots, &vec![1.0; plots.len()])?);
        }
    }
    blueprint.tabs(&tabs, 0)
}

/// Plots of the finding, at most the given number: its specific ones, else the errors of its stream.
fn finding_plots(
    replay: &Replay<'_>,
    index: usize,
    most: usize,
    blueprint: &Blueprint<'_>,
) -> Result<Vec<LayoutPart>, ReplayCause> {
    let Some(finding) = replay.report.findings.get(index) else { return Ok(Vec::new()) };
    let own = finding_views::list(replay.report, index);
    if !own.is_empty() {
        let own = own.into_iter().take(most).map(|view| match view.kind {
            ViewKind::Series => plot_view(view.title, &view.path, blueprint),
            ViewKind::Bars => blueprint.view::<BarChartView>(view.title, &view.path),
            ViewKind::Space => blueprint.view::<Spatial3DView>(view.title, &view.path),
        });
        return own.collect();
    }
    let plots = replay.arm_of(finding).map(|arm| plot_entities(finding, arm)).unwrap_or_default();
    let plots = plots.into_iter().take(most);
    plots.map(|(title, series)| plot_view(&title, &series, blueprint)).collect()
}

/// Plots with titles: errors of its stream (rotation first for rotation faults), yaw of its IMU, or the
/// joint and the effect of its zero on all streams.
pub(super) fn plot_entities(finding: &Finding, arm: &ReplayArm<'_>) -> Vec<(String, EntityPath)> {
    let topic = finding.subject.topic.as_deref().unwrap_or_default();
    let titled = |quantity: PlotQuantity, path| (quantity.title().to_owned(), path);
    if arm.streams.iter().any(|stream| stream.topic == topic) {
        let mut both = [PlotQuantity::Position, PlotQuantity::Rotation];
        if finding.code.starts_with("ORD") {
            both.reverse();
        }
        return both.map(|it| titled(it, it.topic_root(arm.name, topic))).into();
    }
    if let Some(imu) = arm.imus.iter().find(|imu| imu.topic == topic) {
        let yaw = titled(PlotQuantity::Yaw, PlotQuantity::Yaw.topic_root(arm.name, topic));
        return imu.has_yaw().then_some(yaw).into_iter().collect();
    }
    let all = (!arm.streams.is_empty())
        .then(|| titled(PlotQuantity::Position, PlotQuantity::Position.root(arm.name)));
    let joint = finding.subject.joint.as_deref();
    let joint = joint.and_then(|name| Some((name, plots::joint_entity(arm, name)?)));
    let joint = joint.map(|(name, (path, unit))| (format!("{name}, {unit}"), path));
    all.into_iter().chain(joint).collect()
}

fn plot_view(
    title: &str,
    series: &EntityPath,
    blueprint: &Blueprint<'_>,
) -> Result<LayoutPart, ReplayCause> {
    let plot = blueprint.view::<TimeSeriesView>(title, series)?;
    blueprint.set(plot, &PlotLegend::new().with_corner(Corner2D::LeftTop))?;
    Ok(plot)
}

fn timeline_panel(blueprint: &Blueprint<'_>) -> Result<LayoutPart, ReplayCause> {
    let spans = blueprint.view::<StateTimelineView>("when", &findings::spans())?;
    let lines = blueprint.view::<TextLogView>("findings", &findings::log())?;
    let columns = [TextLogColumnKind::LogLevel, TextLogColumnKind::Body];
    let columns = columns.map(|kind| TextLogColumn { kind, visible: true.into() });
    blueprint.set(lines, &TextLogColumns::new().with_text_log_columns(columns))?;
    blueprint.row(&[spans, lines], &[5.0, 4.0])
}
