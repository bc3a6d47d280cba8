use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::Reading;
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::geometry::{Coding, Convention, QuaternionSlip, vendors};
use crate::log::{Note, RotationLabels};

rule! {
    /// Metadata contradict the numbers.
    ///
    /// ## What it means
    /// What a dataset declares of its columns (the rate, how many numbers a row has, their names) is not
    /// what the file holds; or the name of a column says rad or joint position, and its numbers go beyond two
    /// turns or hold a unit quaternion in each row; or the columns of a rotation are named roll, pitch, yaw, A, B,
    /// C (KUKA), W, P, R (FANUC), O, A, T (Kawasaki) or x, y, z, w, and follow the arm only in another encoding; or commands name their numbers in another order than the
    /// joints that these move as; or an episode's columns are others than its dataset's.
    ///
    /// ## Why it matters
    /// Loaders believe the metadata. A wrong rate scales every velocity and every latency; a name too few
    /// shifts the meaning of all numbers behind it.
    ///
    /// ## Evidence
    /// One finding for each contradiction, with the file; the message has the declared and the measured value.
    ///
    /// ## How to fix
    /// Correct `meta/info.json` or the name, or write the dataset again with the features it declares.
    ///
    /// ## When it misleads
    /// Two joints that move alike are not told from each other, and swapped names of such are not found. Rates are compared with the median step of the stamps, where the stamps are a column: stamps that the
    /// recorder made from the declared rate agree with it whatever the true rate was. Other
    /// units and meanings are not compared here: joints in degrees are ORD004's, a pose that follows no arm is
    /// FRM007's.
    META001 {
        name: "contradicted-metadata",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no metadata that declare what the numbers are",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let arms = case.evidence.robots.iter();
    let labelled = arms.flat_map(|arm| arm.poses.iter().filter_map(|pose| judge_labels(arm, pose)));
    let declared = match case.evidence.contradictions.as_deref() {
        None => Vec::new(),
        Some([]) => vec![Judged::new(Subject::default(), Outcome::sound())],
        Some(found) => found.iter().map(judge).collect(),
    };
    declared.into_iter().chain(labelled).collect()
}

fn judge(note: &Note) -> Judged {
    let file = note.file.display().to_string();
    let fix = "correct the metadata, or write the dataset again";
    let outcome = contradicted(note.what.clone(), fix.to_owned());
    Judged::new(Subject { topic: Some(file), ..Subject::default() }, outcome)
}

fn contradicted(message: String, fix: String) -> Outcome {
    Outcome::faulty(Fault {
        cause: Cause::Other,
        severity: Severity::Warning,
        title: "metadata contradict the numbers",
        message,
        evidence: Evidence::default(),
        fix,
    })
}

/// Whether the rotation of a stream is what the names of its columns say; `None` if they say nothing, or the
/// motion does not tell.
fn judge_labels(arm: &ArmEvidence, pose: &Of<PoseEvidence>) -> Option<Judged> {
    /// No reading is believed that leaves more, rad; the named one must leave so many times what the best does.
    const FOLLOWS_RAD: f64 = 0.17;
    const CLEAR_RATIO: f64 = 2.0;
    let labels = pose.labels?;
    let reading = pose.diagnosis.reading.as_ref().ok().filter(|reading| reading.is_told)?;
    if reading.best_rad > FOLLOWS_RAD {
        return None;
    }
    let named = codings(labels, &arm.name);
    let coding = |reading: &Reading| match reading {
        Reading::Numbers(convention) => Some(Coding::Three(*convention)),
        Reading::QuaternionOrder(QuaternionSlip::WxyzReadAsXyzw) => Some(Coding::Wxyz),
        Reading::AsLogged => Some(Coding::Xyzw),
        _ => None,
    };
    let best = coding(&reading.best)?;
    let is_named = |reading: &Reading| coding(reading).is_some_and(|own| named.contains(&own));
    let limit_rad = CLEAR_RATIO * reading.best_rad.max(Unit::Radian.noise_floor());
    let is_near = |(reading, rad): &(Reading, f64)| is_named(reading) && *rad <= limit_rad;
    let fits = named.contains(&best)
        || reading.equivalent.iter().any(is_named)
        || reading.ranked.iter().any(is_near);
    let outcome = match fits {
        true => Outcome::sound(),
        false => {
            let said = named.first().map_or_else(String::new, Coding::to_string);
            let message = format!(
                "its rotation is named {} ({said}), and the numbers follow the arm only as {best}",
                words(labels)
            );
            contradicted(message, format!("rename the columns, or write the rotation as {said}"))
        }
    };
    Some(pose.judged(outcome))
}

/// The encodings that names may stand for, the usual one first.
fn codings(labels: RotationLabels, arm: &str) -> Vec<Coding> {
    let is_of = |maker: &str| arm.to_lowercase().contains(maker);
    // `vendors.toml`: makers whose A, B, C are not KUKA's.
    let makers: &[&str] = match labels {
        RotationLabels::Quaternion => return vec![Coding::Xyzw],
        RotationLabels::RotationVector => return vec![Coding::Three(Convention::RotVec)],
        RotationLabels::RollPitchYaw => &["xarm"],
        RotationLabels::Wpr => &["fanuc"],
        RotationLabels::Oat => &["kawasaki"],
        // A Doosan can be set to other orders.
        RotationLabels::Abc if is_of("doosan") => &["doosan", "kuka", "mitsubishi"],
        RotationLabels::Abc if is_of("mitsubishi") => &["mitsubishi"],
        RotationLabels::Abc => &["kuka"],
    };
    makers.iter().filter_map(|maker| Some(vendors::find(maker)?.coding)).collect()
}

fn words(labels: RotationLabels) -> &'static str {
    match labels {
        RotationLabels::Quaternion => "x, y, z, w of a quaternion",
        RotationLabels::RollPitchYaw => "roll, pitch, yaw",
        RotationLabels::Abc => "A, B, C",
        RotationLabels::Wpr => "W, P, R",
        RotationLabels::Oat => "O, A, T",
        RotationLabels::RotationVector => "a rotation vector",
    }
}
