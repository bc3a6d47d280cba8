pub(super) mod frm006_reference_at_rest;
mod joint_maps;
pub(super) mod lat004_command_delay;
pub(super) mod mot004_line;
mod sources;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Commands compared with the motion of the arm",
    rules: &[
        &frm006_reference_at_rest::FRM006,
        &lat004_command_delay::LAT004,
        &mot004_line::MOT004,
    ],
};
