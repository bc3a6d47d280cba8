"""`fleet`: many logs, into one folder of Parquet files (docs/fleet.md)."""

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
    """Why; the table `errors` knows more."""


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """How a call went, and the tables that it and earlier ones filled."""

    out: Path
    logs: int
    """Logs that were named."""
    duplicates: int
    """Those that have the content of another of them, whose row is theirs."""
    done_before: int
    """Those that an earlier call had done."""
    done_now: int
    """Those that this call did."""
    retried: int = 0
    """How often a log was begun again because the worker that had it died."""
    failing: int
    """Those with a finding at or above `fail_on`."""
    statuses: Mapping[str, int]
    """How the audits ended, each content once."""
    verdicts: Mapping[str, int]
    errors: tuple[Failure, ...] = ()
    """Those that could not be audited."""

    def to_polars(self, table: Table = "findings") -> polars.DataFrame:
        """A table of the folder, with the rows of all calls."""
        import polars

        if not self._parts(table):
            return polars.DataFrame()
        rows = polars.read_parquet(self._parts(table)).unique(subset=_key(table), maintain_order=True)
        if table == "runs":
            return rows
        # Rows of a log that is not done are those of a process that died.
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
    """What names a row: after a crash it may stand in two parts."""
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
    """Audits many logs, each in a process of its own, and keeps a row for each in `out`.

    `sources` are logs, folders of logs, and patterns. What `out` has already is not done again. The
    options are those of `poseaudit fleet`, with `_` for `-`.

    `engine="local"` takes `jobs` logs at a time, by default one for each core. `engine="ray"` makes a
    task of every `batch` logs (by default of as many as take some seconds), on the cluster at `address`
    (else the one that Ray finds), and begins those again whose worker died, up to `retries` times; what
    then is left this process does itself.
    `progress` shows on stderr how far it is.

    What is wrong with a log is its row, and does not raise. Raises `TypeError` for an option that there
    is not, `CallError` where the call is wrong, `ProgramError` where the binary or Ray is missing.
    """
    named = [sources] if isinstance(sources, (str, os.PathLike)) else list(sources)
    if not named:
        raise TypeError("fleet(): no source: name logs, folders of logs, or patterns")
    if engine not in ("local", "ray"):
        raise ValueError(f"fleet(): engine={engine!r}: there are 'local' and 'ray'")
    if (batch is not None and batch < 1) or retries < 0:
        raise ValueError(f"fleet(): batch={batch}, retries={retries}: expected 1 or more, and 0 or more")
    said = arguments("fleet", options, FleetOptions)
    call = _Call(Path(out), said, [os.fspath(source) for source in named], jobs, progress)
    if engine == "local":
        return call.audit()
    from . import _ray

    done = _ray.spread(
        call.pending(),
        call.out,
        said,
        retries=retries,
        batch=batch,
        address=address,
        progress=progress,
    )
    # Whatever became of the tasks: what has no row gets one here, and parts are merged. What was tried
    # again there is not tried once more.
    once = [option for option in said if option != "--retry"]
    whole = replace(call, options=once).audit()
    return replace(
        whole,
        done_before=whole.done_before - len(done.keys),
        done_now=whole.done_now + len(done.keys),
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
        """The logs that have no row yet, as far as that is known without reading them."""
        return self._run("--pending").splitlines()

    def audit(self) -> Fleet:
        """Audits here what has no row yet."""
        jobs = [] if self.jobs is None else [f"--jobs={self.jobs}"]
        try:
            summary = json.loads(self._run("--format=json", *jobs))
        except ValueError as error:
            raise ReportError(f"the summary: no JSON: {error}; install the package again") from error
        if summary.get("schema") != SCHEMA:
            raise ReportError(f"the summary: schema {summary.get('schema')!r}, not {SCHEMA!r}")
        return decode(Fleet, _summary(summary, self.out), "the summary")

    def _run(self, *how: str) -> str:
        named, listed = _binary.sources(self.sources)
        call = ["fleet", f"--out={self.out}", *how, *self.options, "--", *named]
        done = _binary.run(call, stdin=listed, shows_progress=self.progress)
        if done.returncode == _MISUSE:
            raise CallError(_binary.trouble_in(done.stderr))
        if done.returncode not in (0, 1, _NONE_AUDITED):
            raise ProgramError(_binary.trouble_in(done.stderr))
        return done.stdout


def _summary(summary: Mapping[str, Any], out: Path) -> Mapping[str, Any]:
    return {**summary, "out": out, "retried": 0}
