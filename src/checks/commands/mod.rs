//! Rules that compare commands with the motion of the arm.

pub(super) mod frm006;
pub(super) mod lat004;
pub(super) mod mot004;
mod witness;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Commands compared with the motion of the arm",
    rules: &[&frm006::FRM006, &lat004::LAT004, &mot004::MOT004],
};
