"""The JSON report (`poseaudit.report/1`) as dataclasses.

SI units: m, rad, s; stamps in integer nanoseconds; None if unknown. Keys added by later versions
are in `Report.json`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, overload

from ._decode import decode
from ._errors import ReportError
from ._frame import Rows

if TYPE_CHECKING:
    import pandas
    import polars

SCHEMA = "poseaudit.report/1"


@dataclass(frozen=True, kw_only=True)
class Tool:
    """The program that wrote the report."""

    name: str
    version: str


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """Why the audit could not be done."""

    what: str
    where: str
    do: str


@dataclass(frozen=True, kw_only=True)
class File:
    """One file of the log."""

    path: str
    container: str
    bytes: int
    crc: str
    """How much of it is covered by checksums: `all`, `partial` or `none`."""


@dataclass(frozen=True, kw_only=True)
class Note:
    """A remark about a file, other than damage."""

    path: str
    note: str


@dataclass(frozen=True, kw_only=True)
class Log:
    """The log that was read."""

    files: tuple[File, ...]
    messages: int
    start_ns: int | None
    end_ns: int | None
    duration_s: float | None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Robot:
    """One arm."""

    name: str
    source: str
    base: str
    tip: str
    joints: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Stream:
    """One topic, or one pair of frames on a topic."""

    topic: str
    type: str
    role: str
    reason: str
    robot: str | None
    frame_id: str | None
    child_frame_id: str | None
    reference: str | None
    """Reference link of its poses."""
    link: str | None
    """Link whose poses they are."""
    witness: str | None = None
    """Source of its poses: `controller`, `external` or `unknown`."""
    count: int
    dropped: int
    rate_hz: float | None
    start_ns: int | None
    end_ns: int | None


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Subject of a rule; None for parts that do not apply."""

    robot: str | None = None
    topic: str | None = None
    joint: str | None = None
    frame: str | None = None
    reference: str | None = None


@dataclass(frozen=True, kw_only=True)
class Rotation:
    """The angle of a frame's error, rad."""

    value: float
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Magnitude of a finding: `value` with its unit and 95 % interval; or the actual encoding (`is_`) and its
    misinterpretation (`read_as`). If it changes within the run, `value` is the size of the change, from
    `from_` to `to` at `change_ns`. A coupled joint moves by `factor` per unit of the joint `with_`; a joint
    that is off by whole turns has `turns`."""

    name: str
    value: float | None = None
    unit: str | None = None
    ci95: tuple[float, float] | None = None
    from_: float | None = None
    to: float | None = None
    change_ns: int | None = None
    change_ci95_ns: tuple[int, int] | None = None
    rotation: Rotation | None = None
    with_: str | None = None
    factor: float | None = None
    turns: float | None = None
    is_: Any = None
    read_as: Any = None
    equivalent: tuple[Mapping[str, Any], ...] = ()
    runner_up: Mapping[str, Any] | None = None
    permutation: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Check:
    """Result of a rule for a subject: `pass`, `fail`, `inconclusive` or `skipped`."""

    code: str
    name: str
    subject: Subject
    status: str
    reason: str | None
    estimate: Estimate | None
    evidence: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fault of a subject, its magnitude, and its remedy."""

    code: str
    severity: str
    title: str
    message: str
    subject: Subject
    estimate: Estimate | None
    evidence: Mapping[str, Any]
    fix: str
    start_ns: int | None
    end_ns: int | None


@dataclass(frozen=True, kw_only=True)
class Ignored(Finding):
    """A finding that the config ignores, with the reason and its place in the config."""

    reason: str
    place: str


@dataclass(frozen=True, kw_only=True)
class JointCoverage:
    """The part of its range over which a joint moved."""

    joint: str
    unit: str
    lowest: float
    highest: float
    lower: float | None
    upper: float | None
    visited: float | None


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """The part of its workspace in which an arm moved."""

    robot: str
    joints: tuple[JointCoverage, ...]
    reach_m: tuple[float, float]
    max_reach_m: float
    hides: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TrajectoryError:
    """Root mean squares of the distance and the angle."""

    translation_m: float
    rotation_rad: float


@dataclass(frozen=True, kw_only=True)
class StreamComparison:
    """A pose stream compared with another, with ATE and RPE as computed by evo."""

    topic: str
    reference: str
    reason: str
    pairs: int
    ate: TrajectoryError | None = None
    ate_aligned: TrajectoryError | None = None
    rpe: TrajectoryError | None = None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A motion that would resolve undetermined checks, and the command that writes it."""

    robot: str
    purpose: str
    codes: tuple[str, ...]
    command: str


@dataclass(frozen=True, kw_only=True, repr=False)
class Report:
    """The report on one run."""

    schema: str
    tool: Tool
    verdict: str
    """`pass`, `fail` or `inconclusive`."""
    error: Trouble | None
    log: Log
    robots: tuple[Robot, ...]
    streams: Rows[Stream]
    checks: Rows[Check]
    findings: Rows[Finding]
    """Most severe first; `findings.to_polars()` and `findings.to_pandas()` return data frames."""
    ignored: Rows[Ignored] = field(default_factory=lambda: Rows(Ignored, (), ()))
    observability: tuple[Mapping[str, Any], ...] = ()
    comparisons: tuple[StreamComparison, ...] = ()
    workspace: tuple[Workspace, ...] = ()
    plans: tuple[Plan, ...] = ()
    open: str | None = None
    """The program's message about rules of `require` that are inconclusive; not in the JSON."""
    json: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """The complete JSON report."""
    text: str = field(default="", repr=False, compare=False)
    """The report for a terminal, as returned by `str()`; empty if it was read from JSON."""
    run: Any = field(default=None, repr=False, compare=False)
    """The audited run, which `html()` and `samples()` read again."""

    def __repr__(self) -> str:
        codes = ", ".join(dict.fromkeys(finding.code for finding in self.findings))
        found = f"{len(self.findings)} findings ({codes})" if codes else "no findings"
        logs = ", ".join(file.path for file in self.log.files)
        return f"<poseaudit.Report {self.verdict}: {found}, {logs}>"

    def __str__(self) -> str:
        return self.text or "\n".join(
            [self.verdict, *(f"{one.severity} {one.code} {one.message}" for one in self.findings)]
        )

    def html(self) -> str:
        """The report as one HTML page with its plots.

        Reads the log again. Raises `ReportError` if the report was read from JSON.
        """
        return str(self._require_run("html").html())

    def _repr_html_(self) -> str | None:
        """The page, in a notebook; None if the report was read from JSON."""
        from ._audit import embed_page

        return None if self.run is None else embed_page(self.html())

    @overload
    def samples(self, library: Literal["polars"] = "polars") -> polars.DataFrame: ...
    @overload
    def samples(self, library: Literal["pandas"]) -> pandas.DataFrame: ...
    def samples(self, library: Literal["polars", "pandas"] = "polars") -> Any:
        """The samples of the pose streams as logged, by forward kinematics and corrected, one row each, with
        the columns of `aligned.parquet` (docs/tables.md). Reads the log again.

        Raises `ReportError` if the report was read from JSON.
        """
        return self._require_run("samples").samples(library)

    def _require_run(self, what: str) -> Any:
        if self.run is None:
            raise ReportError(f"{what}: the report was read from JSON; audit the log for it")
        return self.run

    def of_run(self, *, text: str, run: object) -> Report:
        """This report with its text and its run."""
        return replace(self, text=text, run=run)

    @property
    def ok(self) -> bool:
        """Whether the binary would exit with status 0: no finding at or above `fail_on`, and no inconclusive
        rule of `require`."""
        return self.error is None and self.verdict != "fail" and self.open is None

    def left_open(self, message: str) -> Report:
        """This report, with rules of `require` that are inconclusive."""
        return replace(self, open=message)

    @classmethod
    def from_json(cls, text: str | bytes) -> Report:
        """Parses a report written by `poseaudit audit --format json`.

        Raises `ReportError` if it is not a report, or its schema is not `poseaudit.report/1`.
        """
        try:
            value = json.loads(text)
        except ValueError as error:
            raise ReportError(f"the report: invalid JSON: {error}; write it with --format json") from error
        schema = value.get("schema") if isinstance(value, dict) else None
        if schema != SCHEMA:
            raise ReportError(
                f"the report: schema {schema!r}, not {SCHEMA!r}; install the version that wrote it"
            )
        # These fields are not keys of the report.
        return decode(cls, {**value, "open": None, "json": value, "text": "", "run": None}, "the report")
