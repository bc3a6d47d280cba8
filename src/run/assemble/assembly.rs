//! State of a run during assembly.

use std::collections::HashSet;
use std::sync::Arc;

use crate::run::RunOptions;
use crate::run::arm::Arm;
use crate::run::frozen::FrozenSpan;
use crate::run::not_audited::NotAudited;
use crate::run::shared_stream::SharedStream;
use crate::run::streams::Stream;
use crate::run::tf_tree::TfTree;
use crate::run::timing::Timing;
use crate::time::Stamp;

pub(super) struct Assembly<'a> {
    pub(super) options: &'a RunOptions,
    pub(super) streams: Vec<Stream>,
    /// Topics of dynamic transforms.
    pub(super) tf_topics: HashSet<String>,
    pub(super) timing: Timing,
    pub(super) origin: Stamp,
    pub(super) tf: Arc<TfTree>,
    pub(super) arms: Vec<Arm>,
    /// Joint state streams without an arm.
    pub(super) unmatched_joint_topics: Vec<usize>,
    pub(super) not_audited: Vec<NotAudited>,
    pub(super) shared_streams: Vec<SharedStream>,
    pub(super) frozen: Vec<FrozenSpan>,
    pub(super) searched_for_frozen: Vec<usize>,
}
