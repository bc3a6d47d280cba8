//! Pose desk results as JSON.

use super::{Answer, End, Hypothesis, Inversion, Reading, Sheets, Verdict};
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

fn reading_as_json(reading: &Reading) -> Value {
    let angle = reading.form.has_angles().then(|| reading.angle.symbol());
    json!({
        "convention": reading.form.to_string(),
        "angles": angle,
        "lengths": reading.has_position.then(|| reading.length.to_string()),
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
pub fn sheets_as_json(sheets: &Sheets) -> Value {
    let schema = "poseaudit.pose/1";
    match sheets {
        Sheets::One(sheet) => {
            let rows = sheet.rows.iter().map(|row| {
                let names = row
                    .names
                    .iter()
                    .map(|library| json!({"who": library.who, "name": library.name}));
                json!({
                    "convention": row.form.to_string(),
                    "numbers": row.numbers,
                    "gimbal_margin_rad": row.gimbal_margin_rad,
                    "used_by": uses_as_json(&row.uses),
                    "called": names.collect::<Vec<_>>(),
                })
            });
            let worlds = sheet.worlds.iter().map(|(who, pose)| {
                json!({"who": who, "xyz_m": xyz_of(pose), "xyzw": xyzw_from_rotation(&pose.rotation)})
            });
            let code = sheet.code_of_numbers.iter().chain(&sheet.code_of_quaternion);
            let code = code.map(|line| json!({"library": line.library, "line": line.line}));
            json!({
                "schema": schema,
                "read_as": reading_as_json(&sheet.reading),
                "notes": sheet.notes,
                "has_position": sheet.has_position,
                "pose": pose_as_json(&sheet.pose),
                "conventions": rows.collect::<Vec<_>>(),
                "worlds": worlds.collect::<Vec<_>>(),
                "code": code.collect::<Vec<_>>(),
            })
        }
        Sheets::Several { candidates, notes } => {
            let candidates = candidates.iter().map(|candidate| {
                json!({
                    "read_as": reading_as_json(&candidate.reading),
                    "pose": pose_as_json(&candidate.pose),
                    "used_by": uses_as_json(&candidate.uses),
                })
            });
            json!({"schema": schema, "notes": notes, "candidates": candidates.collect::<Vec<_>>()})
        }
    }
}

/// Converts the result for pairs of poses.
pub fn answer_as_json(answer: &Answer, pairs: usize) -> Value {
    let hypotheses: Vec<Value> = answer.hypotheses.iter().map(hypothesis_as_json).collect();
    let would_do = answer.would_do.as_ref().map(|would_do| {
        json!({
            "is_from_but": pose_as_json(&would_do.tool),
            "but_from_is": pose_as_json(&would_do.base),
            "is_translation": would_do.is_translation,
            "apart": would_do.apart(),
        })
    });
    json!({
        "schema": "poseaudit.reconciled/1",
        "verdict": match answer.verdict {
            Verdict::Reconciled => "reconciled",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Open => "open",
        },
        "pairs": pairs,
        "as_good": answer.as_good,
        "hypotheses": hypotheses,
        "would_do": would_do,
        "tried": answer.tried,
        "by_chance": answer.by_chance,
        "notes": answer.notes,
    })
}

/// `sense` is the key that gives the direction.
fn end_as_json(end: &End, sense: &str) -> Value {
    let transform = pose_as_json(&end.transform());
    match end {
        End::None => Value::Null,
        End::Frames(frames) => {
            json!({"is": frames.is, "but": frames.but, "arms": frames.arms, "also": frames.also, sense: transform})
        }
        End::Fitted(_) => json!({"fitted": true, sense: transform}),
    }
}

fn hypothesis_as_json(hypothesis: &Hypothesis) -> Value {
    let equivalents = hypothesis
        .equivalents
        .iter()
        .map(|[is, but]| json!({"is": reading_as_json(is), "but": reading_as_json(but)}));
    let residual = &hypothesis.residual;
    json!({
        "is": reading_as_json(&hypothesis.is),
        "but": reading_as_json(&hypothesis.but),
        "inversion": match hypothesis.inversion {
            Inversion::None => Value::Null,
            Inversion::Pose => "pose-inverse".into(),
            Inversion::Rotation => "transpose".into(),
        },
        "misreading": hypothesis.misreading.map(|misreading| {
            json!({"is": misreading.is.to_string(), "read_as": misreading.read_as.to_string()})
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
        "agrees": residual.agrees(),
        "score": hypothesis.score,
        "equivalents": equivalents.collect::<Vec<_>>(),
    })
}
