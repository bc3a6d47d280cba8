//! Conversion of Denavit-Hartenberg tables to joints.
//!
//! Standard (Denavit & Hartenberg 1955; Spong, Hutchinson & Vidyasagar, "Robot Modeling and Control", eq.
//! 3.10): `T_i = Rz(θ_i)·Dz(d_i)·Dx(a_i)·Rx(α_i)`. Modified (Craig, "Introduction to Robotics", eq. 3.6):
//! `T_i = Rx(α_{i−1})·Dx(a_{i−1})·Rz(θ_i)·Dz(d_i)`; row i contains `a_{i−1}` and `α_{i−1}`. A revolute
//! joint adds its position to θ, a prismatic one to d.

use serde::Deserialize;

use crate::geometry::{Pose, Vec3, pose, rotation_from_rpy};

use super::error::Problem;
use super::joint::{JointDraft, JointKind, Limits, MAX_MAGNITUDE};

/// Declared convention of a DH table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DhConvention {
    /// A row rotates about z first.
    Standard,
    /// Craig: a row rotates about x first.
    Modified,
}

impl DhConvention {
    /// Name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::Modified => "modified",
        }
    }

    /// The opposite convention.
    pub const fn other(self) -> Self {
        match self {
            Self::Standard => Self::Modified,
            Self::Modified => Self::Standard,
        }
    }
}

/// DH table behind a robot's joints.
#[derive(Debug, Clone, PartialEq)]
pub struct DhModel {
    /// Declared convention.
    pub convention: DhConvention,
    /// `parent_from_joint` in file order, under the other convention.
    pub(super) other_origins: Vec<Pose>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RowKind {
    #[default]
    Revolute,
    Prismatic,
}

/// Rows are `[a, d, alpha, theta_offset]` in m and rad.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DhTable {
    pub convention: DhConvention,
    pub rows: Vec<[f64; 4]>,
    pub base: Option<String>,
    pub tip: Option<String>,
    pub joint_names: Option<Vec<String>>,
    pub joint_types: Option<Vec<RowKind>>,
    #[serde(default)]
    pub pre_xyz: [f64; 3],
    #[serde(default)]
    pub pre_rpy: [f64; 3],
    #[serde(default)]
    pub post_xyz: [f64; 3],
    #[serde(default)]
    pub post_rpy: [f64; 3],
    #[serde(rename = "note")]
    _note: Option<String>,
    #[serde(rename = "max_diff_vs_urdf_m")]
    _max_diff_vs_urdf_m: Option<f64>,
    #[serde(rename = "max_diff_vs_urdf_rad")]
    _max_diff_vs_urdf_rad: Option<f64>,
}

impl DhTable {
    /// One movable joint per row, about or along its z axis, and a fixed joint to the tip. Joint i moves
    /// `link_i`, in the modified convention frame i.
    pub(super) fn joints(&self, at: usize) -> Result<Vec<JointDraft>, Problem> {
        self.check_finite()?;
        let names = self.per_row("joint_names", self.joint_names.as_deref(), |row| {
            format!("joint_{}", row + 1)
        })?;
        let kinds =
            self.per_row("joint_types", self.joint_types.as_deref(), |_| RowKind::default())?;
        let mut from = self.base_name().to_owned();
        let mut joints = Vec::with_capacity(self.rows.len() + 1);
        let mut origins = self.origins(self.convention).into_iter();
        let mut origin = || origins.next().unwrap_or_default();
        for (index, (name, kind)) in names.into_iter().zip(kinds).enumerate() {
            let to = format!("link_{}", index + 1);
            joints.push(draft(name, kind.into(), from, to.clone(), origin(), at));
            from = to;
        }
        let tip = self.tip_name().to_owned();
        joints.push(draft(format!("{from}-{tip}"), JointKind::Fixed, from, tip, origin(), at));
        Ok(joints)
    }

    fn origins(&self, convention: DhConvention) -> Vec<Pose> {
        let mut before = pose(self.pre_xyz, rotation_from_rpy(self.pre_rpy));
        let mut origins = Vec::with_capacity(self.rows.len() + 1);
        for row in &self.rows {
            let (ahead, after) = split(convention, *row);
            origins.push(before * ahead);
            before = after;
        }
        origins.push(before * pose(self.post_xyz, rotation_from_rpy(self.post_rpy)));
        origins
    }

    pub(super) fn model(&self) -> DhModel {
        let other_origins = self.origins(self.convention.other());
        DhModel { convention: self.convention, other_origins }
    }

    pub(super) fn base_name(&self) -> &str {
        self.base.as_deref().unwrap_or("base")
    }

    pub(super) fn tip_name(&self) -> &str {
        self.tip.as_deref().unwrap_or("tip")
    }

    fn check_finite(&self) -> Result<(), Problem> {
        let ends = [self.pre_xyz, self.pre_rpy, self.post_xyz, self.post_rpy];
        let mut numbers = self.rows.iter().flatten().chain(ends.iter().flatten());
        if numbers.all(|number| number.abs() <= MAX_MAGNITUDE) {
            return Ok(());
        }
        Err(Problem::NotFinite { element: "[dh]".to_owned() })
    }

    fn per_row<T: Clone>(
        &self,
        what: &str,
        given: Option<&[T]>,
        default: impl Fn(usize) -> T,
    ) -> Result<Vec<T>, Problem> {
        let rows = self.rows.len();
        match given {
            Some(values) if values.len() != rows => {
                Err(Problem::DhCount { found: format!("{} {what}", values.len()), rows })
            }
            Some(values) => Ok(values.to_vec()),
            None => Ok((0..rows).map(default).collect()),
        }
    }
}

impl From<RowKind> for JointKind {
    fn from(kind: RowKind) -> Self {
        match kind {
            RowKind::Revolute => JointKind::Revolute,
            RowKind::Prismatic => JointKind::Prismatic,
        }
    }
}

/// Fixed parts before and after the motion, which commutes with `Rz(theta_offset)` and `Dz(d)`.
fn split(convention: DhConvention, [a, d, alpha, theta_offset]: [f64; 4]) -> (Pose, Pose) {
    let across = pose([a, 0.0, 0.0], rotation_from_rpy([alpha, 0.0, 0.0]));
    let along = pose([0.0, 0.0, d], rotation_from_rpy([0.0, 0.0, theta_offset]));
    match convention {
        DhConvention::Standard => (Pose::identity(), along * across),
        DhConvention::Modified => (across * along, Pose::identity()),
    }
}

fn draft(
    name: String,
    kind: JointKind,
    parent: String,
    child: String,
    parent_from_joint: Pose,
    at: usize,
) -> JointDraft {
    JointDraft {
        name,
        kind,
        parent,
        child,
        parent_from_joint,
        axis: Vec3::z(),
        limits: Limits::default(),
        mimic: None,
        at,
    }
}
