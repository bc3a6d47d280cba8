//! Calibration as JSON: SI units, `a_from_b` maps coordinates in b to coordinates in a.

use serde_json::{Value, json};

use crate::audit::{CalibrationInput, CalibrationResult, Measurement};
use crate::diagnosis::{
    CalibrationResidual, LinkParameter, StreamCalibration, UndeterminedDirection,
};
use crate::geometry::{Convention, Pose, xyz_of, xyzw_from_rotation};
use crate::robot::CALIBRATION_SCHEMA;
use crate::stats::Measured;

impl CalibrationResult {
    /// Result with all inputs, and whether files are `written`.
    pub fn json(&self, written: bool) -> Value {
        let found = &self.calibration;
        let joints: Vec<Value> = self
            .changed_joints()
            .map(|joint| {
                let origin = &joint.parent_from_joint;
                let (parent, child) = (found.robot.link_name(joint.parent), found.robot.link_name(joint.child));
                let rpy = Convention::RPY.numbers(&origin.rotation);
                json!({"name": joint.name, "parent": parent, "child": child, "xyz": xyz_of(origin), "rpy": rpy})
            })
            .collect();
        let links: Vec<Value> = found
            .links
            .iter()
            .zip(&found.deviations)
            .enumerate()
            .map(|(at, (link, deviation))| {
                let errors = found.std_errors(at);
                json!({
                    "link": link,
                    "xyz": deviation[..3], "rotation_vector": deviation[3..],
                    "std_error_xyz": errors[..3], "std_error_rotation_vector": errors[3..],
                })
            })
            .collect();
        let names = self.parameter_names();
        let parameters: Vec<Value> = names
            .iter()
            .enumerate()
            .map(|(at, name)| {
                let Measured { value, std_error, .. } = found.value(at);
                let parameter = found.parameters.get(at);
                json!({
                    "name": name,
                    "link": parameter.map(|one| &found.links[one.link]),
                    "direction": parameter.map(|one| one.direction),
                    "unit": if parameter.is_none_or(|one| one.is_rotation) { "rad" } else { "m" },
                    "value": value, "std_error": std_error, "ci95": found.value(at).interval(0.95),
                })
            })
            .collect();
        let covariance: Vec<Vec<f64>> =
            found.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
        let streams: Vec<Value> = self
            .streams
            .iter()
            .zip(&found.streams)
            .map(|(taken, stream)| stream_json(taken, stream))
            .collect();
        let undetermined: Vec<Value> =
            found.undetermined.iter().map(|one| self.undetermined_json(one, &names)).collect();
        let still: Vec<Value> = self
            .unmoved
            .iter()
            .map(|one| json!({"joint": one.joint, "moved": one.moved, "unit": if one.slides { "m" } else { "rad" }}))
            .collect();
        let distances: Vec<Value> = self
            .distances
            .iter()
            .zip(&found.distances_m)
            .map(|(known, [before, after])| {
                let logs = known.streams.map(|s| self.streams[s].log.display().to_string());
                json!({"logs": logs, "given_m": known.distance_m, "before_m": before, "after_m": after})
            })
            .collect();
        json!({
            "schema": CALIBRATION_SCHEMA,
            "tool": {"name": "poseaudit", "version": env!("CARGO_PKG_VERSION")},
            "arm": self.nominal.name,
            "model": self.nominal.source,
            "written": written,
            "equals_model": self.equals_nominal,
            "refused": self.rejection,
            "witness": self.source_kind().name(),
            "of": self.subject(),
            "joints": joints,
            "link_m": found.link_m,
            "max_link_m": found.max_link_m,
            "links": links,
            "parameters": parameters,
            "covariance": covariance,
            "workspace": {"expected": residual_json(&found.calibrated_uncertainty), "drawing": residual_json(&found.nominal_uncertainty)},
            "streams": streams,
            "distances": distances,
            "left_out": self.left_out,
            "not_told": undetermined,
            "moved_little": still,
            "plan": self.plan,
            "converged": found.remaining_step.is_none(),
            "last_step": found.remaining_step,
            "conventions": self.conventions(),
        })
    }

    pub(super) fn parameter_names(&self) -> Vec<String> {
        let found = &self.calibration;
        let links = found
            .parameters
            .iter()
            .map(|one| format!("{}.{}", found.links[one.link], axis_name(one)));
        let zeros = found.zeros.iter().map(|&joint| format!("{}.zero", self.joints[joint]));
        links.chain(zeros).collect()
    }

    fn undetermined_json(&self, undetermined: &UndeterminedDirection, names: &[String]) -> Value {
        let parts: Vec<Value> = undetermined
            .parts
            .iter()
            .map(|&(at, share)| json!({"parameter": names[at], "share": share}))
            .collect();
        json!({"parts": parts, "variance_left": undetermined.share, "effect_m": undetermined.effect_m})
    }

    /// Fixed by convention because poses do not determine them.
    pub(super) fn conventions(&self) -> Vec<String> {
        let mut said = vec![
            "a deviation about or along a joint's own axis is assigned to the origin of that joint, not to \
             the one after it"
                .to_owned(),
        ];
        let found = &self.calibration;
        if !found.zeros.is_empty() {
            said.push(
                "a rotation about the axis of the next joint is that joint's zero, if it is estimated"
                    .to_owned(),
            );
        }
        let has = |link: usize| found.parameters.iter().any(|one| one.link == link);
        if !has(0) {
            said.push(format!(
                "the base frame and the zero of {}: they cannot be separated from the frame of the poses, \
                 which is free",
                self.joints.first().map_or("the first joint", String::as_str)
            ));
        }
        if !has(found.links.len() - 1) {
            said.push(format!(
                "the tool frame and the zero of {}: they cannot be separated from the point measured on the \
                 tool, which is free",
                self.joints.last().map_or("the last joint", String::as_str)
            ));
        }
        said
    }
}

fn axis_name(parameter: &LinkParameter) -> String {
    let turn = if parameter.is_rotation { "r" } else { "" };
    let along = parameter.direction.iter().position(|part| part.abs() > 1.0 - 1e-9);
    match along {
        Some(along) => format!("{turn}{}", ["x", "y", "z"][along]),
        None => {
            let [x, y, z] = parameter.direction;
            format!("{turn}({x:.3} {y:.3} {z:.3})")
        }
    }
}

fn residual_json(of: &CalibrationResidual) -> Value {
    json!({"m": finite_or_none(of.m), "rad": finite_or_none(of.rad)})
}

fn finite_or_none(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn frame_json(pose: &Option<Pose>) -> Option<Value> {
    let pose = pose.as_ref()?;
    Some(json!({"xyz": xyz_of(pose), "quaternion_xyzw": xyzw_from_rotation(&pose.rotation)}))
}

fn stream_json(taken: &CalibrationInput, stream: &StreamCalibration) -> Value {
    let is_point = taken.measurement == Measurement::FixedPoint;
    let point = stream.reference.filter(|_| is_point).map(|reference| xyz_of(&reference.inverse()));
    let latency = stream
        .latency_s
        .map(|latency| json!({"value": latency.value, "ci95": latency.interval(0.95)}));
    json!({
        "log": taken.log.display().to_string(), "topic": taken.topic, "witness": taken.source_kind.name(),
        "base": taken.base, "tip": taken.tip, "read_as": taken.encoding, "samples": stream.samples,
        "latency_s": latency, "stream_from_base": frame_json(&stream.reference.filter(|_| !is_point)),
        "fixed_point_in_base": point,
        "tip_from_tool": frame_json(&stream.tool),
        "before": residual_json(&stream.before), "after": residual_json(&stream.after),
        "held_out": {"before": residual_json(&stream.held_out_before), "after": residual_json(&stream.held_out_after)},
        "noise": {"m": finite_or_none(stream.noise[0]), "rad": finite_or_none(stream.noise[1]), "inflation": stream.inflation},
        "joints_moved": stream.spans,
    })
}
