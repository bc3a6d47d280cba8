//! The report on many logs.

use std::path::Path;

use anyhow::{Context as _, Result};
use poseaudit::synth::START;
use serde::Deserialize;

use crate::fleet::logs::short_run;
use crate::fleet::{fleet, status};

/// JSON report as declared by a reader. Unknown keys are errors.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct FleetReport {
    schema: String,
    tool: ToolInfo,
    failing: bool,
    logs: LogCounts,
    #[serde(default)]
    datasets: Vec<serde_json::Value>,
    arms: Vec<ArmRow>,
    runs: Vec<RunRow>,
    findings: Vec<FindingRow>,
    trends: Vec<TrendRow>,
    errors: Vec<ErrorRow>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct ToolInfo {
    name: String,
    version: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct LogCounts {
    total: usize,
    statuses: StatusCounts,
    verdicts: VerdictCounts,
    copies: usize,
    undated: usize,
    before: usize,
    start_ns: Option<String>,
    end_ns: Option<String>,
    version: String,
    settings: String,
    set_aside: usize,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct StatusCounts {
    audited: usize,
    not_audited: usize,
    unreadable: usize,
    timed_out: usize,
    out_of_memory: usize,
    crashed: usize,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct VerdictCounts {
    pass: usize,
    fail: usize,
    inconclusive: usize,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct ArmRow {
    site: Option<String>,
    arm: Option<String>,
    robot: Option<String>,
    logs: usize,
    not_audited: usize,
    verdicts: VerdictCounts,
    fails: Vec<FailCount>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct FailCount {
    code: String,
    logs: usize,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct RunRow {
    path: String,
    site: Option<String>,
    arm: Option<String>,
    robot: Option<String>,
    status: String,
    verdict: Option<String>,
    start_ns: Option<String>,
    page: Option<std::path::PathBuf>,
    codes: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct FindingRow {
    code: String,
    title: String,
    severity: String,
    site: Option<String>,
    arm: Option<String>,
    robot: Option<String>,
    topic: Option<String>,
    joint: Option<String>,
    frame: Option<String>,
    logs: usize,
    sound: usize,
    message: String,
    path: String,
    start_ns: Option<String>,
    #[serde(default)]
    worst: Option<serde_json::Value>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct TrendRow {
    code: String,
    name: String,
    unit: String,
    site: Option<String>,
    arm: Option<String>,
    robot: Option<String>,
    topic: Option<String>,
    joint: Option<String>,
    frame: Option<String>,
    course: String,
    logs: usize,
    rate_per_day: Option<Measured>,
    rate_per_episode: Option<Measured>,
    level: Option<Measured>,
    spread: Option<f64>,
    step: Option<Measured>,
    step_between_ns: Option<[String; 2]>,
    step_between: Option<[String; 2]>,
    figure: Option<f64>,
    reaches_figure_ns: Option<String>,
    points: Vec<TrendPoint>,
    line: Option<[f64; 2]>,
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Measured {
    value: f64,
    ci95: [f64; 2],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct TrendPoint {
    start_ns: Option<String>,
    episode: Option<usize>,
    value: f64,
    ci95: [f64; 2],
    path: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "the test reads it as a tool would, whole")]
struct ErrorRow {
    path: String,
    status: String,
    what: String,
    #[serde(rename = "do")]
    remedy: String,
}

const DAY_S: f64 = 86_400.0;

/// Sets zero offsets and pose latency of a log, as a function of its day.
type PlantFault = fn(&mut poseaudit::synth::Scenario, f64);

/// Logs of two arms at intervals of ten days, with faults that depend on the day.
fn write_logs_with_faults(folder: &Path, arms: &[(&str, PlantFault)]) -> Result<()> {
    for (arm, (name, plant)) in arms.iter().enumerate() {
        for run in 0..10 {
            let mut log = short_run(100 * arm as u64 + run);
            let day = 10.0 * run as f64;
            log.0.start = START.shifted(day * DAY_S);
            plant(&mut log.0, day);
            log.write(&folder.join(format!("logs/berlin/{name}/{run}.mcap")))?;
        }
    }
    Ok(())
}

fn report_json(folder: &Path, more: &[&str]) -> Result<(FleetReport, Option<i32>)> {
    let out = folder.join("out").display().to_string();
    let mut args = vec!["report", out.as_str(), "--format", "json"];
    args.extend(more);
    let output = fleet(&args).output()?;
    let report = serde_json::from_slice(&output.stdout)
        .with_context(|| String::from_utf8_lossy(&output.stderr).into_owned())?;
    Ok((report, status(&output)))
}

#[test]
fn a_creeping_zero_offset_is_a_trend_with_its_rate_and_a_constant_one_is_not() -> Result<()> {
    const RATE_RAD: f64 = 1.5e-5;
    const STEP_S: f64 = 0.004;
    let folder = tempfile::tempdir()?;
    write_logs_with_faults(
        folder.path(),
        &[
            ("creeping", |run, day| {
                run.joints.zero_offsets = vec![0.0, 0.0, 5e-4 + RATE_RAD * day]
            }),
            ("constant", |run, _| run.joints.zero_offsets = vec![0.0, 0.01]),
            ("stepping", |run, day| {
                run.pose.timing.latency_s = if day < 55.0 { 0.001 } else { 0.001 + STEP_S };
            }),
        ],
    )?;
    let [logs, out] = ["logs", "out"].map(|name| folder.path().join(name).display().to_string());
    fleet(&[&logs, "--out", &out, "--labels-from", "{site}/{arm}/*"]).output()?;
    let (report, status) = report_json(folder.path(), &[])?;
    assert_eq!((report.schema.as_str(), status), ("poseaudit.fleet/1", Some(1)));
    assert_eq!((report.logs.total, report.logs.undated), (30, 0));

    let moving: Vec<(&str, &str, &str)> = report
        .trends
        .iter()
        .filter(|row| row.course == "creeps" || row.course == "stepped")
        .map(|row| (row.arm.as_deref().unwrap_or(""), row.code.as_str(), row.course.as_str()))
        .collect();
    let expected = [("creeping", "ZER001", "creeps"), ("stepping", "LAT001", "stepped")];
    assert_eq!(moving, expected);

    let creeping_trend =
        report.trends.iter().find(|row| row.course == "creeps").context("a creep")?;
    assert_eq!(creeping_trend.joint.as_deref(), Some("elbow_joint"));
    let rate = creeping_trend.rate_per_day.as_ref().context("a rate")?;
    assert!((rate.ci95[0]..=rate.ci95[1]).contains(&RATE_RAD), "{rate:?}");
    assert!(rate.ci95[0] > 0.0 && (rate.value - RATE_RAD).abs() < 0.1 * RATE_RAD, "{rate:?}");
    // From 5e-4 rad to 0.1°.
    let day = (0.1_f64.to_radians() - 5e-4) / RATE_RAD;
    let reaches_ns: i64 = creeping_trend.reaches_figure_ns.as_deref().context("a day")?.parse()?;
    let reached_day = (reaches_ns - START.nanos()) as f64 / 1e9 / DAY_S;
    assert!((reached_day - day.max(90.0)).abs() < 2.0, "{reached_day} is not {day}");

    let stepped = report.trends.iter().find(|row| row.course == "stepped").context("a step")?;
    let by = stepped.step.as_ref().context("its size")?;
    assert!((by.value - STEP_S).abs() < 1e-4, "{by:?}");
    let between = stepped.step_between_ns.as_ref().context("its time")?;
    let days = between.each_ref().map(|stamp| {
        stamp.parse::<i64>().map(|stamp| ((stamp - START.nanos()) as f64 / 1e9 / DAY_S).round())
    });
    assert_eq!(days, [Ok(50.0), Ok(60.0)]);

    let constant = |row: &&TrendRow| {
        row.arm.as_deref() == Some("constant")
            && row.joint.as_deref() == Some("shoulder_lift_joint")
    };
    let constant = report.trends.iter().find(constant).context("its zero")?;
    assert_eq!((constant.course.as_str(), constant.logs), ("steady", 10));
    let arm = |name: &str| report.arms.iter().find(|row| row.arm.as_deref() == Some(name));
    let fails = &arm("constant").context("the arm")?.fails;
    assert!(fails.iter().any(|fail| fail.code == "ZER001" && fail.logs == 10), "{fails:?}");
    let found = report.findings.iter().find(|row| row.arm.as_deref() == Some("constant"));
    let found = found.context("its finding")?;
    assert_eq!((found.code.as_str(), found.logs, found.sound), ("ZER001", 10, 0));

    // Earlier findings are ignored then, but trends are not.
    let (since, status) =
        report_json(folder.path(), &["--since", "2027-06-01", "--fail-on", "error"])?;
    assert_eq!((since.findings.len(), since.logs.before, status), (0, 30, Some(0)));
    let (_, status) = report_json(folder.path(), &["--select", "LAT002"])?;
    assert_eq!(status, Some(0));
    assert_html_report(folder.path(), &out)
}

/// The page has a plot for each trend, and no external resources.
fn assert_html_report(folder: &Path, out: &str) -> Result<()> {
    let page = folder.join("fleet.html");
    let written = page.display().to_string();
    let output = fleet(&["report", out, "--format", "html", "--output", &written]).output()?;
    assert_eq!(status(&output), Some(1));
    let text = std::fs::read_to_string(&page)?;
    assert!(text.contains("default-src 'none'") && text.contains("data-plot=\"trend-1\""));
    assert!(text.contains("elbow_joint") && !text.contains("<script src"), "{}", text.len());
    // The creeping zero offset: a point for each log, the fitted line, and the limit of 0.1° in view.
    let data = text.split("id=\"data\" type=\"application/json\">").nth(1).context("data")?;
    let data = data.split("</script>").next().unwrap_or_default();
    let plot = &serde_json::from_str::<serde_json::Value>(data)?["trend-1"];
    let [amounts, line] = [0, 1].map(|index| &plot["series"][index]);
    assert_eq!((&amounts["points"], &line["points"]), (&true.into(), &false.into()), "{plot}");
    assert_eq!(amounts["values"].as_array().map(Vec::len), Some(10));
    let limit = plot["limits"][0]["at"].as_f64().context("a limit")?;
    assert!((limit - 0.1).abs() < 1e-9 && plot["shows_limits"] == true, "{plot}");
    Ok(())
}

/// Tables that do not name their arm, so that no model can be chosen.
fn write_tables_without_arm(folder: &Path, count: u32) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for table in 0..count {
        let mut text = "time,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6\n".to_owned();
        for row in 0..200 {
            let t_s = 0.02 * f64::from(row);
            let q = |joint: u32| ((1.0 + 0.1 * f64::from(joint)) * t_s + f64::from(table)).sin();
            let numbers = std::iter::once(t_s).chain((0..6).map(q));
            let numbers: Vec<String> = numbers.map(|number| number.to_string()).collect();
            text += &(numbers.join(",") + "\n");
        }
        std::fs::write(folder.join(format!("{table}.csv")), text)?;
    }
    Ok(())
}

#[test]
fn logs_that_were_not_audited_are_not_reported_as_fine() -> Result<()> {
    let folder = tempfile::tempdir()?;
    write_tables_without_arm(&folder.path().join("logs"), 3)?;
    let [logs, out] = ["logs", "out"].map(|name| folder.path().join(name).display().to_string());
    let output = fleet(&[&logs, "--out", &out]).output()?;
    let summary = String::from_utf8(output.stdout.clone())?;
    assert_eq!(status(&output), Some(3), "{summary}");
    assert!(summary.contains("  3 logs: ") && summary.contains("pass --robot"), "{summary}");
    let next = format!("next: poseaudit fleet report {out}");
    assert_eq!(summary.lines().last(), Some(next.as_str()));

    for format in ["text", "markdown", "html"] {
        let report = |more: &[&str]| -> Result<(String, Option<i32>)> {
            let args = [&["report", out.as_str(), "--format", format], more].concat();
            let output = fleet(&args).output()?;
            Ok((String::from_utf8(output.stdout.clone())?, status(&output)))
        };
        let (text, exit_status) = report(&[])?;
        assert_eq!(exit_status, Some(1), "{text}");
        assert!(text.contains("3 logs, 3 not audited"), "{text}");
        assert!(text.contains("pass --robot"), "{text}");
        assert!(text.contains("not checked: the logs have no estimate"), "{text}");
        assert!(!text.contains("no problems") && !text.contains("PASS"), "{text}");
        let command = format!("poseaudit fleet report {out} --format html --output fleet.html");
        assert!(text.contains(&command), "{text}");
        let (text, exit_status) = report(&["--fail-on", "never"])?;
        assert_eq!(exit_status, Some(0));
        assert!(text.contains("INCONCLUSIVE") && !text.contains("PASS"), "{text}");
    }
    Ok(())
}

#[test]
fn the_text_report_ends_with_the_verdict_and_the_audit_of_the_worst_log() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out").display().to_string();
    let log = format!("{}/fixtures/faulty.mcap", env!("CARGO_MANIFEST_DIR"));
    fleet(&[&log, "--out", &out]).output()?;
    let report = String::from_utf8(fleet(&["report", &out]).output()?.stdout)?;
    let lines: Vec<&str> = report.lines().collect();
    let [.., trends, verdict, audit, page] = lines.as_slice() else { panic!("{report}") };
    // A single log shows no trend.
    assert!(trends.starts_with("trends          0 found, 0 steady, "), "{report}");
    assert!(trends.ends_with("not determined: in fewer than 4 dated logs"), "{report}");
    assert!(verdict.starts_with("FAIL            0 pass, 1 fail, 0 inconclusive"), "{report}");
    assert!(audit.starts_with(&format!("next            poseaudit audit {log} ")), "{report}");
    assert!(page.contains(&format!("poseaudit fleet report {out} --format html")), "{report}");
    Ok(())
}

#[test]
fn requested_pages_are_linked_from_the_fleet_report() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("results").display().to_string();
    let logs = ["clean", "faulty"]
        .map(|name| format!("{}/fixtures/{name}.mcap", env!("CARGO_MANIFEST_DIR")));
    let output = fleet(&[&logs[0], "--out", &out]).output()?;
    assert_eq!(status(&output), Some(0));
    let output = fleet(&[&logs[0], &logs[1], "--out", &out, "--pages"]).output()?;
    assert_eq!(status(&output), Some(1));
    let page = folder.path().join("fleet.html");
    let written = page.display().to_string();
    let output = fleet(&["report", &out, "--format", "html", "--output", &written]).output()?;
    assert_eq!(status(&output), Some(1));
    let text = std::fs::read_to_string(&page)?;
    let links: Vec<&str> = text.split("href=\"results/pages/").skip(1).collect();
    // The other log already had results.
    assert_eq!(links.len(), 1, "{text}");
    let name = links[0].split('"').next().context("a name")?;
    let log_page = std::fs::read_to_string(folder.path().join("results/pages").join(name))?;
    assert!(log_page.contains("ZER001") && log_page.contains("Zero offsets of all joints"));
    let section = |id: &str| {
        let rest = text.split(&format!("id=\"{id}\"")).nth(1);
        rest.and_then(|rest| rest.split("</section>").next()).with_context(|| id.to_owned())
    };
    let arms = section("arms")?;
    assert!(arms.contains("LAT001") && arms.contains("1<span class=\"quiet\"> of 2</span>"));
    // One table for each rule, with all of its findings.
    let findings = section("findings")?;
    for code in ["LAT001", "ZER001"] {
        assert_eq!(findings.matches(&format!("id=\"rule-{code}\"")).count(), 1, "{findings}");
    }
    Ok(())
}

#[test]
fn a_zero_offset_step_within_a_dataset_is_reported_with_its_episodes() -> Result<()> {
    let folder = tempfile::tempdir()?;
    for episode in 0..12 {
        // Their names are not in numerical order.
        let elbow_offset_rad = if episode < 9 { 0.0 } else { 0.01 };
        // Duplicates count once.
        let table = crate::tables::csv_of_ur5e_with_elbow_offset(
            elbow_offset_rad + 1e-8 * f64::from(episode),
        );
        std::fs::write(folder.path().join(format!("episode_{episode}.csv")), table)?;
    }
    let [logs, out] = ["", "out"].map(|name| folder.path().join(name).display().to_string());
    fleet(&[&logs, "--out", &out, "--robot", "ur5e", "--select", "ZER001"]).output()?;
    let (report, _) = report_json(folder.path(), &[])?;
    assert_eq!((report.logs.total, report.logs.undated), (12, 0));
    let moving: Vec<&TrendRow> = report
        .trends
        .iter()
        .filter(|row| row.course == "creeps" || row.course == "stepped")
        .collect();
    let [stepped] = moving.as_slice() else { panic!("{moving:?}") };
    assert_eq!(
        (stepped.joint.as_deref(), stepped.course.as_str()),
        (Some("elbow_joint"), "stepped")
    );
    let by = stepped.step.as_ref().context("its size")?;
    assert!((by.value + 0.01).abs() < 1e-4, "{by:?}");
    let between = stepped.step_between.as_ref().context("its episodes")?;
    assert!(
        between[0].ends_with("episode_8.csv") && between[1].ends_with("episode_9.csv"),
        "{between:?}"
    );
    assert_eq!((&stepped.step_between_ns, &stepped.rate_per_day), (&None, &None));
    assert_eq!(
        stepped.points.iter().map(|point| point.episode).collect::<Vec<_>>(),
        (0..12).map(Some).collect::<Vec<_>>()
    );
    Ok(())
}

#[test]
fn an_arm_that_deviates_in_several_logs_is_to_be_calibrated() -> Result<()> {
    let folder = tempfile::tempdir()?;
    for run in 0..3 {
        let mut log = short_run(run);
        log.0.duration_s = 20.0;
        crate::checks::mdl::add_link_deviations(&mut log.0);
        log.0.has_description = false;
        log.write(&folder.path().join(format!("logs/arm-7/{run}.mcap")))?;
    }
    let [logs, out] = ["logs", "out"].map(|name| folder.path().join(name).display().to_string());
    fleet(&[&logs, "--out", &out, "--labels-from", "{arm}/*"]).output()?;
    let report = String::from_utf8(fleet(&["report", &out]).output()?.stdout)?;
    let command = report.lines().find(|line| line.contains("poseaudit calibrate "));
    let command = command.with_context(|| report.clone())?;
    assert!((0..3).all(|run| command.contains(&format!("arm-7/{run}.mcap"))), "{command}");
    assert!(
        report.contains("--calibration auto") && report.contains("3 logs of arm-7"),
        "{report}"
    );
    Ok(())
}
