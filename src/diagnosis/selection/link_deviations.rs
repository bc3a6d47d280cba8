//! Joint zeros of an arm whose links deviate from the nominal model.
//!
//! A joint zero is reported only if it exceeds the effect of link deviations. The interval of a zero includes the inaccuracy
//! of the nominal model.

use super::deviation_model::{DeviationFit, DeviationModel, DeviationParameter, sizes_m};
use super::model_selection::Cause;
use crate::model::measurement::StreamAt;
use crate::priors::{
    FREE_PRIOR, LINK_PRIOR_M, MAX_LOG_RATIO_OF_CONFOUNDER, MIN_LOG_RATIO_OF_ZERO, ZERO_PRIOR,
};
use crate::{Confounder, Measured};
use ground::stats::MeasuredLength;

/// Zeros with a larger standard error, relative to [`ZERO_PRIOR`], are not observable.
const MAX_STD_ERROR_SHARE: f64 = 0.5;
const MAX_ZEROS: usize = 4;
/// Zeros of several degrees are nonlinear.
const LINEARIZATION_ROUNDS: usize = 4;

/// Joint zeros estimated together with link deviations.
#[derive(Clone, Debug)]
pub(crate) struct LinkDeviations {
    /// Columns of joints with a zero offset, each with the zeros that could replace it.
    pub reported: Vec<(usize, Vec<Confounder>)>,
    /// One per joint of the track, rad or m. `None` if not in the chain or not observable.
    pub zeros: Vec<Option<Measured>>,
    /// Standard deviation of the links, m.
    pub link_m: f64,
    /// Of the link that is displaced most.
    pub largest_displacement: Option<LinkDisplacement>,
}

/// Displacement of a link's outer end from the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkDisplacement {
    /// Columns of the joints at its ends.
    pub joints: [usize; 2],
    /// Size, m.
    pub length_m: Measured,
}

impl LinkDeviations {
    /// Joint offsets plus the reported zeros.
    pub fn with_zeros(&self, offsets: &[f64]) -> Vec<f64> {
        let mut with = offsets.to_vec();
        for &(column, _) in &self.reported {
            with[column] = self.zeros[column].map_or(with[column], |zero| zero.value);
        }
        with
    }

    /// Confounders of a joint's zero. `None` if it is not reported.
    pub fn confounders(&self, column: usize) -> Option<&[Confounder]> {
        self.reported.iter().find(|named| named.0 == column).map(|named| named.1.as_slice())
    }
}

/// Estimates the likeliest zeros and link deviations. The state excludes causes that link deviations imitate.
pub(crate) fn estimate_link_deviations(
    StreamAt { observations, state, offsets }: StreamAt,
) -> Option<LinkDeviations> {
    let mut offsets = offsets.to_vec();
    let mut chosen: Option<DeviationFit> = None;
    for round in 1.. {
        let model = DeviationModel::linearize(observations.at(state, &offsets), 0)?;
        let fit = model.select_zeros(chosen)?;
        let mut next = offsets.clone();
        for &joint in &fit.zeros {
            next[observations.columns[joint]] += model.measured_zero(&fit, joint)?.value;
        }
        let moved = next.iter().zip(&offsets).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if moved < 1e-6 || round == LINEARIZATION_ROUNDS {
            return Some(model.to_link_deviations(&fit, observations.joints.dof, &offsets));
        }
        (offsets, chosen) = (next, Some(fit));
    }
    None
}

impl DeviationModel {
    fn zeros(&self, joints: &[usize]) -> Vec<Cause> {
        joints.iter().map(|&joint| Cause::Zero(self.columns[joint])).collect()
    }

    /// Started from the best common deviation size.
    fn without_zeros(&self) -> Option<DeviationFit> {
        let fit = |link_m| self.fit_with(&[], &self.uniform_sizes(link_m));
        let fits = sizes_m().filter_map(fit);
        let best = fits.max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
        self.maximize_likelihood(&[], &best.sizes_m)
    }

    /// One fit per joint that is not `excluded`.
    fn with_one_more_zero(
        &self,
        zeros: &[usize],
        sizes_m: &[f64],
        excluded: &[usize],
    ) -> Vec<(usize, DeviationFit)> {
        let others = (0..self.joints).filter(|joint| !excluded.contains(joint));
        let with = |joint| {
            let with: Vec<usize> = zeros.iter().copied().chain([joint]).collect();
            Some((joint, self.maximize_likelihood(&self.zeros(&with), sizes_m)?))
        };
        others.filter_map(with).collect()
    }

    /// Selects zeros that exceed link deviations, starting from `before`.
    fn select_zeros(&self, before: Option<DeviationFit>) -> Option<DeviationFit> {
        let mut chosen = match before {
            Some(before) => {
                self.maximize_likelihood(&self.zeros(&before.zeros), &before.sizes_m)?
            }
            None => self.without_zeros()?,
        };
        while chosen.zeros.len() < MAX_ZEROS {
            let with = self.with_one_more_zero(&chosen.zeros, &chosen.sizes_m, &chosen.zeros);
            let with = with.into_iter().map(|(_, with)| with);
            let likeliest = with.max_by(|a, b| a.evidence.total_cmp(&b.evidence));
            let min_evidence = chosen.evidence + MIN_LOG_RATIO_OF_ZERO;
            match likeliest.filter(|likeliest| likeliest.evidence > min_evidence) {
                Some(likeliest) => chosen = likeliest,
                None => break,
            }
        }
        Some(chosen)
    }

    /// Converts `fit` to columns of the joint track.
    fn to_link_deviations(
        &self,
        fit: &DeviationFit,
        dof: usize,
        offsets: &[f64],
    ) -> LinkDeviations {
        let absolute = |fit: &DeviationFit, joint: usize| {
            let zero = self.measured_zero(fit, joint)?;
            Some(Measured { value: offsets[self.columns[joint]] + zero.value, ..zero })
        };
        let mut zeros = vec![None; dof];
        for &joint in &fit.zeros {
            zeros[self.columns[joint]] = absolute(fit, joint);
        }
        for (joint, with) in self.with_one_more_zero(&fit.zeros, &fit.sizes_m, &fit.zeros) {
            zeros[self.columns[joint]] = absolute(&with, joint)
                .filter(|zero| zero.std_error < MAX_STD_ERROR_SHARE * ZERO_PRIOR);
        }
        let confounders_of = |&joint: &usize| {
            let others: Vec<usize> =
                fit.zeros.iter().copied().filter(|zero| *zero != joint).collect();
            let instead = self.with_one_more_zero(&others, &fit.sizes_m, &fit.zeros);
            let as_likely = instead.into_iter().filter(|(_, fit_with_zero)| {
                fit_with_zero.evidence > fit.evidence - MAX_LOG_RATIO_OF_CONFOUNDER
            });
            // An insignificant zero replaces nothing: the scatter of all zeros explains the residual.
            let confounder = |(other, fit_with_zero): (usize, DeviationFit)| {
                let zero = self.measured_zero(&fit_with_zero, other)?;
                let column = self.columns[other];
                (zero.value.abs() > zero.half_width(0.95))
                    .then(|| Confounder::JointZero(column, offsets[column] + zero.value))
            };
            (self.columns[joint], as_likely.filter_map(confounder).collect())
        };
        let links: Vec<usize> = self.groups().filter(|group| *group <= self.joints).collect();
        let squares: f64 = links.iter().map(|link| fit.sizes_m[*link].powi(2)).sum();
        LinkDeviations {
            reported: fit.zeros.iter().map(confounders_of).collect(),
            zeros,
            link_m: (squares / links.len().max(1) as f64).sqrt(),
            largest_displacement: self.largest_displacement(fit),
        }
    }

    /// Beyond the first joint and before the last. Other links are the base and the tool. `None` unless the displacement of
    /// one link alone explains the residual, which usual deviations do not, and no other link is as likely.
    fn largest_displacement(&self, fit: &DeviationFit) -> Option<LinkDisplacement> {
        /// Residual beside usual deviations, relative to that beside the displaced link; not calibrated. Far displacements in
        /// directions that hardly move the tip make a residual smaller, too.
        const MIN_RESIDUAL_RATIO: f64 = 2.0;
        let zeros = self.zeros(&fit.zeros);
        let usual = self.uniform_sizes(self.typical_size_m(&fit.sizes_m).min(LINK_PRIOR_M));
        let links = self.groups().filter(|group| (1..self.joints).contains(group));
        let alone = links.filter_map(|link| {
            let mut sizes_m = usual.clone();
            sizes_m[link] = FREE_PRIOR;
            Some((link, self.fit_with(&zeros, &sizes_m)?))
        });
        let mut alone: Vec<(usize, DeviationFit)> = alone.collect();
        alone.sort_by(|a, b| b.1.evidence.total_cmp(&a.1.evidence));
        let (link, best) = alone.first()?;
        let min_gain = (MIN_RESIDUAL_RATIO.powi(2) - 1.0) * self.dof;
        let is_needed = best.evidence > self.fit_with(&zeros, &usual)?.evidence + min_gain;
        let is_single = alone
            .get(1)
            .is_none_or(|(_, other)| best.evidence > other.evidence + MAX_LOG_RATIO_OF_CONFOUNDER);
        (is_needed && is_single).then(|| {
            let is_own = |&i: &usize| {
                let DeviationParameter { group, unit, .. } = &self.kinds[i];
                *group == Some(*link) && *unit == 1.0
            };
            let own: Vec<usize> = (0..self.kinds.len()).filter(is_own).collect();
            let mean: Vec<f64> = own.iter().map(|&i| best.mean[i]).collect();
            let covariance = best.covariance_columns(&own).select_rows(&own);
            let length_m = MeasuredLength::estimate(&mean, &covariance, self.dof).norm;
            LinkDisplacement { joints: [self.columns[link - 1], self.columns[*link]], length_m }
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::diagnose_arm;
    use crate::test_motion::{arm, chain_with, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use ground::geometry::{Pose, Rotation, Vec3};
    use ground::robot::Chain;

    /// Joints and length, mm, of the link that is displaced most, of an arm that moves like `of`.
    fn largest_displacement(of: &Chain) -> Option<([usize; 2], f64)> {
        let (joints, chain) = arm();
        let mut random = Lcg::new();
        let noisy = |q: &[f64]| {
            let pose = of.forward(q);
            (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
        };
        let track = pose_track(&joints.t_s, joints.q.chunks(6).map(noisy));
        let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
        assert!(found.streams[0].is_nominal);
        let link = found.streams[0].largest_displacement?;
        Some((link.joints, 1e3 * link.length_m.value))
    }

    #[test]
    fn one_link_that_differs_from_the_model_is_found() {
        for link in 2..5 {
            let mut deviations = [Pose::identity(); 7];
            let shift = Vec3::new(3e-3, 0.0, 0.0);
            deviations[link] = Pose::from_parts(shift.into(), Rotation::identity());
            let found = largest_displacement(&chain_with(&deviations));
            let (joints, length_mm) = found.expect("a link");
            assert_eq!(joints, [link - 1, link]);
            assert!((length_mm - 3.0).abs() < 0.3, "{link}: {length_mm}");
        }
        let usual = largest_displacement(&deviating_chain(5e-4));
        assert!(usual.is_none_or(|(_, usual_mm)| usual_mm < 2.0), "{usual:?}");
    }
}
