//! Audits many logs, each in a separate process, and stores the results as Parquet tables in one folder.
//!
//! The key of a log's rows combines its content, the program version and the settings. A call audits only
//! logs without a row. `docs/fleet.md` documents the folder.

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
