//! Whether logs carry a calibration of an arm.

use crate::diagnosis::{ArmCalibration, StreamCalibration};
use crate::robot::{JointKind, Robot};

/// A calibration is worth a file where FK is known so many times better by it than by the drawing …
const WORTH: f64 = 2.0;
/// … and what it foretells of poses that it has not seen leaves less than this share of what the
/// drawing does, …
const FORETELLS: f64 = 0.9;
/// … unless there is no more than the noise to foretell.
const NOISE: f64 = 1.1;
/// A joint that moves through less than this tells little of the links beside it, rad and m.
const LITTLE_RAD: f64 = 60.0 * std::f64::consts::PI / 180.0;
const LITTLE_M: f64 = 0.1;

/// A joint whose motion shows little.
#[derive(Clone, Debug)]
pub struct Still {
    /// Its name.
    pub joint: String,
    /// How far it moved, rad or m.
    pub moved: f64,
    /// Whether it slides.
    pub slides: bool,
}

/// The joints that no stream saw move far.
pub(crate) fn still(robot: &Robot, joints: &[String], found: &ArmCalibration) -> Vec<Still> {
    let of = |(at, joint): (usize, &String)| {
        let moved = found
            .streams
            .iter()
            .filter_map(|stream| stream.spans.get(at))
            .fold(0.0, |a: f64, b| a.max(*b));
        let slides = robot.joint(joint).is_some_and(|joint| joint.kind == JointKind::Prismatic);
        let is_little = moved < if slides { LITTLE_M } else { LITTLE_RAD };
        is_little.then(|| Still { joint: joint.clone(), moved, slides })
    };
    joints.iter().enumerate().filter_map(of).collect()
}

/// Why the logs carry no calibration, where they do not.
pub(crate) fn refusal(found: &ArmCalibration, still: &[Still]) -> Option<String> {
    let (known, drawing) = (found.expected.m, found.drawing.m);
    if known.is_nan() || drawing == 0.0 || known * WORTH > drawing {
        let moved = match still {
            [] => String::new(),
            still => {
                let names: Vec<&str> = still.iter().map(|one| one.joint.as_str()).collect();
                format!("; {} moved too little", names.join(", "))
            }
        };
        return Some(format!(
            "over the workspace FK would be known to {:.3} mm rms, to no more than {:.3} mm by the drawing{moved}",
            1e3 * known,
            1e3 * drawing
        ));
    }
    found.streams.iter().find_map(gains_nothing)
}

/// Why a stream speaks against the calibration, if it does: it is described no better than by the drawing.
pub(crate) fn gains_nothing(stream: &StreamCalibration) -> Option<String> {
    let noise_m = NOISE * 3f64.sqrt() * stream.noise[0];
    if stream.after.m > stream.before.m.max(noise_m) {
        return Some(format!(
            "the calibrated links leave more than the drawing: {:.3} mm rms, {:.3} mm by the drawing",
            1e3 * stream.after.m,
            1e3 * stream.before.m
        ));
    }
    let (before, after) = (stream.held_out_before.m, stream.held_out_after.m);
    (after > FORETELLS * before && before > noise_m).then(|| {
        format!(
            "of stretches that it has not seen it foretells no more than the drawing: {:.3} mm rms are \
             left, {:.3} mm by the drawing",
            1e3 * after,
            1e3 * before
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::LeftOver;
    use crate::robot::catalogue;

    /// A calibration by which FK is known to `expected_m`, by the drawing to 1 mm, and that leaves what is
    /// said, m: by the drawing and by itself, and likewise of what it has not seen.
    fn found(
        expected_m: f64,
        [before, after]: [f64; 2],
        [unseen, foretold]: [f64; 2],
    ) -> ArmCalibration {
        let left = |m: f64| LeftOver { m, rad: m };
        let stream = StreamCalibration {
            samples: 1000,
            latency_s: None,
            reference: None,
            tool: None,
            before: left(before),
            after: left(after),
            held_out_before: left(unseen),
            held_out_after: left(foretold),
            noise: [1e-5, 1e-5],
            inflation: [1.0, 1.0],
            spans: vec![2.0, 2.0, 2.0, 0.1, 2.0, 2.0],
        };
        ArmCalibration {
            robot: catalogue::find("ur5e").expect("it is in the catalogue").clone(),
            links: Vec::new(),
            deviations: Vec::new(),
            link_m: 3e-4,
            unsettled: None,
            parameters: Vec::new(),
            zeros: Vec::new(),
            values: Vec::new(),
            covariance: Default::default(),
            dof: 1000.0,
            streams: vec![stream],
            untold: Vec::new(),
            expected: left(expected_m),
            drawing: left(1e-3),
        }
    }

    #[test]
    fn a_calibration_is_refused_that_knows_or_foretells_no_more_than_the_drawing() {
        let good = found(1e-5, [1e-3, 2e-5], [1e-3, 2e-5]);
        assert_eq!(refusal(&good, &[]), None);
        // The drawing leaves nothing but noise.
        assert_eq!(refusal(&found(1e-5, [1.8e-5, 1.7e-5], [1.8e-5, 1.9e-5]), &[]), None);
        for (bad, why) in [
            (found(7e-4, [1e-3, 2e-5], [1e-3, 2e-5]), "would be known to 0.700 mm"),
            (found(f64::NAN, [1e-3, 2e-5], [1e-3, 2e-5]), "would be known"),
            (found(1e-5, [1e-3, 2e-5], [1e-3, 9.5e-4]), "has not seen"),
            (found(1e-5, [1e-3, 2e-3], [1e-3, 2e-5]), "leave more than the drawing"),
        ] {
            let refused = refusal(&bad, &[]).unwrap_or_default();
            assert!(refused.contains(why), "{refused}");
        }
    }

    #[test]
    fn a_stream_gains_nothing_that_is_described_no_better_than_by_the_drawing() {
        let gains = |left: [f64; 2], unseen: [f64; 2]| {
            gains_nothing(&found(1e-5, left, unseen).streams[0]).is_none()
        };
        assert!(gains([1e-3, 2e-5], [1e-3, 2e-5]));
        assert!(!gains([1e-3, 2e-3], [1e-3, 2e-5]));
        assert!(!gains([1e-3, 2e-5], [1e-3, 9.5e-4]));
    }

    #[test]
    fn joints_that_hardly_move_are_named() {
        let found = found(7e-4, [1e-3, 2e-5], [1e-3, 2e-5]);
        let joints = ["a", "b", "c", "d", "e", "f"].map(str::to_owned);
        let still = still(&found.robot, &joints, &found);
        assert_eq!(still.iter().map(|one| one.joint.as_str()).collect::<Vec<_>>(), ["d"]);
        assert!(refusal(&found, &still).is_some_and(|why| why.contains("d moved too little")));
    }
}
