//! Reports for other programs: destinations and content of each format.

mod cases;
mod ci;
mod compare;
mod foreign;
mod formats;
mod junit;
mod markdown;
mod order;
mod sarif;
mod shell;
mod snapshots;
mod words;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};
