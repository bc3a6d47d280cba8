"""`compare`: compares two runs or two reports."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _binary
from ._options import CommonOptions, arguments
from ._report import Report

if TYPE_CHECKING:
    from typing_extensions import Unpack


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Comparison of two reports."""

    regression: bool
    """Whether the new report is worse."""
    verdicts: tuple[str, str]
    """Old and new."""
    causes: tuple[Mapping[str, Any], ...]
    """Every cause: its `course` (`appeared`, `grew`, `changed`, `same`, `shrank`, `untold`, `gone`),
    `code`, `subject`, and the findings `old` and `new`; regressions first."""
    lost: tuple[Mapping[str, Any], ...]
    """Checks that passed before and are inconclusive now."""
    text: str = field(repr=False)
    """Text for a terminal, as returned by `str()`."""

    def __str__(self) -> str:
        return self.text


def compare(
    old: Report | str | os.PathLike[str],
    new: Report | str | os.PathLike[str],
    **options: Unpack[CommonOptions],
) -> Comparison:
    """Compares two runs: reports, kept reports (JSON) or logs, which are audited with the options of `audit`.

    Raises `CallError` if the call is invalid, `ProgramError` if the binary is missing or was terminated.
    A new log that cannot be audited is a regression.
    """
    flags = arguments("compare", options, CommonOptions)
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
        paths = [_path_of(side, Path(folder, name)) for side, name in ((old, "old.json"), (new, "new.json"))]
        text, value = (
            _binary.output_of(["compare", "--quiet", f"--format={form}", *flags, "--", *paths], may_find=True)
            for form in ("text", "json")
        )
    found = json.loads(value)
    return Comparison(
        regression=found["regression"],
        verdicts=(found["verdicts"][0], found["verdicts"][1]),
        causes=tuple(found["causes"]),
        lost=tuple(found["lost"]),
        text=text,
    )


def _path_of(side: Report | str | os.PathLike[str], place: Path) -> str:
    """Path of a log or report. A report in memory is written to `place`."""
    if not isinstance(side, Report):
        return os.fspath(side)
    place.write_text(json.dumps(side.json), encoding="utf-8")
    return str(place)
