"""The pytest plugin: a fixture that audits a recorded run and fails the test with the short report
(docs/pytest.md). The wheel registers it, so no `conftest.py` is needed.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from ._audit import audit
from ._errors import PoseauditError
from ._report import Check, Report, Subject

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ._options import Options

_OPTIONS_MARKER, _LIMITS_MARKER = "pose_audit", "pose_limits"
_PAGES = "--pose-audit-pages"


class PoseAudit(Protocol):
    """The type of the fixture `pose_audit`."""

    def __call__(
        self,
        bag: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        **options: Unpack[Options],
    ) -> Report: ...


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("poseaudit", "audits of recorded runs")
    group.addoption(
        _PAGES,
        metavar="DIR",
        help="write the HTML report of each audit by the fixture pose_audit into this folder",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        f"{_OPTIONS_MARKER}(**options): options for the audits of this test, as in poseaudit.audit()",
    )
    config.addinivalue_line(
        "markers",
        f"{_LIMITS_MARKER}(**limits): thresholds of rules for the audits of this test, as in "
        'pose_limits(LAT001="20 ms", FRM002=["2 mm", "0.2°"])',
    )


@pytest.fixture
def pose_audit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PoseAudit:
    """Audits a recorded run, and fails the test with the short report if the audit fails.

    `pose_audit(bag, robot="ur5e", require=["LAT001"])` takes the options of `poseaudit.audit` and returns its
    report. Estimates become properties of the test in JUnit XML.
    """
    audits = 0

    def run(
        bag: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], **options: Unpack[Options]
    ) -> Report:
        __tracebackhide__ = True
        nonlocal audits
        audits += 1
        merged: dict[str, Any] = {**_marked(request.node, _OPTIONS_MARKER), **options}
        limits = _marked(request.node, _LIMITS_MARKER)
        if limits:
            if merged.get("config"):
                config = os.fspath(merged["config"])
                pytest.fail(
                    f"{config} and the marker {_LIMITS_MARKER}: an audit reads one config; "
                    f"move the limits to [rules] in {config}",
                    pytrace=False,
                )
            # Kept after the test, because the commands in the report name it.
            merged["config"] = tmp_path_factory.mktemp("pose_limits") / "poseaudit.toml"
            merged["config"].write_text(_config(limits), encoding="utf-8")
        report, error = _audit(bag, merged)
        if report is None:
            pytest.fail(error, pytrace=False)
        folder = request.config.getoption(_PAGES)
        if folder:
            _write_page(report, Path(folder), request.node.nodeid, audits)
        prefix = "poseaudit" if audits == 1 else f"poseaudit#{audits}"
        request.node.user_properties.extend(_properties(report, prefix))
        if not report.ok:
            pytest.fail(f"{_headline(report)}\n{report}", pytrace=False)
        return report

    return run


def _audit(bag: Any, options: Mapping[str, Any]) -> tuple[Report | None, str]:
    """Returns the report, or the reason why there is none, so that pytest shows no chained exceptions."""
    try:
        return audit(bag, **options), ""
    except PoseauditError as error:
        return None, str(error)


def _headline(report: Report) -> str:
    """First line of a failure, which pytest repeats in its summary."""
    if report.open:
        return report.open
    return f"{report.verdict}: {', '.join(dict.fromkeys(one.code for one in report.findings))}"


def _marked(node: pytest.Item, name: str) -> dict[str, Any]:
    """Arguments of all markers with this name; a test's override its class's, which override its module's."""
    merged: dict[str, Any] = {}
    for marker in reversed(list(node.iter_markers(name))):
        if marker.args:
            pytest.fail(f"the marker {name} takes only keyword arguments", pytrace=False)
        merged.update(marker.kwargs)
    return merged


def _config(limits: Mapping[str, Any]) -> str:
    """Converts limits by rule to a `poseaudit.toml`. A bare limit is both `warning` and `error`."""
    lines = []
    for code, limit in limits.items():
        table = limit if isinstance(limit, Mapping) else {"warning": limit, "error": limit}
        # JSON's strings, numbers and lists are also TOML's.
        lines += [f"[rules.{code}]", *(f"{key} = {_toml(value)}" for key, value in table.items()), ""]
    return "\n".join(lines)


def _toml(value: object) -> str:
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def _properties(report: Report, prefix: str) -> Iterator[tuple[str, str]]:
    """Properties for JUnit XML: log, verdict, and each estimate with an interval, in SI units."""
    yield f"{prefix}.log", ", ".join(file.path for file in report.log.files)
    yield f"{prefix}.verdict", report.verdict
    for check in report.checks:
        yield from _amounts(check, f"{prefix}.{check.code}.{_label(check.subject)}".rstrip("."))


def _amounts(check: Check, name: str) -> Iterator[tuple[str, str]]:
    estimate = check.estimate
    if estimate is None:
        return
    rotation = estimate.rotation
    for value, unit, ci95 in (
        (estimate.value, estimate.unit or "1", estimate.ci95),
        *([(rotation.value, "rad", rotation.ci95)] if rotation else []),
    ):
        if value is not None and ci95 is not None:
            yield f"{name} ({unit})", f"{value:.6g}"
            yield f"{name} ci95 ({unit})", f"{ci95[0]:.6g} {ci95[1]:.6g}"


def _label(subject: Subject) -> str:
    """Short label of a subject: its joint, or its topic and frame."""
    parts = [subject.joint] if subject.joint else [subject.topic, subject.frame]
    return " ".join(filter(None, parts)) or subject.robot or ""


def _write_page(report: Report, folder: Path, test: str, number: int) -> None:
    """Writes the HTML report, named after the test."""
    folder.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^\w.-]+", "-", test).strip("-")
    suffix = "" if number == 1 else f"-{number}"
    (folder / f"{name}{suffix}.html").write_text(report.html(), encoding="utf-8")
