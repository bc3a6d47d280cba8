//! Orientation errors beyond drift, jumps and random walk: a slip in the mount, a heading-dependent yaw
//! error, or an exponential warm-up. Hard and soft iron act at the first and second harmonic of the
//! heading, as in a ship's compass.

use super::super::estimates::{HeadingError, ImuMountChange, YawWarmUp};
use super::super::extension_tests::{ExtensionTests, ModelExtension};
use super::super::solve::Solved;
use super::super::yaw;
use super::{OrientationModel, OrientationSolution};
use crate::Measured;
use crate::priors::MODEL_ERROR_RAD;
use crate::solver::linear::Linear;
use ground::geometry::{Rotation, Vec3, rotvec_from_rotation};

/// Linear combination of given functions.
#[derive(Clone)]
pub(super) struct YawTerm {
    kind: YawTermKind,
    /// Per function, one value per row.
    pub weights: Vec<Vec<f64>>,
    pub sizes_rad: Vec<f64>,
}

#[derive(Clone, Copy, PartialEq)]
enum YawTermKind {
    /// Harmonics of this IMU axis' heading.
    Heading(usize),
    /// Time constant, s.
    WarmUp(f64),
}

impl YawTerm {
    fn new(kind: YawTermKind, weights: Vec<Vec<f64>>) -> Self {
        Self { kind, sizes_rad: vec![0.0; weights.len()], weights }
    }

    /// Yaw error at a row, rad.
    pub fn at(&self, row: usize) -> f64 {
        self.weights.iter().zip(&self.sizes_rad).map(|(weight, size)| weight[row] * size).sum()
    }
}

impl<'a> OrientationModel<'a> {
    pub(super) fn first_jump(&self) -> usize {
        Self::TERM_COLUMNS_START + self.terms.iter().map(|term| term.sizes_rad.len()).sum::<usize>()
    }

    pub(super) fn mount_at(&self, t_s: f64) -> Rotation {
        match &self.slip {
            Some((at_s, _, slip)) if t_s > *at_s => self.link_from_imu * slip,
            _ => self.link_from_imu,
        }
    }

    /// Free parameters without changes.
    fn constant_parameters(moves: bool) -> Vec<usize> {
        let moving = [Self::LATENCY, Self::SKEW].into_iter().filter(move |_| moves);
        Self::WORLD.chain([Self::DRIFT]).chain(Self::MOUNT).chain(moving).collect()
    }

    fn stamps(&self, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|&row| self.link.stream.track.t_s[self.rows[row]]).collect()
    }

    /// `None` unless the slip is likelier than a constant mount, a jump of the world frame and a heading error.
    pub(super) fn with_mount_slip(&self, moves: bool) -> Option<Self> {
        let (linear, rows) = self.linearized();
        let tests = self.extension_tests(&linear, &rows, moves);
        let mount: Vec<usize> = Self::MOUNT.collect();
        let slip = tests.step(&mount).filter(ModelExtension::is_likelier)?;
        let world: Vec<usize> = Self::WORLD.collect();
        let headings = self.headings_by_axis(&rows).into_iter();
        let headings =
            headings.filter_map(|(_, weights)| tests.best_extension(&Self::YAW, &weights));
        let mut alternatives = tests.step(&world).into_iter().chain(headings);
        let change = Some((slip.at_s, slip.interval_s, Rotation::identity()));
        alternatives
            .all(|other| slip.log_bayes_factor > other.log_bayes_factor)
            .then(|| Self { slip: change, ..self.clone() })
    }

    fn extension_tests<'t>(
        &self,
        linear: &'t Linear,
        rows: &[usize],
        moves: bool,
    ) -> ExtensionTests<'t> {
        let base = Self::constant_parameters(moves);
        ExtensionTests::new(linear, self.stamps(rows), &base, MODEL_ERROR_RAD)
    }

    pub(super) fn longer_side(&self) -> (f64, f64) {
        match self.slip {
            Some((at_s, ..)) if at_s > self.link.middle_s => (f64::NEG_INFINITY, at_s),
            Some((at_s, ..)) => (at_s, f64::INFINITY),
            None => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    pub(super) fn mount_change(&self, solved: &Solved) -> Option<ImuMountChange> {
        let (at_s, interval_s, slip) = self.slip?;
        let columns: Vec<usize> = Self::SLIP.collect();
        let size_rad = solved.length(&columns, rotvec_from_rotation(&slip).as_slice()).ok()?;
        let link_from_imu = self.link_from_imu * slip;
        Some(ImuMountChange { at_s, interval_s, link_from_imu, size_rad })
    }

    /// World rotation about the vertical.
    const YAW: [usize; 1] = [Self::WORLD.start + 2];

    /// `None` unless the term is likelier than no term and a jump, and removes most of the walk without adding
    /// jumps.
    pub(super) fn with_yaw_term(&self, moves: bool) -> Option<(Self, OrientationSolution<'a>)> {
        /// Share of the walk that remains.
        const MAX_WALK_SHARE: f64 = 0.3;
        let (linear, rows) = self.linearized();
        let tests = self.extension_tests(&linear, &rows, moves);
        let headings = self.headings_by_axis(&rows).into_iter().filter_map(|(axis, weights)| {
            let extension = tests.best_extension(&Self::YAW, &weights)?;
            Some((extension, YawTermKind::Heading(axis)))
        });
        let decay = tests.decay(&Self::YAW).map(|decay| {
            let kind = YawTermKind::WarmUp(decay.at_s);
            (decay, kind)
        });
        let (best, kind) = headings
            .chain(decay)
            .max_by(|(a, _), (b, _)| a.log_bayes_factor.total_cmp(&b.log_bayes_factor))?;
        let is_likelier_than_jump =
            tests.step(&Self::YAW).is_none_or(|jump| best.log_bayes_factor > jump.log_bayes_factor);
        if !best.is_likelier() || !is_likelier_than_jump {
            return None;
        }
        let before = yaw::decompose_yaw(&self.yaw_without_terms()).parts;
        let mut model = self.with_term(kind);
        let mut solution = model.fit(moves);
        if matches!(kind, YawTermKind::Heading(_)) {
            model = Self { terms: Vec::new(), ..solution.model }.with_term(kind);
            solution = model.fit(moves);
        }
        let after = yaw::decompose_yaw(&solution.model.yaw_without_terms()).parts;
        let walk = before.walk_rad_per_sqrt_s.unwrap_or(f64::INFINITY);
        let is_steady =
            after.walk_rad_per_sqrt_s.is_none_or(|walk_after| walk_after < MAX_WALK_SHARE * walk);
        (is_steady && after.jumps.len() <= before.jumps.len()).then_some((model, solution))
    }

    fn with_term(&self, kind: YawTermKind) -> Self {
        let rows: Vec<usize> = (0..self.rows.len()).collect();
        let weights = match kind {
            YawTermKind::Heading(axis) => self
                .headings_by_axis(&rows)
                .into_iter()
                .find(|(term_axis, _)| *term_axis == axis)
                .map(|(_, weights)| weights)
                .unwrap_or_default(),
            YawTermKind::WarmUp(tau_s) => {
                let t_s = self.stamps(&rows);
                let first_s = t_s.first().copied().unwrap_or_default();
                vec![t_s.iter().map(|t_s| (-(t_s - first_s) / tau_s).exp()).collect()]
            }
        };
        let terms = self.terms.iter().cloned().chain([YawTerm::new(kind, weights)]).collect();
        Self { terms, ..self.clone() }
    }

    /// Harmonics per IMU axis.
    fn headings_by_axis(&self, rows: &[usize]) -> Vec<(usize, Vec<Vec<f64>>)> {
        let t_s = self.stamps(rows);
        let mut buffers = self.link.buffers();
        let by_fk: Vec<Rotation> = t_s
            .iter()
            .map(|stamp| {
                let link_state = self.link.at(self.delay.truth_s(*stamp), &mut buffers);
                let rotation =
                    link_state.map_or(Rotation::identity(), |link_state| link_state.rotation);
                self.world_from_base * rotation * self.mount_at(*stamp)
            })
            .collect();
        let heading = |axis: usize| -> Vec<f64> {
            let points = by_fk.iter().map(|rotation| rotation * Vec3::ith(axis, 1.0));
            points.map(|points| points.y.atan2(points.x)).collect()
        };
        let harmonics = |axis: usize| -> Vec<Vec<f64>> {
            let heading = heading(axis);
            let function = |of: fn(f64) -> f64| heading.iter().map(|one| of(*one)).collect();
            vec![
                function(f64::sin),
                function(f64::cos),
                function(|one| (2.0 * one).sin()),
                function(|one| (2.0 * one).cos()),
            ]
        };
        (0..3).map(|axis| (axis, harmonics(axis))).collect()
    }

    pub(super) fn term_estimates(
        &self,
        solved: &Solved,
    ) -> (Option<HeadingError>, Option<YawWarmUp>) {
        let (mut heading, mut warm_up) = (None, None);
        let mut column = Self::TERM_COLUMNS_START;
        for term in &self.terms {
            let columns: Vec<usize> = (column..column + term.sizes_rad.len()).collect();
            column += columns.len();
            match term.kind {
                YawTermKind::Heading(axis) => {
                    let errors = (0..self.rows.len()).map(|row| (row, term.at(row)));
                    let min = errors.clone().min_by(|a, b| a.1.total_cmp(&b.1));
                    let max = errors.max_by(|a, b| a.1.total_cmp(&b.1));
                    heading = min.zip(max).and_then(|(min, max)| {
                        let half = |weight: &Vec<f64>| 0.5 * (weight[max.0] - weight[min.0]);
                        let along: Vec<f64> = term.weights.iter().map(half).collect();
                        let half = 0.5 * (max.1 - min.1);
                        let amplitude_rad =
                            solved.measure_combination(&columns, &along, half).ok()?;
                        Some(HeadingError { amplitude_rad, axis })
                    });
                }
                YawTermKind::WarmUp(time_constant_s) => {
                    let size = solved.measure(columns[0], term.sizes_rad[0]);
                    warm_up = size.ok().map(|size| {
                        let times = |by: f64| Measured {
                            value: size.value * by,
                            std_error: size.std_error * by.abs(),
                            ..size
                        };
                        YawWarmUp {
                            time_constant_s,
                            turned_rad: times(-1.0),
                            at_first_rad_s: times(-1.0 / time_constant_s),
                        }
                    });
                }
            }
        }
        (heading, warm_up)
    }
}
