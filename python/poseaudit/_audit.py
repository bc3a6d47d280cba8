"""`audit`: one run, one report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import _binary
from ._errors import CallError, LogError, ProgramError
from ._options import Options, arguments
from ._report import Report

if TYPE_CHECKING:
    from typing_extensions import Unpack

_FINDINGS, _MISUSE, _UNUSABLE = 1, 2, 3


def audit(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    **options: Unpack[Options],
) -> Report:
    """Audits one recorded run; several files of one run are merged.

    The options are those of `poseaudit audit`, with `_` for `-`: `audit("run.mcap", robot="ur5e",
    select=["LAT", "ZER001"], declare={"/tcp": "rotvec"})`.

    Findings do not raise: they are in the report. Raises `TypeError` for an option that there is not,
    `CallError` where the call or the config is wrong, `LogError` where the log cannot be audited, and
    `ProgramError` where the binary is missing or died.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    if not paths:
        raise TypeError("audit(): no log: name one file, or the files of one run")
    call = [
        "audit",
        "--format=json",
        *arguments("audit", options, Options),
        "--",
        *(os.fspath(one) for one in paths),
    ]
    done = _binary.run(call)
    if done.returncode not in (0, _FINDINGS):
        error = {_MISUSE: CallError, _UNUSABLE: LogError}.get(done.returncode, ProgramError)
        raise error(_binary.trouble_in(done.stderr))
    report = Report.from_json(done.stdout)
    if done.returncode == _FINDINGS and report.ok:
        return report.left_open(_binary.trouble_in(done.stderr))
    return report
