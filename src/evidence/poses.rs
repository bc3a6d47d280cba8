use super::joint_axes::JointAxes;
use crate::diagnosis::{
    EstimateResult, ImuDiagnosis, ImuResidualCheck, Measured, PoseDiagnosis, PoseEncoding,
    ResidualCheck, ToolSwitching,
};
use crate::geometry::{AngleUnit, Convention, LengthScale, Rotation, RotationEncoding, Units};
use crate::log::RotationLabels;
use crate::run::{Declaration, MovingBase, PoseSource, PoseSourceKind, Role, Run, Stream};
use crate::stream::Columns;
use crate::time::Stamp;

/// One pose stream.
#[derive(Clone, Debug)]
pub struct PoseEvidence {
    /// Frame of its poses.
    pub reference: String,
    /// That frame is fixed to the robot; otherwise its pose is not judged.
    pub reference_known: bool,
    /// Frame whose poses it contains.
    pub tip: String,
    /// The tip is declared (`--tip`, child frame): an offset from it is a fault rather than the active TCP.
    pub is_tip_declared: bool,
    /// The stream's child frame names the tip, so no option names another one.
    pub is_tip_of_child_frame: bool,
    /// In a log without joint states: the caller or the log states that it is of the reference's body.
    pub is_of_reference_body: bool,
    /// Source of the poses.
    pub source_kind: PoseSourceKind,
    /// Direct comparison with FK.
    pub proof: EstimateResult<ResidualCheck>,
    /// Stamps are not copies of the joints' stamps.
    pub has_independent_stamps: bool,
    /// Rotations are bare numbers, possibly degrees.
    pub has_bare_numbers: bool,
    /// Bare numbers in one encoding, without a declaration, which cannot violate a convention.
    pub is_undeclared: bool,
    /// Units declared by the caller.
    pub declared: Option<DeclaredUnits>,
    /// Rotation encoding, for three bare numbers.
    pub euler: Option<EulerEvidence>,
    /// Rotation encoding according to column names.
    pub labels: Option<RotationLabels>,
    /// Units according to column names.
    pub named_units: Units,
    /// From table columns for which the caller names no frame.
    pub names_no_frame: bool,
    /// Unidentified columns, possibly its rotation.
    pub unidentified_columns: Vec<String>,
    /// Transforms of the moving frame of its poses, if they are late.
    pub late_transforms: Option<LateTransforms>,
    /// Rigid bodies on the tool between which its poses alternate. Other estimates refer to the most
    /// frequent one.
    pub alternation: Option<ToolSwitching>,
    /// `proof` compares with the joint states before the corrections that the caller gave: transforms in the log
    /// were computed from those.
    pub is_uncorrected: bool,
    /// Axes of the joints that may have the effect of a wrong frame.
    pub joint_axes: JointAxes,
    /// Diagnosis.
    pub diagnosis: PoseDiagnosis,
}

impl PoseEvidence {
    /// Rule that reports positions in another unit than metres.
    pub fn unit_rule(&self) -> &'static str {
        if self.is_undeclared { "ORD001" } else { "ORD008" }
    }
}

/// Transforms that are late against the joint states, which is corrected.
#[derive(Clone, Debug)]
pub struct LateTransforms {
    /// Their topic.
    pub topic: String,
    /// The frame that they relate to the arm.
    pub frame: String,
    /// Their latency.
    pub latency_s: Measured,
}

impl LateTransforms {
    pub(super) fn of(run: &Run, source: &PoseSource) -> Option<Self> {
        let MovingBase { frame, latency_s, .. } = source.moving_base.as_ref()?;
        let has_frame = |stream: &&Stream| match &stream.columns {
            Some(Columns::Transforms(all)) => {
                let names = all.iter().flat_map(|one| [&one.frame_id, &one.child_frame_id]);
                stream.role == Role::Tf && names.into_iter().any(|name| name == frame)
            }
            _ => false,
        };
        let own = || run.streams.get(source.stream);
        let stream = run.streams.iter().find(has_frame).or_else(own)?;
        let (topic, frame) = (stream.topic.clone(), frame.clone());
        Some(Self { topic, frame, latency_s: (*latency_s)? })
    }
}

/// Rotations as three numbers.
#[derive(Clone, Debug)]
pub struct EulerEvidence {
    /// Declared or estimated convention, if determined.
    pub convention: Option<Convention>,
    /// Distance of stamped rows from gimbal lock, rad. Empty if the convention has none.
    pub margins_rad: Vec<(Stamp, f64)>,
}

/// Units declared by the caller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeclaredUnits {
    /// Angle unit, if it contains angles.
    pub angles: Option<AngleUnit>,
    /// Length unit.
    pub lengths: LengthScale,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ImuEvidence {
    /// Stamps are not copies of the joints' stamps.
    pub has_independent_stamps: bool,
    /// Link of the IMU.
    pub link: String,
    /// Orientation in that link according to the log's frames.
    pub link_from_imu: Option<Rotation>,
    /// Direct comparison with FK. `None` if it does not rotate with the arm.
    pub proof: Option<ImuResidualCheck>,
    /// Diagnosis.
    pub diagnosis: ImuDiagnosis,
}

/// Rotation encoding of six bare numbers per row, and their distance from gimbal lock.
pub(super) fn euler(
    run: &Run,
    source: &PoseSource,
    found: &PoseDiagnosis,
) -> Option<EulerEvidence> {
    let stream = run.streams.get(source.stream)?;
    let Some(Columns::Array(array)) = &stream.columns else { return None };
    let clock = run.clocks_of(source.stream).first()?;
    if array.width != 6 {
        return None;
    }
    let names = |declared: &&Declaration| declared.is_of(&stream.topic);
    let declared = run.declared.iter().find(names);
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

/// Unidentified columns that may be the rotation of positions without one.
pub(super) fn unidentified_columns(run: &Run, source: &PoseSource) -> Vec<String> {
    if !run.streams[source.stream].lacks_rotation() {
        return Vec::new();
    }
    let is_left = |stream: &&Stream| matches!(stream.role, Role::Ignored | Role::Unassigned);
    let left = run.streams.iter().filter(is_left);
    left.flat_map(|stream| stream.unidentified.iter().cloned()).collect()
}
