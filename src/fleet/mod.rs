//! Audits many logs, each in a separate process, and stores the results as Parquet tables in one folder.
//!
//! The key of a log's rows combines its content, the program version and the settings. A call audits only
//! logs without a row. `docs/fleet.md` documents the folder.

mod audit_log;
mod content;
mod dataset;
mod engine;
mod labels;
mod memory;
mod outcomes;
mod pending;
pub mod report;
mod settings;
mod sources;
mod store;
mod task;
mod worker;

pub use content::Identity;
pub use engine::{FleetCall, FleetProgress, run};
pub use labels::{Labels, Template, TemplateError};
pub use memory::available_memory_bytes;
pub use outcomes::{Failure, FailureGroup, Outcomes, Statuses, Verdicts};
pub use pending::pending;
pub use settings::AuditSettings;
pub use sources::{LogSource, find_sources};
pub use store::{Status, Store, StoreError, Table};
pub use worker::{Limits, serve};
