//! Parameters of a calibration, and the gauge that fixes unobservable ones.
//!
//! Deviations along or about a joint's axis have the same effect before and after the joint (for a
//! prismatic joint: all translations and the rotation about its axis). By convention they belong to the
//! frame before it. This leaves the minimal 4n + 6 parameters for n revolute joints (Everett, Driels and
//! Mooring, *Kinematic modelling for robot calibration*, ICRA 1987).

use super::{CalibrationStream, LinkParameter};
use ground::geometry::{Pose, Vec3};
use ground::robot::LinkPath;
use nalgebra::{DMatrix, DVector};

use crate::priors::FREE_PRIOR;
/// 0.1° per mm.
pub(super) use crate::priors::RAD_PER_M;

/// Shared links and zeros come first.
pub(super) struct CalibrationParameters {
    pub links: Vec<LinkParameter>,
    /// Joints with a free zero.
    pub zeros: Vec<usize>,
    /// First parameter per stream, then the total.
    starts: Vec<usize>,
    joints: usize,
    free_parameters: Vec<FreeStreamParameters>,
    base_from_first: Vec<Pose>,
}

#[derive(Clone, Copy)]
pub(super) struct FreeStreamParameters {
    pub latency: bool,
    pub reference: bool,
    pub tool: bool,
}

impl FreeStreamParameters {
    fn width(self) -> usize {
        usize::from(self.latency) + 6 * (usize::from(self.reference) + usize::from(self.tool))
    }
}

impl CalibrationParameters {
    pub fn new(
        path: &LinkPath,
        streams: &[CalibrationStream],
        paths: &[LinkPath],
        zeros: Vec<usize>,
    ) -> Self {
        let joints = path.axes.len();
        let own: Vec<FreeStreamParameters> = streams
            .iter()
            .map(|stream| FreeStreamParameters {
                latency: stream.latency_is_free,
                reference: stream.reference_is_free,
                tool: stream.tool_is_free || !path.can_deviate(joints),
            })
            .collect();
        let mut links = Vec::new();
        for link in 0..=joints {
            let is_seen = match link {
                0 => own.iter().any(|own| !own.reference),
                _ if link == joints => own.iter().any(|own| !own.tool),
                _ => true,
            };
            if !is_seen || !path.can_deviate(link) {
                continue;
            }
            for turns in [false, true] {
                for direction in distinguishable_axes(path, link, turns) {
                    links.push(LinkParameter {
                        link,
                        is_rotation: turns,
                        direction: direction.into(),
                    });
                }
            }
        }
        let mut starts = vec![links.len() + zeros.len()];
        for own in &own {
            starts.push(starts[starts.len() - 1] + own.width());
        }
        let base_from_first = paths.iter().map(|path| path.base_from_first).collect();
        Self { links, zeros, starts, joints, free_parameters: own, base_from_first }
    }

    /// Number of parameters.
    pub fn width(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// Number of shared parameters.
    pub fn shared(&self) -> usize {
        self.starts[0]
    }

    pub fn free_parameters_of(&self, stream: usize) -> FreeStreamParameters {
        self.free_parameters[stream]
    }

    /// Precision per parameter.
    pub fn prior(&self, link_m: f64) -> Vec<f64> {
        let links = self.links.iter().map(|one| match one.is_rotation {
            true => (RAD_PER_M * link_m).powi(-2),
            false => link_m.powi(-2),
        });
        let rest = self.width() - self.links.len();
        links.chain(std::iter::repeat_n(FREE_PRIOR.powi(-2), rest)).collect()
    }

    /// Prior of a nominal model's shared parameters. Zeros have the prior of link angles.
    pub fn nominal_covariance(&self, link_m: f64) -> DMatrix<f64> {
        let mut precision = self.prior(link_m);
        precision.truncate(self.shared());
        precision[self.links.len()..].fill((RAD_PER_M * link_m).powi(-2));
        DMatrix::from_diagonal(&DVector::from_vec(precision).map(f64::recip))
    }

    /// Maps parameters to columns of `nominal_model::link_frames`: reference, each joint's child
    /// link, latency, zeros.
    pub fn columns_of(&self, stream: usize) -> DMatrix<f64> {
        let own = self.free_parameters[stream];
        let mut columns =
            self.shared_columns_where(stream, own).resize_horizontally(self.width(), 0.0);
        let latency = 6 * (self.joints + 1);
        let mut at = self.starts[stream];
        let mut frame = |link: usize, is_free: bool| {
            if is_free {
                (0..6).for_each(|axis| columns[(6 * link + axis, at + axis)] = 1.0);
                at += 6;
            }
        };
        frame(0, own.reference);
        frame(self.joints, own.tool);
        if own.latency {
            columns[(latency, at)] = 1.0;
        }
        columns
    }

    /// Maps the shared parameters, with known frames.
    pub fn shared_columns(&self, stream: usize) -> DMatrix<f64> {
        self.shared_columns_where(
            stream,
            FreeStreamParameters { latency: false, reference: false, tool: false },
        )
    }

    fn shared_columns_where(&self, stream: usize, own: FreeStreamParameters) -> DMatrix<f64> {
        let latency = 6 * (self.joints + 1);
        let mut columns = DMatrix::zeros(latency + 1 + self.joints, self.shared());
        for (at, one) in self.links.iter().enumerate() {
            let direction = Vec3::from(one.direction);
            let (shift, turn) = match one.is_rotation {
                true => (Vec3::zeros(), direction),
                false => (direction, Vec3::zeros()),
            };
            let (shift, turn) = match one.link {
                0 if own.reference => continue,
                0 => {
                    // Transform to the stream's reference, where the columns are derivatives.
                    let frame = &self.base_from_first[stream];
                    let turn = frame.rotation * turn;
                    (frame.rotation * shift + frame.translation.vector.cross(&turn), turn)
                }
                link if link == self.joints && own.tool => continue,
                _ => (shift, turn),
            };
            for axis in 0..3 {
                columns[(6 * one.link + axis, at)] = shift[axis];
                columns[(6 * one.link + 3 + axis, at)] = turn[axis];
            }
        }
        for (at, &joint) in self.zeros.iter().enumerate() {
            columns[(latency + 1 + joint, self.links.len() + at)] = 1.0;
        }
        columns
    }

    /// Translation in m, rotation vector in rad.
    pub fn deviations(&self, values: &[f64]) -> Vec<[f64; 6]> {
        let mut all = vec![[0.0; 6]; self.joints + 1];
        for (one, value) in self.links.iter().zip(values) {
            let first = if one.is_rotation { 3 } else { 0 };
            for (axis, part) in one.direction.iter().enumerate() {
                all[one.link][first + axis] += part * value;
            }
        }
        all
    }

    /// A stream's own parameters.
    pub fn stream_range(&self, stream: usize) -> std::ops::Range<usize> {
        self.starts[stream]..self.starts[stream + 1]
    }
}

/// Unit vectors along which a link's deviation is distinguishable from one before its joint.
pub(super) fn distinguishable_axes(path: &LinkPath, link: usize, turns: bool) -> Vec<Vec3> {
    let all = || (0..3).map(|axis| Vec3::ith(axis, 1.0)).collect();
    if link == 0 {
        return all();
    }
    let axis = path.axes[link - 1];
    if path.slides[link - 1] && !turns {
        return Vec::new();
    }
    let along = axis.iamax();
    if axis[along].abs() > 1.0 - 1e-9 {
        return (0..3).filter(|&other| other != along).map(|other| Vec3::ith(other, 1.0)).collect();
    }
    let first = axis.cross(&Vec3::ith(axis.iamin(), 1.0)).normalize();
    vec![first, axis.cross(&first)]
}
