use crate::checks::decision::{Decision, Threshold, decide, not_observable};
use crate::checks::joint_groups::{group_equal, group_prefix, group_subject, with_joint_names};
use crate::checks::motion::mot003_limits_exceeded;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{CommandDelay, DelayFailure, Measured, Response};
use crate::evidence::{ArmEvidence, ReferenceEvidence, StreamEvidence};
use crate::finding::{
    Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Span, Subject, Unit,
};

rule! {
    /// High command-to-state delay.
    ///
    /// ## What it means
    /// The state follows a streamed command with this delay: the command at stamp *t* is reached at *t +
    /// delay*. A negative delay is impossible, so one of the stamps is wrong. Joint commands are judged per
    /// joint; joints with the same delay are one finding on their topic. Commanded poses are compared with
    /// FK of the joint states. Without an arm model, commands are compared with the joint states of the
    /// same names.
    ///
    /// ## Why it matters
    /// A control loop closed over this delay oscillates. Visual servoing, teleoperation and force control
    /// need a bandwidth below a fraction of its inverse. A policy trained on pairs of state and command
    /// learns the delay.
    ///
    /// ## Evidence
    /// The delay at which changes of the command best explain changes of the state, over windows, with a
    /// block-based interval. If a first-order low-pass explains much more, `low_pass_hz` is its corner
    /// frequency; the delay then includes its time constant, `pure_delay_s` does not. `gain` is the motion
    /// of the state per unit of the command, negative if the joint moves the other way, `explained` the
    /// explained fraction of the state's motion, `command_period_s` the time between commands. A delay of
    /// one period is a one-step shift. FRM006 reports reversed and scaled joints, and differences at rest.
    ///
    /// ## How to fix
    /// Look for smoothing or buffering of the trajectory: a look-ahead time, a low-pass on the set-points,
    /// a command queue, or a low gain in the tracking loop. A one-step shift comes from a controller that
    /// interpolates to each command until the next arrives, or from pairing each state with the previous
    /// command.
    ///
    /// ## When it misleads
    /// Goals, even repeated ones, do not show a delay, because the controller plans the path. Periodic
    /// motion fits several delays. A command without a stamp is compared at its record time. The
    /// `time_from_start` of trajectory points is not subtracted. Late joint states (LAT001) increase the
    /// delay.
    LAT004 {
        name: "command-delay",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: false,
        missing: "no commands to the arm in this log",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::Second, warning: 0.05, error: 0.2 };
const SETTLE: &str = "record 10 s of motion that starts, stops and does not repeat";

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        arm.references.iter().flat_map(|one| judge_stream(case, arm, one)).collect()
    };
    let unmodelled = case.evidence.unmodelled_commands.iter().flat_map(|of| {
        let joints = of.value.joints.iter().map(String::as_str).collect();
        let commands = Commands { subject: &of.subject, span: of.span, joints };
        let goals = goals_reason(&of.value.delays).map(|why| {
            vec![SubjectResult::new(of.subject.clone(), Outcome::Inconclusive(why)).within(of.span)]
        });
        goals.unwrap_or_else(|| judge_delays(case, &commands, &of.value.delays))
    });
    case.evidence.robots.iter().flat_map(of_arm).chain(unmodelled).collect()
}

struct Commands<'a> {
    subject: &'a Subject,
    span: Option<Span>,
    joints: Vec<&'a str>,
}

#[derive(Clone, Copy)]
struct ExcessiveDelay<'a> {
    of: &'a CommandDelay,
    response: &'a Response,
    severity: Severity,
}

fn judge_stream(
    case: &Case,
    arm: &ArmEvidence,
    reference: &StreamEvidence<ReferenceEvidence>,
) -> Vec<SubjectResult> {
    let for_stream = |outcome| vec![reference.judged(outcome)];
    if let Err(why) = &reference.diagnosis {
        return for_stream(Outcome::Skipped(why.clone()));
    }
    if let Some(why) = mot003_limits_exceeded::doubt(arm).filter(|_| reference.is_of_joints) {
        return for_stream(Outcome::Inconclusive(why));
    }
    if let Some(why) = goals_reason(&reference.delays) {
        return for_stream(Outcome::Inconclusive(why));
    }
    let joints = arm.joints.iter().map(|joint| joint.name.as_str()).collect();
    let commands = Commands { subject: &reference.subject, span: reference.span, joints };
    judge_delays(case, &commands, &reference.delays)
}

fn judge_delays(case: &Case, commands: &Commands, delays: &[CommandDelay]) -> Vec<SubjectResult> {
    let mut rows = Vec::new();
    let mut faults = Vec::new();
    for (at, of) in delays.iter().enumerate() {
        let place = of.joint.unwrap_or(at);
        let joints: Vec<usize> = of.joint.into_iter().collect();
        let subject = group_subject(commands.subject, &commands.joints, &joints);
        let judged = |outcome| SubjectResult::new(subject.clone(), outcome).within(commands.span);
        let response = match &of.response {
            Ok(response) => response,
            Err(why) => {
                rows.push(judged(no_delay_outcome(why)));
                continue;
            }
        };
        let threshold = case.thresholds.threshold(&LAT004, THRESHOLD);
        let outcome = match decide(&response.delay_s, &threshold, case.evidence.subjects()) {
            Decision::Fail(severity) => {
                faults.push((place, ExcessiveDelay { of, response, severity }));
                continue;
            }
            Decision::Pass => Outcome::pass_with_remark(describe_delay(of, response)),
            Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
        };
        rows.push(with_numbers(judged(outcome), of, response));
    }
    let groups = group_equal(faults, |a, b| is_same(a.response, b.response));
    rows.extend(groups.iter().map(|group| report_group(case, commands, group)));
    rows
}

/// Reason why commands do not show a delay: they are goals.
fn goals_reason(delays: &[CommandDelay]) -> Option<String> {
    let are = |why: &DelayFailure| {
        let failed_with = |of: &CommandDelay| of.response.as_ref().err() == Some(why);
        !delays.is_empty() && delays.iter().all(failed_with)
    };
    let what = match () {
        () if are(&DelayFailure::Goals) => "its commands are goals, not streamed",
        () if are(&DelayFailure::Steps) => "its commands change in steps, like repeated goals",
        () => return None,
    };
    Some(format!("{what}, and the arm plans the path itself; log the drives' set-points"))
}

fn no_delay_outcome(why: &DelayFailure) -> Outcome {
    match why {
        DelayFailure::Goals | DelayFailure::Steps => {
            Outcome::Inconclusive(format!("it receives goals and plans the path itself; {SETTLE}"))
        }
        DelayFailure::NotObservable(why) => not_observable(why, SETTLE),
    }
}

fn is_same(a: &Response, b: &Response) -> bool {
    /// Closer delays are the same, s or relative.
    const MAX_DELAY_DIFFERENCE_S: f64 = 5e-3;
    const MAX_RELATIVE_DIFFERENCE: f64 = 0.1;
    let difference_s = (a.delay_s.value - b.delay_s.value).abs();
    let known_s = 4.0 * a.delay_s.std_error.hypot(b.delay_s.std_error);
    difference_s
        < MAX_DELAY_DIFFERENCE_S
            .max(MAX_RELATIVE_DIFFERENCE * a.delay_s.value.abs())
            .max(known_s.min(0.05))
}

fn report_group(
    case: &Case,
    commands: &Commands,
    group: &[(usize, ExcessiveDelay<'_>)],
) -> SubjectResult {
    let joints: Vec<usize> = group.iter().filter_map(|(_, long)| long.of.joint).collect();
    let by_delay = |a: &&(usize, ExcessiveDelay<'_>), b: &&(usize, ExcessiveDelay<'_>)| {
        let size = |one: &(usize, ExcessiveDelay<'_>)| one.1.response.delay_s.value.abs();
        size(a).total_cmp(&size(b))
    };
    let (_, ExcessiveDelay { of, response, severity }) =
        *group.iter().max_by(by_delay).unwrap_or(&group[0]);
    let limit = Unit::Second.show(case.thresholds.threshold(&LAT004, THRESHOLD).warning);
    let is_early = response.delay_s.value < 0.0;
    let subject = group_subject(commands.subject, &commands.joints, &joints);
    let who = group_prefix(&commands.joints, &joints);
    let fault = Fault {
        severity,
        cause: Cause::Pictured(Picture::Stream),
        title: if is_early { "state leads its command" } else { "state follows its command late" },
        message: format!("{who}{} (limit {limit})", describe_delay(of, response)),
        evidence: Evidence::default(),
        fix: match is_early {
            true => "stamp commands when they are sent, and states when they are read".to_owned(),
            false => format!(
                "reduce buffering and smoothing between {} and the drives, or allow for the delay in the control loop",
                commands.subject.topic.as_deref().unwrap_or_default()
            ),
        },
    };
    let judged = SubjectResult::new(subject, Outcome::fail(fault)).within(commands.span);
    with_joint_names(with_numbers(judged, of, response), &commands.joints, &joints)
}

fn describe_delay(of: &CommandDelay, response: &Response) -> String {
    let delay = &response.delay_s;
    let shown = Unit::Second.show_measured(&delay.abs());
    if delay.value < 0.0 {
        return format!("state leads its command by {shown}");
    }
    let how = match response.corner_hz() {
        Some(hz) => {
            let pure_s = response.pure_delay_s();
            let low_pass = match pure_s > 0.3 * response.low_pass_s {
                true => format!(" after {}", Unit::Second.show(pure_s)),
                false => String::new(),
            };
            format!(": low-pass of {hz:.1} Hz{low_pass}")
        }
        None if is_one_step(of, delay) => {
            format!(": one-step shift of commands every {}", Unit::Second.show(of.period_s))
        }
        None => String::new(),
    };
    format!("state follows by {shown}{how}")
}

fn is_one_step(of: &CommandDelay, delay: &Measured) -> bool {
    const MAX_PERIOD_DEVIATION: f64 = 0.1;
    (delay.value - of.period_s).abs() < MAX_PERIOD_DEVIATION * of.period_s
}

fn with_numbers(judged: SubjectResult, of: &CommandDelay, response: &Response) -> SubjectResult {
    judged
        .estimated(Estimate::scalar("command delay", THRESHOLD.unit, &response.delay_s))
        .with_evidence("low_pass_hz", response.corner_hz())
        .with_evidence("pure_delay_s", response.pure_delay_s())
        .with_evidence("gain", response.gain)
        .with_evidence("explained", response.explained)
        .with_evidence("command_period_s", of.period_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{COMMANDS, clean_run, evaluate_rule, precise};
    use crate::evidence::RunEvidence;
    use crate::finding::Status;

    fn planted(delays: &[(Option<usize>, f64, f64)]) -> RunEvidence {
        let mut run = clean_run();
        let clean = run.robots[0].references[0].delays[0].clone();
        let Ok(response) = clean.response.clone() else { panic!("a clean delay") };
        let of = |&(joint, delay_s, low_pass_s): &(Option<usize>, f64, f64)| CommandDelay {
            joint,
            period_s: 0.1,
            response: Ok(Response { delay_s: precise(delay_s), low_pass_s, ..response }),
            map: None,
        };
        run.robots[0].references[0].delays = delays.iter().map(of).collect();
        run
    }

    #[test]
    fn a_pose_delay_is_reported_on_the_pose_topic() {
        let (_, findings) = evaluate_rule(&LAT004, &planted(&[(None, 0.14, 0.0)]));
        assert_eq!(findings[0].severity, Severity::Warning);
        assert_eq!(findings[0].subject.topic.as_deref(), Some(COMMANDS));
        assert!(findings[0].message.starts_with("state follows by 140.000 ± "), "{findings:?}");
    }

    #[test]
    fn joints_with_equal_delays_are_one_finding() {
        let run = planted(&[(Some(0), 0.1, 0.0), (Some(1), 0.101, 0.0), (Some(2), 0.3, 0.25)]);
        let (rows, findings) = evaluate_rule(&LAT004, &run);
        assert_eq!((rows.len(), findings.len()), (2, 2), "{findings:?}");
        let all = findings.iter().find(|found| found.subject.joint.is_none()).unwrap();
        assert!(all.message.starts_with("2 joints: state follows by 101"), "{}", all.message);
        assert!(all.message.contains("one-step shift of commands every 100 ms"), "{}", all.message);
        let one = findings.iter().find(|found| found.subject.joint.is_some()).unwrap();
        assert!(one.message.contains("low-pass of 0.6 Hz (limit 50 ms)"), "{}", one.message);
        assert_eq!(one.severity, Severity::Error);
    }

    #[test]
    fn goals_are_inconclusive_and_a_leading_state_is_reported() {
        let mut run = planted(&[(Some(0), 0.1, 0.0)]);
        run.robots[0].references[0].delays[0].response = Err(DelayFailure::Goals);
        let (rows, findings) = evaluate_rule(&LAT004, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
        let (_, findings) = evaluate_rule(&LAT004, &planted(&[(None, -0.1, 0.0)]));
        assert_eq!(findings[0].title, "state leads its command");
    }
}
