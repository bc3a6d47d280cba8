//! Rerun's recording stream, with the run's two timelines.

use rerun::log::TimeColumn;
use rerun::{AsComponents, EntityPath, RecordingStream, RecordingStreamError};
use rerun::{SerializationResult, SerializedComponentColumn};

use re_sdk_types::archetypes::Transform3D;
use re_sdk_types::datatypes::Quaternion;

use crate::geometry::{Pose, xyz_of, xyzw_from_rotation};
use crate::time::{Stamp, nanos};

pub type Recorded = Result<(), RecordingStreamError>;

/// Name of the timeline that counts from the run's origin.
pub const SINCE_ORIGIN: &str = "t";
/// Name of the timeline of the run's own clock.
const STAMP: &str = "stamp";

/// Takes what is to be shown.
pub struct Recorder {
    stream: RecordingStream,
    origin: Stamp,
}

impl Recorder {
    /// Records to `stream`; times in seconds count from `origin`.
    pub fn new(stream: RecordingStream, origin: Stamp) -> Self {
        Self { stream, origin }
    }

    /// What holds at all times.
    pub fn fixed(&self, entity: EntityPath, what: &dyn AsComponents) -> Recorded {
        self.stream.log_static(entity, what)
    }

    /// What changes: a row of `columns` for each time.
    pub fn moving<C>(
        &self,
        entity: EntityPath,
        t_s: &[f64],
        columns: SerializationResult<C>,
    ) -> Recorded
    where
        C: IntoIterator<Item = SerializedComponentColumn>,
    {
        if t_s.is_empty() {
            return Ok(());
        }
        let since_origin = t_s.iter().map(|&t_s| nanos(t_s));
        let stamps = t_s.iter().map(|&t_s| self.origin.shifted(t_s).nanos());
        let times = [
            TimeColumn::new_duration_nanos(SINCE_ORIGIN, since_origin),
            TimeColumn::new_timestamp_nanos_since_epoch(STAMP, stamps),
        ];
        self.stream.send_columns(entity, times, columns?)
    }

    /// A frame that moves: `poses` in the frame of the parent entity.
    pub fn frame(&self, entity: EntityPath, t_s: &[f64], poses: &[Pose]) -> Recorded {
        let quaternion = |pose: &Pose| {
            Quaternion::from_xyzw(xyzw_from_rotation(&pose.rotation).map(|part| part as f32))
        };
        let columns = Transform3D::update_fields()
            .with_many_translation(poses.iter().map(xyz_of))
            .with_many_quaternion(poses.iter().map(quaternion))
            .columns_of_unit_batches();
        self.moving(entity, t_s, columns)
    }
}
