//! Reports for other programs: destinations and content of each format.

mod ci;
mod compare;
mod escaping;
mod formats;
mod junit;
mod layout;
mod markdown;
mod sample_reports;
mod sarif;
mod shell;
mod snapshots;
mod wording;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};
