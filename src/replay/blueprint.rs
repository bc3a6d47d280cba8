//! Writes a blueprint, Rerun's name for a layout of the viewer.
//!
//! The SDK's own writer (re_sdk 0.36) cannot set a view's properties, as its camera, and panics where
//! the environment variable RERUN turns logging off. This one logs the same archetypes.

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
use rerun::sink::MemorySinkStorage;
use rerun::{
    ApplicationId, AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder,
    RecordingStreamResult, StoreId, StoreKind,
};

/// A view or a container, which can be put into a container.
#[derive(Clone, Copy)]
pub(super) struct Part {
    kind: &'static str,
    id: Uuid,
}

impl Part {
    fn new(kind: &'static str) -> Self {
        Self { kind, id: Uuid::new_v4() }
    }

    fn path(self) -> String {
        format!("{}/{}", self.kind, self.id)
    }
}

/// A blueprint in the making.
pub(super) struct Blueprint {
    id: StoreId,
    stream: RecordingStream,
    messages: MemorySinkStorage,
}

impl Blueprint {
    /// An empty blueprint for recordings of `application`.
    pub fn new(application: ApplicationId) -> RecordingStreamResult<Self> {
        let id = StoreId::random(StoreKind::Blueprint, application);
        let (stream, messages) =
            RecordingStreamBuilder::from_store_id(&id).enabled(true).memory()?;
        // Blueprints live on a timeline of their own.
        stream.set_time_sequence("blueprint", 0);
        Ok(Self { id, stream, messages })
    }

    /// A view of class `V` on `origin` and all below it.
    pub fn view<V: View>(&self, name: &str, origin: &EntityPath) -> RecordingStreamResult<Part> {
        let view = Part::new("view");
        let contents = ViewContents::new(["$origin/**"]);
        self.stream.log(format!("{}/ViewContents", view.path()), &contents)?;
        let blueprint = ViewBlueprint::new(V::identifier().as_str())
            .with_display_name(name)
            .with_space_origin(origin.to_string());
        self.stream.log(view.path(), &blueprint)?;
        Ok(view)
    }

    /// Sets a property of a view.
    pub fn set<A: Archetype + AsComponents>(
        &self,
        view: Part,
        property: &A,
    ) -> RecordingStreamResult<()> {
        self.stream.log(format!("{}/{}", view.path(), A::name().short_name()), property)
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
        let container = Part::new("container");
        let contents = parts.iter().map(|part| IncludedContent(part.path().into()));
        let blueprint = ContainerBlueprint::new(kind).with_contents(contents);
        self.stream.log(container.path(), &with_shares(blueprint))?;
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
        self.stream.log("viewport", &viewport)?;
        let collapsed = PanelBlueprint::new().with_state(PanelState::Collapsed);
        self.stream.log("blueprint_panel", &collapsed)?;
        self.stream.log("selection_panel", &collapsed)?;
        self.stream.log("time_panel", time)?;
        let activation = BlueprintActivationCommand::make_active(self.id);
        recording.send_blueprint(self.messages.take(), activation);
        Ok(())
    }
}
