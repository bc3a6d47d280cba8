//! The streams of an arm: tool poses and IMUs.

use crate::diagnosis::{Alternation, ImuDiagnosis, ImuProof, PoseDiagnosis, Proof, Reading, Seen};
use crate::geometry::{AngleUnit, Coding, Convention, LengthScale, Rotation};
use crate::log::RotationLabels;
use crate::run::{Declaration, PoseSource, Role, Run, Stream, Witness};
use crate::stream::Columns;
use crate::time::Stamp;

/// One stream of poses.
#[derive(Clone, Debug)]
pub struct PoseEvidence {
    /// The frame that its poses are expressed in.
    pub reference: String,
    /// Whether that frame is tied to the robot; if not its pose is estimated and not judged.
    pub reference_known: bool,
    /// The frame whose poses they are.
    pub tip: String,
    /// Whether somebody named the tip (`--tip`, the stream's child frame), so that an offset from it
    /// is a fault and not the active TCP.
    pub tip_named: bool,
    /// Whose word the poses are.
    pub witness: Witness,
    /// Its error straight from FK.
    pub proof: Seen<Proof>,
    /// Whether its stamps are its own, not copies of the joints'.
    pub independent: bool,
    /// Whether its rotations are bare numbers, which may be degrees.
    pub bare_numbers: bool,
    /// Whether it holds bare numbers of which nothing is declared, so that they violate no convention.
    pub bare: bool,
    /// The units that the caller declared its numbers to be in.
    pub declared: Option<Declared>,
    /// How its rotations are coded, where they are three bare numbers.
    pub euler: Option<EulerEvidence>,
    /// What the names of its rotation's columns say of their encoding, of a table.
    pub labels: Option<RotationLabels>,
    /// Whether it is columns of a table, which name no frame.
    pub is_of_table: bool,
    /// Columns of a table beside positions that nothing identifies, and that may be their rotation.
    pub rotation_unread: Vec<String>,
    /// The rigid bodies on the tool that its poses alternate between, where they do; everything else was
    /// estimated on all of them as those of the usual one.
    pub alternation: Option<Alternation>,
    /// What was estimated on it.
    pub diagnosis: PoseDiagnosis,
}

/// Rotations that are coded as three numbers.
#[derive(Clone, Debug)]
pub struct EulerEvidence {
    /// What the numbers are, as declared or as the arm tells; `None` where it does not.
    pub convention: Option<Convention>,
    /// For every row with a stamp, how far it is from gimbal lock, rad; empty where the convention
    /// has none.
    pub margins_rad: Vec<(Stamp, f64)>,
}

/// The units of a stream's numbers as the caller declared them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Declared {
    /// The unit of the angles, where the numbers hold any.
    pub angles: Option<AngleUnit>,
    /// The unit of the positions.
    pub lengths: LengthScale,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ImuEvidence {
    /// Whether its stamps are its own, not copies of the joints'.
    pub independent: bool,
    /// The link that carries it.
    pub link: String,
    /// How it is turned in that link by the log's frames, where they say.
    pub link_from_imu: Option<Rotation>,
    /// What it leaves straight against FK; `None` where it does not turn with the arm.
    pub proof: Option<ImuProof>,
    /// What was estimated on it.
    pub diagnosis: ImuDiagnosis,
}

/// How the rotations of a stream of six bare numbers are coded, and how near gimbal lock all its rows
/// are; `None` of other streams.
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
    let reading = found.reading.as_ref().ok().filter(|reading| reading.is_told);
    let told = reading.and_then(|reading| match reading.best {
        Reading::Numbers(convention) => Some(convention),
        _ => Some(reading.best.misreading()?.is),
    });
    let said = declared.and_then(|declared| match declared.coding {
        Coding::Three(convention) => Some(convention),
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

/// The numbers of the table that may be the rotation of positions without one, as nothing identifies them.
pub(super) fn rotation_unread(run: &Run, source: &PoseSource) -> Vec<String> {
    if !run.streams[source.stream].holds_no_rotation() {
        return Vec::new();
    }
    let is_left = |stream: &&Stream| matches!(stream.role, Role::Ignored | Role::Unassigned);
    let left = run.streams.iter().filter(is_left);
    left.flat_map(|stream| stream.unidentified.iter().cloned()).collect()
}
