mod imu;

use serde_json::{Value, json};

use crate::checks::decision::{not_observable, too_uncertain};
use crate::checks::encoding::{encoding_names, rotation_not_checked};
use crate::checks::frames::THRESHOLDS;
use crate::checks::residual_attribution::{
    Attribution, CauseOutcomes, ExceedingResidual, attribute_residual,
};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::plan::Purpose;
use crate::diagnosis::{
    ErrorMagnitude, ErrorSize, FkError, LinkDisplacement, Measured, PartError, PoseDiagnosis,
    PoseEncoding,
};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{
    Cause, Estimate, Evidence, Fault, Interpretation, Outcome, Ruling, Severity, Subject, Unit,
    rounded,
};
use crate::run::{CompetingModel, NotAuditedReason};

rule! {
    /// Residual error with no identified cause.
    ///
    /// ## What it means
    /// Every stream is compared with FK independently of the estimators, by the 95th percentile of the raw
    /// error over the moving run and its tenths. If that reaches the thresholds, the other rules' findings
    /// must explain it. The corrected error in every tenth must then be below the thresholds, or at most
    /// twice the sample-to-sample noise, if that noise is not itself an error. A larger residual has no
    /// modelled cause: kinematic parameters, a bent link, gear error, a slow change during the run, or a
    /// different arm. Orientations that do not follow the arm in any known convention are a finding.
    ///
    /// For an IMU: residuals of orientation and gyro after correction, relative error of the gyro's scale
    /// (`gyro gain`), and a full-scale rate below the arm's (`gyro saturation`).
    ///
    /// ## Why it matters
    /// A run passes only if this rule passes on every stream. The residual is the accuracy that correcting
    /// the other findings can reach. The description may belong to a different arm.
    ///
    /// ## Evidence
    /// - `value`, `rotation`: rms position and orientation error beyond the sample-to-sample noise.
    /// - `rms_m`, `rms_rad`: with the noise; `before_m`, `before_rad`: uncorrected.
    /// - `as_logged`, `left`: error before and after correcting the findings: the 95th percentile
    ///   (`most_m`, `most_rad`) in the worst tenth of the run, its times and tip position (`from_ns`,
    ///   `to_ns`, `at_m`).
    /// - `shared_by`: streams with a residual at the same times.
    /// - `candidates`: closest explanations with their residuals.
    /// - `fits`: a catalogue arm with the same joints that fits far better than the given model, and its
    ///   residual (`misfit_m`; `tool_m` if it needs an active TCP). The given model is kept; rules that
    ///   compare poses with it are inconclusive.
    /// - `link_m`, for a nominal model of a calibrated arm: standard deviation of the link deviations, with
    ///   0.1° per 1 mm for their angles.
    /// - `link`, if one link differs from the model by more than 2 mm: the joints at its ends, and the
    ///   displacement of its outer end with its interval. The finding is then a warning.
    /// - For a gyro: `scale` is the gain minus 1 along x, y, z with its interval, `axes` the saturated
    ///   axes, `share` the fraction of samples at the limit, `by_fk_rad_s` the arm's maximum rate.
    ///
    /// If the residual is mostly along the motion and the delays are skewed, the message states how far delays scatter.
    ///
    /// If the residual varies with one, two or three times a joint's angle (eccentric gear or encoder), the
    /// message names joint and amplitude.
    ///
    /// A stream that leads the arm by more than 40 ms is inconclusive: a command, or a tool pose with late
    /// joint states.
    ///
    /// The residual is a finding if it is at least three times the sample-to-sample noise (F = 9) or
    /// repeats with the configuration. Otherwise the rule and the run are inconclusive. They are also inconclusive if the
    /// half-width of the residual's 95 % interval exceeds the threshold.
    ///
    /// ## How to fix
    /// Use the arm's calibrated description (for a UR, `calibration.yaml` extracted from the controller).
    /// Millimetres everywhere are usually calibration; centimetres suggest the wrong model. If the residual
    /// starts at some time, check what happened then.
    ///
    /// ## When it misleads
    /// A nominal description of a calibrated arm has a residual of 1–10 mm, from deviations of many links; the
    /// log is then not at fault.
    /// Slowly varying tracker noise counts as residual.
    ///
    /// Without joint states, several streams of which none moves rigidly with the reference may be of separate
    /// bodies. They are inconclusive, unless their child frames are equal or each has a file of its own.
    MDL001 {
        name: "unexplained-residual",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle, imu::GAIN]),
        headline: true,
        needs_model: true,
        missing: "no joint states with a model",
        check: check,
    }
}

/// Motion that resolves an inconclusive row, if one does.
pub(in crate::checks) fn resolving_motion(reason: &str) -> Option<Purpose> {
    match () {
        () if reason.ends_with(EVERY_JOINT_MOVES) => Some(Purpose::Calibration),
        () if reason.ends_with(imu::SETTLE) => Some(Purpose::Yaw),
        () => None,
    }
}

const EVERY_JOINT_MOVES: &str = "record 10 s in which every joint moves";

fn settle(subject: &Subject) -> &'static str {
    match &subject.reference {
        Some(_) => "record 10 s in which the body moves and turns",
        None => EVERY_JOINT_MOVES,
    }
}

/// No motion resolves it.
const REDUCE_NOISE: &str = "reduce the noise of the poses or of their stamps, or record longer";

/// The text report adds the command for its log.
const CALIBRATE: &str =
    "estimate all links from the log with `poseaudit calibrate LOG --out calibrated`";

const AS_RECORDED: &str =
    "compared with the joint states before their correction, from which it was computed";

const RECORD: &str = "record the tool's pose (from the controller or a tracker), /tf or an IMU on the arm \
    while every joint moves for 10 s";

fn check(case: &Case) -> Vec<SubjectResult> {
    let outcomes = CauseOutcomes::evaluate(case);
    let arms = case.evidence.robots.iter().flat_map(|arm| judge_arm(case, &outcomes, arm));
    let unmodelled = case.evidence.unmodelled_arms.iter().map(|arm| judge_unmodelled(case, arm));
    let leaders = case.evidence.leading_streams.iter().map(judge_leader);
    let others = case.evidence.not_audited.iter().filter_map(judge_not_following);
    arms.chain(unmodelled).chain(leaders).chain(others).collect()
}

/// A stream that does not move like the tool may be of another body, or of the tool with a large fault: inconclusive.
fn judge_not_following(stream: &StreamEvidence<Vec<NotAuditedReason>>) -> Option<SubjectResult> {
    let not_following = |why: &NotAuditedReason| match why {
        NotAuditedReason::DoesNotFollow { reference, .. } => Some(reference.clone()),
        _ => None,
    };
    let reference = stream.iter().find_map(not_following)?;
    let whose =
        reference.map_or("the tool's".to_owned(), |of| format!("on the same body as '{of}'"));
    let why = format!(
        "not compared: its motion does not show that it is {whose}; set role = \"pose\" or role = \"ignored\" in \
         [stream.\"{}\"] of poseaudit.toml",
        stream.topic(),
    );
    Some(stream.judged(Outcome::Inconclusive(why)))
}

/// Without a model there is no FK.
fn judge_unmodelled(case: &Case, arm: &ArmEvidence) -> SubjectResult {
    let why = case.evidence.no_robot.as_deref().unwrap_or("the arm has no model");
    let why = format!(
        "poses, joint zeros and limits are not checked, because {why}; {}",
        case.evidence.no_robot_remedy
    );
    let topic = arm.topic(&arm.joints_topic);
    SubjectResult::new(topic, Outcome::Inconclusive(why)).within(arm.span)
}

/// A leading stream is a command, or a tool pose with late joint states, which could hide a fault:
/// inconclusive.
fn judge_leader(stream: &StreamEvidence<f64>) -> SubjectResult {
    let why = format!(
        "not compared: it leads the arm by {:.0} ms, as a command, hand tracker or leader arm does, or a \
         tool pose if the joint states are late; set role = \"reference\" or role = \"pose\" in \
         [stream.\"{}\"] of poseaudit.toml",
        1e3 * **stream,
        stream.topic(),
    );
    stream.judged(Outcome::Inconclusive(why))
}

struct AttributedStream<'a> {
    stream: &'a StreamEvidence<PoseEvidence>,
    subject: Subject,
    attribution: Option<Attribution>,
    /// Clause of [`eccentricity`]; may be empty.
    varying_angle: String,
}

impl AttributedStream<'_> {
    fn residual(&self) -> Option<&ExceedingResidual> {
        match self.attribution.as_ref()? {
            Attribution::Unexplained(residual)
            | Attribution::UnreadOrientations(residual)
            | Attribution::Undetermined(residual, _) => Some(residual),
            _ => None,
        }
    }

    /// Whether a pose stream and its reference may be of separate bodies: only their motion shows that they are of one, and
    /// the residual is large, or none of several streams moves rigidly with the reference.
    fn are_separate_bodies(&self, all: &[AttributedStream]) -> bool {
        let diagnosis = &self.stream.diagnosis;
        let is_choice = all.len() > 1 && !self.stream.is_of_reference_body;
        self.subject.reference.is_some()
            && (diagnosis.residual.is_err()
                || diagnosis.is_far_from_fk()
                || is_choice && all.iter().all(|stream| stream.residual().is_some()))
    }

    fn is_mismatched(&self) -> bool {
        let reference_known = self.stream.reference_known;
        match &self.stream.diagnosis.residual {
            Ok(_) => self.stream.diagnosis.is_far_from_fk(),
            Err(_) => reference_known,
        }
    }
}

fn judge_arm(case: &Case, outcomes: &CauseOutcomes, arm: &ArmEvidence) -> Vec<SubjectResult> {
    let thresholds = case.thresholds.frame_thresholds(&MDL001, THRESHOLDS);
    let attributed = |subject: Subject, stream| {
        let attribution =
            attribute_residual(outcomes, arm, stream, &thresholds, case.evidence.subjects());
        AttributedStream { stream, subject, attribution, varying_angle: eccentricity(arm) }
    };
    let poses = arm.poses.iter().map(|stream| attributed(stream.subject.clone(), stream));
    // A stream computed from the joint states does not contain their eccentricity.
    let tf = arm.tf.iter().map(|tf| AttributedStream {
        varying_angle: String::new(),
        ..attributed(arm.frame(tf.topic(), &tf.tip), tf)
    });
    let streams: Vec<AttributedStream> = poses.chain(tf).collect();
    if streams.is_empty() && arm.imus.iter().all(|imu| imu.proof.is_none()) {
        if case.evidence.hand_eyes.iter().any(|eye| eye.robot.as_ref() == Some(&arm.name)) {
            let why = "compared only with camera observations (HEC001)".to_owned();
            return vec![SubjectResult::new(arm.subject(), Outcome::Skipped(why))];
        }
        let record = arm.arm_or_body(RECORD, "record poses of the same body from another source");
        let commanded = arm.references.iter().find(|reference| !reference.is_of_joints);
        let commanded = commanded.map_or(String::new(), |reference| {
            let topic = reference.topic();
            let mut rhythms = case.evidence.rhythms.iter();
            let is_of_table =
                rhythms.any(|rhythm| rhythm.topic() == topic && rhythm.is_from_table);
            let columns = if is_of_table { ", or leave out `cmd.` in --columns" } else { "" };
            format!(
                " ({topic} is taken for commands, by its name: if its poses are measured, set role = \"pose\" in \
                 [stream.\"{topic}\"] of poseaudit.toml{columns})"
            )
        });
        let why = format!(
            "nothing in this log can be compared with {}{commanded}; {record}",
            arm.joints_topic
        );
        return vec![
            SubjectResult::new(arm.subject(), Outcome::Inconclusive(why)).within(arm.span),
        ];
    }
    let imus = arm.imus.iter().flat_map(|imu| imu::judge(case, &thresholds, imu));
    let judged = streams.iter().map(|attributed| {
        let competitor = arm.better_model.as_ref().filter(|competing| {
            competing.topic == attributed.stream.topic()
                && !fits_as_well(&attributed.stream.diagnosis, competing)
        });
        match competitor.filter(|_| attributed.subject.frame.is_none()) {
            Some(competitor) => {
                SubjectResult::new(attributed.subject.clone(), wrong_model(case, arm, competitor))
                    .within(attributed.stream.span)
            }
            None => judge(case, arm, attributed, &streams),
        }
    });
    judged.chain(imus).collect()
}

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    attributed: &AttributedStream,
    all: &[AttributedStream],
) -> SubjectResult {
    let AttributedStream { stream, subject, .. } = attributed;
    let proof = match &stream.proof {
        Ok(proof) => proof,
        Err(why) => {
            return SubjectResult::new(subject.clone(), not_observable(why, settle(subject)))
                .within(stream.span);
        }
    };
    let error = match attributed.residual() {
        Some(residual) => &residual.error,
        None => proof.corrected.as_ref().unwrap_or(&proof.as_logged),
    };
    let angle = error.angle.as_ref().map(|angle| excess_rms(&angle.whole));
    let has_angle = angle.is_some();
    // `null` in the report.
    let none = Measured { value: f64::NAN, std_error: f64::INFINITY, dof: f64::INFINITY };
    let length = excess_rms(&error.length.whole);
    let thresholds = case.thresholds.frame_thresholds(&MDL001, THRESHOLDS);
    let uncertain = too_uncertain(&length, &thresholds.length)
        .or_else(|| too_uncertain(angle.as_ref()?, &thresholds.angle));
    let competing = &arm.indistinguishable_models;
    let outcome = match outcome(case, arm, attributed, all) {
        Outcome::Evaluated(Ruling::Fail(_))
            if !competing.is_empty() && attributed.residual().is_some() =>
        {
            Outcome::Inconclusive(format!(
                "residual {} with {}, but this motion does not distinguish it from {}: name your arm with --robot",
                sizes(error),
                arm.name,
                competing.join(", ")
            ))
        }
        Outcome::Evaluated(Ruling::Pass(_)) if !stream.unidentified_columns.is_empty() => {
            rotation_not_checked(&stream.unidentified_columns)
        }
        Outcome::Evaluated(Ruling::Pass(_)) if uncertain.is_some() => {
            Outcome::Inconclusive(format!("{}; {REDUCE_NOISE}", uncertain.unwrap_or_default()))
        }
        outcome => outcome,
    };
    let judged = SubjectResult::new(subject.clone(), outcome)
        .within(stream.span)
        .estimated(Estimate::frame("residual", &length, &angle.unwrap_or(none)))
        .with_evidence("as_logged", error_json(case, &proof.as_logged))
        .with_evidence("left", error_json(case, error));
    let judged = match &proof.calibrated {
        Some(residual) => judged.with_evidence("calibrated", error_json(case, residual)),
        None => judged,
    };
    match &stream.diagnosis.residual {
        Ok(residual) => judged
            .with_evidence("rms_m", residual.rms_m)
            .with_evidence("rms_rad", has_angle.then_some(residual.rms_rad))
            .with_evidence("before_m", residual.before_m)
            .with_evidence("before_rad", has_angle.then_some(residual.before_rad)),
        Err(_) => judged,
    }
}

/// The error repeats with the motion apart from the noise, so its interval follows from averaging
/// independent noise.
fn excess_rms(whole: &ErrorMagnitude) -> Measured {
    let noise = whole.noise.unwrap_or_default();
    let independent = (whole.samples as f64 / noise.lag_samples.max(1) as f64).max(3.0);
    Measured {
        value: (whole.rms.powi(2) - noise.rms.powi(2)).max(0.0).sqrt(),
        std_error: noise.rms / independent.sqrt(),
        dof: independent,
    }
}

fn error_json(case: &Case, error: &FkError) -> Value {
    let quantile = |size: &ErrorSize| size.worst().map(|part| part.magnitude.quantile_95);
    let worst = error.length.worst();
    let ns = |at_s: f64| case.evidence.origin.shifted(at_s).to_string();
    json!({
        "most_m": quantile(&error.length),
        "most_rad": error.angle.as_ref().and_then(quantile),
        "noise_m": error.length.whole.noise.map(|noise| noise.rms),
        "noise_rad": error.angle.as_ref().and_then(|angle| angle.whole.noise).map(|noise| noise.rms),
        "from_ns": worst.map(|part| ns(part.from_s)),
        "to_ns": worst.map(|part| ns(part.to_s)),
        "at_m": worst.map(|part| <[f64; 3]>::from(part.at)),
    })
}

fn outcome(
    case: &Case,
    arm: &ArmEvidence,
    attributed: &AttributedStream,
    all: &[AttributedStream],
) -> Outcome {
    let Some(attribution) = &attributed.attribution else { return Outcome::pass() };
    let settle = settle(&attributed.subject);
    if attributed.stream.proof.as_ref().is_ok_and(|proof| proof.is_at_rest) {
        return Outcome::Inconclusive(match attributed.residual() {
            Some(residual) => format!(
                "off by {} at rest; one configuration cannot show why; {settle}",
                sizes(&residual.error)
            ),
            None => format!(
                "there is hardly any motion, and agreement in one configuration proves little; {settle}"
            ),
        });
    }
    let as_logged =
        || attributed.stream.proof.as_ref().map_or(String::new(), |proof| sizes(&proof.as_logged));
    match attribution {
        Attribution::BelowThresholds if attributed.stream.is_uncorrected => {
            Outcome::pass_with_remark(AS_RECORDED)
        }
        Attribution::BelowThresholds | Attribution::Explained { is_reported: true } => {
            Outcome::pass()
        }
        Attribution::WithinNoise => Outcome::pass_with_remark(format!(
            "{} off as logged, within the sample-to-sample noise",
            as_logged()
        )),
        Attribution::Explained { is_reported: false } => Outcome::pass_with_remark(format!(
            "{} off as logged, fully explained by the estimated corrections",
            as_logged()
        )),
        Attribution::SmallErrors(residual) => Outcome::fail(small(case, residual)),
        Attribution::NominalModel(error) => {
            let PoseDiagnosis { link_m, largest_displacement, .. } = &attributed.stream.diagnosis;
            Outcome::fail(match largest_displacement.as_ref().filter(|link| is_unusual(link)) {
                Some(link) => displaced_link(arm, error, link),
                None => nominal(error, *link_m),
            })
        }
        Attribution::Unexplained(residual) if attributed.are_separate_bodies(all) => {
            Outcome::Inconclusive(format!(
                "the streams do not move like one rigid body: off by {} at best, by two separate bodies or an unknown \
                 error; name the stream to compare with by --reference, and exclude poses of other bodies",
                sizes(&residual.error)
            ))
        }
        Attribution::Unexplained(residual) if attributed.is_mismatched() => {
            Outcome::fail(disagreement(attributed, residual))
        }
        Attribution::UnreadOrientations(residual) => {
            Outcome::fail(unread_orientations(case, residual))
        }
        Attribution::Unexplained(residual) => {
            Outcome::fail(unexplained(case, attributed, all, residual))
        }
        Attribution::Undetermined(residual, open) => {
            Outcome::Inconclusive(undetermined_reason(case, residual, open, settle))
        }
    }
}

/// As `12 mm and 0.3°`.
fn sizes(error: &FkError) -> String {
    let length = Unit::Metre.show(error.length.whole.rms);
    match &error.angle {
        Some(angle) => format!("{length} and {}", Unit::Radian.show(angle.whole.rms)),
        None => length,
    }
}

/// As `in 5 of 10 parts of the run, from +10.02 s to +20.00 s, up to 70 mm and 0.2°, largest near (…) m`.
fn describe_residual(case: &Case, residual: &ExceedingResidual) -> String {
    let PartError { at, .. } = residual.worst;
    let quantile = |size: &ErrorSize| size.worst().map_or(0.0, |part| part.magnitude.quantile_95);
    let length = Unit::Metre.show(quantile(&residual.error.length));
    let angle = residual.error.angle.as_ref().map(|angle| Unit::Radian.show(quantile(angle)));
    let quantile = angle.map_or(length.clone(), |angle| format!("{length} and {angle}"));
    let time_of = |at_s: f64| case.evidence.moment_at(at_s);
    let (first, last) = (residual.parts.first(), residual.parts.last());
    let from = time_of(first.map_or(0.0, |part| part.from_s));
    let to = time_of(last.map_or(0.0, |part| part.to_s));
    let at = <[f64; 3]>::from(at).map(|part| rounded(part, 2)).join(", ");
    let (count, all) = (residual.parts.len(), residual.error.length.parts.len());
    let parts = match count {
        _ if count == all => "throughout".to_owned(),
        count => format!("in {count} of {all} parts of the run, from {from} to {to}"),
    };
    format!("{parts}, up to {quantile}, largest near ({at}) m")
}

fn undetermined_reason(
    case: &Case,
    residual: &ExceedingResidual,
    open: &[&str],
    settle: &str,
) -> String {
    let (error_text, largest_text) = (sizes(&residual.error), describe_residual(case, residual));
    let why = match (open, residual.error.length.whole.noise) {
        ([], Some(noise)) if !residual.is_significant() => format!(
            "no finding explains it, and it is not significantly above the noise of {}; {REDUCE_NOISE}",
            Unit::Metre.show(noise.rms)
        ),
        ([], Some(_)) => format!("no finding explains it; {settle}"),
        ([], None) => {
            "no finding explains it, and the samples are too far apart to estimate the noise; \
             record them at a higher rate"
                .to_owned()
        }
        (open, _) => {
            format!(
                "its possible causes are undetermined: {}; resolve these first",
                open.join(", ")
            )
        }
    };
    format!("residual {error_text}, {largest_text}; {why}")
}

fn small(case: &Case, residual: &ExceedingResidual) -> Fault {
    Fault {
        cause: Cause::UnexplainedResidual,
        severity: Severity::Info,
        title: "small residual",
        message: format!(
            "residual {} rms, consistent with normal sag, backlash or encoder error below 0.1° per joint",
            sizes(&residual.error)
        ),
        evidence: Evidence {
            effect: Some(describe_residual(case, residual)),
            effect_m: Some(residual.error.length.whole.rms),
            ..Evidence::default()
        },
        fix: "no action needed if this is within the arm's rated accuracy".to_owned(),
    }
}

fn round_to_one(value: f64) -> f64 {
    let unit = 10f64.powf(value.abs().log10().floor());
    (value / unit).round() * unit
}

fn nominal(error: &FkError, link_m: Option<f64>) -> Fault {
    // Deviations that a motion hides are not known.
    let link_m = link_m.filter(|link_m| *link_m <= error.length.whole.rms);
    let by = link_m.map_or(String::new(), |link_m| {
        format!(": about {} per link", Unit::Metre.show(round_to_one(link_m)))
    });
    Fault {
        cause: Cause::UnexplainedResidual,
        severity: Severity::Info,
        title: "nominal kinematics",
        message: format!(
            "residual {} rms, typical of a nominal model of a calibrated arm{by}",
            sizes(error)
        ),
        evidence: Evidence {
            effect_m: Some(error.length.whole.rms),
            more: link_m.map(|link_m| ("link_m".to_owned(), link_m.into())).into_iter().collect(),
            ..Evidence::default()
        },
        fix: format!(
            "use the arm's calibration (for a UR, calibration.yaml from the controller), or {CALIBRATE}"
        ),
    }
}

/// Whether a link is displaced by significantly more than usual.
fn is_unusual(LinkDisplacement { length_m, .. }: &LinkDisplacement) -> bool {
    /// Links of four UR arms in public logs are displaced by at most 1 mm.
    const MAX_USUAL_M: f64 = 2e-3;
    const CONFIDENCE: f64 = 0.999;
    length_m.value - length_m.half_width(CONFIDENCE) > MAX_USUAL_M
}

fn displaced_link(arm: &ArmEvidence, error: &FkError, link: &LinkDisplacement) -> Fault {
    let name = |column: usize| arm.joints.get(column).map_or("", |joint| &joint.name);
    let [from, to] = link.joints.map(name);
    let length = Unit::Metre.show_measured(&link.length_m);
    let Measured { value: displacement_m, .. } = link.length_m;
    let half = link.length_m.half_width(0.95);
    Fault {
        cause: Cause::UnexplainedResidual,
        severity: Severity::Warning,
        title: "a link differs from the model",
        message: format!(
            "residual {} rms: the link between {from} and {to} differs from the model by {length}",
            sizes(error)
        ),
        evidence: Evidence {
            effect_m: Some(error.length.whole.rms),
            more: [(
                "link".to_owned(),
                json!({
                    "joints": [from, to],
                    "displacement_m": displacement_m,
                    "ci95_m": [displacement_m - half, displacement_m + half],
                }),
            )]
            .into_iter()
            .collect(),
            ..Evidence::default()
        },
        fix: format!(
            "check that the description belongs to this arm and variant; measure the link, or {CALIBRATE}"
        ),
    }
}

fn unexplained(
    case: &Case,
    attributed: &AttributedStream,
    all: &[AttributedStream],
    residual: &ExceedingResidual,
) -> Fault {
    let sharing = all.iter().filter(|other| other.subject != attributed.subject);
    let sharing =
        sharing.filter(|other| other.residual().is_some_and(|other| residual.overlaps(other)));
    let sharing: Vec<&str> = sharing.map(|other| other.stream.topic()).collect();
    let mut evidence = Evidence {
        effect_m: Some(residual.error.length.whole.rms),
        effect: Some(describe_residual(case, residual)),
        ..Evidence::default()
    };
    let shared = match sharing.as_slice() {
        [] => String::new(),
        sharing => format!(", shared with {}", sharing.join(", ")),
    };
    evidence.more.insert("shared_by".to_owned(), sharing.into());
    let said = format!("unexplained residual {} rms{shared}", sizes(&residual.error));
    let varying_angle = &attributed.varying_angle;
    /// Of the residual, for delays that explain it.
    const MIN_SCATTER_SHARE: f64 = 0.5;
    let jitter = attributed.stream.diagnosis.delay_jitter.as_ref().filter(|jitter| {
        attributed.subject.reference.is_none()
            && jitter.scatter_m > MIN_SCATTER_SHARE * residual.error.length.whole.rms
    });
    let scatter = jitter.map_or(String::new(), |jitter| {
        let scatter = Unit::Second.show(jitter.scatter_s);
        format!("; it is mostly along the motion, as delays that scatter by {scatter} produce it")
    });
    let message =
        format!("{said} with the best latency, frames and joint zeros{varying_angle}{scatter}");
    let limits = case.thresholds.frame_thresholds(&MDL001, THRESHOLDS);
    let worst_position = residual.error.length.worst();
    let is_of_rotations =
        worst_position.is_some_and(|part| part.magnitude.quantile_95 < limits.length.warning);
    let fix = match &attributed.subject.reference {
        _ if jitter.is_some() => "stamp each sample at acquisition, not when it is received".to_owned(),
        _ if is_of_rotations => {
            "positions agree, so check how the orientations are computed: interpolated or filtered component by \
             component, not normalised, or integrated from a gyro"
                .to_owned()
        }
        None => format!(
            "check that the description belongs to this arm and variant; {CALIBRATE}; if the error starts at some \
             time, check what happened to the tool, the frames or the joints then"
        ),
        Some(_) => {
            "look at the error over time in the HTML report: a lost track, a drift that is not even, or two bodies \
             that are not rigidly connected"
                .to_owned()
        }
    };
    Fault {
        severity: residual.severity,
        cause: Cause::UnexplainedResidual,
        title: "unexplained residual",
        message,
        evidence,
        fix,
    }
}

fn unread_orientations(case: &Case, residual: &ExceedingResidual) -> Fault {
    let FkError { length, angle } = &residual.error;
    let positions = Unit::Metre.show(length.whole.rms);
    let angle = angle.as_ref().map_or(0.0, |angle| angle.whole.rms);
    let said = format!(
        "orientations differ from FK by {} rms in every known convention, while positions agree to {positions}",
        Unit::Radian.show(angle)
    );
    Fault {
        severity: residual.severity,
        cause: Cause::UnreadOrientations,
        title: "orientations do not follow the arm",
        message: said,
        evidence: Evidence {
            effect: Some(describe_residual(case, residual)),
            ..Evidence::default()
        },
        fix: "check how the orientations are computed: Euler angles in degrees that are taken as radians look like this"
            .to_owned(),
    }
}

fn disagreement(attributed: &AttributedStream, residual: &ExceedingResidual) -> Fault {
    let stream = attributed.stream;
    let as_logged = stream.proof.as_ref().ok().map(|proof| &proof.as_logged);
    // Meaningless as logged if the reference frame is not fixed to the robot.
    let error = as_logged.filter(|_| stream.reference_known).unwrap_or(&residual.error);
    let candidates = candidates(stream);
    let said = format!("{}, and no known cause explains it", describe_disagreement(error));
    let nearest = match candidates.first() {
        Some(first) => format!("; closest explanation: {first}"),
        None => String::new(),
    };
    let mut evidence = Evidence { effect_m: Some(error.length.whole.rms), ..Evidence::default() };
    let message = format!("{said}{nearest}");
    evidence.more.insert("candidates".to_owned(), candidates.into());
    Fault {
        severity: Severity::Error,
        cause: Cause::Disagreement { description: said },
        title: DISAGREEMENT_TITLE,
        message,
        evidence,
        fix: "check that the description and the joint states belong to this arm; record 10 s in which the joints move \
            by 30° one at a time"
            .to_owned(),
    }
}

const DISAGREEMENT_TITLE: &str = "poses and joint states disagree";

fn describe_disagreement(error: &FkError) -> String {
    let length = Unit::Metre.show(error.length.whole.rms);
    let angle = error.angle.as_ref().map(|angle| Unit::Radian.show(angle.whole.rms));
    let angle = angle.map_or(String::new(), |angle| format!(", {angle}"));
    format!("poses and joint states disagree by {length}{angle}")
}

/// Best first.
fn candidates(stream: &StreamEvidence<PoseEvidence>) -> Vec<String> {
    let found = &stream.diagnosis;
    let proof = stream.proof.as_ref().ok();
    let rms = |error: &FkError| error.length.whole.rms;
    let residual = proof.and_then(|proof| {
        let nearer = |residual: &&FkError| rms(residual) < 0.5 * rms(&proof.as_logged);
        proof.corrected.as_ref().filter(nearer)
    });
    let all =
        residual.map(|residual| format!("all findings together (residual {})", sizes(residual)));
    let ranked = found.encoding.as_ref().map_or(&[] as &[_], |encoding| &encoding.ranked);
    let encodings =
        ranked.iter().filter(|(encoding, _)| !matches!(encoding, PoseEncoding::AsLogged)).take(3);
    let encodings = encodings.map(|(encoding, residual_rad)| {
        let Interpretation { is, read_as: was } = encoding_names(encoding);
        format!("{is} read as {was} (residual {})", Unit::Radian.show(*residual_rad))
    });
    all.into_iter().chain(encodings).collect()
}

/// Whether the named arm with its findings fits as well: if a joint turns alone, any arm does.
fn fits_as_well(found: &PoseDiagnosis, competing: &CompetingModel) -> bool {
    /// Between fits that are equally good; not calibrated.
    const MAX_RESIDUAL_RATIO: f64 = 2.0;
    let max_m = MAX_RESIDUAL_RATIO * competing.residual_m;
    found.residual.as_ref().is_ok_and(|residual| residual.excess_m.value < max_m)
}

fn wrong_model(case: &Case, arm: &ArmEvidence, competitor: &CompetingModel) -> Outcome {
    let CompetingModel { name, named_residual_m: named_m, residual_m: left_m, tool_m, .. } =
        competitor;
    let [fits, misfit_text] = [left_m, named_m].map(|left_m| Unit::Metre.show(*left_m));
    let with = match tool_m {
        Some(tool_m) => format!("with a TCP of {}", Unit::Metre.show(*tool_m)),
        None => "with no further correction".to_owned(),
    };
    let named = match *name == arm.name {
        true => format!("the {name} of the given model"),
        false => format!("the given {}", arm.name),
    };
    let mut evidence = Evidence { effect_m: Some(*named_m), ..Evidence::default() };
    let fits_json = json!({"robot": name, "misfit_m": left_m, "tool_m": tool_m});
    evidence.more.insert("fits".to_owned(), fits_json);
    Outcome::fail(Fault {
        cause: Cause::OtherRobot(name.clone()),
        severity: case
            .thresholds
            .frame_thresholds(&MDL001, THRESHOLDS)
            .length
            .severity(*named_m)
            .unwrap_or(Severity::Warning),
        title: "wrong robot model",
        message: format!(
            "wrong robot model: a {name} fits the poses to {fits} {with}, {named} only to {misfit_text}"
        ),
        evidence,
        fix: format!(
            "if the arm is a {name}, audit with --robot {name}; otherwise check the order, unit and sign of \
             the joints"
        ),
    })
}

mod eccentric;
use eccentric::eccentricity;

#[cfg(test)]
mod tests;
