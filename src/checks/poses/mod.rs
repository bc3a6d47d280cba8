//! Rules on tool poses and /tf against FK: frames, encodings, units and residuals.

pub(super) mod frm001;
pub(super) mod frm002;
pub(super) mod frm003;
pub(super) mod mdl001;
pub(super) mod ord001;
pub(super) mod ord002;
pub(super) mod ord003;
pub(super) mod ord004;
pub(super) mod ord006;
pub(super) mod ord008;
pub(super) mod ord010;
pub(super) mod ord011;
pub(super) mod zer002;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Tool poses and /tf against FK: frames, encodings, units and residuals",
    rules: &[
        &frm001::FRM001,
        &frm002::FRM002,
        &frm003::FRM003,
        &mdl001::MDL001,
        &ord001::ORD001,
        &ord002::ORD002,
        &ord003::ORD003,
        &ord004::ORD004,
        &ord006::ORD006,
        &ord008::ORD008,
        &ord010::ORD010,
        &ord011::ORD011,
        &zer002::ZER002,
    ],
};
