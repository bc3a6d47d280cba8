//! Pose desk results as JSON.

use super::{
    ConversionResult, EndTransform, Hypothesis, Inversion, NumberEncoding, ReconcileVerdict,
    Reconciliation,
};
use crate::geometry::vendors::VendorUse;
use crate::geometry::{Axes, Pose, xyz_of, xyzw_from_rotation};
use serde_json::{Value, json};

fn pose_as_json(pose: &Pose) -> Value {
    let matrix = pose.to_homogeneous();
    let rows: [[f64; 4]; 4] =
        std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] + 0.0));
    json!({
        "xyz_m": xyz_of(pose),
        "xyzw": xyzw_from_rotation(&pose.rotation),
        "matrix": rows,
    })
}

fn encoding_as_json(encoding: &NumberEncoding) -> Value {
    let angle = encoding.rotation.has_angles().then(|| encoding.angle.symbol());
    json!({
        "convention": encoding.rotation.to_string(),
        "angles": angle,
        "lengths": encoding.has_position.then(|| encoding.length.to_string()),
    })
}

fn uses_as_json(uses: &[&'static VendorUse]) -> Vec<Value> {
    let entry = |entry: &&'static VendorUse| {
        json!({
            "who": entry.who,
            "what": entry.what,
            "units": entry.units.to_string(),
            "confirmed": entry.is_confirmed,
            "source": entry.source,
        })
    };
    uses.iter().map(entry).collect()
}

/// Converts the result for one pose.
pub fn conversions_as_json(conversions: &ConversionResult) -> Value {
    let schema = "poseaudit.pose/1";
    match conversions {
        ConversionResult::Determined(conversions) => {
            let rows = conversions.rows.iter().map(|row| {
                let names = row
                    .names
                    .iter()
                    .map(|library| json!({"who": library.who, "name": library.name}));
                json!({
                    "convention": row.rotation.to_string(),
                    "numbers": row.numbers,
                    "gimbal_margin_rad": row.gimbal_margin_rad,
                    "used_by": uses_as_json(&row.uses),
                    "called": names.collect::<Vec<_>>(),
                })
            });
            let worlds = conversions.worlds.iter().map(|(who, pose)| {
                json!({"who": who, "xyz_m": xyz_of(pose), "xyzw": xyzw_from_rotation(&pose.rotation)})
            });
            let code = conversions.numbers_code.iter().chain(&conversions.quaternion_code);
            let code = code.map(|line| json!({"library": line.library, "line": line.line}));
            json!({
                "schema": schema,
                "read_as": encoding_as_json(&conversions.encoding),
                "notes": conversions.notes,
                "has_position": conversions.has_position,
                "pose": pose_as_json(&conversions.pose),
                "conventions": rows.collect::<Vec<_>>(),
                "worlds": worlds.collect::<Vec<_>>(),
                "code": code.collect::<Vec<_>>(),
            })
        }
        ConversionResult::Ambiguous { candidates, notes } => {
            let candidates = candidates.iter().map(|candidate| {
                json!({
                    "read_as": encoding_as_json(&candidate.encoding),
                    "pose": pose_as_json(&candidate.pose),
                    "used_by": uses_as_json(&candidate.uses),
                })
            });
            json!({"schema": schema, "notes": notes, "candidates": candidates.collect::<Vec<_>>()})
        }
    }
}

/// Converts the result for pairs of poses.
pub fn reconciliation_as_json(answer: &Reconciliation, pairs: usize) -> Value {
    let hypotheses: Vec<Value> = answer.hypotheses.iter().map(hypothesis_as_json).collect();
    let offsets = answer.single_pair_offsets.as_ref().map(|offsets| {
        json!({
            "is_from_but": pose_as_json(&offsets.tool),
            "but_from_is": pose_as_json(&offsets.base),
            "is_translation": offsets.is_translation,
            "apart": offsets.translation_text(),
        })
    });
    json!({
        "schema": "poseaudit.reconciled/1",
        "verdict": match answer.verdict {
            ReconcileVerdict::Reconciled => "reconciled",
            ReconcileVerdict::Ambiguous => "ambiguous",
            ReconcileVerdict::Unexplained => "open",
        },
        "pairs": pairs,
        "as_good": answer.equally_good,
        "hypotheses": hypotheses,
        "would_do": offsets,
        "tried": answer.tried,
        "by_chance": answer.expected_by_chance,
        "notes": answer.notes,
    })
}

/// `sense` is the key that gives the direction.
fn end_as_json(end: &EndTransform, sense: &str) -> Value {
    let transform = pose_as_json(&end.transform());
    match end {
        EndTransform::None => Value::Null,
        EndTransform::Frames(frames) => {
            json!({"is": frames.frame_a, "but": frames.frame_b, "arms": frames.arms, "also": frames.also, sense: transform})
        }
        EndTransform::Fitted(_) => json!({"fitted": true, sense: transform}),
    }
}

fn hypothesis_as_json(hypothesis: &Hypothesis) -> Value {
    let equivalents = hypothesis
        .equivalents
        .iter()
        .map(|[is, but]| json!({"is": encoding_as_json(is), "but": encoding_as_json(but)}));
    let residual = &hypothesis.residual;
    json!({
        "is": encoding_as_json(&hypothesis.encoding_a),
        "but": encoding_as_json(&hypothesis.encoding_b),
        "inversion": match hypothesis.inversion {
            Inversion::None => Value::Null,
            Inversion::Pose => "pose-inverse".into(),
            Inversion::Rotation => "transpose".into(),
        },
        "misreading": hypothesis.misinterpretation.map(|misinterpretation| {
            json!({"is": misinterpretation.is.to_string(), "read_as": misinterpretation.read_as.to_string()})
        }),
        "axes": (hypothesis.axes != Axes::STANDARD).then(|| hypothesis.axes.to_string()),
        "base": end_as_json(&hypothesis.base, "but_from_is"),
        "tool": end_as_json(&hypothesis.tip, "is_from_but"),
        "claims": hypothesis.claims(),
        "also": hypothesis.also,
        "residual": {
            "rotation_rad": residual.rotation_rad,
            "position_m": residual.position_m,
            "worst_rotation_rad": residual.worst_rotation_rad,
            "worst_position_m": residual.worst_position_m,
        },
        "agrees": residual.is_agreement(),
        "score": hypothesis.score,
        "equivalents": equivalents.collect::<Vec<_>>(),
    })
}
