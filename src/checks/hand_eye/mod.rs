//! Hand-eye chains: a camera that sees a target, and the hand that moves one of them.

mod chain;
pub(super) mod hec001;
pub(super) mod hec002;
pub(super) mod hec003;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Cameras that see a target, each with a hand",
    rules: &[&hec001::HEC001, &hec002::HEC002, &hec003::HEC003],
};
