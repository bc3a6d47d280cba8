//! The reports as other programs get them: which formats go where, and what each of them holds.

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
