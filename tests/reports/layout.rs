//! Order of a report, and the plots and messages of findings.

use std::collections::BTreeMap;

use poseaudit::finding::{Estimate, Finding, Status, Subject};
use poseaudit::report::{Format, Report, Trouble, TroubleKind};
use poseaudit::{Audited, Options, audit};
use serde_json::Value;

fn audit_fixture(name: &str) -> Audited {
    let log = format!("{}/fixtures/{name}.mcap", env!("CARGO_MANIFEST_DIR"));
    audit(&Options { logs: vec![log.into()], ..Options::default() }).expect("a report")
}

fn render(format: &str, report: &Report) -> String {
    let mut out = Vec::new();
    Format::from_name(format).expect("a format").write(report, &mut out).expect("a report");
    // Without terminal styles.
    anstream::adapter::strip_str(&String::from_utf8(out).expect("UTF-8")).to_string()
}

/// Lines that begin with `start`, without it.
fn lines_with<'a>(text: &'a str, start: &str) -> Vec<&'a str> {
    text.lines().filter_map(|line| line.strip_prefix(start)).collect()
}

/// The lines below a label, without the label.
fn lines_below<'a>(text: &'a str, label: &str) -> Vec<&'a str> {
    let mut lines = text.lines().skip_while(|line| !line.starts_with(label));
    let first = lines.next().map(|line| line[label.len()..].trim_start());
    first.into_iter().chain(lines.take_while(|line| line.starts_with(' ')).map(str::trim)).collect()
}

#[test]
fn a_report_on_an_arm_at_rest_suggests_one_motion_in_a_few_lines() {
    let mut report = audit_fixture("shake").report;
    let text = render("text", &report);
    let untested = lines_with(&text, "  untested  ");
    assert_eq!(untested.len(), 1, "{text}");
    assert!(
        untested[0].starts_with("not observable in this motion: ")
            && untested[0].contains("ZER001")
    );
    let because = lines_with(&text, "  because   ");
    assert_eq!(because, ["no joint moved over more than 3 % of its range"]);
    let next = text.split("\n  next      ").nth(1).expect("a next step");
    // It can be pasted unchanged.
    let command = next.lines().nth(1).expect("a command").trim_start();
    assert!(command.starts_with("poseaudit plan ") && command.contains(" --for "), "{command}");
    report.is_verbose = true;
    let text = render("text", &report);
    let open = lines_below(&text, "inconclusive");
    assert!((1..=4).contains(&open.len()), "{open:#?}");
    assert!(open[0].contains("all 6 joints"), "{open:#?}");
    let settle = lines_below(&text, "to settle");
    assert!(settle[0].starts_with("record 60 s with each joint by 30° or more"), "{settle:#?}");
    let label = |name: &str| text.find(&format!("\n{name}")).expect(name);
    assert!(label("warning[MOT001]") < label("inconclusive"));
    assert!(label("inconclusive") < label("passed") && label("passed") < label("FAIL"));
}

#[test]
fn a_pass_lists_its_bounds_with_their_limits() {
    let audited = audit_fixture("clean");
    let text = render("text", &audited.report);
    for (bound, limit) in [
        ("  latency (LAT001, largest of 3) ", "  limit 2 ms"),
        ("  residual (MDL001, largest of 2) ", "  limit 1 mm, 0.1°"),
        ("  joint zero offset (ZER001, largest of 6) ", "  limit 0.1°"),
    ] {
        let line = lines_with(&text, bound);
        assert!(line.len() == 1 && line[0].contains(" ± ") && line[0].ends_with(limit), "{text}");
    }
    let page = render("html", &audited.report);
    assert!(page.contains("largest, ± 95 %") && page.contains("<td>2 ms</td>"), "no limit given");
}

#[test]
fn gimbal_lock_is_not_checked_without_a_declared_convention() {
    let report = audit_fixture("gimbal").report;
    let row = report.checks.iter().find(|row| row.code == "ORD006").expect("a row");
    assert_eq!(row.status, Status::Inconclusive);
    let text = render("text", &report);
    assert!(text.contains("ORD006 on /tool_pose: not checked: "), "{text}");
}

#[test]
fn a_latency_is_supported_by_stamps_ahead_of_the_receive_times() {
    let text = render("text", &audit_fixture("faulty").report);
    let block = text.split("\n\n").find(|block| block.starts_with("error[LAT001]"));
    let block = block.expect("a block");
    assert!(
        block.contains("\n  note    messages arrive up to 14.9 ms before their own stamps"),
        "{block}"
    );
}

#[test]
fn a_cause_on_many_subjects_is_one_block() {
    let mut report = audit_fixture("shake").report;
    let first = report.findings[0].clone();
    report.findings = (0..10)
        .map(|index| {
            let topic = Some(format!("/model/box_{index}/pose"));
            Finding { subject: Subject { topic, ..Subject::default() }, ..first.clone() }
        })
        .collect();
    let text = render("text", &report);
    assert_eq!(text.matches("warning[MOT001]").count(), 1, "{text}");
    assert!(text.contains("/model/box_0/pose, ") && text.contains(" and 5 more: "), "{text}");
    assert!(text.contains("FAIL  1 warning; "), "{text}");
    // Other values have a line each.
    report.findings.truncate(3);
    report.findings[0].message = "12 mm".to_owned();
    let text = render("text", &report);
    assert!(text.contains("\n  /model/box_0/pose: 12 mm\n"), "{text}");
    assert!(text.contains("warning[MOT001] 3 topics: "), "{text}");
}

#[test]
fn an_equivalent_zero_has_the_size_of_the_frame_error() {
    let report = audit_fixture("base").report;
    let found = report.findings.iter().find(|found| found.code == "FRM002").expect("FRM002");
    let zero = found.evidence.indistinguishable[0].estimate.as_ref().and_then(Estimate::value);
    assert!(zero.is_some_and(|rad| (rad.abs() - std::f64::consts::PI).abs() < 1e-4), "{zero:?}");
    let text = render("text", &report);
    assert!(text.contains("joint zero of shoulder_pan_joint, "), "{text}");
}

#[test]
fn the_page_of_a_pass_shows_the_error_of_each_stream_and_its_limit() {
    let page = render("html", &audit_fixture("clean").with_figures().report);
    let section = page.split("id=\"errors\"").nth(1).expect("the errors");
    let section = section.split("</section>").next().unwrap_or_default();
    let data = page.split("id=\"data\" type=\"application/json\">").nth(1).expect("data");
    let data: Value = serde_json::from_str(data.split("</script>").next().unwrap_or_default())
        .expect("the data of the plots");
    for (topic, plots) in [("/tcp_pose_broadcaster/pose", 2), ("/tf", 2), ("/imu/data", 1)] {
        let figures: Vec<&str> = section
            .split("<figure")
            .filter(|figure| figure.contains(&format!("<span class=\"of\">{topic}</span>")))
            .collect();
        assert_eq!(figures.len(), plots, "{topic}");
        for figure in figures {
            let id = figure.split("data-plot=\"").nth(1).and_then(|rest| rest.split('"').next());
            let plot = &data[id.expect("an id")];
            let lines = plot["series"].as_array().expect("series");
            let has_limit_line = lines.iter().any(|line| line["role"] == "limit");
            assert!(has_limit_line || plot["limits"][0]["at"].is_f64(), "{topic}: no limit");
            assert_eq!(plot["shows_limits"], true, "{topic}");
            assert!(lines[0]["values"].as_array().is_some_and(|values| values.len() > 100));
        }
    }
}

#[test]
fn a_log_that_cannot_be_audited_passes_no_rule() {
    let trouble = Trouble {
        kind: TroubleKind::Log,
        what: "nothing can be audited".to_owned(),
        place: "run.mcap".to_owned(),
        remedy: "record the joint states".to_owned(),
    };
    let report = audit_fixture("clean").report.with_trouble(trouble);
    for format in ["text", "html", "markdown"] {
        let text = render(format, &report).to_lowercase();
        assert!(text.contains("no audit") && !text.contains("passed"), "{format}: {text}");
    }
}

#[test]
fn findings_have_plots_with_their_limits() {
    for (log, titles, limit) in [
        (
            "shake",
            &["Spectrum of the tip's path", "Path during the strongest vibration"][..],
            "0.5 mm",
        ),
        ("line", &["Deviation from the commanded line"], "1 mm"),
        ("goal", &["Rest positions relative to goals", "Goals and rests"], "1 mm"),
        ("slipped_target", &["Hand-eye residual of each view", "Viewing directions"], "2 mm"),
        ("stop", &["Joint speed", "Joint position"], ""),
    ] {
        let page = render("html", &audit_fixture(log).with_figures().report);
        for title in titles {
            assert!(page.contains(title), "{log}: {title}");
        }
        let limits = [format!("limit {limit}"), format!("limit ±{limit}")];
        assert!(
            limit.is_empty() || limits.iter().any(|limit| page.contains(limit)),
            "{log}: {limit}"
        );
        assert!(!page.contains("No plot"), "{log}");
    }
}

#[test]
fn the_plotjuggler_layout_plots_columns_of_its_table() {
    let audited = audit_fixture("faulty");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("errors.csv");
    audited.write_plotjuggler(&path).expect("a file");
    let mut reader = csv::Reader::from_path(&path).expect("a table");
    let header: Vec<String> =
        reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let rows: Vec<Vec<f64>> = reader
        .records()
        .map(|row| row.expect("a row").iter().map(|cell| cell.parse().expect(cell)).collect())
        .collect();
    assert!(rows.len() > 500 && rows.is_sorted_by(|a, b| a[0] <= b[0]));
    let layout =
        std::fs::read_to_string(folder.path().join("errors.layout.xml")).expect("a layout");
    let layout = roxmltree::Document::parse(&layout).expect("XML");
    let named = |tag: &str, name: &str| -> Vec<String> {
        let tags = layout.descendants().filter(|node| node.has_tag_name(tag));
        tags.map(|node| node.attribute(name).expect(name).to_owned()).collect()
    };
    assert_eq!(named("fileInfo", "filename"), ["errors.csv"]);
    assert_eq!(named("parameters", "time_axis"), [header[0].clone()]);
    assert_eq!(named("Tab", "tab_name"), ["tcp_pose_broadcaster/pose: LAT001, ZER001"]);
    assert_eq!(named("curve", "name"), header[1..]);
    let largest = |name: &str| {
        let column = header.iter().position(|own| own.ends_with(name)).expect(name);
        rows.iter().map(|row| row[column]).fold(0.0, f64::max)
    };
    // 15 ms at up to 0.66 m/s, and a zero offset.
    assert!((5.0..40.0).contains(&largest("position_mm/as_logged")));
    assert!(largest("position_mm/corrected") < largest("position_mm/limit"));
    assert!(largest("rotation_deg/corrected") < largest("rotation_deg/limit"));
    assert!(largest("rotation_deg/limit") < largest("rotation_deg/as_logged"));
}

#[test]
fn the_foxglove_file_holds_every_finding_and_the_tool_error_and_a_layout() {
    let audited = audit_fixture("faulty");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("findings.mcap");
    audited.write_foxglove(&path).expect("a file");
    let bytes = std::fs::read(&path).expect("the file");
    let mut by_schema: BTreeMap<String, Vec<(u64, Value)>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).expect("an MCAP") {
        let message = message.expect("a message");
        let schema = message.channel.schema.clone().expect("a schema");
        assert_eq!(
            (schema.encoding.as_str(), &*message.channel.message_encoding),
            ("jsonschema", "json")
        );
        let content: Value = serde_json::from_slice(&message.data).expect("JSON");
        let schema_of: Value = serde_json::from_slice(&schema.data).expect("a schema");
        let fields = schema_of["properties"].as_object().expect("fields");
        assert!(content.as_object().expect("an object").keys().all(|key| fields.contains_key(key)));
        by_schema.entry(schema.name.clone()).or_default().push((message.log_time, content));
    }
    let lines = &by_schema["foxglove.Log"];
    assert_eq!(lines.len(), audited.report.findings.len() + 1);
    assert!(lines[0].1["message"].as_str().is_some_and(|text| text.starts_with("FAIL: ")));
    for finding in &audited.report.findings {
        let line = lines.iter().find(|(_, line)| line["file"] == finding.code).expect(finding.code);
        assert!(line.1["message"].as_str().is_some_and(|text| text.contains(&finding.message)));
    }
    let scenes = &by_schema["foxglove.SceneUpdate"];
    let error_m = |scene: &Value| {
        let at = |ball: usize, axis: &str| {
            scene["entities"][0]["spheres"][ball]["pose"]["position"][axis]
                .as_f64()
                .expect("a number")
        };
        ["x", "y", "z"].map(|axis| (at(1, axis) - at(0, axis)).powi(2)).iter().sum::<f64>().sqrt()
    };
    // 15 ms at up to 0.66 m/s, and a zero offset.
    let max_error_m = scenes.iter().map(|(_, scene)| error_m(scene)).fold(0.0, f64::max);
    assert!((5e-3..40e-3).contains(&max_error_m), "{max_error_m}");
    for (at, scene) in scenes {
        let stamp = &scene["entities"][0]["timestamp"];
        let [sec, nsec] = ["sec", "nsec"].map(|part| stamp[part].as_u64().expect("a time"));
        assert_eq!(sec * 1_000_000_000 + nsec, *at);
        assert_eq!(scene["entities"][0]["frame_id"], "base");
        assert_eq!(scene["entities"][0]["metadata"][0]["key"], "LAT001");
    }
    let errors = &by_schema["poseaudit.Error"];
    let most = |field: &str| {
        let values = errors.iter().map(|(_, error)| error[field].as_f64().expect(field));
        values.fold(0.0, f64::max)
    };
    // The numbers keep the peaks, which even rows may miss.
    assert!((1e3 * max_error_m..40.0).contains(&most("position_mm")), "{}", most("position_mm"));
    assert!(most("corrected_position_mm") < 0.1 * most("position_mm"));
    for (field, limit) in [("position_limit_mm", 1.0), ("rotation_limit_deg", 0.1)] {
        assert!((most(field) - limit).abs() < 1e-9, "{field}: {}", most(field));
    }

    let layout = std::fs::read(folder.path().join("findings.layout.json")).expect("the layout");
    let layout: Value = serde_json::from_slice(&layout).expect("JSON");
    let panels = layout["configById"].as_object().expect("panels");
    assert_eq!(panels["RosOut!findings"]["topicToRender"], "/poseaudit/log");
    // Every plotted path is a number of a topic in the file.
    for panel in ["Plot!position", "Plot!rotation"] {
        let paths = panels[panel]["paths"].as_array().expect("paths");
        assert_eq!(paths.len(), 3, "{paths:?}");
        for path in paths {
            let path = path["value"].as_str().expect("a path");
            let (topic, field) = path.rsplit_once('.').expect("a field");
            assert_eq!(topic, "/poseaudit/error/tcp_pose_broadcaster/pose");
            assert!(errors[0].1[field].is_number(), "{field}");
        }
    }
}
