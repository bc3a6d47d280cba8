//! A run while it is assembled.

use std::sync::Arc;

use crate::run::RunOptions;
use crate::run::arm::Arm;
use crate::run::contest::Contest;
use crate::run::frozen::Frozen;
use crate::run::streams::Stream;
use crate::run::tf_tree::TfTree;
use crate::run::timing::Timing;
use crate::run::unaudited::Unaudited;
use crate::time::Stamp;

/// A run in the making.
pub(super) struct Assembly<'a> {
    pub(super) options: &'a RunOptions,
    pub(super) streams: Vec<Stream>,
    pub(super) timing: Timing,
    pub(super) origin: Stamp,
    pub(super) tf: Arc<TfTree>,
    pub(super) arms: Vec<Arm>,
    /// The streams of joint states of which there is no arm.
    pub(super) strangers: Vec<usize>,
    pub(super) unaudited: Vec<Unaudited>,
    pub(super) contests: Vec<Contest>,
    pub(super) frozen: Vec<Frozen>,
    /// The streams that were looked at for that.
    pub(super) watched: Vec<usize>,
}

pub(super) fn is_topic(stream: &Stream, topic: &str) -> bool {
    stream.topic.trim_start_matches('/') == topic.trim_start_matches('/')
}
