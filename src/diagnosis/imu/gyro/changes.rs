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

    /// Adds the change that explains most of the residual. `None` if none is significant.
    pub(super) fn with_best_change(&self, moves: bool) -> Option<Self> {
        /// Relative to the residual squares without a change.
        const MAX_RESIDUAL_RATIO: f64 = 0.5;
        /// Relative to those with any other change.
        const MAX_RESIDUAL_RATIO_TO_OTHERS: f64 = 0.8;
        let with_scale_error = Self { has_scale_error: true, ..self.clone() };
        let (linear, t_s) = with_scale_error.linearized();
        let mut base: Vec<usize> = Self::BIAS.chain(self.change_parameters()).collect();
        if moves {
            base.extend(Self::MOUNT.chain(Self::SCALE_ERROR).chain([Self::LATENCY]));
        }
        let tests = ExtensionTests::new(&linear, t_s, &base, FLOOR_RAD_S);
        let if_significant =
            |extension: Option<ModelExtension>| extension.filter(ModelExtension::is_significant);
        let bias: Vec<usize> = Self::BIAS.collect();
        let of_bias = |profile: fn(&ModelExtension) -> GyroBiasProfile,
                       extension: Option<ModelExtension>| {
            let extension = if_significant(extension)?;
            Some((
                extension.residual_squares,
                Self { bias_profile: Some(profile(&extension)), ..self.clone() },
            ))
        };
        let is_constant = self.bias_profile.is_none();
        let step = is_constant.then(|| of_bias(step_profile, tests.step(&bias))).flatten();
        let decay = is_constant.then(|| of_bias(warm_up_profile, tests.decay(&bias))).flatten();
        let mount: Vec<usize> = Self::MOUNT.collect();
        let slip =
            (moves && self.slip.is_none()).then(|| if_significant(tests.step(&mount))).flatten();
        let slip = slip.map(|slip| {
            let change = Some((slip.at_s, slip.interval_s, Rotation::identity()));
            (slip.residual_squares, Self { slip: change, ..self.clone() })
        });
        let of_bias = [step, decay].into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
        let best_alternative =
            of_bias.as_ref().map_or(tests.residual_squares, |(squares, _)| *squares);
        match slip {
            Some((squares, model))
                if squares < MAX_RESIDUAL_RATIO_TO_OTHERS * best_alternative
                    && squares < MAX_RESIDUAL_RATIO * tests.residual_squares =>
            {
                Some(model)
            }
            _ => of_bias.map(|(_, model)| model),
        }
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

fn step_profile(extension: &ModelExtension) -> GyroBiasProfile {
    GyroBiasProfile::Step { at_s: extension.at_s, interval_s: extension.interval_s }
}

fn warm_up_profile(extension: &ModelExtension) -> GyroBiasProfile {
    GyroBiasProfile::WarmUp { time_constant_s: extension.at_s }
}
