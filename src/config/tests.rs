use super::*;
use crate::checks::{Threshold, find, registry};
use crate::finding::{Severity, Unit};
use crate::geometry::{AngleUnit, LengthScale, RotationEncoding};
use crate::run::{PoseSourceKind, RoleSetting};

fn config(text: &str) -> Result<Config, Trouble> {
    Config::from_text(text.to_owned(), Path::new("setup/p.toml"))
}

#[test]
fn an_empty_config_gives_the_defaults() {
    let options = config("").expect("an empty config").options();
    let default = Options { config: options.config.clone(), ..Options::default() };
    assert_eq!(format!("{options:?}"), format!("{default:?}"));
}

#[test]
fn config_settings_reach_the_options() {
    let text = r#"
robot = { left_ = "ur5e", right_ = "arms/panda.urdf" }
calibration = "calibration.yaml"
base = "base"
tip = "tool0"
stamp = "log"
max_latency = "500 ms"
fail_on = "never"
require = ["LAT001"]
select = ["lat", "ZER001"]

[[ignore]]
code = "LAT001"
topic = "/tcp"
reason = " the driver's delay "

[stream."/tcp"]
role = "pose"
convention = "euler:ZYX"
units = ["mm", "deg"]
witness = "external"
rate_hz = 125
frame = "base"
link = "flange"

[stream."/pendant"]
vendor = "kuka"
units = ["m"]

[rules.LAT001]
warning = "3 ms"
severity = "warning"

[rules.FRM002]
error = ["6 mm", "1°"]

[rules.MOT002]
turning = "30 rad/s²"
"#;
    let config = config(text).expect("a config");
    let options = config.options();
    let robots: Vec<_> = options.run.robots.iter().map(|robot| robot.model.as_str()).collect();
    assert_eq!(robots, ["ur5e", "setup/arms/panda.urdf"]);
    assert_eq!(options.run.calibrations[0].file, Path::new("setup/calibration.yaml"));
    assert_eq!((options.run.max_latency_s, options.policy.fail_on), (0.5, None));
    assert_eq!(options.run.stamp, crate::time::Clock::Log);
    assert!(
        options.policy.rules.required[0].matches("LAT001")
            && options.policy.rules.select[0].matches("LAT003")
    );
    let [known] = options.policy.rules.exemptions.as_slice() else { panic!("{options:?}") };
    assert_eq!(known.reason, "the driver's delay");
    assert_eq!(known.place, "setup/p.toml:12");
    let [pendant, tcp] = options.run.topics.as_slice() else { panic!("{options:?}") };
    assert_eq!(
        (tcp.role, tcp.source_kind),
        (Some(RoleSetting::Pose), Some(PoseSourceKind::External))
    );
    assert_eq!((tcp.rate_hz, tcp.place.as_str()), (Some(125.0), "setup/p.toml:17"));
    assert!(pendant.vendor.as_ref().is_some_and(|text| text.contains("KUKA")), "{pendant:?}");
    let coded = |topic: &str| {
        let declared = options.run.declared.iter().find(|declared| declared.is_of(topic));
        let declared = declared.expect("a declaration");
        (declared.coding, declared.angle, declared.length, declared.is_of_vendor)
    };
    let kuka = RotationEncoding::Three("euler:ZYX".parse().expect("a convention"));
    assert_eq!(coded("/tcp"), (kuka, AngleUnit::Degree, LengthScale::MILLIMETRE, false));
    assert_eq!(coded("/pendant"), (kuka, AngleUnit::Degree, LengthScale::METRE, true));
    let threshold = |code: &str, unit: Unit| {
        let rule = find(code).expect("a rule");
        let own = rule.grade.thresholds().iter().find(|own| own.unit == unit).expect("a threshold");
        options.policy.rules.thresholds.threshold(rule, *own)
    };
    let late = Threshold { unit: Unit::Second, warning: 3e-3, error: 10e-3 };
    assert_eq!(threshold("LAT001", Unit::Second), late);
    assert_eq!(threshold("FRM002", Unit::Metre).error, 6e-3);
    assert_eq!(threshold("FRM003", Unit::Metre).error, 5e-3);
    assert_eq!(options.policy.rules.severities, [("LAT001", Severity::Warning)]);
    let mot002 = find("MOT002").expect("a rule");
    assert_eq!(options.policy.rules.thresholds.limit(mot002, &mot002.limits[0]), 30.0);
}

#[test]
fn config_errors_name_line_and_suggestion() {
    for (text, line, part) in [
        ("\ntipp = \"tool0\"", 2, "unknown key `tipp`: did you mean `tip`?"),
        ("[stream.\"/t\"]\nrol = \"pose\"", 2, "did you mean `role`?"),
        ("[stream.\"/t\"]\nrole = \"poze\"", 2, "unknown value `poze`: did you mean `pose`?"),
        ("[stream.\"/t\"]\n\nunits = [\"m\", \"mm\"]", 3, "contradict"),
        ("[stream.\"/t\"]\nunits = [\"mm\"]", 1, "requires a `convention`"),
        ("[stream.\"/t\"]\nvendor = \"kuks\"", 2, "did you mean `kuka`?"),
        ("[stream.\"/t\"]\nconvention = \"euler:xxy\"", 2, "twice"),
        ("[stream.\"/t\"]\nrate_hz = -5", 2, "above 0"),
        ("[rules.LAT009]\nwarning = \"2 ms\"", 1, "did you mean LAT001"),
        ("[rules.LAT001]\nwarnign = \"2 ms\"", 2, "did you mean `warning`?"),
        ("[rules.LAT001]\n# so\nwarning = \"2 mm\"", 3, "write it in ms"),
        ("[rules.LAT001]\nwarning = 2", 2, "2 has no unit"),
        ("[rules.LAT001]\nwarning = \"21 ms\"", 1, "must not exceed the error"),
        ("[rules.ORD001]\nwarning = \"20 ms\"", 2, "known are severity"),
        ("[rules.MOT002]\nturning = \"5 m/s²\"", 2, "rad/s²"),
        ("max_latency = \"5 m\"", 1, "write it in ms"),
        ("max_latency = 0", 1, "above 0"),
        ("stamp = \"heder\"", 1, "did you mean `header`?"),
        ("robot = \"ur5f\"", 1, "did you mean"),
        ("robot = 5", 1, "a table of texts by prefix"),
        ("require = [\"FOO\"]", 1, "FOO"),
        ("\n[[ignore]]\ncode = \"LAT001\"", 2, "the key `reason` is missing"),
        ("[[ignore]]\ncode = \"LAT001\"\nreason = \" \"", 3, "say why"),
        ("\n\nbase = ", 3, ""),
    ] {
        let trouble = config(text).expect_err(text);
        assert_eq!(trouble.place, format!("setup/p.toml:{line}"), "{text}\n{trouble}");
        assert!(trouble.what.contains(part), "{text}\n{trouble}");
        assert!(!trouble.to_string().contains('\n'), "{trouble}");
    }
}

/// Uncomments the settings of a template.
fn awake(template: &str) -> String {
    let is_setting = |line: &str| line.starts_with('[') || line.contains(" = ");
    let line = |line: &str| match line.strip_prefix("# ") {
        Some(rest) if is_setting(rest) && !rest.contains(": ") => rest.to_owned(),
        _ => line.to_owned(),
    };
    template.lines().map(line).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_template_can_be_read_with_and_without_its_comments() {
    let report = crate::report::Report::from_log(Default::default(), Vec::new(), Vec::new());
    let text = template(&report, true);
    assert_eq!(
        config(&text).expect("a config").options().policy.rules.thresholds,
        Default::default()
    );
    let all = awake(&text).replace("\"my_arm.urdf\"", "\"ur5e\"");
    let options = config(&all).expect("a config").options();
    for rule in registry() {
        for own in rule.grade.thresholds() {
            let set = options.policy.rules.thresholds.threshold(rule, *own);
            let is_own = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-9;
            let same = is_own(set.warning, own.warning) && is_own(set.error, own.error);
            assert!(same, "{} {set:?}", rule.code);
        }
        assert!(all.contains(&format!("[rules.{}]", rule.code)), "{all}");
    }
}

#[test]
fn a_config_that_is_too_large_is_refused() {
    let comment = |bytes: usize| format!("#{}", " ".repeat(bytes - 1));
    assert!(config(&comment(256 << 10)).is_ok());
    let trouble = config(&comment((256 << 10) + 1)).expect_err("refused");
    assert!(trouble.what.contains("maximum of 262144 bytes"), "{}", trouble.what);
    let trouble = config(&format!("robot = {}", "x".repeat(100_000))).expect_err("refused");
    let length = trouble.what.len() + trouble.place.len() + trouble.remedy.len();
    assert!(length < 1000, "{length} bytes");
}
