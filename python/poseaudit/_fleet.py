"""`fleet`: audits many logs into one folder of Parquet files (docs/fleet.md)."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from . import _binary
from ._decode import decode
from ._errors import CallError, ProgramError, ReportError
from ._options import FleetOptions, arguments

if TYPE_CHECKING:
    import pandas
    import polars
    from typing_extensions import Unpack

SCHEMA = "poseaudit.fleet-run/1"

Table = Literal["runs", "streams", "checks", "findings", "errors"]

_MISUSE, _NONE_AUDITED = 2, 3


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A log that could not be audited."""

    path: str
    status: str
    what: str | None = None
    """The reason."""
    do: str | None = None
    """What to do about it."""


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """Summary of a call, and the tables of this and earlier calls."""

    out: Path
    logs: int
    """Number of given logs."""
    duplicates: int
    """Logs with the same content as another one, whose row they share."""
    done_before: int
    """Logs audited by earlier calls."""
    done_now: int
    """Logs audited by this call."""
    retried: int = 0
    """Number of restarts of logs because their worker was terminated."""
    failing: int
    """Logs with a finding at or above `fail_on`."""
    statuses: Mapping[str, int]
    """Number of audits by status; duplicates count once."""
    verdicts: Mapping[str, int]
    errors: tuple[Failure, ...] = ()
    """Logs that could not be audited."""

    def to_polars(self, table: Table = "findings") -> polars.DataFrame:
        """A table of the folder, with the rows of all calls."""
        import polars

        if not self._parts(table):
            return polars.DataFrame()
        rows = polars.read_parquet(self._parts(table)).unique(subset=_key(table), maintain_order=True)
        if table == "runs":
            return rows
        # Rows of an unfinished log come from a terminated process.
        return rows.join(self.to_polars("runs").select("key"), on="key", how="semi")

    def to_pandas(self, table: Table = "findings") -> pandas.DataFrame:
        """A table of the folder, with the rows of all calls. Needs pyarrow."""
        import pandas

        parts = [pandas.read_parquet(path) for path in self._parts(table)]
        if not parts:
            return pandas.DataFrame()
        rows = pandas.concat(parts, ignore_index=True).drop_duplicates(subset=_key(table))
        return rows if table == "runs" else rows[rows["key"].isin(self.to_pandas("runs")["key"])]

    def _parts(self, table: Table) -> list[Path]:
        return sorted(path for path in (self.out / table).glob("*.parquet") if path.name[0] != ".")


def _key(table: Table) -> list[str]:
    """Columns that identify a row, which may occur in two parts after a crash."""
    return ["key"] if table == "runs" else ["key", "row"]


def fleet(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    engine: Literal["local", "ray"] = "local",
    jobs: int | None = None,
    progress: bool = False,
    address: str | None = None,
    retries: int = 3,
    batch: int | None = None,
    **options: Unpack[FleetOptions],
) -> Fleet:
    """Audits many logs, each in a separate process, and stores one row for each in `out`.

    `sources` are logs, folders of logs, and patterns. Logs with results in `out` are skipped. The options
    are those of `poseaudit fleet`, with `_` for `-`.

    `engine="local"` audits `jobs` logs at a time, by default one for each core. `engine="ray"` runs tasks
    of `batch` logs (by default as many as take some seconds) on the cluster at `address` (default: the one
    that Ray finds). Logs whose worker was terminated are restarted up to `retries` times; this process then
    audits the remaining ones. `progress` prints progress to stderr.

    Faults of a log are in its row, and do not raise. Raises `TypeError` for an unknown option, `CallError` if
    the call is invalid, `ProgramError` if the binary or Ray is missing.
    """
    named = [sources] if isinstance(sources, (str, os.PathLike)) else list(sources)
    if not named:
        raise TypeError("fleet(): no source: name logs, folders of logs, or patterns")
    if engine not in ("local", "ray"):
        raise ValueError(f"fleet(): engine={engine!r}: there are 'local' and 'ray'")
    if (batch is not None and batch < 1) or retries < 0:
        raise ValueError(f"fleet(): batch={batch}, retries={retries}: expected 1 or more, and 0 or more")
    flags = arguments("fleet", options, FleetOptions)
    call = _Call(Path(out), flags, [os.fspath(source) for source in named], jobs, progress)
    if engine == "local":
        return call.audit()
    from . import _ray

    done = _ray.run_tasks(
        call.pending(),
        call.out,
        flags,
        retries=retries,
        batch=batch,
        address=address,
        progress=progress,
    )
    # Audits logs that still have no row, and merges the parts. The tasks have already retried failed logs.
    flags_without_retry = [option for option in flags if option != "--retry"]
    final = replace(call, options=flags_without_retry).audit()
    return replace(
        final,
        done_before=final.done_before - len(done.keys),
        done_now=final.done_now + len(done.keys),
        retried=done.retried,
    )


@dataclass(frozen=True)
class _Call:
    """A call of `poseaudit fleet`."""

    out: Path
    options: list[str]
    sources: list[str]
    jobs: int | None
    progress: bool

    def pending(self) -> list[str]:
        """Logs without a row, as far as known without reading them."""
        return self._run("--pending").splitlines()

    def audit(self) -> Fleet:
        """Audits logs without a row in this process."""
        jobs = [] if self.jobs is None else [f"--jobs={self.jobs}"]
        try:
            summary = json.loads(self._run("--format=json", *jobs))
        except ValueError as error:
            raise ReportError(f"the summary: invalid JSON: {error}; install the package again") from error
        if summary.get("schema") != SCHEMA:
            raise ReportError(f"the summary: schema {summary.get('schema')!r}, not {SCHEMA!r}")
        return decode(Fleet, _summary(summary, self.out), "the summary")

    def _run(self, *extra_flags: str) -> str:
        named, listed = _binary.split_sources(self.sources)
        call = ["fleet", f"--out={self.out}", *extra_flags, *self.options, "--", *named]
        done = _binary.run(call, stdin=listed, shows_progress=self.progress)
        if done.returncode == _MISUSE:
            raise CallError(_binary.error_line(done.stderr))
        if done.returncode not in (0, 1, _NONE_AUDITED):
            raise ProgramError(_binary.error_line(done.stderr))
        return done.stdout


def _summary(summary: Mapping[str, Any], out: Path) -> Mapping[str, Any]:
    return {**summary, "out": out, "retried": 0}
