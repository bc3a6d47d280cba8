use crate::checks::decision::not_observable;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::JointEncoding;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// Joint names and positions are paired in the wrong order.
    ///
    /// ## What it means
    /// Positions are published under other joints' names: usually alphabetical (elbow before shoulder) or
    /// driver order against the chain's.
    ///
    /// ## Why it matters
    /// Consumers that pair by name get wrong positions. FK, collision checks and /tf are all wrong, but
    /// consistent with each other.
    ///
    /// ## Evidence
    /// Every order is compared with a stream that is not computed from the named joints.
    ///
    /// - `permutation`: the joints in the order of the numbers.
    /// - `as_logged_m`, `corrected_m`, `runner_up_m`: residuals as logged, in that order, and in the next
    ///   best.
    ///
    /// ## How to fix
    /// Fill `position` in the order of `name`; look joints up by name, never by index. In ros2_control, the
    /// `joints` parameter defines the order.
    ///
    /// ## When it misleads
    /// /tf from a robot_state_publisher inherits the mistake; another pose is required. Joints that do not
    /// move are indistinguishable.
    ORD005 {
        name: "joint-order",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states with a stream to compare them with",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.robots.iter().map(judge).collect()
}

fn judge(arm: &ArmEvidence) -> SubjectResult {
    let subject = arm.topic(&arm.joints_topic);
    match arm.diagnosis.reported_encoding() {
        Err(why) => SubjectResult::new(subject, not_observable(why, "also log a pose that does not come from /tf")),
        Ok(JointEncoding {
            permutation: Some(order),
            residual: Some(error),
            runner_up_m,
            ..
        }) => {
            let names: Vec<String> = arm.joints.iter().map(|joint| joint.name.clone()).collect();
            let is: Vec<String> =
                order.iter().filter_map(|&joint| names.get(joint).cloned()).collect();
            let (before, after) =
                (Unit::Metre.show(error.as_logged), Unit::Metre.show(error.corrected));
            let next = runner_up_m.map(|m| format!(" (next best order: {})", Unit::Metre.show(m)));
            let swapped = names.iter().zip(&is).filter(|(name, is)| name != is).count();
            let fault = Fault {
                severity: Severity::Error,
                cause: Cause::JointOrder { is: is.clone(), read_as: names.clone() },
                title: "joint names and positions in different orders",
                message: format!(
                    "{swapped} positions are published under other joints' names ({before} error at the tip)"
                ),
                evidence: Evidence {
                    effect: Some(format!(
                        "{after} after correction{}",
                        next.unwrap_or_default()
                    )),
                    effect_m: Some(error.as_logged),
                    ..Evidence::default()
                },
                fix: format!("name the numbers in the order they are in: {}", is.join(", ")),
            };
            SubjectResult::new(subject, Outcome::fail(fault))
                .estimated(Estimate::Order {
                    name: "joint order",
                    is: is.clone(),
                    read_as: names,
                    permutation: is,
                })
                .with_evidence("as_logged_m", error.as_logged)
                .with_evidence("corrected_m", error.corrected)
                .with_evidence("runner_up_m", *runner_up_m)
        }
        Ok(_) => SubjectResult::new(subject, Outcome::pass()),
    }
    .within(arm.span)
}
