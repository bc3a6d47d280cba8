//! Shared by ORD001, ORD002 and ORD003, which judge the same encoding estimate.

use crate::checks::decision::{DEGREE, not_observable};
use crate::checks::{Case, SubjectResult};
use crate::diagnosis::{
    EncodingEstimate, EstimateResult, LengthUnitError, NotObservable, PoseDiagnosis, PoseEncoding,
};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{
    Cause, Estimate, Evidence, Fault, Interpretation, Outcome, Ruling, Severity, Unit,
};
use crate::geometry::{
    AngleUnit, Convention, LengthScale, Misinterpretation, Misread, QuaternionOrderError,
    RotationEncoding, RotationError, vendors,
};
use crate::run::named_encodings;

/// Minimum ratio of the residuals as logged and of the next best encoding to that of a reported one.
const MIN_CLEAR_RATIO: f64 = 2.0;

/// Limit for an accepted encoding, rad.
const MAX_RESIDUAL_RAD: f64 = 10.0 * DEGREE;

const SETTLE: &str = "turn the wrist through 60° or more about two axes";

/// Each kind belongs to one rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodingFaultKind {
    /// ORD001: three numbers in another convention.
    Convention,
    /// ORD002.
    QuaternionOrder,
    /// ORD003: inverse or transpose.
    Direction,
}

fn fault_kind(encoding: &PoseEncoding) -> Option<EncodingFaultKind> {
    match encoding {
        PoseEncoding::AsLogged | PoseEncoding::Numbers(_) => None,
        PoseEncoding::Misinterpreted(_) => Some(EncodingFaultKind::Convention),
        PoseEncoding::QuaternionOrder(_) => Some(EncodingFaultKind::QuaternionOrder),
        PoseEncoding::Transposed | PoseEncoding::Inverted => Some(EncodingFaultKind::Direction),
    }
}

pub struct EncodingReport {
    pub title: &'static str,
    /// Followed in the message by ", 64° off as logged".
    pub what: String,
    /// Preceded in the message by "0.01° once".
    pub corrected_reading: String,
    pub fix: String,
    pub error: RotationError,
    pub estimate: Estimate,
}

/// Judges every stream for faults of kind `kind`; `report` writes the report.
pub fn judge(
    case: &Case,
    kind: EncodingFaultKind,
    report: fn(&EncodingEstimate) -> Option<EncodingReport>,
) -> Vec<SubjectResult> {
    let mut judged = Vec::new();
    for arm in &case.evidence.robots {
        let streams = arm.poses_and_tf().map(|stream| {
            let found = &stream.diagnosis;
            let doubt = found.is_far_from_fk().then_some("its positions do not match FK");
            let is_changing = stream.has_bare_numbers && found.encoding_spans.rotation.is_some();
            let stated = || {
                let compared = compare_labels(arm, stream)?;
                (!compared.is_followed).then_some(compared.stated)
            };
            let undeclared = (stream.is_undeclared || is_changing).then(|| (found, stated()));
            let unidentified = stream.unidentified_columns.as_slice();
            stream.with_value((
                &found.encoding,
                doubt,
                undeclared,
                unidentified,
                arm.is_derived(stream),
            ))
        });
        let unidentified = arm.diagnosis.encoding.is_err() && !arm.poses.is_empty();
        let doubt =
            unidentified.then_some("the encoding of the joint states is itself undetermined");
        let imus = arm.imus.iter();
        let imus =
            imus.map(|imu| imu.with_value((&imu.diagnosis.encoding, doubt, None, &[][..], false)));
        judged.extend(streams.chain(imus).map(|stream| {
            let (encoding, doubt, undeclared, unidentified, is_derived) = stream.value;
            let judged = judge_stream(arm, encoding, kind, report);
            let judged = match undeclared {
                Some(found) => judge_undeclared(arm, stream.topic(), kind, found, judged),
                None => judged,
            };
            let judged = match unidentified {
                [_, ..] if kind == EncodingFaultKind::Convention => {
                    (rotation_not_checked(unidentified), None)
                }
                _ => judged,
            };
            let (outcome, estimate) = match (judged, doubt) {
                ((Outcome::Evaluated(Ruling::Fail(_)), _), Some(doubt)) => (
                    Outcome::Inconclusive(format!("{doubt}; check the model and its joints")),
                    None,
                ),
                (judged, _) => judged,
            };
            stream.judged(outcome).estimated(estimate).derived_if(is_derived)
        }));
    }
    judged
}

fn judge_stream(
    arm: &ArmEvidence,
    encoding: &EstimateResult<EncodingEstimate>,
    kind: EncodingFaultKind,
    report: fn(&EncodingEstimate) -> Option<EncodingReport>,
) -> (Outcome, Option<Estimate>) {
    let encoding = match encoding {
        Ok(encoding) => encoding,
        Err(why) => return (not_observable(why, SETTLE), None),
    };
    if encoding.best_rad > MAX_RESIDUAL_RAD {
        let residual = Unit::Radian.show(encoding.best_rad);
        let why =
            format!("no encoding matches FK (best residual {residual}): check --base and --tip");
        return (Outcome::Inconclusive(why), None);
    }
    let runner_up = encoding.runner_up.as_ref().map(|(runner_up, _)| runner_up);
    if !is_clear(encoding) {
        let concerned =
            [Some(&encoding.best), runner_up].into_iter().flatten().filter_map(fault_kind);
        if concerned.into_iter().any(|concerned| concerned == kind) {
            return (Outcome::Inconclusive(ambiguity_reason(encoding)), None);
        }
    }
    if is_undetermined(encoding) {
        return (Outcome::Inconclusive(format!("most encodings fit this motion; {SETTLE}")), None);
    }
    let is_inverted = kind == EncodingFaultKind::Direction && encoding.is_inverted;
    if fault_kind(&encoding.best) != Some(kind) && !is_inverted {
        let remark = match encoding.best {
            PoseEncoding::Numbers(convention) => {
                Outcome::pass_with_remark(format!("read as {convention}"))
            }
            _ => Outcome::pass(),
        };
        return (remark, None);
    }
    match report(encoding) {
        Some(wording) => fault(arm, encoding, wording),
        None => (Outcome::pass(), None),
    }
}

/// For positions whose rotation may be in unidentified columns.
pub(super) fn rotation_not_checked(unidentified: &[String]) -> Outcome {
    const MAX_LISTED_COLUMNS: usize = 6;
    let shown =
        unidentified.iter().take(MAX_LISTED_COLUMNS).cloned().collect::<Vec<_>>().join(", ");
    let more = if unidentified.len() > MAX_LISTED_COLUMNS { ", …" } else { "" };
    Outcome::Inconclusive(format!(
        "rotation not checked: columns {shown}{more} are not identified; list the rotation's columns in \
         `columns.pose` of the config, after the position's"
    ))
}

/// Rotation encoding that the names of columns state, and the one in which they follow the arm.
pub(super) struct LabelComparison {
    pub stated: RotationEncoding,
    pub actual: RotationEncoding,
    /// Whether the columns follow the arm as they are named.
    pub is_followed: bool,
}

/// `None` if column names or motion do not determine the rotation encoding.
pub(super) fn compare_labels(
    arm: &ArmEvidence,
    pose: &StreamEvidence<PoseEvidence>,
) -> Option<LabelComparison> {
    let labels = pose.labels?;
    let encoding =
        pose.diagnosis.encoding.as_ref().ok().filter(|encoding| encoding.is_determined)?;
    if encoding.best_rad > MAX_RESIDUAL_RAD {
        return None;
    }
    let named = named_encodings(labels, &arm.name);
    let coding = |encoding: &PoseEncoding| match encoding {
        PoseEncoding::Numbers(convention) => Some(RotationEncoding::Three(*convention)),
        PoseEncoding::QuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw) => {
            Some(RotationEncoding::Wxyz)
        }
        PoseEncoding::AsLogged => Some(RotationEncoding::Xyzw),
        _ => None,
    };
    let actual = coding(&encoding.best)?;
    let is_named = |encoding: &PoseEncoding| {
        coding(encoding).is_some_and(|named_coding| named.contains(&named_coding))
    };
    let limit_rad = MIN_CLEAR_RATIO * encoding.best_rad.max(Unit::Radian.noise_floor());
    let is_close = |(encoding, rad): &(PoseEncoding, f64)| is_named(encoding) && *rad <= limit_rad;
    let is_followed = named.contains(&actual)
        || encoding.equivalent.iter().any(is_named)
        || encoding.ranked.iter().any(is_close);
    Some(LabelComparison { stated: *named.first()?, actual, is_followed })
}

/// For numbers without a declared convention: a note with the inferred encoding, never a fault. Names of their columns may
/// state another one.
fn judge_undeclared(
    arm: &ArmEvidence,
    topic: &str,
    kind: EncodingFaultKind,
    (found, stated): (&PoseDiagnosis, Option<RotationEncoding>),
    (outcome, estimate): (Outcome, Option<Estimate>),
) -> (Outcome, Option<Estimate>) {
    let is_read = matches!(outcome, Outcome::Evaluated(_));
    let form = found.encoding.as_ref().ok().and_then(|encoding| match encoding.best {
        PoseEncoding::Numbers(convention) => Some(RotationEncoding::Three(convention)),
        PoseEncoding::QuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw) => {
            Some(RotationEncoding::Wxyz)
        }
        _ => None,
    });
    match (kind, form) {
        (EncodingFaultKind::Convention, Some(form)) if is_read => {
            let description = describe_inferred(arm, topic, form, found);
            let mut evidence = Evidence::default();
            let (length, angle) = inferred_units(found);
            evidence.more.insert("length_unit".to_owned(), length.to_string().into());
            evidence.more.insert("angle_unit".to_owned(), angle.symbol().into());
            let declaration = declaration(topic, form, found);
            let fault = Fault {
                severity: match found.encoding_spans.rotation {
                    Some(_) => Severity::Error,
                    None => Severity::Info,
                },
                cause: Cause::InferredEncoding { coding: form, length, angle },
                title: "encoding of undeclared numbers was inferred",
                message: format!("assumed {description}: this encoding matches the arm's motion"),
                evidence,
                fix: match stated {
                    Some(stated) => format!(
                        "the columns are named as {stated} (META001): rename or rewrite them; to audit the \
                         numbers as they are: {declaration}"
                    ),
                    None => format!("declare it to make this a check: {declaration}"),
                },
            };
            let (is, read_as) = (form.to_string(), form.to_string());
            (Outcome::fail(fault), Some(Estimate::misinterpretation("reading", is, read_as)))
        }
        // A quaternion in the default order, or no rotation.
        (EncodingFaultKind::Convention, None) => match &found.length_unit {
            Ok(Some(error))
                if is_read || matches!(found.encoding, Err(NotObservable::NoOrientation)) =>
            {
                let (is, read_as) = (error.is.to_string(), error.read_as.to_string());
                (
                    report_inferred_length(topic, error),
                    Some(Estimate::misinterpretation("length unit", is, read_as)),
                )
            }
            _ => (outcome, estimate),
        },
        (EncodingFaultKind::QuaternionOrder, Some(RotationEncoding::Wxyz)) if is_read => {
            let why = "no component order is declared for these numbers, so none is violated";
            (Outcome::pass_with_remark(why.to_owned()), None)
        }
        _ => (outcome, estimate),
    }
}

/// For bare positions that match FK in another unit than metres.
fn report_inferred_length(topic: &str, error: &LengthUnitError) -> Outcome {
    let is = error.is.plural_name();
    Outcome::fail(Fault {
        severity: Severity::Info,
        cause: Cause::LengthUnit(Misread { is: error.is, read_as: error.read_as }),
        title: "encoding of undeclared numbers was inferred",
        message: format!("assumed {is}: positions match the arm's motion in this unit"),
        evidence: Evidence::default(),
        fix: format!("multiply the positions of {topic} by {} to get metres", error.is.in_m()),
    })
}

pub(super) fn inferred_units(found: &PoseDiagnosis) -> (LengthScale, AngleUnit) {
    let length = found.length_unit.as_ref().ok().copied().flatten().map(|error| error.is);
    let angle = if found.degrees.is_some() { AngleUnit::Degree } else { AngleUnit::Radian };
    (length.unwrap_or(LengthScale::METRE), angle)
}

/// Inferred encoding and vendors that use it: `mm, euler:ZYX in deg (as KUKA does)`.
fn describe_inferred(
    arm: &ArmEvidence,
    topic: &str,
    form: RotationEncoding,
    found: &PoseDiagnosis,
) -> String {
    const MAX_LISTED_VENDORS: usize = 3;
    let (length, angle) = inferred_units(found);
    let is_three = matches!(form, RotationEncoding::Three(_));
    let is_alike = |entry: &&'static vendors::VendorUse| {
        let angles = !is_three || entry.units.angle.unwrap_or_default() == angle;
        entry.is_vendor() && entry.units.length.unwrap_or_default() == length && angles
    };
    // Vendors named by the arm or topic come first.
    let names = format!("{} {topic}", arm.name).to_lowercase();
    let is_other = |entry: &&str| {
        let first = entry.split_whitespace().next().unwrap_or_default().to_lowercase();
        !names.contains(&first)
    };
    let mut vendor_names: Vec<&str> = Vec::new();
    for entry in vendors::uses_of(form).filter(is_alike) {
        if !vendor_names.contains(&entry.who.as_str()) {
            vendor_names.push(&entry.who);
        }
    }
    vendor_names.sort_by_key(is_other);
    vendor_names.truncate(MAX_LISTED_VENDORS);
    let vendor_names = match vendor_names.as_slice() {
        [] => String::new(),
        vendor_names => {
            format!(
                " (as {} {})",
                vendor_names.join(", "),
                if vendor_names.len() == 1 { "does" } else { "do" }
            )
        }
    };
    let angles = if is_three { format!(" in {}", angle.symbol()) } else { String::new() };
    format!("{length}, {form}{angles}{vendor_names}")
}

/// Option that declares the inferred units and this rotation encoding.
pub(super) fn declaration(topic: &str, form: RotationEncoding, found: &PoseDiagnosis) -> String {
    let (length, angle) = inferred_units(found);
    let is_degrees = matches!(form, RotationEncoding::Three(_)) && angle == AngleUnit::Degree;
    let angle = if is_degrees { ",deg" } else { "" };
    let length = if length == LengthScale::MILLIMETRE { ",mm" } else { "" };
    format!("--declare {topic}={form}{angle}{length}")
}

fn fault(
    arm: &ArmEvidence,
    encoding: &EncodingEstimate,
    wording: EncodingReport,
) -> (Outcome, Option<Estimate>) {
    let EncodingReport { title, what, corrected_reading, fix, error, estimate } = wording;
    let residual = Unit::Radian.show(encoding.best_rad);
    let next = match encoding.runner_up {
        Some((_, rad)) => format!(" (next best encoding: {})", Unit::Radian.show(rad)),
        None => String::new(),
    };
    let message = match encoding.as_logged_rad {
        Some(rad) => format!("{what}, {} off as logged", Unit::Radian.show(rad)),
        None => format!("{what}, residual {residual} once {corrected_reading}"),
    };
    let mut evidence = Evidence {
        effect: Some(format!("{residual} once {corrected_reading}{next}")),
        effect_m: encoding.as_logged_rad.map(|rad| rad * arm.reach_m),
        ..Evidence::default()
    };
    evidence.more.insert("as_logged_rad".to_owned(), encoding.as_logged_rad.into());
    evidence.more.insert("corrected_rad".to_owned(), encoding.best_rad.into());
    let cause = Cause::Rotation(error);
    let fault = Fault { severity: Severity::Error, cause, title, message, evidence, fix };
    (Outcome::fail(fault), Some(estimate))
}

/// Whether every encoding fits equally well because the orientation barely changes.
fn is_undetermined(encoding: &EncodingEstimate) -> bool {
    fault_kind(&encoding.best).is_none() && !encoding.is_inverted && !encoding.is_determined
}

/// Whether the best encoding clearly beats the stream as logged and the next best.
fn is_clear(encoding: &EncodingEstimate) -> bool {
    let best = encoding.best_rad.max(Unit::Radian.noise_floor());
    let clear_of = |rad: f64| rad >= MIN_CLEAR_RATIO * best;
    fault_kind(&encoding.best).is_none()
        || encoding.as_logged_rad.is_none_or(clear_of)
            && encoding.runner_up.as_ref().is_none_or(|&(_, rad)| clear_of(rad))
}

fn ambiguity_reason(encoding: &EncodingEstimate) -> String {
    let best = describe(&encoding.best);
    let residual = Unit::Radian.show(encoding.best_rad);
    match &encoding.runner_up {
        Some((runner_up, rad)) => {
            let (runner_up, rad) = (describe(runner_up), Unit::Radian.show(*rad));
            format!("residual with {best}: {residual}, with {runner_up}: {rad}; {SETTLE}")
        }
        None => format!("residual with {best}: {residual}, little better than as logged; {SETTLE}"),
    }
}

fn describe(encoding: &PoseEncoding) -> String {
    match encoding {
        PoseEncoding::AsLogged => "the stream as logged".to_owned(),
        encoding => {
            let Interpretation { is, read_as } = encoding_names(encoding);
            format!("{is} read as {read_as}")
        }
    }
}

/// Names in the report's contract.
pub fn encoding_names(encoding: &PoseEncoding) -> Interpretation {
    let (is, read_as) = match encoding {
        PoseEncoding::AsLogged => ("pose".to_owned(), "pose"),
        PoseEncoding::Numbers(convention) => {
            return Interpretation { is: convention.to_string(), read_as: convention.to_string() };
        }
        PoseEncoding::Misinterpreted(class) => match class.members.first() {
            Some(misreading) => return convention_names(misreading),
            None => ("pose".to_owned(), "pose"),
        },
        PoseEncoding::QuaternionOrder(error) => {
            let (is, read_as) = quaternion_orders(*error);
            (is.to_owned(), read_as)
        }
        PoseEncoding::Transposed => ("transpose".to_owned(), "pose"),
        PoseEncoding::Inverted => ("pose-inverse".to_owned(), "pose"),
    };
    Interpretation { is, read_as: read_as.to_owned() }
}

/// Names in the report's contract.
pub fn convention_names(misreading: &Misinterpretation) -> Interpretation {
    Interpretation { is: misreading.is.to_string(), read_as: misreading.read_as.to_string() }
}

/// Actual and assumed order.
pub fn quaternion_orders(error: QuaternionOrderError) -> (&'static str, &'static str) {
    match error {
        QuaternionOrderError::WxyzReadAsXyzw => ("quat:wxyz", "quat:xyzw"),
        QuaternionOrderError::XyzwReadAsWxyz => ("quat:xyzw", "quat:wxyz"),
    }
}

pub fn describe_convention(convention: Convention) -> String {
    if convention == Convention::RPY {
        return "roll-pitch-yaw".to_owned();
    }
    let name = convention.to_string();
    let Some(letters) = name.strip_prefix("euler:") else {
        return "rotation vector".to_owned();
    };
    let (letters, labelled) = match letters.strip_suffix("@axes") {
        Some(letters) => (letters, " labelled by axis"),
        None => (letters, ""),
    };
    let axes =
        if letters.starts_with(|c: char| c.is_ascii_lowercase()) { "fixed" } else { "moving" };
    format!("{axes}-axes {letters} angles{labelled}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::poses::ord001_rotation_convention::ORD001;
    use crate::checks::poses::ord002_quaternion_order::ORD002;
    use crate::checks::poses::ord003_inverted_pose::ORD003;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::evidence::RunEvidence;
    use crate::finding::Status;

    fn rotation_of(
        best: PoseEncoding,
        best_rad: f64,
        runner_up: Option<(PoseEncoding, f64)>,
    ) -> RunEvidence {
        let mut run = clean_run();
        let as_logged_rad = Some(1.1);
        run.robots[0].poses[0].diagnosis.encoding = Ok(EncodingEstimate {
            is_inverted: matches!(best, PoseEncoding::Inverted),
            best,
            as_logged_rad,
            best_rad,
            runner_up,
            equivalent: Vec::new(),
            ranked: Vec::new(),
            is_determined: true,
        });
        run
    }

    #[test]
    fn each_fault_is_reported_by_its_own_rule_only() {
        for (encoding, code) in [
            (PoseEncoding::QuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw), "ORD002"),
            (PoseEncoding::Inverted, "ORD003"),
            (PoseEncoding::Transposed, "ORD003"),
        ] {
            let run = rotation_of(encoding, 1e-4, Some((PoseEncoding::AsLogged, 1.1)));
            for rule in [&ORD001, &ORD002, &ORD003] {
                let (rows, findings) = evaluate_rule(rule, &run);
                assert_eq!(
                    findings.len(),
                    usize::from(rule.code == code),
                    "{} {rows:?}",
                    rule.code
                );
            }
        }
    }

    #[test]
    fn two_encodings_that_fit_equally_are_inconclusive() {
        let run =
            rotation_of(PoseEncoding::Inverted, 1e-3, Some((PoseEncoding::Transposed, 1.2e-3)));
        let (rows, findings) = evaluate_rule(&ORD003, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
        assert_eq!(evaluate_rule(&ORD002, &run).0[0].status, Status::Pass);
    }

    #[test]
    fn an_encoding_that_does_not_follow_the_arm_is_rejected() {
        let (rows, findings) =
            evaluate_rule(&ORD003, &rotation_of(PoseEncoding::Inverted, 0.5, None));
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
    }

    #[test]
    fn conventions_have_descriptions() {
        let plural_name = |name: &str| name.parse().map(describe_convention);
        assert_eq!(plural_name("euler:xyz").as_deref(), Ok("roll-pitch-yaw"));
        assert_eq!(plural_name("rotvec").as_deref(), Ok("rotation vector"));
        assert_eq!(plural_name("euler:ZYX").as_deref(), Ok("moving-axes ZYX angles"));
        let labelled = "fixed-axes xzy angles labelled by axis";
        assert_eq!(plural_name("euler:xzy@axes").as_deref(), Ok(labelled));
    }
}
