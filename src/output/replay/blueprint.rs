//! Writes a blueprint, Rerun's layout of the viewer. The SDK's writer (re_sdk 0.36) cannot set properties
//! of a view, such as its camera.

use std::cell::Cell;

use re_log_types::{EntityPath, TimePoint, Timeline};
use re_sdk_types::blueprint::archetypes::{
    ContainerBlueprint, PanelBlueprint, TimePanelBlueprint, ViewBlueprint, ViewContents,
    ViewportBlueprint,
};
use re_sdk_types::blueprint::components::{
    ActiveTab, ColumnShare, ContainerKind, IncludedContent, PanelState, RootContainer, RowShare,
};
use re_sdk_types::external::uuid::Uuid;
use re_sdk_types::{Archetype, AsComponents, View};

use super::ReplayCause;
use super::chunk_writer::ChunkWriter;

#[derive(Clone, Copy)]
pub(super) struct LayoutPart {
    kind: &'static str,
    id: Uuid,
}

impl LayoutPart {
    fn path(self) -> String {
        format!("{}/{}", self.kind, self.id)
    }
}

pub(super) struct Blueprint<'a> {
    chunks: &'a ChunkWriter,
    parts: Cell<usize>,
}

impl<'a> Blueprint<'a> {
    pub fn new(chunks: &'a ChunkWriter) -> Self {
        Self { chunks, parts: Cell::new(0) }
    }

    fn part(&self, kind: &'static str) -> LayoutPart {
        let number = self.parts.replace(self.parts.get() + 1);
        LayoutPart { kind, id: Uuid::from_u128(self.chunks.seed.id(&format!("{kind} {number}"))) }
    }

    /// At the single time of a blueprint, on its timeline.
    fn log(&self, path: String, what: &impl AsComponents) -> Result<(), ReplayCause> {
        let time = TimePoint::default().with(Timeline::new_sequence("blueprint"), 0);
        self.chunks.log_layout(path, time, what)
    }

    /// View of class `V` on `origin` and everything below.
    pub fn view<V: View>(
        &self,
        name: &str,
        origin: &EntityPath,
    ) -> Result<LayoutPart, ReplayCause> {
        self.view_of::<V>(name, origin, ["$origin/**"])
    }

    /// View of class `V` on the entities that the rules include.
    pub fn view_of<'r, V: View>(
        &self,
        name: &str,
        origin: &EntityPath,
        rules: impl IntoIterator<Item = &'r str>,
    ) -> Result<LayoutPart, ReplayCause> {
        let view = self.part("view");
        let contents = ViewContents::new(rules);
        self.log(format!("{}/ViewContents", view.path()), &contents)?;
        let blueprint = ViewBlueprint::new(V::identifier().as_str())
            .with_display_name(name)
            .with_space_origin(origin.to_string());
        self.log(view.path(), &blueprint)?;
        Ok(view)
    }

    pub fn set<A: Archetype + AsComponents>(
        &self,
        view: LayoutPart,
        property: &A,
    ) -> Result<(), ReplayCause> {
        self.log(format!("{}/{}", view.path(), A::name().short_name()), property)
    }

    /// Side by side, with shares of the width.
    pub fn row(&self, parts: &[LayoutPart], shares: &[f32]) -> Result<LayoutPart, ReplayCause> {
        let shares = shares.iter().map(|&share| ColumnShare(share.into()));
        self.container(ContainerKind::Horizontal, parts, |row| row.with_col_shares(shares))
    }

    /// Vertical, with shares of the height.
    pub fn column(&self, parts: &[LayoutPart], shares: &[f32]) -> Result<LayoutPart, ReplayCause> {
        let shares = shares.iter().map(|&share| RowShare(share.into()));
        self.container(ContainerKind::Vertical, parts, |column| column.with_row_shares(shares))
    }

    /// Tab `first` is active.
    pub fn tabs(&self, parts: &[LayoutPart], first: usize) -> Result<LayoutPart, ReplayCause> {
        let first = parts.get(first).map(|part| ActiveTab(part.path().into()));
        self.container(ContainerKind::Tabs, parts, |tabs| match first {
            Some(first) => tabs.with_active_tab(first),
            None => tabs,
        })
    }

    /// Vertical under one name, with shares of the height.
    pub fn page(
        &self,
        name: &str,
        parts: &[LayoutPart],
        shares: &[f32],
    ) -> Result<LayoutPart, ReplayCause> {
        let shares = shares.iter().map(|&share| RowShare(share.into()));
        self.container(ContainerKind::Vertical, parts, |page| {
            page.with_row_shares(shares).with_display_name(name)
        })
    }

    fn container(
        &self,
        kind: ContainerKind,
        parts: &[LayoutPart],
        with_shares: impl FnOnce(ContainerBlueprint) -> ContainerBlueprint,
    ) -> Result<LayoutPart, ReplayCause> {
        let container = self.part("container");
        let contents = parts.iter().map(|part| IncludedContent(part.path().into()));
        let blueprint = ContainerBlueprint::new(kind).with_contents(contents);
        self.log(container.path(), &with_shares(blueprint))?;
        Ok(container)
    }

    /// Uses the container `root` and the time panel, with collapsed side panels.
    pub fn finish(self, root: LayoutPart, time: &TimePanelBlueprint) -> Result<(), ReplayCause> {
        let viewport = ViewportBlueprint::new()
            .with_root_container(RootContainer(root.id.into()))
            .with_auto_layout(false)
            .with_auto_views(false);
        self.log("viewport".to_owned(), &viewport)?;
        let collapsed = PanelBlueprint::new().with_state(PanelState::Collapsed);
        self.log("blueprint_panel".to_owned(), &collapsed)?;
        self.log("selection_panel".to_owned(), &collapsed)?;
        self.log("time_panel".to_owned(), time)
    }
}
