//! Interpretation of the joint states that a search found.

use super::encoding::{JointCoupling, JointEncoding, JointUnit, JointUnitError};
use super::interpreted_poses::ResidualSize;
use super::map::{Coupling, JointMap};
use crate::{PoseStream, UnitResiduals};
use ground::stats::Measured;

pub(super) struct JointInterpretation {
    pub map: JointMap,
    pub residual: ResidualSize,
    /// Next best residual at no higher price.
    pub runner_up_m: Option<f64>,
}

impl JointInterpretation {
    /// The same in the columns of a joint track with `dof` joints. `as_logged` is the position residual as logged, m.
    pub fn encoding(&self, dof: usize, stream: &PoseStream, as_logged: f64) -> JointEncoding {
        /// Relative.
        const SCALE_PRECISION: f64 = 1e-3;
        let PoseStream { chain, columns, .. } = *stream;
        let Self { map, residual, runner_up_m } = self;
        let degree = 1f64.to_radians();
        let is_degree = |factor: f64| (factor / degree - 1.0).abs() < SCALE_PRECISION;
        // Also if some are reversed.
        let is_in_degrees = chain.turning_joints().count() > 1
            && chain.turning_joints().all(|joint| is_degree(map.factor[joint].abs()));
        let unit_errors = (0..map.from.len()).filter_map(|joint| {
            let slides = chain.slides(joint);
            let is_common = is_in_degrees && !slides;
            let factor = map.factor[joint] / if is_common { degree } else { 1.0 };
            let unit = match factor {
                1.0 => return None,
                _ if is_common && (factor - 1.0).abs() < SCALE_PRECISION => return None,
                _ if !slides && is_degree(factor) => JointUnit::Degrees,
                1e-3 if slides => JointUnit::Millimetres,
                1e-2 if slides => JointUnit::Centimetres,
                _ => JointUnit::Scaled,
            };
            let factor = if unit == JointUnit::Degrees { degree } else { factor };
            Some(JointUnitError { column: columns[joint], unit, factor })
        });
        let coupling = map.coupling.map(|Coupling { joint, by, factor }| JointCoupling {
            column: columns[joint],
            by: columns[by],
            factor: Measured { value: factor, std_error: 0.0, dof: 1.0 },
        });
        let mut zeros = vec![0.0; dof];
        let mut permutation: Vec<usize> = (0..dof).collect();
        for (joint, &column) in columns.iter().enumerate() {
            zeros[column] = map.zero[joint];
            permutation[columns[map.from[joint]]] = column;
        }
        let is_in_order = map.from.iter().enumerate().all(|(joint, &from)| joint == from);
        JointEncoding {
            is_in_degrees,
            permutation: (!is_in_order).then_some(permutation),
            unit_errors: unit_errors.collect(),
            couplings: coupling.into_iter().collect(),
            zeros,
            residual: Some(UnitResiduals { as_logged, corrected: residual.m }),
            runner_up_m: *runner_up_m,
        }
    }
}
