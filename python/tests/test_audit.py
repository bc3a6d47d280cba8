"""`audit`: finds planted faults, and reports in one line if a log cannot be audited."""

import json
import re
import subprocess
from pathlib import Path

import pytest

import poseaudit
from poseaudit._binary import find_binary
from poseaudit._options import Options, arguments, names


def test_planted_faults_are_found_with_their_values(faulty: Path) -> None:
    report = poseaudit.audit(faulty)
    assert (report.verdict, report.ok, report.error) == ("fail", False, None)
    amounts = {finding.code: finding.estimate for finding in report.findings}
    assert set(amounts) == {"LAT001", "ZER001"}
    latency, zero = amounts["LAT001"], amounts["ZER001"]
    assert latency is not None and latency.unit == "s" and latency.ci95 is not None
    assert latency.ci95[0] <= 0.015 <= latency.ci95[1]
    assert zero is not None and zero.value == pytest.approx(0.0104720, abs=2e-5)
    subject = next(finding.subject for finding in report.findings if finding.code == "ZER001")
    assert (subject.robot, subject.joint) == ("ur5e", "elbow_joint")
    assert report.log.start_ns == 1_780_000_000_000_000_000
    assert [robot.tip for robot in report.robots] == ["tool0"]


def test_a_fault_free_log_passes_with_only_the_selected_rules(clean: Path) -> None:
    report = poseaudit.audit(clean, select=["LAT", "ZER001"], verify=True)
    assert report.ok and not report.findings
    assert {check.code[:3] for check in report.checks} == {"LAT", "ZER"}


def test_a_required_rule_that_is_inconclusive_is_not_ok(clean: Path) -> None:
    report = poseaudit.audit(clean, require="MOT004")
    assert report.open is not None and "MOT004" in report.open and not report.ok
    assert poseaudit.audit(clean, require=["LAT001"]).ok


def test_severities_that_do_not_fail_are_still_findings(faulty: Path) -> None:
    report = poseaudit.audit(faulty, fail_on="never")
    assert report.ok and len(report.findings) == 2


def test_a_log_that_cannot_be_audited_raises_the_error_line_of_the_program(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("not a log\n")
    with pytest.raises(poseaudit.LogError, match=r"^.*notes\.txt: not a robot log: .*; name an MCAP.*$"):
        poseaudit.audit(text)
    with pytest.raises(poseaudit.CallError, match="no such file"):
        poseaudit.audit(tmp_path / "nowhere.mcap")


def test_a_wrong_option_raises(clean: Path) -> None:
    with pytest.raises(TypeError, match=r"audit\(\) got an unexpected .* 'robt'; did you mean 'robot'\?"):
        poseaudit.audit(clean, robt="ur5e")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="takes a value"):
        poseaudit.audit(clean, robot=True)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="no log"):
        poseaudit.audit([])
    with pytest.raises(poseaudit.CallError, match="there is no rule"):
        poseaudit.audit(clean, select="XXX001")


def test_every_option_of_the_program_is_an_option_here() -> None:
    usage = subprocess.run([find_binary(), "audit", "--help"], stdout=subprocess.PIPE, text=True, check=True)
    flags = set(re.findall(r"^ +(?:-\w, )?--([a-z-]+)", usage.stdout, re.MULTILINE))
    # Output options and options that open a window are not parameters of the function.
    program_options = flags - {"help", "format", "output", "view", "statistics", "quiet", "verbose", "color"}
    assert program_options == {name.replace("_", "-") for name in names(Options)}


def test_option_values_become_arguments() -> None:
    converted = arguments(
        "audit",
        {
            "robot": {"left_": Path("a.urdf"), "right_": "ur5e"},
            "declare": {"/tcp": "rotvec", "/flange": "euler:ZYX,deg"},
            "select": ("LAT", "ZER001"),
            "max_latency": 0.5,
            "verify": True,
            "tip": None,
            "config": Path("-odd.toml"),
        },
        Options,
    )
    assert converted == [
        *("--robot=left_=a.urdf", "--robot=right_=ur5e"),
        *("--declare=/tcp=rotvec", "--declare=/flange=euler:ZYX,deg"),
        *("--select=LAT", "--select=ZER001", "--max-latency=0.5", "--verify", "--config=-odd.toml"),
    ]


def test_a_report_is_read_back_with_keys_of_later_versions(faulty: Path) -> None:
    call = [str(find_binary()), "audit", "--format=json", str(faulty)]
    text = subprocess.run(call, stdout=subprocess.PIPE, text=True).stdout
    report = poseaudit.Report.from_json(text)
    assert report == poseaudit.audit(faulty)
    later = json.loads(text)
    later["weather"] = {"rain_mm": 3}
    later["findings"][0]["mood"] = "grim"
    read = poseaudit.Report.from_json(json.dumps(later))
    assert read == report
    assert read.json["weather"] == {"rain_mm": 3} and read.json["findings"][0]["mood"] == "grim"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "invalid JSON"),
        ("[]", "schema None"),
        ('{"schema": "poseaudit.report/2"}', "schema 'poseaudit.report/2'"),
        ('{"schema": "poseaudit.report/1"}', "it has no 'tool'"),
        ('{"schema": "poseaudit.report/1", "tool": 3}', r"the report\.tool: expected an object, found 3"),
    ],
)
def test_an_invalid_report_is_refused_with_its_place(text: str, expected: str) -> None:
    with pytest.raises(poseaudit.ReportError, match=expected):
        poseaudit.Report.from_json(text)
