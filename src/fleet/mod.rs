//! Many logs: each audited in a process of its own, its rows kept as Parquet in one folder.
//!
//! What is kept of a log has a key: its content, the version of the program and the settings of the
//! audit. A call does what has no row yet, and a call that is killed loses the logs that it was at.
//! `docs/fleet.md` says how the folder is laid out; other programs may read it and write to it.

mod child;
mod content;
mod dataset;
mod engine;
mod labels;
mod machine;
mod outcomes;
mod pending;
pub mod report;
mod settings;
mod settle;
mod sources;
mod store;
mod task;

pub use child::{Limits, serve};
pub use content::Identity;
pub use engine::{Call, Course, run};
pub use labels::{Labels, Template, TemplateError};
pub use machine::memory_bytes;
pub use outcomes::{Failure, Outcomes, Statuses, Verdicts};
pub use pending::pending;
pub use settings::AuditSettings;
pub use sources::{Source, sources};
pub use store::{Status, Store, StoreError, Table};
