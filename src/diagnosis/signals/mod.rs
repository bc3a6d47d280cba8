//! Signals without a kinematic fit: limits, velocities, responses, vibration, trends and workspace.

pub(crate) mod joint_motion;
pub(crate) mod response;
pub(crate) mod trend;
pub(crate) mod velocity;
pub(crate) mod vibration;
pub(crate) mod workspace;
