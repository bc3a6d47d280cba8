//! Pose streams and IMUs of an arm.

use crate::diagnosis::{
    EstimateResult, ImuDiagnosis, ImuResidualCheck, PoseDiagnosis, PoseEncoding, ResidualCheck,
    ToolSwitching,
};
use crate::geometry::{AngleUnit, Convention, LengthScale, Rotation, RotationEncoding};
use crate::log::RotationLabels;
use crate::run::{Declaration, PoseSource, PoseSourceKind, Role, Run, Stream};
use crate::stream::Columns;
use crate::time::Stamp;

/// One pose stream.
#[derive(Clone, Debug)]
pub struct PoseEvidence {
    /// Frame in which its poses are expressed.
    pub reference: String,
    /// Whether that frame is fixed to the robot; if not, its pose is estimated but not judged.
    pub reference_known: bool,
    /// Frame whose poses it contains.
    pub tip: String,
    /// Whether the tip is declared (`--tip`, the stream's child frame). If so, an offset from it is a fault
    /// rather than the active TCP.
    pub is_tip_declared: bool,
    /// Source of the poses.
    pub source_kind: PoseSourceKind,
    /// Direct comparison with FK.
    pub proof: EstimateResult<ResidualCheck>,
    /// Whether its stamps are independent rather than copies of the joints' stamps.
    pub has_independent_stamps: bool,
    /// Whether its rotations are bare numbers, which may be degrees.
    pub has_bare_numbers: bool,
    /// Whether it contains bare numbers without a declaration, which cannot violate a convention.
    pub is_undeclared: bool,
    /// Units declared by the caller.
    pub declared: Option<DeclaredUnits>,
    /// Encoding of its rotations, if they are three bare numbers.
    pub euler: Option<EulerEvidence>,
    /// Rotation encoding according to the column names of a table.
    pub labels: Option<RotationLabels>,
    /// Whether it comes from table columns, which have no frame.
    pub is_of_table: bool,
    /// Unidentified table columns next to positions, which may be their rotation.
    pub unidentified_columns: Vec<String>,
    /// Rigid bodies on the tool between which its poses alternate, if any. All other estimates refer to the
    /// most frequent one.
    pub alternation: Option<ToolSwitching>,
    /// Diagnosis.
    pub diagnosis: PoseDiagnosis,
}

/// Rotations encoded as three numbers.
#[derive(Clone, Debug)]
pub struct EulerEvidence {
    /// Convention, as declared or as estimated. `None` if undetermined.
    pub convention: Option<Convention>,
    /// Distance from gimbal lock of every row with a stamp, rad. Empty if the convention has no gimbal
    /// lock.
    pub margins_rad: Vec<(Stamp, f64)>,
}

/// Units of a stream's numbers as declared by the caller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeclaredUnits {
    /// Angle unit, if the numbers contain angles.
    pub angles: Option<AngleUnit>,
    /// Length unit of the positions.
    pub lengths: LengthScale,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ImuEvidence {
    /// Whether its stamps are independent rather than copies of the joints' stamps.
    pub has_independent_stamps: bool,
    /// Link on which it is mounted.
    pub link: String,
    /// Its orientation in that link according to the log's frames, if given.
    pub link_from_imu: Option<Rotation>,
    /// Direct comparison with FK. `None` if it does not rotate with the arm.
    pub proof: Option<ImuResidualCheck>,
    /// Diagnosis.
    pub diagnosis: ImuDiagnosis,
}

/// Rotation encoding of a stream with six bare numbers, and the distance of its rows from gimbal lock.
/// `None` for other streams.
pub(super) fn euler(
    run: &Run,
    source: &PoseSource,
    found: &PoseDiagnosis,
    declared: &[Declaration],
) -> Option<EulerEvidence> {
    let stream = run.streams.get(source.stream)?;
    let Some(Columns::Array(array)) = &stream.columns else { return None };
    let clock = run.clocks.iter().find(|clock| clock.stream == source.stream)?;
    if array.width != 6 {
        return None;
    }
    let names = |declared: &&Declaration| declared.is_of(&stream.topic);
    let declared = declared.iter().find(names);
    let reading = found.encoding.as_ref().ok().filter(|reading| reading.is_determined);
    let told = reading.and_then(|reading| match reading.best {
        PoseEncoding::Numbers(convention) => Some(convention),
        _ => Some(reading.best.misinterpretation()?.is),
    });
    let said = declared.and_then(|declared| match declared.coding {
        RotationEncoding::Three(convention) => Some(convention),
        _ => None,
    });
    let convention = told.or(said);
    let in_degrees = declared.is_some_and(|declared| declared.angle == AngleUnit::Degree)
        != found.degrees.is_some();
    let to_radians = if in_degrees { 1_f64.to_radians() } else { 1.0 };
    let margin = |row: usize| {
        let numbers = array.row(row);
        let numbers = [3, 4, 5].map(|at| numbers[at] * to_radians);
        Some((clock.stamp_of(&array.times, row)?, convention?.gimbal_margin(numbers)?))
    };
    Some(EulerEvidence {
        convention,
        margins_rad: (0..array.times.len()).filter_map(margin).collect(),
    })
}

/// Unidentified table columns that may be the rotation of positions without one.
pub(super) fn unidentified_columns(run: &Run, source: &PoseSource) -> Vec<String> {
    if !run.streams[source.stream].holds_no_rotation() {
        return Vec::new();
    }
    let is_left = |stream: &&Stream| matches!(stream.role, Role::Ignored | Role::Unassigned);
    let left = run.streams.iter().filter(is_left);
    left.flat_map(|stream| stream.unidentified.iter().cloned()).collect()
}
