//! Selection of the causes that explain the streams of an arm.

pub(crate) mod causes_beside_links;
pub(crate) mod deviation_model;
pub(crate) mod evidence;
pub(crate) mod held_out;
pub(crate) mod link_deviations;
pub(crate) mod model_selection;
pub(crate) mod nominal_model;
pub(crate) mod stepwise;
pub(crate) mod tool_preference;
