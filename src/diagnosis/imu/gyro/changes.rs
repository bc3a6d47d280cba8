//! Changes of a gyro's bias and mount within the run.

use super::super::estimates::{GyroBiasProfile, ImuMountChange};
use super::super::extension_tests::{ExtensionTests, ModelExtension};
use super::super::solve::Solved;
use super::{FLOOR_RAD_S, GyroModel};
use ground::geometry::{Rotation, Vec3, rotvec_from_rotation};

impl GyroModel<'_> {
    /// Fraction of the bias change in effect, 0 to 1.
    pub(super) fn change_at(&self, t_s: f64) -> f64 {
        match self.bias_profile {
            Some(GyroBiasProfile::Step { at_s, .. }) => f64::from(u8::from(t_s > at_s)),
            Some(GyroBiasProfile::WarmUp { time_constant_s }) => {
                let first_s = self.link.stream.track.t_s.first().copied().unwrap_or(t_s);
                (-(t_s - first_s) / time_constant_s).exp()
            }
            None => 0.0,
        }
    }

    pub(super) fn bias_at(&self, t_s: f64) -> Vec3 {
        self.bias_rad_s + self.changed_rad_s * self.change_at(t_s)
    }

    pub(super) fn mount_at(&self, t_s: f64) -> Rotation {
        match &self.slip {
            Some((at_s, _, slip)) if t_s > *at_s => self.link_from_imu * slip,
            _ => self.link_from_imu,
        }
    }

    /// Adds the likeliest change. `None` if none is likelier than the model without it.
    pub(super) fn with_best_change(&self, moves: bool) -> Option<Self> {
        let with_scale_error = Self { has_scale_error: true, ..self.clone() };
        let (linear, t_s) = with_scale_error.linearized();
        let mut base: Vec<usize> = Self::BIAS.chain(self.change_parameters()).collect();
        if moves {
            base.extend(Self::MOUNT.chain(Self::SCALE_ERROR).chain([Self::LATENCY]));
        }
        let tests = ExtensionTests::new(&linear, t_s, &base, FLOOR_RAD_S);
        let bias: Vec<usize> = Self::BIAS.collect();
        let mount: Vec<usize> = Self::MOUNT.collect();
        let is_constant = self.bias_profile.is_none();
        let with_profile = |profile| Self { bias_profile: Some(profile), ..self.clone() };
        let step = is_constant.then(|| tests.step(&bias)).flatten().map(|step| {
            let ModelExtension { at_s, interval_s, .. } = step;
            (step, with_profile(GyroBiasProfile::Step { at_s, interval_s }))
        });
        let decay = is_constant.then(|| tests.decay(&bias)).flatten().map(|decay| {
            let time_constant_s = decay.at_s;
            (decay, with_profile(GyroBiasProfile::WarmUp { time_constant_s }))
        });
        let slip = (moves && self.slip.is_none()).then(|| tests.step(&mount)).flatten();
        let slip = slip.map(|slip| {
            let change = Some((slip.at_s, slip.interval_s, Rotation::identity()));
            (slip, Self { slip: change, ..self.clone() })
        });
        let (best, model) = [step, decay, slip]
            .into_iter()
            .flatten()
            .max_by(|(a, _), (b, _)| a.log_bayes_factor.total_cmp(&b.log_bayes_factor))?;
        best.is_likelier().then_some(model)
    }

    pub(super) fn change_parameters(&self) -> impl Iterator<Item = usize> + use<> {
        let of_bias = self.bias_profile.is_some().then_some(Self::CHANGE);
        let of_mount = self.slip.is_some().then_some(Self::SLIP);
        of_bias.into_iter().chain(of_mount).flatten()
    }

    pub(super) fn mount_change(&self, solved: &Solved) -> Option<ImuMountChange> {
        let (at_s, interval_s, slip) = self.slip?;
        let columns: Vec<usize> = Self::SLIP.collect();
        let size_rad = solved.length(&columns, rotvec_from_rotation(&slip).as_slice()).ok()?;
        let link_from_imu = self.link_from_imu * slip;
        Some(ImuMountChange { at_s, interval_s, link_from_imu, size_rad })
    }
}
