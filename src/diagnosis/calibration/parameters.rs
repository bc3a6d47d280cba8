//! Which numbers a calibration estimates, and what is fixed by convention because no log can tell it.
//!
//! What a joint turns about or slides along may stand before the joint or after it, and no pose tells
//! which: a turn about and a shift along a turning joint's axis, all shifts and the turn about a
//! sliding joint's. They stand before it, in the origin of that joint. So 4n + 6 numbers are left of
//! n turning joints, as many as there are (Everett, Driels and Mooring, *Kinematic modelling for robot
//! calibration*, ICRA 1987).

use super::{CalibrationStream, LinkParameter};
use ground::geometry::{Pose, Vec3};
use ground::robot::LinkPath;
use nalgebra::{DMatrix, DVector};

/// The angle that a link is off where it is off by a length, rad/m: 0.1° to 1 mm.
pub(super) use crate::drawing::RAD_PER_M;
use crate::nominal::ANYTHING;

/// The parameters of all streams of one arm: links and zeros first, which they share.
pub(super) struct Parameters {
    /// What each of the links' parameters is.
    pub links: Vec<LinkParameter>,
    /// The joints of the chain whose zero is free.
    pub zeros: Vec<usize>,
    /// Where the own parameters of each stream begin, and the end of the last.
    starts: Vec<usize>,
    joints: usize,
    own: Vec<Own>,
    base_from_first: Vec<Pose>,
}

/// Which of a stream's own parameters are free.
#[derive(Clone, Copy)]
pub(super) struct Own {
    pub latency: bool,
    pub reference: bool,
    pub tool: bool,
}

impl Own {
    fn width(self) -> usize {
        usize::from(self.latency) + 6 * (usize::from(self.reference) + usize::from(self.tool))
    }
}

impl Parameters {
    pub fn of(
        path: &LinkPath,
        streams: &[CalibrationStream],
        paths: &[LinkPath],
        zeros: Vec<usize>,
    ) -> Self {
        let joints = path.axes.len();
        let own: Vec<Own> = streams
            .iter()
            .map(|stream| Own {
                latency: stream.latency_is_free,
                reference: stream.reference_is_free,
                tool: stream.tool_is_free || !path.carries(joints),
            })
            .collect();
        let mut links = Vec::new();
        for link in 0..=joints {
            let is_seen = match link {
                0 => own.iter().any(|own| !own.reference),
                _ if link == joints => own.iter().any(|own| !own.tool),
                _ => true,
            };
            if !is_seen || !path.carries(link) {
                continue;
            }
            for turns in [false, true] {
                for direction in told(path, link, turns) {
                    links.push(LinkParameter { link, turns, direction: direction.into() });
                }
            }
        }
        let mut starts = vec![links.len() + zeros.len()];
        for own in &own {
            starts.push(starts[starts.len() - 1] + own.width());
        }
        let base_from_first = paths.iter().map(|path| path.base_from_first).collect();
        Self { links, zeros, starts, joints, own, base_from_first }
    }

    /// Number of parameters.
    pub fn width(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// How many of them the streams share.
    pub fn shared(&self) -> usize {
        self.starts[0]
    }

    pub fn own(&self, stream: usize) -> Own {
        self.own[stream]
    }

    /// The precision of each parameter before the log is known, where links are off by `link_m`.
    pub fn prior(&self, link_m: f64) -> Vec<f64> {
        let links = self.links.iter().map(|one| match one.turns {
            true => (RAD_PER_M * link_m).powi(-2),
            false => link_m.powi(-2),
        });
        let rest = self.width() - self.links.len();
        links.chain(std::iter::repeat_n(ANYTHING.powi(-2), rest)).collect()
    }

    /// The covariance of the shared parameters of a drawing from which links are off by `link_m`, zeros
    /// as any angle of theirs.
    pub fn of_drawing(&self, link_m: f64) -> DMatrix<f64> {
        let mut precision = self.prior(link_m);
        precision.truncate(self.shared());
        precision[self.links.len()..].fill((RAD_PER_M * link_m).powi(-2));
        DMatrix::from_diagonal(&DVector::from_vec(precision).map(f64::recip))
    }

    /// What each parameter changes of the columns of [`crate::nominal::link_frames`] of a stream: its
    /// reference, each child link of a joint, the latency, the zeros.
    pub fn columns_of(&self, stream: usize) -> DMatrix<f64> {
        let own = self.own[stream];
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

    /// The same of the parameters that streams share, in frames that are known.
    pub fn shared_columns(&self, stream: usize) -> DMatrix<f64> {
        self.shared_columns_where(stream, Own { latency: false, reference: false, tool: false })
    }

    fn shared_columns_where(&self, stream: usize, own: Own) -> DMatrix<f64> {
        let latency = 6 * (self.joints + 1);
        let mut columns = DMatrix::zeros(latency + 1 + self.joints, self.shared());
        for (at, one) in self.links.iter().enumerate() {
            let direction = Vec3::from(one.direction);
            let (shift, turn) = match one.turns {
                true => (Vec3::zeros(), direction),
                false => (direction, Vec3::zeros()),
            };
            let (shift, turn) = match one.link {
                0 if own.reference => continue,
                0 => {
                    // The columns are about the stream's reference, the link's own frame is fixed in it.
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

    /// The deviation of each link, of all parameters: translation in m, rotation vector in rad.
    pub fn deviations(&self, values: &[f64]) -> Vec<[f64; 6]> {
        let mut all = vec![[0.0; 6]; self.joints + 1];
        for (one, value) in self.links.iter().zip(values) {
            let first = if one.turns { 3 } else { 0 };
            for (axis, part) in one.direction.iter().enumerate() {
                all[one.link][first + axis] += part * value;
            }
        }
        all
    }

    /// The parameters of a stream's own among all of them.
    pub fn of_stream(&self, stream: usize) -> std::ops::Range<usize> {
        self.starts[stream]..self.starts[stream + 1]
    }
}

/// The directions in which the frame of `link` may be off so that poses tell it from a deviation before
/// its joint: unit vectors in the link.
pub(super) fn told(path: &LinkPath, link: usize, turns: bool) -> Vec<Vec3> {
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
