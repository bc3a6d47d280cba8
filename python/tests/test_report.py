"""Representations of a report, its page and samples; poses, kinematics, comparisons."""

import math
from pathlib import Path

import pytest

import poseaudit


def test_a_report_has_a_line_a_text_and_a_page(faulty: Path) -> None:
    report = poseaudit.audit(faulty)
    line = repr(report)
    assert line.startswith("<poseaudit.Report fail: 2 findings (") and "LAT001" in line and len(line) < 200
    assert "FAIL" in str(report) and "\x1b" not in str(report)
    page = report.html()
    assert page.startswith("<!DOCTYPE html>") and "elbow_joint" in page
    embedded = report._repr_html_()
    assert embedded is not None and embedded.startswith("<iframe srcdoc=") and "&lt;html" in embedded


def test_a_report_read_from_json_has_no_page(faulty: Path) -> None:
    import json

    stored = poseaudit.Report.from_json(json.dumps(poseaudit.audit(faulty).json))
    assert stored._repr_html_() is None and str(stored).startswith("fail\n")
    with pytest.raises(poseaudit.ReportError, match="html: the report was read from JSON"):
        stored.html()


def test_samples_equal_the_table_of_the_program(faulty: Path, tmp_path: Path) -> None:
    polars = pytest.importorskip("polars")
    report = poseaudit.audit(faulty, parquet=tmp_path)
    stored = polars.read_parquet(tmp_path / "aligned.parquet")
    assert report.samples().equals(stored) and stored.height > 500


def test_forward_kinematics_of_one_and_of_many() -> None:
    upright = [0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0]
    one = poseaudit.fk("ur5e", upright)
    # Sum of the lengths along z, from the vendor's table: d1 + a2 + a3 + d5.
    assert one["xyz_m"][2] == pytest.approx(0.1625 + 0.425 + 0.3922 + 0.0997, abs=1e-4)
    many = poseaudit.fk("ur5e", [upright, [0.0] * 6])
    assert many[0]["xyz_m"] == pytest.approx(one["xyz_m"]) and len(many) == 2
    none: list[list[float]] = []
    assert list(poseaudit.fk("ur5e", none)) == []
    with pytest.raises(poseaudit.CallError, match="ur5f"):
        poseaudit.fk("ur5f", upright)


def test_one_pose_is_converted_and_two_are_reconciled() -> None:
    quarter = poseaudit.pose([0, 0, math.pi / 2], a_as="rotvec")
    turns = {row["convention"]: row["numbers"] for row in quarter["conventions"]}
    assert turns["euler:ZYX"] == pytest.approx([math.pi / 2, 0, 0])
    both = poseaudit.pose("0.1 0.2 0.3 0 0 0 1", "0.1 0.2 0.42 0 0 0 1", a_as="quat:xyzw", b_as="quat:xyzw")
    assert both["would_do"]["is_from_but"]["xyz_m"] == pytest.approx([0, 0, 0.12])
    with pytest.raises(poseaudit.CallError):
        poseaudit.pose("no pose at all")


def test_logs_reports_and_files_are_compared(faulty: Path, clean: Path, tmp_path: Path) -> None:
    baseline = tmp_path / "baseline.json"
    before = poseaudit.audit(clean, write_baseline=baseline)
    worse = poseaudit.compare(before, faulty)
    assert worse.regression and worse.verdicts == ("pass", "fail")
    assert {cause["code"] for cause in worse.causes} == {"LAT001", "ZER001"}
    assert "REGRESSION" in str(worse)
    same = poseaudit.compare(baseline, clean, select="LAT")
    assert not same.regression and same.verdicts == ("pass", "pass")
