//! Writes a blueprint, Rerun's name for a layout of the viewer.
//!
//! The SDK's own writer (re_sdk 0.36) cannot set a view's properties, as its camera, and panics where
//! the environment variable RERUN turns logging off. This one logs the same archetypes.

use std::cell::Cell;

use re_sdk_types::blueprint::archetypes::{
    ContainerBlueprint, PanelBlueprint, TimePanelBlueprint, ViewBlueprint, ViewContents,
    ViewportBlueprint,
};
use re_sdk_types::blueprint::components::{
    ActiveTab, ColumnShare, ContainerKind, IncludedContent, PanelState, RootContainer, RowShare,
};
use re_sdk_types::external::uuid::Uuid;
use re_sdk_types::{Archetype, View};
use rerun::external::re_log_types::BlueprintActivationCommand;
use rerun::log::{Chunk, RowId};
use rerun::sink::MemorySinkStorage;
use rerun::time::{TimePoint, Timeline};
use rerun::{
    ApplicationId, AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder,
    RecordingStreamResult, StoreId, StoreKind,
};

use super::fixed::{BATCHES, Seed};

/// A view or a container, which can be put into a container.
#[derive(Clone, Copy)]
pub(super) struct Part {
    kind: &'static str,
    id: Uuid,
}

impl Part {
    fn path(self) -> String {
        format!("{}/{}", self.kind, self.id)
    }
}

/// A blueprint in the making.
pub(super) struct Blueprint {
    id: StoreId,
    stream: RecordingStream,
    messages: MemorySinkStorage,
    seed: Seed,
    /// How many parts there are.
    parts: Cell<usize>,
}

impl Blueprint {
    /// An empty blueprint for recordings of `application`.
    pub fn new(application: ApplicationId, seed: Seed) -> RecordingStreamResult<Self> {
        let id = format!("{:032x}", seed.id("blueprint"));
        let id = StoreId::new(StoreKind::Blueprint, application, id);
        let builder = RecordingStreamBuilder::from_store_id(&id).enabled(true);
        let (stream, messages) = builder.batcher_config(BATCHES).send_properties(false).memory()?;
        Ok(Self { id, stream, messages, seed, parts: Cell::new(0) })
    }

    /// A part that is not there yet.
    fn part(&self, kind: &'static str) -> Part {
        let number = self.parts.replace(self.parts.get() + 1);
        Part { kind, id: Uuid::from_u128(self.seed.id(&format!("{kind} {number}"))) }
    }

    /// Logs at the one time that a blueprint has, on a timeline of its own, and at no time of a clock.
    fn log(&self, path: String, what: &impl AsComponents) -> RecordingStreamResult<()> {
        let time = TimePoint::default().with(Timeline::new_sequence("blueprint"), 0);
        let chunk = Chunk::builder(path).with_archetype(RowId::new(), time, what).build()?;
        self.stream.send_chunk(chunk);
        Ok(())
    }

    /// A view of class `V` on `origin` and all below it.
    pub fn view<V: View>(&self, name: &str, origin: &EntityPath) -> RecordingStreamResult<Part> {
        let view = self.part("view");
        let contents = ViewContents::new(["$origin/**"]);
        self.log(format!("{}/ViewContents", view.path()), &contents)?;
        let blueprint = ViewBlueprint::new(V::identifier().as_str())
            .with_display_name(name)
            .with_space_origin(origin.to_string());
        self.log(view.path(), &blueprint)?;
        Ok(view)
    }

    /// Sets a property of a view.
    pub fn set<A: Archetype + AsComponents>(
        &self,
        view: Part,
        property: &A,
    ) -> RecordingStreamResult<()> {
        self.log(format!("{}/{}", view.path(), A::name().short_name()), property)
    }

    /// Parts beside each other, with their shares of the width.
    pub fn row(&self, parts: &[Part], shares: &[f32]) -> RecordingStreamResult<Part> {
        let shares = shares.iter().map(|&share| ColumnShare(share.into()));
        self.container(ContainerKind::Horizontal, parts, |row| row.with_col_shares(shares))
    }

    /// Parts below each other, with their shares of the height.
    pub fn column(&self, parts: &[Part], shares: &[f32]) -> RecordingStreamResult<Part> {
        let shares = shares.iter().map(|&share| RowShare(share.into()));
        self.container(ContainerKind::Vertical, parts, |column| column.with_row_shares(shares))
    }

    /// Parts behind each other, the one with the index `first` before the others.
    pub fn tabs(&self, parts: &[Part], first: usize) -> RecordingStreamResult<Part> {
        let first = parts.get(first).map(|part| ActiveTab(part.path().into()));
        self.container(ContainerKind::Tabs, parts, |tabs| match first {
            Some(first) => tabs.with_active_tab(first),
            None => tabs,
        })
    }

    /// Parts below each other under one name, with their shares of the height.
    pub fn page(&self, name: &str, parts: &[Part], shares: &[f32]) -> RecordingStreamResult<Part> {
        let shares = shares.iter().map(|&share| RowShare(share.into()));
        self.container(ContainerKind::Vertical, parts, |page| {
            page.with_row_shares(shares).with_display_name(name)
        })
    }

    fn container(
        &self,
        kind: ContainerKind,
        parts: &[Part],
        with_shares: impl FnOnce(ContainerBlueprint) -> ContainerBlueprint,
    ) -> RecordingStreamResult<Part> {
        let container = self.part("container");
        let contents = parts.iter().map(|part| IncludedContent(part.path().into()));
        let blueprint = ContainerBlueprint::new(kind).with_contents(contents);
        self.log(container.path(), &with_shares(blueprint))?;
        Ok(container)
    }

    /// Sends the blueprint to `recording`, to be used at once: the container `root`, the side panels
    /// collapsed, and the time panel as given.
    pub fn send(
        self,
        root: Part,
        time: &TimePanelBlueprint,
        recording: &RecordingStream,
    ) -> RecordingStreamResult<()> {
        let viewport = ViewportBlueprint::new()
            .with_root_container(RootContainer(root.id.into()))
            .with_auto_layout(false)
            .with_auto_views(false);
        self.log("viewport".to_owned(), &viewport)?;
        let collapsed = PanelBlueprint::new().with_state(PanelState::Collapsed);
        self.log("blueprint_panel".to_owned(), &collapsed)?;
        self.log("selection_panel".to_owned(), &collapsed)?;
        self.log("time_panel".to_owned(), time)?;
        let activation = BlueprintActivationCommand::make_active(self.id);
        recording.send_blueprint(self.messages.take(), activation);
        Ok(())
    }
}
