use super::*;
use crate::finding::Unit;

#[test]
fn a_selector_is_a_code_or_a_prefix_of_codes() -> Result<(), UnknownRule> {
    let ord: Selector = "ord".parse()?;
    assert!(ord.matches("ORD001") && !ord.matches("LAT001"));
    let settings =
        Settings { select: vec![ord], ignore: vec!["ORD001".parse()?], ..Settings::default() };
    let asked = REGISTRY.iter().filter(|rule| settings.selects(rule)).map(|rule| rule.code);
    let orders = REGISTRY.iter().map(|rule| rule.code).filter(|code| code.starts_with("ORD"));
    let expected: Vec<&str> = orders.filter(|code| *code != "ORD001").collect();
    assert!(expected.contains(&"ORD002"));
    assert_eq!(asked.collect::<Vec<_>>(), expected);
    Ok(())
}

#[test]
fn an_unknown_code_suggests_the_nearest() {
    let error = "ORD000".parse::<Selector>().expect_err("no such rule");
    assert_eq!(error.nearest, ["ORD001", "ORD002", "ORD003"]);
    let unlike = "".parse::<Selector>().expect_err("names no rule");
    assert_eq!(unlike.to_string(), "there is no rule ``; `poseaudit rules` lists them all");
}

#[test]
fn a_clean_run_passes_every_arm_rule() {
    let evaluation = evaluate(&testing::clean_run(), &Settings::default());
    assert!(evaluation.findings.is_empty(), "{:?}", evaluation.findings);
    for row in evaluation.checks {
        let asked = find(row.code).is_ok_and(|rule| rule.needs_model);
        assert!(!asked || row.status == Status::Pass, "{row:?}");
    }
}

fn statuses(rule: &Rule, run: &RunEvidence, settings: &Settings) -> Vec<Status> {
    let select = vec![rule.code.parse().expect("the rule's own code")];
    let settings = Settings { select, ..settings.clone() };
    evaluate(run, &settings).checks.iter().map(|row| row.status).collect()
}

#[test]
fn every_configured_threshold_reaches_its_rule() {
    // The clean run has no prismatic or compliant joint, yaw step, shaking or gyro gain.
    let idle = [
        ("ZER001", Unit::Metre),
        ("ZER003", Unit::Radian),
        ("MOT006", Unit::Radian),
        ("YAW001", Unit::Radian),
        ("MOT001", Unit::Metre),
        ("MDL001", Unit::One),
    ];
    let mut reached = 0;
    for rule in registry() {
        for own in rule.grade.thresholds() {
            let run = testing::clean_run();
            let mut settings = Settings::default();
            let before = statuses(rule, &run, &settings);
            let is_asked = before.iter().any(|status| *status != Status::Skipped);
            if !is_asked || idle.contains(&(rule.code, own.unit)) {
                continue;
            }
            // Below the noise floor of every estimate.
            let fine = Threshold { warning: 1e-15, error: 2e-15, ..*own };
            settings.thresholds.set(rule, fine);
            assert_ne!(statuses(rule, &run, &settings), before, "{} {:?}", rule.code, own.unit);
            reached += 1;
        }
    }
    assert!(reached >= 15, "{reached}");
}

#[test]
fn a_configured_severity_applies_to_all_but_info_findings() {
    let mut run = testing::clean_run();
    run.robots[0].poses[0].diagnosis.latency_s = Ok(testing::precise(0.05));
    let mut settings = Settings::default();
    settings.severities.push(("LAT001", Severity::Warning));
    let found = evaluate(&run, &settings).findings;
    assert_eq!((found[0].code, found[0].severity), ("LAT001", Severity::Warning));
    let lat001 = find("LAT001").expect("a rule");
    assert_eq!(settings.severity(lat001, Severity::Info), Severity::Info);
}

#[test]
fn exempt_findings_are_reported_and_not_counted() {
    let mut run = testing::clean_run();
    run.robots[0].poses[0].diagnosis.latency_s = Ok(testing::precise(0.05));
    let exemption = |topic: &str| Exemption {
        rules: "LAT".parse().expect("a family"),
        subject: Subject { topic: Some(topic.to_owned()), ..Subject::default() },
        reason: "a known driver".to_owned(),
        place: "p.toml:3".to_owned(),
    };
    let settings = Settings {
        exemptions: vec![exemption("pose"), exemption("/other")],
        ..Settings::default()
    };
    let evaluation = evaluate(&run, &settings);
    assert!(evaluation.findings.is_empty(), "{:?}", evaluation.findings);
    assert_eq!(evaluation.ignored[0].finding.code, "LAT001");
    let row = evaluation
        .checks
        .iter()
        .find(|row| row.code == "LAT001" && row.subject.topic.as_deref() == Some(testing::POSE));
    let said = row.map(|row| (row.status, row.reason.as_deref()));
    assert_eq!(said, Some((Status::Skipped, Some("ignored: a known driver (p.toml:3)"))));
    assert_eq!(settings.unused_exemptions(&evaluation.checks), [&exemption("/other")]);
    assert_eq!(exemption("/t").to_string(), "LAT on /t");
}

#[test]
fn findings_are_sorted_by_severity_then_effect() {
    let mut run = testing::clean_run();
    run.robots[0].poses[0].diagnosis.latency_s = Ok(testing::precise(0.003));
    for (joint, degrees) in [(1, 0.6), (2, 2.0)] {
        let radians = f64::to_radians(degrees);
        let offset = &mut run.robots[0].diagnosis.offsets[joint];
        (offset.offset, offset.is_chosen) = (Ok(testing::precise(radians)), true);
        offset.effect_m = radians;
    }
    let findings = evaluate(&run, &Settings::default()).findings;
    let said: Vec<_> = findings.iter().map(|one| (one.code, one.subject.label())).collect();
    assert_eq!(said, [("ZER001", "elbow"), ("ZER001", "lift"), ("LAT001", testing::POSE)]);
}

#[test]
fn a_wrong_model_is_listed_before_its_consequences() {
    let mut run = testing::clean_run();
    run.robots[0].poses[0].diagnosis.latency_s = Ok(testing::precise(0.5));
    let mut findings = evaluate(&run, &Settings::default()).findings;
    let mut model = findings[0].clone();
    (model.code, model.severity) = ("MDL001", Severity::Warning);
    model.cause = Cause::OtherRobot("ur10e".to_owned());
    findings.push(model);
    rank(&mut findings);
    let said: Vec<_> = findings.iter().map(|one| one.code).collect();
    assert_eq!(said, ["MDL001", "LAT001"]);
    findings[0].severity = Severity::Info;
    rank(&mut findings);
    assert_eq!(findings[0].code, "LAT001");
}

#[test]
fn a_run_without_a_model_passes_no_rule_that_needs_one() {
    let no_robot = "no joint states in this log";
    let run = RunEvidence { no_robot: Some(no_robot.to_owned()), ..RunEvidence::default() };
    let evaluation = evaluate(&run, &Settings::default());
    for (rule, row) in REGISTRY.iter().zip(&evaluation.checks) {
        assert_eq!(rule.code, row.code);
        if rule.needs_model {
            assert_eq!((row.status, row.reason.as_deref()), (Status::Skipped, Some(no_robot)));
        }
    }
    assert!(evaluation.findings.is_empty());
}
