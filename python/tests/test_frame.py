"""Findings, checks and streams as data frames: the same rows as the program's Parquet tables."""

import json
from pathlib import Path

import pytest

import poseaudit

polars = pytest.importorskip("polars")
pytest.importorskip("pandas")
JSON = ("estimate_json", "evidence_json")


@pytest.mark.parametrize("table", ["findings", "checks"])
def test_frames_equal_the_tables_of_the_program(faulty: Path, tmp_path: Path, table: str) -> None:
    report = poseaudit.audit(faulty, parquet=tmp_path)
    own = getattr(report, table).to_polars()
    written = polars.read_parquet(tmp_path / f"{table}.parquet")
    assert own.height > 0 and own.columns == written.columns
    assert own.drop(JSON).equals(written.drop(JSON)) and own.schema == written.schema
    for name in JSON:
        left, right = ([json.loads(text or "null") for text in frame[name]] for frame in (own, written))
        assert left == right


def test_pandas_and_polars_frames_are_equal(faulty: Path) -> None:
    findings = poseaudit.audit(faulty).findings
    rows = findings.frame("pandas").astype(object)
    assert rows.where(rows.notna(), None).to_dict("records") == findings.frame("polars").to_dicts()
    with pytest.raises(ValueError, match="'polars' or 'pandas'"):
        findings.frame("excel")  # type: ignore[call-overload]


def test_a_report_without_findings_has_a_frame_with_all_columns(clean: Path) -> None:
    report = poseaudit.audit(clean)
    frame = report.findings.to_polars()
    assert frame.height == 0 and frame.schema["start_ns"] == polars.Int64
    assert report.streams.to_polars().filter(polars.col("role") == "imu").height == 1
