//! Order of a report, and the plots and messages of findings.

use std::collections::BTreeMap;

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

/// The lines below a label, without the label.
fn lines_below<'a>(text: &'a str, label: &str) -> Vec<&'a str> {
    let mut lines = text.lines().skip_while(|line| !line.starts_with(label));
    let first = lines.next().map(|line| line[label.len()..].trim_start());
    first.into_iter().chain(lines.take_while(|line| line.starts_with(' ')).map(str::trim)).collect()
}

#[test]
fn a_report_on_an_arm_at_rest_suggests_one_motion_in_a_few_lines() {
    let text = render("text", &audit_fixture("shake").report);
    let open = lines_below(&text, "inconclusive");
    assert!((1..=4).contains(&open.len()), "{open:#?}");
    assert!(open[0].starts_with("not observable in this motion: ") && open[0].contains("ZER001"));
    assert!(open[0].contains("all 6 joints"), "{open:#?}");
    let settle = lines_below(&text, "to settle");
    assert_eq!(settle.len(), 2, "{settle:#?}");
    assert!(settle[0].starts_with("record 60 s with each joint by 30° or more"), "{settle:#?}");
    // It can be pasted unchanged.
    assert!(settle[1].starts_with("poseaudit plan ") && settle[1].contains(" --for "));
    let label = |name: &str| text.find(&format!("\n{name}")).expect(name);
    assert!(
        label("warning MOT001") < label("inconclusive") && label("inconclusive") < label("passed")
    );
}

#[test]
fn a_pass_lists_its_bounds() {
    let audited = audit_fixture("clean");
    let text = render("text", &audited.report);
    let passed = lines_below(&text, "passed").join("; ");
    for bound in ["LAT001 latency ", "ZER001 joint zero offset ", "FRM003 tool frame "] {
        let amount = passed.split(bound).nth(1).and_then(|rest| rest.split(';').next());
        assert!(amount.is_some_and(|amount| amount.contains(" ± ")), "{bound}: {passed}");
    }
    let page = render("html", &audited.report);
    assert!(page.contains("largest, ± 95 %") && page.contains("<td>2 ms</td>"), "no limit given");
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
