"""`audit`: audits one run; its report can also return an HTML page and samples."""

from __future__ import annotations

import html
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from . import _binary
from ._errors import CallError, LogError, ProgramError
from ._frame import read_parquet
from ._options import Options, arguments
from ._report import Report

if TYPE_CHECKING:
    from typing_extensions import Unpack

_FINDINGS, _MISUSE, _UNUSABLE = 1, 2, 3
#: Options that write files or determine the exit status; omitted when a run is read again.
_OPTIONS_WITH_SIDE_EFFECTS = (
    *("fix", "mcap", "mesh_root", "parquet", "plotjuggler", "rrd", "rrd_layer", "tum", "write_baseline"),
    "require",
)


def audit(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    **options: Unpack[Options],
) -> Report:
    """Audits one recorded run; several files of one run are merged.

    The options equal the command's, `poseaudit audit`, with `_` for `-`: `audit("run.mcap", robot="ur5e",
    select=["LAT", "ZER001"], declare={"/tcp": "rotvec"})`.

    Findings do not raise: they are in the report. Raises `TypeError` for an unknown option, `CallError`
    if the call or the config is invalid, `LogError` if the log cannot be audited, and `ProgramError` if
    the binary is missing or was terminated.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    if not paths:
        raise TypeError("audit(): no log: name one file, or the files of one run")
    logs = tuple(os.path.abspath(one) if os.path.lexists(one) else os.fspath(one) for one in paths)
    call_options = arguments("audit", options, Options)
    repeat_options = arguments(
        "audit",
        {name: one for name, one in options.items() if name not in _OPTIONS_WITH_SIDE_EFFECTS},
        Options,
    )
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
        status, stderr = _run_audit(
            [*call_options, "--format=json", "--format=text", f"--output={folder}"], paths
        )
        text = Path(folder, "report.txt").read_text(encoding="utf-8")
        report = Report.from_json(Path(folder, "report.json").read_bytes())
    report = report.of_run(text=text, run=_Run(tuple(repeat_options), logs))
    if status == _FINDINGS and report.ok:
        return report.left_open(_binary.error_line(stderr))
    return report


def _run_audit(options: Sequence[str], paths: Sequence[str | os.PathLike[str]]) -> tuple[int, str]:
    """Runs an audit and returns exit status and stderr. Raises if there is no report."""
    done = _binary.run(["audit", "--quiet", *options, "--", *(os.fspath(one) for one in paths)])
    if done.returncode not in (0, _FINDINGS):
        error = {_MISUSE: CallError, _UNUSABLE: LogError}.get(done.returncode, ProgramError)
        raise error(_binary.error_line(done.stderr))
    return done.returncode, done.stderr


@dataclass(frozen=True)
class _Run:
    """An audited run: its options and its logs."""

    options: tuple[str, ...]
    logs: tuple[str, ...]

    def html(self) -> str:
        """The report as one HTML page with its plots."""
        with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
            page = Path(folder, "report.html")
            _run_audit([*self.options, "--format=html", f"--output={page}"], self.logs)
            return page.read_text(encoding="utf-8")

    def samples(self, library: Literal["polars", "pandas"]) -> Any:
        """The samples of the pose streams with forward kinematics, as a data frame."""
        with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
            _run_audit([*self.options, f"--parquet={folder}"], self.logs)
            return read_parquet(Path(folder, "aligned.parquet"), library)


def embed_page(page: str, height_px: int = 720) -> str:
    """Embeds an HTML page in another."""
    return (
        f'<iframe srcdoc="{html.escape(page)}" style="width:100%;height:{height_px}px;border:0"'
        ' title="poseaudit report"></iframe>'
    )
