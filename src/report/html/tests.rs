use serde_json::Value;

use super::finding_plots::FindingPlots;
use super::plot::{Plot, PlotSeries, SeriesRole};
use super::*;
use crate::checks::{self, Evaluation};
use crate::finding::{Cause, Evidence, Finding, Severity, Subject};
use crate::geometry::{Convention, Misinterpretation, Pose, RotationError};
use crate::report::figures::{
    EncodingScore, Figures, FrameEdge, FrameEdgeKind, ImuFigure, PoseFigure, StreamGap, TimelineRow,
};
use crate::report::{LogSummary, NoteRow, RobotRow, StreamRow};
use crate::stats::Measured;

const HOSTILE: &str = "/pose</script><img src=x onerror=alert(1)>\"'&";

const POSE: &str = "/pose";
const IMU: &str = "/imu";

fn finding(code: &'static str, topic: &str) -> Finding {
    let measured = Measured { value: 1e-2, std_error: 1e-4, dof: 1e3 };
    let cause = match code {
        "ORD001" => {
            let misreading = Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY };
            Cause::Rotation(RotationError::Misread(misreading))
        }
        "ZER001" => Cause::JointZero { offset: measured, is_prismatic: false },
        "LAT001" => Cause::Latency(measured),
        "LAT003" => Cause::VaryingLatency,
        "YAW001" => Cause::YawDrift(measured),
        "MDL001" => Cause::UnexplainedResidual,
        "MOT006" | "ZER003" => Cause::Compliance,
        "FRM004" => Cause::FrameTree,
        "TIM002" => Cause::Stamps,
        "LAT002" => Cause::ClockSkew(measured),
        "ZER002" => Cause::RadialScale,
        "FRM002" => Cause::ReferenceFrame(Pose::identity()),
        _ => Cause::Other,
    };
    Finding {
        code,
        severity: Severity::Error,
        title: "something is off",
        message: format!("{topic} is off"),
        subject: Subject {
            robot: Some("arm".to_owned()),
            topic: Some(topic.to_owned()),
            ..Subject::default()
        },
        cause,
        segment: None,
        estimate: None,
        evidence: Evidence::default(),
        fix: format!("mend {topic}"),
        start_ns: None,
        end_ns: None,
    }
}

#[test]
fn findings_of_one_topic_in_several_segments_are_of_one_topic() {
    let title = |topics: [&str; 2]| {
        let findings = topics.iter().zip(["6.1 %", "6.0 %"]).map(|(topic, share)| Finding {
            message: format!("{share} of the rows repeat old values"),
            fix: "stamp each row".to_owned(),
            ..finding("TIM008", topic)
        });
        let report = report(findings.collect(), Figures::default());
        let outline = Outline::new(&report);
        outline.group_title(&outline.finding_groups()[0]).0
    };
    assert!(title(["/joints", "/joints"]).ends_with("/joints"));
    assert_eq!(title(["/joints", "/other"]), "2 topics");
}

fn report(findings: Vec<Finding>, figures: Figures) -> Report {
    let evaluation = Evaluation { findings, ..Evaluation::default() };
    let robot = RobotRow {
        name: "arm".to_owned(),
        source: "the log".to_owned(),
        base: "base".to_owned(),
        tip: "tool".to_owned(),
        joints: Vec::new(),
    };
    let log = LogSummary { duration_s: Some(1.0), ..LogSummary::default() };
    let report = Report::new(log, vec![robot], vec![], evaluation, Some(Severity::Warning));
    Report { figures: Some(figures), ..report }
}

/// A peak in each error.
fn pose_figure(topic: &str, rows: usize) -> PoseFigure {
    let wave = |rate: f64| -> Vec<f64> {
        (0..rows).map(|row| 0.012_345_678 * (1.0 + (rate * row as f64).sin())).collect()
    };
    PoseFigure {
        robot: "arm".to_owned(),
        topic: topic.to_owned(),
        t_s: (0..rows).map(|row| row as f64 * 0.180_123_4).collect(),
        before_m: wave(0.011),
        before_rad: wave(0.023),
        after_m: wave(0.7),
        after_rad: wave(0.9),
        reach_m: wave(0.017),
        residual_by_latency: (0..120).map(|at| [f64::from(at) * 1e-3, 0.01, 0.02]).collect(),
        encodings: vec![EncodingScore {
            actual: "rotvec".to_owned(),
            assumed: topic.to_owned(),
            is_as_logged: false,
            is_best: true,
            rms_rad: 0.1,
        }],
        ..PoseFigure::default()
    }
}

fn imu_figure(topic: &str, rows: usize) -> ImuFigure {
    ImuFigure {
        robot: "arm".to_owned(),
        topic: topic.to_owned(),
        yaw_error: (0..rows).map(|row| [row as f64 * 0.7, 1e-3 * (row as f64).sin()]).collect(),
        headings: (0..rows).map(|row| [row as f64 * 0.7, (row as f64).sin(), 0.1]).collect(),
        ..ImuFigure::default()
    }
}

fn figures(rows: usize) -> Figures {
    Figures {
        duration_s: 3600.0,
        poses: vec![pose_figure(POSE, rows)],
        imus: vec![imu_figure(IMU, rows)],
        ..Figures::default()
    }
}

fn render(report: &Report) -> String {
    let mut page = Vec::new();
    write(report, &mut page).expect("a page");
    String::from_utf8(page).expect("UTF-8")
}

/// Outside scripts and styles.
fn attributes<'a>(page: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    let parts = page.split(&start).skip(1);
    parts.filter_map(|part| part.split('"').next()).collect()
}

#[test]
fn the_page_loads_nothing() {
    let page = render(&report(vec![finding("ORD001", POSE), finding("YAW001", IMU)], figures(50)));
    let links = attributes(&page, "href");
    assert!(!links.is_empty() && links.iter().all(|link| link.starts_with('#')), "{links:?}");
    assert_eq!(attributes(&page, "src"), [""; 0]);
    for loading in ["<link", "<img", "<iframe", "@import", "url("] {
        assert!(!page.contains(loading), "{loading}");
    }
    let policy = attributes(&page, "content").into_iter().find(|text| text.contains("script-src"));
    let policy = policy.expect("a policy");
    assert!(policy.starts_with("default-src 'none'; style-src 'unsafe-inline';"), "{policy}");
    assert_eq!(policy.matches("'sha256-").count(), 2, "{policy}");
    assert!(!policy.contains("http"), "{policy}");
}

#[test]
fn every_link_has_a_target() {
    let codes = ["ORD001", "LAT001", "TIM002", "FRM004", "ZER002"];
    let all = codes.map(|code| finding(code, POSE)).to_vec();
    let timeline = vec![TimelineRow { topic: POSE.to_owned(), ..TimelineRow::default() }];
    let frames = vec![FrameEdge {
        parent: "base".to_owned(),
        child: "tool".to_owned(),
        kind: FrameEdgeKind::Static,
    }];
    let page = render(&report(all, Figures { timeline, frames, ..figures(50) }));
    let ids = attributes(&page, "id");
    for link in attributes(&page, "href") {
        assert!(ids.contains(&&link[1..]), "{link}");
    }
    let mut once = ids.clone();
    once.sort_unstable();
    once.dedup();
    assert_eq!(once.len(), ids.len(), "{ids:?}");
}

#[test]
fn hostile_names_stay_text() {
    let codes = ["ORD001", "LAT001", "FRM002", "ZER002", "TIM002"];
    let findings = codes.map(|code| finding(code, HOSTILE)).to_vec();
    let figures = Figures {
        poses: vec![pose_figure(HOSTILE, 30)],
        imus: vec![imu_figure(HOSTILE, 30)],
        timeline: vec![TimelineRow {
            topic: HOSTILE.to_owned(),
            frame: Some(HOSTILE.to_owned()),
            gaps: vec![StreamGap { span_s: [0.1, 0.2], missing: 3 }],
            ..TimelineRow::default()
        }],
        frames: vec![FrameEdge {
            parent: HOSTILE.to_owned(),
            child: "tool".to_owned(),
            kind: FrameEdgeKind::Moving,
        }],
        ..Figures::default()
    };
    let mut report = report(findings, figures);
    report.robots[0].name = HOSTILE.to_owned();
    report.log.notes = vec![NoteRow { path: HOSTILE.into(), note: HOSTILE.to_owned() }];
    let row = |topic: &str| StreamRow {
        topic: topic.to_owned(),
        type_name: HOSTILE.to_owned(),
        role: "pose",
        reason: HOSTILE.to_owned(),
        robot: None,
        frame_id: Some(HOSTILE.to_owned()),
        child_frame_id: None,
        reference: None,
        link: None,
        source_kind: None,
        count: 1,
        dropped: 0,
        rate_hz: None,
        start_ns: None,
        end_ns: None,
        columns: Vec::new(),
        joint_lines: Vec::new(),
    };
    report.streams = vec![row(HOSTILE)];
    let page = render(&report);
    assert!(!page.contains("<img") && page.contains("&lt;img"), "a name became an element");
    assert_eq!(page.matches("</script").count(), 3);
    assert_eq!(page.matches("<script").count(), 3);
}

#[test]
fn hostile_names_stay_data() {
    let plot = Plot {
        x: vec![0.0, 1.0],
        series: vec![PlotSeries::new(HOSTILE, SeriesRole::Amount, [1.0, 2.0])],
        ..Plot::default()
    };
    let findings = vec![FindingPlots { plots: vec![plot], ..FindingPlots::default() }];
    let data = embed_json(plot_data(&PagePlots { findings, streams: Vec::new() }, 100));
    assert!(!data.contains('<'), "{data}");
    let read: Value = serde_json::from_str(&data).expect("JSON");
    assert_eq!(read["plot-1-1"]["series"][0]["label"], HOSTILE);
}

#[test]
fn scripts_are_closed() {
    for script in [UPLOT, SCRIPT] {
        assert!(!script.contains("</script") && !script.contains("<!--"));
    }
    assert!(!STYLE.contains("</style") && !UPLOT_STYLE.contains("</style"));
}

#[test]
fn every_finding_of_every_rule_has_its_section() {
    let codes: Vec<&str> = checks::registry().iter().map(|rule| rule.code).collect();
    let findings = codes.iter().map(|code| finding(code, POSE)).collect();
    let page = render(&report(findings, figures(50)));
    for (index, code) in codes.iter().enumerate() {
        let start = format!(" id=\"finding-{}\"", index + 1);
        let section = page.split(&start).nth(1).and_then(|rest| rest.split("</article>").next());
        let section = section.unwrap_or_else(|| panic!("{code} has no section"));
        assert!(section.contains(code) && section.contains("mend /pose"), "{code}");
        assert!(section.contains("<figure") || section.contains("class=\"note\""), "{code}");
    }
}

#[test]
fn a_report_on_an_hour_is_below_two_megabytes() {
    let codes = ["ORD001", "LAT001", "LAT002", "ZER001", "ZER002", "FRM002", "MDL001", "TIM002"];
    let topics: Vec<String> = (0..12).map(|stream| format!("/arm/stream_{stream}/pose")).collect();
    let findings = topics.iter().flat_map(|topic| codes.map(|code| finding(code, topic))).collect();
    let silences = (0..60).map(|at| {
        let start_s = f64::from(at) * 59.123_456;
        StreamGap { span_s: [start_s, start_s + 1.234_567], missing: 154 }
    });
    let silences: Vec<StreamGap> = silences.collect();
    let figures = Figures {
        duration_s: 3600.0,
        poses: topics.iter().map(|topic| pose_figure(topic, 20_000)).collect(),
        imus: (0..4).map(|imu| imu_figure(&format!("/imu_{imu}"), 5_000)).collect(),
        timeline: topics
            .iter()
            .map(|topic| TimelineRow {
                topic: topic.clone(),
                span_s: [0.0, 3600.0],
                gaps: silences.clone(),
                ..TimelineRow::default()
            })
            .collect(),
        ..Figures::default()
    };
    let report = report(findings, figures);
    let page = render(&report);
    assert!(page.len() <= 2_000_000, "{} bytes", page.len());
    assert!(page.contains("min/max of"), "omitted samples must be mentioned");
    assert_eq!(page, render(&report));
}

#[test]
fn a_report_without_a_run_is_rendered() {
    let trouble = crate::report::Trouble {
        kind: crate::report::TroubleKind::Log,
        what: "no <joints>".to_owned(),
        place: "run.mcap".to_owned(),
        remedy: "record them".to_owned(),
    };
    let page = render(&Report::from_trouble(trouble));
    assert!(page.contains("NO AUDIT") && page.contains("no &lt;joints&gt;"));
    assert!(!page.contains("<figure"));
}
