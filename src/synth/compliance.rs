//! Joint compliance: backlash, sag, eccentric gears, vibration.

use std::f64::consts::TAU;

use super::motion::Trajectory;
use crate::robot::Chain;

/// Joint compliance: `q_true = q_reported + bend`. Pose stream and IMU use the true position, /tf the
/// reported one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SynthCompliance {
    /// Joint, from the base.
    pub joint: usize,
    /// Its kind.
    pub kind: SynthComplianceKind,
    /// Full backlash, maximum sag, or amplitude, rad.
    pub amplitude_rad: f64,
}

/// Kind of joint compliance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SynthComplianceKind {
    /// Backlash; the link follows after the gap.
    Backlash,
    /// Backlash of a loaded link, which crosses the gap at once on reversal.
    LoadedBacklash,
    /// Proportional to the gravity torque.
    Sag,
    /// Periods per turn.
    Eccentricity(u32),
    /// Vibration of the link, Hz.
    Vibration(f64),
}

pub(super) struct ComplianceMotion {
    joints: Vec<(usize, Vec<f64>)>,
}

impl ComplianceMotion {
    /// Sampling period, and lead before the run, s.
    const STEP_S: f64 = 1e-3;
    const LEAD_S: f64 = 1.0;

    pub(super) fn new(
        compliance: &[SynthCompliance],
        trajectory: &Trajectory,
        chain: &Chain,
        long_s: f64,
    ) -> Self {
        let rows =
            if compliance.is_empty() { 0 } else { (long_s + 2.0 * Self::LEAD_S) as usize * 1000 };
        let positions: Vec<Vec<f64>> = (0..rows)
            .map(|row| trajectory.joints_at(row as f64 * Self::STEP_S - Self::LEAD_S).0)
            .collect();
        let bend = |compliance: &SynthCompliance| {
            let own = || positions.iter().map(|q| q[compliance.joint]);
            let deflections: Vec<f64> = match compliance.kind {
                SynthComplianceKind::Backlash => {
                    let half = 0.5 * compliance.amplitude_rad;
                    let mut link = positions.first().map_or(0.0, |q| q[compliance.joint]);
                    own()
                        .map(|encoder| {
                            link = f64::clamp(link, encoder - half, encoder + half);
                            link - encoder
                        })
                        .collect()
                }
                SynthComplianceKind::LoadedBacklash => {
                    const CROSSING_S: f64 = 0.05;
                    let most = compliance.amplitude_rad * Self::STEP_S / CROSSING_S;
                    let mut before = positions.first().map_or(0.0, |q| q[compliance.joint]);
                    let (mut end, mut behind) = (0.0, 0.0);
                    own()
                        .map(|encoder| {
                            if encoder != before {
                                end = 0.5 * compliance.amplitude_rad * (before - encoder).signum();
                            }
                            before = encoder;
                            behind += f64::clamp(end - behind, -most, most);
                            behind
                        })
                        .collect()
                }
                SynthComplianceKind::Sag => {
                    let torque = positions.iter().map(|q| torque(chain, q, compliance.joint));
                    let torque: Vec<f64> = torque.collect();
                    let most = torque.iter().fold(0.0_f64, |most, torque| most.max(torque.abs()));
                    torque
                        .into_iter()
                        .map(|torque| compliance.amplitude_rad * torque / most)
                        .collect()
                }
                SynthComplianceKind::Eccentricity(order) => own()
                    .map(|q| compliance.amplitude_rad * (f64::from(order) * q + 0.7).sin())
                    .collect(),
                SynthComplianceKind::Vibration(hz) => {
                    let time_s = (0..rows).map(|row| row as f64 * Self::STEP_S);
                    time_s
                        .map(|time_s| compliance.amplitude_rad * (TAU * hz * time_s).sin())
                        .collect()
                }
            };
            (compliance.joint, deflections)
        };
        Self { joints: compliance.iter().map(bend).collect() }
    }

    /// To positions and velocities of the encoders.
    pub(super) fn add(&self, time_s: f64, positions: &mut [f64], velocities: &mut [f64]) {
        for (joint, deflections) in &self.joints {
            let at = ((time_s + Self::LEAD_S) / Self::STEP_S).max(0.0);
            let row = (at as usize).min(deflections.len().saturating_sub(2));
            let rise = deflections[row + 1] - deflections[row];
            positions[*joint] += deflections[row] + (at - row as f64) * rise;
            velocities[*joint] += rise / Self::STEP_S;
        }
    }
}

/// N·m per g, from the change of height with the joint angle. Link masses are midway between the joints;
/// the tool has 1 kg.
fn torque(chain: &Chain, q: &[f64], joint: usize) -> f64 {
    const LINK_MASSES_KG: [f64; 7] = [4.0, 3.0, 2.0, 2.0, 1.0, 1.0, 1.0];
    const STEP_RAD: f64 = 1e-5;
    let moment = |amplitude_rad: f64| -> f64 {
        let mut q = q.to_vec();
        q[joint] += amplitude_rad;
        let mut frames = Vec::new();
        chain.joint_frames(&q, &mut frames);
        frames.push(chain.forward(&q));
        let heights: Vec<f64> = frames.iter().map(|frame| frame.translation.vector.z).collect();
        let links =
            heights.windows(2).zip(LINK_MASSES_KG).map(|(ends, kg)| kg * 0.5 * (ends[0] + ends[1]));
        links.sum::<f64>() + heights[heights.len() - 1]
    };
    (moment(-STEP_RAD) - moment(STEP_RAD)) / (2.0 * STEP_RAD)
}
