use super::*;
use crate::checks::evaluate;
use crate::checks::testing::{
    COMMANDS, POSE, clean_run, evaluate_rule, frame, precise, residual_check_of,
};
use crate::diagnosis::{FrameEstimate, NotObservable, ResidualCheck, SampleNoise};
use crate::finding::{CheckRow, Finding, Status};

fn judged(as_logged_m: f64, left_m: f64, change: fn(&mut ArmEvidence)) -> (CheckRow, Vec<Finding>) {
    let mut run = clean_run();
    run.robots[0].poses[0].proof = Ok(ResidualCheck {
        as_logged: residual_check_of(as_logged_m, 0.0).as_logged,
        ..residual_check_of(left_m, 0.0)
    });
    change(&mut run.robots[0]);
    let (rows, findings) = evaluate_rule(&MDL001, &run);
    let row = rows.into_iter().find(|row| row.subject.label() == POSE);
    (row.expect("the stream was asked about"), findings)
}

#[test]
fn an_unexplained_residual_is_a_finding_above_noise_and_inconclusive_if_noise_is_unknown() {
    let (_, findings) = judged(0.03, 0.02, |_| ());
    assert_eq!(findings[0].severity, Severity::Error);
    assert!(
        findings[0].message.starts_with("unexplained residual 16 mm and 0° rms"),
        "{findings:?}"
    );
    let (row, findings) = judged(0.03, 0.02, |arm| {
        let proof = arm.poses[0].proof.as_mut().expect("a proof");
        for error in [&mut proof.as_logged].into_iter().chain(&mut proof.corrected) {
            error.length.whole.noise = None;
            error.length.parts[0].magnitude.noise = None;
        }
    });
    assert!(findings.is_empty() && row.status == Status::Inconclusive, "{row:?}");
}

#[test]
fn an_unexplained_residual_suggests_calibration_unless_only_rotations_are_off() {
    let fix = |left_m: f64, left_rad: f64| {
        let mut run = clean_run();
        run.robots[0].poses[0].proof = Ok(residual_check_of(left_m, left_rad));
        evaluate_rule(&MDL001, &run).1[0].fix.clone()
    };
    assert!(fix(0.02, 0.0).contains("`poseaudit calibrate LOG --out "), "{}", fix(0.02, 0.0));
    assert!(fix(1e-6, 0.2).starts_with("positions agree"), "{}", fix(1e-6, 0.2));
}

#[test]
fn findings_explain_their_effect_and_inconclusive_causes_do_not() {
    let late = |arm: &mut ArmEvidence| arm.poses[0].diagnosis.latency_s = Ok(precise(0.02));
    assert_eq!(judged(0.03, 1e-4, late).0.status, Status::Pass);
    let (row, _) = judged(0.03, 1e-4, |arm| {
        arm.poses[0].diagnosis.latency_s = Err(NotObservable::Periodic(vec![0.0, 0.3]));
        let proof = arm.poses[0].proof.as_mut().expect("a proof");
        proof.poses_corrected = Some(proof.as_logged.clone());
    });
    assert_eq!(row.status, Status::Inconclusive);
    assert!(row.reason.is_some_and(|why| why.contains("undetermined: LAT001")));
}

#[test]
fn an_unreported_correction_of_poses_prevents_a_pass() {
    let (row, _) = judged(0.03, 1e-4, |arm| {
        let proof = arm.poses[0].proof.as_mut().expect("a proof");
        proof.joints_corrected = Some(proof.as_logged.clone());
    });
    assert_ne!(row.status, Status::Pass, "{row:?}");
}

#[test]
fn an_error_at_the_noise_level_is_noise() {
    let (row, findings) = judged(0.004, 0.004, |arm| {
        let proof = arm.poses[0].proof.as_mut().expect("a proof");
        for error in [&mut proof.as_logged].into_iter().chain(&mut proof.corrected) {
            let noise = Some(SampleNoise { rms: 0.002, quantile_95: 0.003, lag_samples: 1 });
            error.length.whole.noise = noise;
            error.length.parts[0].magnitude.noise = noise;
        }
    });
    assert!(findings.is_empty() && row.status == Status::Pass, "{row:?}");
}

#[test]
fn a_residual_with_an_interval_beyond_the_threshold_is_inconclusive() {
    let (row, findings) = judged(1e-4, 1e-4, |arm| {
        let proof = arm.poses[0].proof.as_mut().expect("a proof");
        for error in [&mut proof.as_logged].into_iter().chain(&mut proof.corrected) {
            let noise = SampleNoise { rms: 0.08, quantile_95: 0.1, lag_samples: 10 };
            error.length.whole.noise = Some(noise);
        }
    });
    assert!(findings.is_empty() && row.status == Status::Inconclusive, "{row:?}");
    let why = row.reason.expect("a reason");
    assert!(why.starts_with("uncertainty ±15.9 mm") && why.contains("reduce the noise"), "{why}");
    assert_eq!(resolving_motion(&why), None);
}

#[test]
fn joint_states_without_a_reference_are_inconclusive() {
    let mut run = clean_run();
    let arm = &mut run.robots[0];
    (arm.poses, arm.tf, arm.imus) = (Vec::new(), None, Vec::new());
    let (rows, _) = evaluate_rule(&MDL001, &run);
    let why = rows[0].reason.as_deref().unwrap_or_default();
    assert_eq!(rows[0].status, Status::Inconclusive);
    assert!(why.contains("nothing in this log can be compared with /joint_states"), "{why}");
    let commanded = format!("({COMMANDS} is taken for commands");
    assert!(why.contains(&commanded), "{why}");
    // The topics of a bag have no columns.
    assert!(why.contains("of poseaudit.toml); record"), "{why}");
}

#[test]
fn a_disagreement_of_poses_and_joints_withdraws_all_causes_with_the_reason() {
    let mut run = clean_run();
    let arm = &mut run.robots[0];
    arm.poses[0].proof = Ok(residual_check_of(0.7, 0.7));
    let stream = &mut arm.poses[0].diagnosis;
    stream.residual = Err(NotObservable::NotExcited);
    stream.latency_s = Ok(precise(0.05));
    let evaluation = evaluate(&run, &Default::default());
    let [finding] = evaluation.findings.as_slice() else { panic!("{evaluation:?}") };
    assert_eq!((finding.code, finding.title), ("MDL001", DISAGREEMENT_TITLE));
    let said = "poses and joint states disagree by 560 mm, 32.1°, and no known cause explains it";
    assert!(finding.message.starts_with(said), "{}", finding.message);
    let late = evaluation
        .checks
        .iter()
        .find(|row| row.code == "LAT001" && row.subject.topic.as_deref() == Some(POSE));
    let late = late.expect("a row");
    assert_eq!(late.status, Status::Inconclusive);
    assert!(late.reason.as_deref().is_some_and(|why| why.starts_with(said)), "{late:?}");
}

#[test]
fn a_competing_model_that_fits_is_the_finding() {
    let mut run = clean_run();
    let arm = &mut run.robots[0];
    arm.better_model = Some(CompetingModel {
        name: "ur3e".to_owned(),
        topic: arm.poses[0].topic().to_owned(),
        named_residual_m: 0.0274,
        residual_m: 2e-5,
        tool_m: None,
    });
    run.robots[0].poses[0].diagnosis.residual.as_mut().unwrap().excess_m = precise(3e-5);
    assert!(evaluate_rule(&MDL001, &run).1.is_empty(), "the named arm fits as well");
    run.robots[0].poses[0].diagnosis.residual.as_mut().unwrap().excess_m = precise(0.02);
    let finding = evaluate_rule(&MDL001, &run).1.remove(0);
    assert!(finding.message.contains("to 20 µm with no further correction"), "{}", finding.message);
    assert!(finding.message.ends_with("only to 27.4 mm"), "{}", finding.message);
    assert_eq!(finding.severity, Severity::Error);
    assert_eq!(finding.evidence.more["fits"]["misfit_m"], 2e-5);
}

#[test]
fn the_residual_of_a_guessed_arm_is_inconclusive_if_another_fits_equally() {
    let mut run = clean_run();
    run.robots[0].poses[0].proof = Ok(residual_check_of(0.03, 0.0));
    assert_eq!(evaluate_rule(&MDL001, &run).1.len(), 1);
    run.robots[0].indistinguishable_models = vec!["ur5e".to_owned()];
    let (rows, findings) = evaluate_rule(&MDL001, &run);
    assert!(findings.is_empty(), "{findings:?}");
    let row = rows.iter().find(|row| row.status == Status::Inconclusive).unwrap();
    assert!(
        row.reason.as_deref().unwrap().contains("does not distinguish it from ur5e"),
        "{row:?}"
    );
}

#[test]
fn an_unexplained_residual_withdraws_tool_and_radial_scale() {
    let found = |tool_m: f64| {
        let mut run = clean_run();
        run.robots[0].poses[0].proof = Ok(residual_check_of(0.03, 0.0));
        let stream = &mut run.robots[0].poses[0].diagnosis;
        (stream.radial_scale, stream.is_radial_scale_chosen) = (Ok(precise(0.01)), true);
        stream.tool = Ok(FrameEstimate { is_chosen: true, p_value: 0.0, ..frame(tool_m) });
        stream.residual.as_mut().unwrap().excess_m = precise(0.02);
        let findings = evaluate(&run, &Default::default()).findings;
        let mut codes: Vec<&str> = findings.iter().map(|finding| finding.code).collect();
        codes.sort_unstable();
        codes
    };
    assert_eq!(found(0.03), ["MDL001"]);
}

#[test]
fn bodies_of_which_none_moves_rigidly_with_the_reference_are_separate() {
    let severity = |other_m: f64, is_of_reference_body: bool| {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        (arm.tf, arm.is_trajectory) = (None, true);
        let mut other = arm.poses[0].clone();
        other.subject.topic = Some("/other".to_owned());
        arm.poses.push(other);
        for (stream, off_m) in arm.poses.iter_mut().zip([0.03, other_m]) {
            stream.subject.reference = Some("/reference".to_owned());
            stream.proof = Ok(residual_check_of(off_m, 0.0));
            stream.is_of_reference_body = is_of_reference_body;
        }
        evaluate_rule(&MDL001, &run).1.first().map(|finding| finding.severity)
    };
    assert_eq!(severity(0.02, false), None);
    assert_eq!(severity(1e-5, false), Some(Severity::Error));
    assert_eq!(severity(0.02, true), Some(Severity::Error));
}
