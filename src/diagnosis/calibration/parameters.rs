//! Parameters of a calibration, and the gauge that fixes unobservable ones.
//!
//! Deviations along or about a joint's axis have the same effect before and after the joint (for a
//! prismatic joint: all translations and the rotation about its axis). By convention they belong to the
//! frame before it. A rotation about the next joint's axis is that joint's zero, if it is free. This leaves the minimal 4n + 6 parameters for n revolute joints (Everett, Driels and
//! Mooring, *Kinematic modelling for robot calibration*, ICRA 1987).

use super::{CalibrationStream, FrameFreedom, LinkParameter};
use ground::geometry::{Pose, Vec3};
use ground::robot::{Chain, LinkPath};
use nalgebra::{DMatrix, DVector};
use std::collections::HashMap;
use std::ops::Range;

use crate::priors::FREE_PRIOR;
/// 0.1° per mm.
pub(super) use crate::priors::RAD_PER_M;

/// Shared links and zeros come first.
pub(super) struct CalibrationParameters {
    pub links: Vec<LinkParameter>,
    /// Joints with a free zero.
    pub zeros: Vec<usize>,
    pub width: usize,
    joints: usize,
    /// Indices of each stream's own parameters of reference, tool and latency. A known one has none, a position
    /// three, a pose six.
    pub streams: Vec<[Range<usize>; 3]>,
    base_from_first: Vec<Pose>,
    /// Derivative of the arm's scale, relative to its nominal size, by each parameter.
    pub scale: DVector<f64>,
}

impl CalibrationParameters {
    pub fn new(
        path: &LinkPath,
        chain: &Chain,
        streams: &[CalibrationStream],
        paths: &[LinkPath],
        zeros: Vec<usize>,
    ) -> Self {
        let joints = path.axes.len();
        let tool_of = |(s, stream): (usize, &CalibrationStream)| match stream.tool_freedom {
            // Above the numbers of shared tools.
            FrameFreedom::Known if !path.can_deviate(joints) => FrameFreedom::Pose(usize::MAX - s),
            given => given,
        };
        let tools: Vec<FrameFreedom> = streams.iter().enumerate().map(tool_of).collect();
        let (next_axes, next_origins) = next_joints(chain);
        let is_zero = |link: usize, direction: &Vec3| {
            zeros.contains(&link) && direction.dot(&next_axes[link]).abs() > 1.0 - 1e-9
        };
        let is_known = |frame: FrameFreedom| frame == FrameFreedom::Known;
        let mut links = Vec::new();
        for link in 0..=joints {
            let is_seen = match link {
                0 => streams.iter().any(|stream| is_known(stream.reference_freedom)),
                _ if link == joints => tools.iter().any(|tool| is_known(*tool)),
                _ => true,
            };
            if !is_seen || !path.can_deviate(link) {
                continue;
            }
            for is_rotation in [false, true] {
                let mut directions = distinguishable_axes(path, link, is_rotation);
                directions.retain(|direction| !(is_rotation && is_zero(link, direction)));
                let parameter = |direction: Vec3| LinkParameter {
                    link,
                    is_rotation,
                    direction: direction.into(),
                };
                links.extend(directions.into_iter().map(parameter));
            }
        }
        let mut next = links.len() + zeros.len();
        let mut allocate = |width: usize| {
            next += width;
            next - width..next
        };
        // Streams can share references and tools.
        let [mut references, mut own_tools] = [(); 2].map(|()| HashMap::new());
        let mut own = Vec::with_capacity(streams.len());
        for (stream, tool) in streams.iter().zip(tools) {
            let mut range = |frames: &mut HashMap<FrameFreedom, Range<usize>>, frame| {
                frames.entry(frame).or_insert_with(|| allocate(frame.width())).clone()
            };
            let reference = range(&mut references, stream.reference_freedom);
            let tool = range(&mut own_tools, tool);
            own.push([reference, tool, allocate(usize::from(stream.latency_is_free))]);
        }
        let base_from_first = paths.iter().map(|path| path.base_from_first).collect();
        // A uniform scale lengthens each link along its nominal length.
        let mut scale = DVector::zeros(next);
        for (along, one) in scale.iter_mut().zip(&links).filter(|(_, one)| !one.is_rotation) {
            let length = next_origins.get(one.link).copied().unwrap_or_default();
            *along = Vec3::from(one.direction).dot(&length);
        }
        let squares = scale.norm_squared();
        if squares > 0.0 {
            scale /= squares;
        }
        Self { links, zeros, width: next, joints, streams: own, base_from_first, scale }
    }

    /// Number of shared parameters.
    pub fn shared(&self) -> usize {
        self.links.len() + self.zeros.len()
    }

    /// Precision per parameter.
    pub fn prior(&self, link_m: f64) -> DVector<f64> {
        let std_deviation = |at: usize| match self.links.get(at) {
            Some(one) if one.is_rotation => RAD_PER_M * link_m,
            Some(_) => link_m,
            None => FREE_PRIOR,
        };
        DVector::from_fn(self.width, |at, _| std_deviation(at).powi(-2))
    }

    /// Prior of a nominal model's shared parameters. Zeros have the prior of link angles.
    pub fn nominal_covariance(&self, link_m: f64) -> DMatrix<f64> {
        let mut precision = self.prior(link_m).rows(0, self.shared()).into_owned();
        precision.rows_range_mut(self.links.len()..).fill((RAD_PER_M * link_m).powi(-2));
        DMatrix::from_diagonal(&precision.map(f64::recip))
    }

    /// Maps parameters to columns of `nominal_model::link_frames`: reference, each joint's child
    /// link, latency, zeros.
    pub fn columns_of(&self, stream: usize) -> DMatrix<f64> {
        let [reference, tool, latency] = &self.streams[stream];
        let are_free = [reference, tool].map(|frame| !frame.is_empty());
        let mut columns =
            self.shared_columns(stream, are_free).resize_horizontally(self.width, 0.0);
        let latency_row = 6 * (self.joints + 1);
        for (row, own) in [(0, reference), (6 * self.joints, tool), (latency_row, latency)] {
            for (axis, parameter) in own.clone().enumerate() {
                columns[(row + axis, parameter)] = 1.0;
            }
        }
        columns
    }

    /// Maps the shared parameters of a stream, whose own reference and tool may be free.
    pub fn shared_columns(
        &self,
        stream: usize,
        [is_reference_free, is_tool_free]: [bool; 2],
    ) -> DMatrix<f64> {
        let latency = 6 * (self.joints + 1);
        let mut columns = DMatrix::zeros(latency + 1 + self.joints, self.shared());
        for (at, one) in self.links.iter().enumerate() {
            if (one.link == 0 && is_reference_free) || (one.link == self.joints && is_tool_free) {
                continue;
            }
            let direction = Vec3::from(one.direction);
            let (mut shift, mut turn) = match one.is_rotation {
                true => (Vec3::zeros(), direction),
                false => (direction, Vec3::zeros()),
            };
            if one.link == 0 {
                // Transform to the stream's reference, where the columns are derivatives.
                let frame = &self.base_from_first[stream];
                turn = frame.rotation * turn;
                shift = frame.rotation * shift + frame.translation.vector.cross(&turn);
            }
            columns.fixed_view_mut::<3, 1>(6 * one.link, at).copy_from(&shift);
            columns.fixed_view_mut::<3, 1>(6 * one.link + 3, at).copy_from(&turn);
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
}

/// Axis and origin of the joint after each link, in that link. The base comes first.
fn next_joints(chain: &Chain) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut frames = Vec::new();
    chain.joint_frames(&vec![0.0; chain.dof()], &mut frames);
    let before = std::iter::once(Pose::identity()).chain(frames.iter().copied());
    let both = before.zip(&frames).zip(chain.joint_axes());
    both.map(|((link, next), axis)| {
        let link_from_next = link.inverse() * next;
        (link_from_next.rotation * axis, link_from_next.translation.vector)
    })
    .unzip()
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
