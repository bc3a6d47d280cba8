mod imu;

use serde_json::{Value, json};

use crate::checks::decision::unseen;
use crate::checks::frames::THRESHOLDS;
use crate::checks::reading::{not_checked, read_as};
use crate::checks::standing::{Left, Named, Standing, standing};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{Amount, Error, Measured, Part, Reading, Size};
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{
    Cause, Estimate, Evidence, Fault, Outcome, ReadAs, Ruling, Severity, Subject, Unit, rounded,
};
use crate::run::BetterModel;

rule! {
    /// An error is left that nothing found explains.
    ///
    /// ## What it means
    /// Every stream is held against FK twice. Beside the estimators, and without them, its error as
    /// logged is taken straight from FK: what 95 % of the samples stay below, over the moving run and
    /// over each tenth of it. Where that reaches the thresholds, the amounts that other rules found must
    /// account for it: with them taken off, less than the thresholds may be left in every tenth, or no
    /// more than twice what differs from sample to sample. What is more than that has no name in this
    /// audit: kinematic parameters, a bent link, gear error, what changes slowly in mid-run, another
    /// arm.
    ///
    /// An IMU is held against FK, too: by what its orientation and its gyro leave beside what was found, by
    /// the scale of its gyro (`gyro gain`, the share by which it reads too much or too little), and by the
    /// value that its gyro never passes while the arm does (`gyro saturation`).
    ///
    /// ## Why it matters
    /// A run passes only where this rule passes on every stream. It is the best accuracy that correcting
    /// the other findings can reach, and the warning that the description may be of another arm.
    ///
    /// ## Evidence
    /// `value` is the rms of position beyond the sample-to-sample noise, `rotation` that of
    /// orientation; `rms_m` and `rms_rad` are with the noise, `before_m` and `before_rad` before
    /// anything was taken off. `as_logged` is the error straight from FK, `left` what the findings
    /// leave of it, both as what 95 % stay below (`most_m`, `most_rad`) in the worst tenth of the run,
    /// with its times and the place of the tip there (`from_ns`, `to_ns`, `at_m`). `shared_by` names
    /// the streams in which it is left at the same times. Where it goes with the angle of a joint once,
    /// twice or three times a turn, as of an eccentric gear or encoder, the message names the joint and
    /// by how much. `candidates` are the nearest causes, each
    /// with what it leaves. `fits` names an arm of the catalogue with the same joints that fits far better
    /// than the model that was named, and its residual (`misfit_m`; `tool_m` if it needs an active TCP). The
    /// audit keeps the named model; rules that compare the poses with it stay open.
    ///
    /// Of a gyro, `scale` is the gain less 1 along x, y and z with its interval; `axes` are those that
    /// saturate, `share` is that of the samples at the limit, `by_fk_rad_s` how fast the arm turned.
    ///
    /// Of a drawing against a calibrated arm `link_m` is by how much each link is off, as a standard
    /// deviation; angles by 0.1° where that is 1 mm.
    ///
    /// A stream that does what the arm does by more than 40 ms before it is not compared, and is open: it is a
    /// command, or a pose of the tool beside late joint states.
    ///
    /// It is a finding where the error is three times what differs from sample to sample (an F of
    /// nine), or comes again with the posture; else it is open, and so is the run's verdict.
    ///
    /// ## How to fix
    /// Use the arm's own calibrated description (for a UR, `calibration.yaml` extracted from the
    /// controller). If it is a few millimetres everywhere, that is it; if it is centimetres, look
    /// for the wrong model; if it begins at some time, look at what happened then.
    ///
    /// ## When it misleads
    /// A nominal description against a calibrated arm leaves 1–10 mm; that is no fault of the log.
    /// Slowly wandering noise of a tracker counts as an error that is left.
    MDL001 {
        name: "unexplained-residual",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle, imu::GAIN]),
        headline: true,
        needs_model: true,
        missing: "no joint states with a model",
        check: check,
    }
}

/// What would tell where the residual could not be had.
const SETTLE: &str = "record 10 s in which every joint moves";

/// What must be recorded where there is nothing to hold the joint states against.
const RECORD: &str = "record the tool's pose (the controller's, a tracker's), /tf or an IMU on the \
                      arm, while every joint moves for 10 s";

fn check(case: &Case) -> Vec<Judged> {
    let named = Named::of(case);
    let arms = case.evidence.robots.iter().flat_map(|arm| judge_arm(case, &named, arm));
    arms.chain(case.evidence.leaders.iter().map(judge_leader)).collect()
}

/// A stream that leads the arm is a command or a pose of the tool beside late joint states. Nothing in the
/// log tells which, and in the second case a fault would go unseen.
fn judge_leader(stream: &Of<f64>) -> Judged {
    let why = format!(
        "not compared: the arm does the same {:.0} ms later. A hand tracker or a leader arm does that, and so does \
         a measurement of the tool beside late joint states; [stream.\"{}\"] with role = \"reference\" or \"pose\" in \
         poseaudit.toml says which",
        1e3 * **stream,
        stream.topic(),
    );
    stream.judged(Outcome::Inconclusive(why))
}

/// A stream of an arm, and how its error stands.
struct Held<'a> {
    stream: &'a Of<PoseEvidence>,
    subject: Subject,
    standing: Option<Standing>,
    /// What it goes with, where that is known: see [`eccentricity`].
    goes_with: String,
}

impl Held<'_> {
    /// What is left of it, where that is too much.
    fn left(&self) -> Option<&Left> {
        match self.standing.as_ref()? {
            Standing::Left(left) | Standing::Open(left, _) => Some(left),
            _ => None,
        }
    }

    /// Whether nothing that was found makes the poses those of the arm.
    fn is_astray(&self) -> bool {
        let reference_known = self.stream.reference_known;
        match &self.stream.diagnosis.residual {
            Ok(_) => self.stream.diagnosis.strays(),
            Err(_) => reference_known,
        }
    }
}

fn judge_arm(case: &Case, named: &Named, arm: &ArmEvidence) -> Vec<Judged> {
    let thresholds = case.thresholds.of_frames(&MDL001, THRESHOLDS);
    let held = |subject: Subject, stream| {
        let standing = standing(named, arm, stream, &thresholds, case.evidence.subjects());
        Held { stream, subject, standing, goes_with: eccentricity(arm) }
    };
    let poses = arm.poses.iter().map(|stream| held(stream.subject.clone(), stream));
    // What is reckoned from the joint states knows nothing of their eccentricity.
    let tf = arm
        .tf
        .iter()
        .map(|tf| Held { goes_with: String::new(), ..held(arm.frame(tf.topic(), &tf.tip), tf) });
    let streams: Vec<Held> = poses.chain(tf).collect();
    if streams.is_empty() && arm.imus.iter().all(|imu| imu.proof.is_none()) {
        if case.evidence.hand_eyes.iter().any(|eye| eye.robot.as_ref() == Some(&arm.name)) {
            let why = "only what a camera sees was held against it (HEC001)".to_owned();
            return vec![Judged::new(arm.subject(), Outcome::Skipped(why))];
        }
        let why =
            format!("nothing in this log could be held against {}; {RECORD}", arm.joints_topic);
        return vec![Judged::new(arm.subject(), Outcome::Inconclusive(why)).within(arm.span)];
    }
    let imus = arm.imus.iter().flat_map(|imu| imu::judge(case, &thresholds, imu));
    let judged = streams.iter().map(|held| {
        let better = arm.better_model.as_ref().filter(|it| it.topic == held.stream.topic());
        match better.filter(|_| held.subject.frame.is_none()) {
            Some(better) => Judged::new(held.subject.clone(), wrong_model(case, arm, better))
                .within(held.stream.span),
            None => judge(case, held, &streams),
        }
    });
    judged.chain(imus).collect()
}

fn judge(case: &Case, held: &Held, all: &[Held]) -> Judged {
    let Held { stream, subject, standing, .. } = held;
    let proof = match &stream.proof {
        Ok(proof) => proof,
        Err(why) => return Judged::new(subject.clone(), unseen(why, SETTLE)).within(stream.span),
    };
    let error = match standing {
        Some(Standing::Left(left) | Standing::Open(left, _)) => &left.error,
        _ => proof.left.as_ref().unwrap_or(&proof.as_logged),
    };
    let angle = error.angle.as_ref().map(|angle| beyond_noise(&angle.whole));
    let none = Measured { value: 0.0, std_error: 0.0, dof: f64::INFINITY };
    let length = beyond_noise(&error.length.whole);
    let outcome = match outcome(case, held, all) {
        Outcome::Evaluated(Ruling::Sound(_)) if !stream.rotation_unread.is_empty() => {
            not_checked(&stream.rotation_unread)
        }
        outcome => outcome,
    };
    let judged = Judged::new(subject.clone(), outcome)
        .within(stream.span)
        .estimated(Estimate::frame("residual", &length, &angle.unwrap_or(none)))
        .with_evidence("as_logged", error_json(case, &proof.as_logged))
        .with_evidence("left", error_json(case, error));
    let judged = match &proof.calibrated {
        Some(left) => judged.with_evidence("calibrated", error_json(case, left)),
        None => judged,
    };
    match &stream.diagnosis.residual {
        Ok(residual) => judged
            .with_evidence("rms_m", residual.rms_m)
            .with_evidence("rms_rad", residual.rms_rad)
            .with_evidence("before_m", residual.before_m)
            .with_evidence("before_rad", residual.before_rad),
        Err(_) => judged,
    }
}

/// What an error is beyond the noise, rms. Whenever the arm does this again it is the same but for the
/// noise: so its interval is that of a mean of independent noise.
fn beyond_noise(whole: &Amount) -> Measured {
    let noise = whole.noise.unwrap_or_default();
    let independent = (whole.samples as f64 / noise.over.max(1) as f64).max(3.0);
    Measured {
        value: (whole.rms.powi(2) - noise.rms.powi(2)).max(0.0).sqrt(),
        std_error: noise.rms / independent.sqrt(),
        dof: independent,
    }
}

/// The size of an error over the run, and in the part in which it is largest.
fn error_json(case: &Case, error: &Error) -> Value {
    let most = |size: &Size| size.worst().map(|part| part.amount.most);
    let worst = error.length.worst();
    let ns = |at_s: f64| case.evidence.origin.shifted(at_s).to_string();
    json!({
        "most_m": most(&error.length),
        "most_rad": error.angle.as_ref().and_then(most),
        "noise_m": error.length.whole.noise.map(|noise| noise.rms),
        "noise_rad": error.angle.as_ref().and_then(|angle| angle.whole.noise).map(|noise| noise.rms),
        "from_ns": worst.map(|part| ns(part.from_s)),
        "to_ns": worst.map(|part| ns(part.to_s)),
        "at_m": worst.map(|part| <[f64; 3]>::from(part.at)),
    })
}

fn outcome(case: &Case, held: &Held, all: &[Held]) -> Outcome {
    let Some(standing) = &held.standing else { return Outcome::sound() };
    let at_rest = held.stream.proof.as_ref().is_ok_and(|proof| proof.at_rest);
    let as_logged =
        || held.stream.proof.as_ref().map_or(String::new(), |proof| sizes(&proof.as_logged));
    match standing {
        Standing::Left(left) | Standing::Open(left, _) if at_rest => {
            let off = sizes(&left.error);
            Outcome::Inconclusive(format!(
                "it is {off} off at rest, and one posture does not tell why; {SETTLE}"
            ))
        }
        _ if at_rest => Outcome::Inconclusive(format!(
            "the arm hardly moves, and that poses agree in one posture proves little; {SETTLE}"
        )),
        Standing::Below | Standing::Accounted { is_named: true } => Outcome::sound(),
        Standing::Noise => Outcome::sound_because(format!(
            "{} off as logged, which differ from sample to sample",
            as_logged()
        )),
        Standing::Accounted { is_named: false } => Outcome::sound_because(format!(
            "{} off as logged, by amounts that are each below the thresholds of their rules",
            as_logged()
        )),
        Standing::Small(left) => Outcome::faulty(small(case, left)),
        Standing::Nominal(error) => Outcome::faulty(nominal(error, held.stream.diagnosis.link_m)),
        Standing::Left(left) if held.is_astray() => Outcome::faulty(disagreement(held, left)),
        Standing::Left(left) => Outcome::faulty(unexplained(case, held, all, left)),
        Standing::Open(left, open) => Outcome::Inconclusive(why_open(case, left, open)),
    }
}

/// The two sizes of an error: `12 mm and 0.3°`.
fn sizes(error: &Error) -> String {
    let length = Unit::Metre.show(error.length.whole.rms);
    match &error.angle {
        Some(angle) => format!("{length} and {}", Unit::Radian.show(angle.whole.rms)),
        None => length,
    }
}

/// When and where too much is left: `in 5 of 10 parts of the run, from +10.02 s to +20.00 s, up to 70 mm
/// and 0.2° near (…) m`.
fn where_left(case: &Case, left: &Left) -> String {
    let Part { at, .. } = left.worst;
    let most = |size: &Size| size.worst().map_or(0.0, |part| part.amount.most);
    let length = Unit::Metre.show(most(&left.error.length));
    let angle = left.error.angle.as_ref().map(|angle| Unit::Radian.show(most(angle)));
    let most = angle.map_or(length.clone(), |angle| format!("{length} and {angle}"));
    let moment = |at_s: f64| case.evidence.moment(case.evidence.origin.shifted(at_s));
    let (first, last) = (left.parts.first(), left.parts.last());
    let from = moment(first.map_or(0.0, |part| part.from_s));
    let to = moment(last.map_or(0.0, |part| part.to_s));
    let at = <[f64; 3]>::from(at).map(|part| rounded(part, 2)).join(", ");
    let (count, all) = (left.parts.len(), left.error.length.parts.len());
    let parts = match count {
        _ if count == all => "throughout".to_owned(),
        count => format!("in {count} of {all} parts of the run, from {from} to {to}"),
    };
    format!("{parts}, up to {most}, most near ({at}) m")
}

/// Why it is open what is left.
fn why_open(case: &Case, left: &Left, open: &[&str]) -> String {
    let (off, most) = (sizes(&left.error), where_left(case, left));
    let why = match (open, left.error.length.whole.noise) {
        ([], Some(noise)) if !left.is_beyond_noise() => format!(
            "no finding accounts for that, and it is not surely more than {} that differ from sample \
             to sample",
            Unit::Metre.show(noise.rms)
        ),
        ([], Some(_)) => "no finding accounts for that".to_owned(),
        ([], None) => "no finding accounts for that, and samples this far apart do not tell its \
                       noise"
            .to_owned(),
        (open, _) => format!("what accounts for it is open: {}", open.join(", ")),
    };
    format!("{off} are left, {most}; {why}; {SETTLE}")
}

fn small(case: &Case, left: &Left) -> Fault {
    Fault {
        cause: Cause::Model,
        severity: Severity::Info,
        title: "small residual",
        message: format!(
            "{} rms are left, as sag, play or encoder error below 0.1° a joint leave together",
            sizes(&left.error)
        ),
        evidence: Evidence {
            effect: Some(where_left(case, left)),
            effect_m: Some(left.error.length.whole.rms),
            ..Evidence::default()
        },
        fix: "nothing, where that is as well as the arm is known to be".to_owned(),
    }
}

/// A number by its first digit.
fn round_to_one(value: f64) -> f64 {
    let unit = 10f64.powf(value.abs().log10().floor());
    (value / unit).round() * unit
}

fn nominal(error: &Error, link_m: Option<f64>) -> Fault {
    let by = link_m.map_or(String::new(), |link_m| {
        format!(": about {} a link", Unit::Metre.show(round_to_one(link_m)))
    });
    Fault {
        cause: Cause::Model,
        severity: Severity::Info,
        title: "nominal kinematics",
        message: format!(
            "residual {} rms, as of a nominal model against a calibrated arm{by}",
            sizes(error)
        ),
        evidence: Evidence {
            effect_m: Some(error.length.whole.rms),
            more: link_m.map(|link_m| ("link_m".to_owned(), link_m.into())).into_iter().collect(),
            ..Evidence::default()
        },
        fix: "use the arm's calibration (of a UR, calibration.yaml from the controller), or estimate it from logs \
              with `poseaudit calibrate`"
            .to_owned(),
    }
}

/// What is left beside the causes that were found.
fn unexplained(case: &Case, held: &Held, all: &[Held], left: &Left) -> Fault {
    let sharing = all.iter().filter(|other| other.subject != held.subject);
    let sharing = sharing.filter(|other| other.left().is_some_and(|other| left.shares(other)));
    let sharing: Vec<&str> = sharing.map(|other| other.stream.topic()).collect();
    let mut evidence = Evidence {
        effect_m: Some(left.error.length.whole.rms),
        effect: Some(where_left(case, left)),
        ..Evidence::default()
    };
    let shared = match sharing.as_slice() {
        [] => String::new(),
        sharing => format!(", and the same of {}", sharing.join(", ")),
    };
    evidence.more.insert("shared_by".to_owned(), sharing.into());
    let said = format!("unexplained residual {} rms{shared}", sizes(&left.error));
    let goes_with = &held.goes_with;
    let message = format!("{said} after all other findings are corrected{goes_with}");
    let fix = "use the arm's calibrated description, or see whether it is the right one; where it \
               begins at some time, see what happened to the tool, the frames or the joints then"
        .to_owned();
    Fault {
        severity: left.severity,
        cause: Cause::Model,
        title: "unexplained residual",
        message,
        evidence,
        fix,
    }
}

/// Poses and joint states that nothing makes those of one arm.
fn disagreement(held: &Held, left: &Left) -> Fault {
    let stream = held.stream;
    let as_logged = stream.proof.as_ref().ok().map(|proof| &proof.as_logged);
    // Against a frame that is not tied to the robot, what is logged is off by any amount.
    let error = as_logged.filter(|_| stream.reference_known).unwrap_or(&left.error);
    let candidates = candidates(stream);
    let said = said(error);
    let nearest = match candidates.first() {
        Some(first) => format!("; nearest is {first}"),
        None => String::new(),
    };
    let mut evidence = Evidence { effect_m: Some(error.length.whole.rms), ..Evidence::default() };
    let said = format!("{said}, and no cause that poseaudit knows explains it");
    let message = format!("{said}{nearest}");
    let fix = format!(
        "see whether it is this arm's description, and whether the joint states are this arm's; {TELLS}"
    );
    evidence.more.insert("candidates".to_owned(), candidates.into());
    Fault {
        severity: Severity::Error,
        cause: Cause::Disagreement { said },
        title: DISAGREE,
        message,
        evidence,
        fix,
    }
}

/// The title where nothing makes poses and joint states those of one arm.
const DISAGREE: &str = "poses and joint states disagree";

/// What would tell why they do.
const TELLS: &str = "record 10 s in which one joint after the other moves by 30° alone";

/// By how much poses and joint states disagree, as reports say it.
fn said(error: &Error) -> String {
    let length = Unit::Metre.show(error.length.whole.rms);
    let angle = error.angle.as_ref().map(|angle| Unit::Radian.show(angle.whole.rms));
    let angle = angle.map_or(String::new(), |angle| format!(", {angle}"));
    format!("poses and joint states disagree by {length}{angle}")
}

/// The nearest causes, each with what it leaves: the best first.
fn candidates(stream: &Of<PoseEvidence>) -> Vec<String> {
    let found = &stream.diagnosis;
    let proof = stream.proof.as_ref().ok();
    let rms = |error: &Error| error.length.whole.rms;
    let left = proof.and_then(|proof| {
        let nearer = |left: &&Error| rms(left) < 0.5 * rms(&proof.as_logged);
        proof.left.as_ref().filter(nearer)
    });
    let all = left.map(|left| format!("all that was found together, which leaves {}", sizes(left)));
    let ranked = found.reading.as_ref().map_or(&[] as &[_], |reading| &reading.ranked);
    let readings =
        ranked.iter().filter(|(reading, _)| !matches!(reading, Reading::AsLogged)).take(3);
    let readings = readings.map(|(reading, left_rad)| {
        let ReadAs { is, read_as: was } = read_as(reading);
        format!("{is} read as {was}, which leaves {}", Unit::Radian.show(*left_rad))
    });
    all.into_iter().chain(readings).collect()
}

/// Another arm fits far better than the model that was named.
fn wrong_model(case: &Case, arm: &ArmEvidence, better: &BetterModel) -> Outcome {
    let BetterModel { name, named_m, left_m, tool_m, .. } = better;
    let [fits, off] = [left_m, named_m].map(|left_m| Unit::Metre.show(*left_m));
    let with = match tool_m {
        Some(tool_m) => format!("with a TCP of {}", Unit::Metre.show(*tool_m)),
        None => "without any cause".to_owned(),
    };
    let named = match *name == arm.name {
        true => format!("the {name} of the model that was given"),
        false => format!("the {} that was named", arm.name),
    };
    let mut evidence = Evidence { effect_m: Some(*named_m), ..Evidence::default() };
    let fits_json = json!({"robot": name, "misfit_m": left_m, "tool_m": tool_m});
    evidence.more.insert("fits".to_owned(), fits_json);
    Outcome::faulty(Fault {
        cause: Cause::OtherRobot(name.clone()),
        severity: case
            .thresholds
            .of_frames(&MDL001, THRESHOLDS)
            .length
            .severity(*named_m)
            .unwrap_or(Severity::Warning),
        title: "wrong robot model",
        message: format!(
            "wrong robot model: a {name} fits the poses to {fits} {with}, {named} only to {off}"
        ),
        evidence,
        fix: format!(
            "if the arm is a {name}, audit with --robot {name}; else check the order, unit and sign of the joints"
        ),
    })
}

mod eccentric;
use eccentric::eccentricity;

#[cfg(test)]
mod tests;
