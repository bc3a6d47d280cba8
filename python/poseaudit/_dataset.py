"""`dataset`: audits each episode of a LeRobot dataset, and writes the result into its card.

The documentation is docs/lerobot.md.
"""

from __future__ import annotations

import csv
import json
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _binary
from ._card import replace_section, section
from ._errors import CallError, ProgramError
from ._fleet import fleet

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ._options import FleetOptions

SCHEMA = "poseaudit.dataset/1"
#: Folder of the results, next to `meta/`.
FOLDER = "poseaudit"

_HUB = "hf://"
_REPOSITORY = re.compile(r"(?:datasets/)?(?P<name>[\w.-]+/[\w.-]+)(?:@(?P<revision>.+))?")
_EPISODE = re.compile(r"(?:#|/episode_)(\d+)(?:\.parquet)?$")
#: Files that an audit reads; videos stay on the hub.
_NEEDED_FILES = ["README.md", "meta/**", "data/**"]


@dataclass(frozen=True, kw_only=True)
class Amount:
    """An estimate of an episode, in SI units."""

    code: str
    subject: str
    name: str
    unit: str
    value: float
    ci95: tuple[float, float] | None = None

    @property
    def column(self) -> str:
        """Name of its column in the table of episodes."""
        return " ".join(filter(None, (self.code, self.subject, f"({self.unit})")))


@dataclass(frozen=True, kw_only=True)
class Episode:
    """Result of one episode."""

    episode: int | None
    """Its index in the dataset; None if its path does not contain it."""
    path: str
    """Relative to the dataset."""
    status: str
    """`audited`, or why it was not, as in the table `runs` (docs/fleet.md)."""
    verdict: str | None
    codes: tuple[str, ...]
    """Rules with findings."""
    amounts: tuple[Amount, ...]
    """Estimates with an interval; the largest one for each rule and subject."""


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """Audit of a dataset."""

    name: str
    revision: str | None
    """Commit of a dataset from the hub."""
    verdict: str
    """`pass`, `fail` or `inconclusive`."""
    failing: bool
    """Whether there is a finding at or above `fail_on`, or a trend."""
    expected: int | None
    """Number of episodes according to `meta/info.json`."""
    episodes: tuple[Episode, ...]
    findings: tuple[Mapping[str, Any], ...]
    """Findings by rule and subject, as in the report on a fleet (docs/fleet.md)."""
    errors: tuple[Mapping[str, Any], ...]
    """Episodes that could not be audited."""
    robots: tuple[str, ...]
    version: str
    card: Path
    json: Path
    table: Path

    @property
    def audited(self) -> int:
        """Number of audited episodes."""
        return sum(one.status == "audited" for one in self.episodes)

    def count(self, verdict: str) -> int:
        """Number of episodes with this verdict."""
        return sum(one.verdict == verdict for one in self.episodes)


def dataset(
    source: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    results: str | os.PathLike[str] | None = None,
    revision: str | None = None,
    jobs: int | None = None,
    progress: bool = False,
    **options: Unpack[FleetOptions],
) -> Dataset:
    """Audits each episode of a LeRobot dataset, and writes the result into its card.

    `source` is a folder, `OWNER/NAME` or `hf://datasets/OWNER/NAME`; the last two need `huggingface_hub`.
    Writes `README.md`, `poseaudit/audit.json` and `poseaudit/episodes.csv` into `out`: by default the
    dataset's folder, or a folder named `NAME` for a dataset of the hub. In `README.md` only the section of an
    earlier call is replaced. `results` keeps the results of `poseaudit fleet`, so that a later call audits
    only new episodes. The other options are those of `fleet`.

    Raises `CallError` if the source is not a LeRobot dataset or the call is invalid, and `ProgramError` if
    `huggingface_hub` or the binary is missing.
    """
    found = _find(os.fspath(source), revision)
    place = Path(out) if out is not None else found.default_out
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as scratch:
        folder = Path(results) if results is not None else Path(scratch, "results")
        fleet(found.folder, folder, jobs=jobs, progress=progress, **options)
        report = _report(folder, options.get("fail_on"))
    audit = _summary(report, found, place)
    _write(audit, found.folder / "README.md")
    return audit


@dataclass(frozen=True)
class _Source:
    """A dataset on this machine."""

    name: str
    folder: Path
    revision: str | None
    default_out: Path
    info: Mapping[str, Any]


def _find(source: str, revision: str | None) -> _Source:
    """Finds the folder of a dataset; downloads it if it is one of the hub."""
    if not source.startswith(_HUB) and os.path.lexists(source):
        if revision is not None:
            raise CallError(f"revision {revision}: {source} is a folder; revisions exist only on the hub")
        folder = Path(source).resolve()
        return _Source(folder.name, folder, None, folder, _info(folder, source))
    named = _REPOSITORY.fullmatch(source.removeprefix(_HUB))
    if named is None:
        raise CallError(f"{source}: no such folder; name the folder of a LeRobot dataset, or OWNER/NAME")
    name = named["name"]
    folder = _download(name, revision or named["revision"]).resolve()
    # The folder of a snapshot is named after its commit.
    return _Source(name, folder, folder.name, Path(name.partition("/")[2]), _info(folder, source))


def _download(name: str, revision: str | None) -> Path:
    try:
        from huggingface_hub import snapshot_download
    except ImportError:
        raise ProgramError(
            f"{name}: no such folder, and a dataset of the hub needs huggingface_hub; "
            "pip install 'poseaudit[hub]'"
        ) from None
    try:
        return Path(
            snapshot_download(name, repo_type="dataset", revision=revision, allow_patterns=_NEEDED_FILES)
        )
    except Exception as error:  # those of the network library are not part of its interface
        raise CallError(
            f"{name}: not downloaded: {_first_line(error)}; check the name and the token"
        ) from error


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0].rstrip(".") or type(error).__name__


def _info(folder: Path, source: str) -> Mapping[str, Any]:
    try:
        info = json.loads((folder / "meta" / "info.json").read_bytes())
    except OSError:
        raise CallError(
            f"{source}: no meta/info.json: not a LeRobot dataset; audit other logs with poseaudit fleet"
        ) from None
    except ValueError as error:
        raise CallError(f"{source}: meta/info.json: invalid JSON: {error}; download it again") from None
    return info if isinstance(info, dict) else {}


def _report(results: Path, fail_on: str | None) -> Mapping[str, Any]:
    """The report on the fleet."""
    severity = [] if fail_on is None else [f"--fail-on={fail_on}"]
    text = _binary.output_of(["fleet", "report", str(results), "--format=json", *severity], may_find=True)
    report: Mapping[str, Any] = json.loads(text)
    return report


def _summary(report: Mapping[str, Any], source: _Source, out: Path) -> Dataset:
    amounts = _amounts(report["trends"])
    episodes = sorted(
        (
            Episode(
                episode=_index(run["path"]),
                path=_relative(run["path"], source.folder),
                status=run["status"],
                verdict=run["verdict"],
                codes=tuple(run["codes"]),
                amounts=tuple(amounts.get(run["path"], {}).values()),
            )
            for run in report["runs"]
        ),
        key=lambda one: (one.episode is None, one.episode, one.path),
    )
    expected = source.info.get("total_episodes")
    failing = bool(report["failing"])
    complete = all(one.verdict == "pass" for one in episodes) and len(episodes) >= (expected or 1)
    return Dataset(
        name=source.name,
        revision=source.revision,
        verdict="fail" if failing else "pass" if complete else "inconclusive",
        failing=failing,
        expected=expected if isinstance(expected, int) else None,
        episodes=tuple(episodes),
        findings=tuple(_without_prefix(one, source.folder) for one in report["findings"]),
        errors=tuple(_without_prefix(one, source.folder) for one in report["errors"]),
        robots=tuple(dict.fromkeys(one["robot"] for one in report["arms"] if one["robot"])),
        version=report["tool"]["version"],
        card=out / "README.md",
        json=out / FOLDER / "audit.json",
        table=out / FOLDER / "episodes.csv",
    )


def _amounts(trends: Sequence[Mapping[str, Any]]) -> dict[str, dict[tuple[str, str], Amount]]:
    """Estimates by path, then by rule and subject; of several the largest."""
    found: dict[str, dict[tuple[str, str], Amount]] = {}
    for trend in trends:
        subject = " ".join(filter(None, (trend.get(key) for key in ("joint", "topic", "frame"))))
        for point in trend["points"]:
            amount = Amount(
                code=trend["code"],
                subject=subject,
                name=trend["name"],
                unit=trend["unit"],
                value=point["value"],
                ci95=tuple(point["ci95"]) if point["ci95"] else None,
            )
            of_path = found.setdefault(point["path"], {})
            known = of_path.get((amount.code, subject))
            if known is None or abs(known.value) < abs(amount.value):
                of_path[amount.code, subject] = amount
    return found


def _index(path: str) -> int | None:
    index = _EPISODE.search(path)
    return int(index[1]) if index else None


def _relative(path: str, folder: Path) -> str:
    return path.removeprefix(f"{folder}{os.sep}")


def _without_prefix(value: Any, folder: Path) -> Any:
    """A value of the report, with paths relative to the dataset."""
    if isinstance(value, Mapping):
        return {key: _without_prefix(one, folder) for key, one in value.items()}
    return _relative(value, folder) if isinstance(value, str) else value


def _write(audit: Dataset, published_card: Path) -> None:
    """Writes the card, the JSON and the table of episodes."""
    try:
        audit.json.parent.mkdir(parents=True, exist_ok=True)
        card = audit.card if audit.card.exists() else published_card
        old = card.read_text(encoding="utf-8") if card.exists() else ""
        audit.json.write_text(json.dumps(_json(audit), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        _write_table(audit)
        audit.card.write_text(replace_section(old, section(audit), audit.card), encoding="utf-8")
    except OSError as error:
        raise CallError(
            f"{error.filename}: not written: {error.strerror}; name another folder by --out"
        ) from error


def _json(audit: Dataset) -> Mapping[str, Any]:
    return {
        "schema": SCHEMA,
        "tool": {"name": "poseaudit", "version": audit.version},
        "dataset": audit.name,
        "revision": audit.revision,
        "verdict": audit.verdict,
        "failing": audit.failing,
        "robots": audit.robots,
        "episodes_expected": audit.expected,
        "episodes": [
            {**vars(one), "amounts": [vars(amount) for amount in one.amounts]} for one in audit.episodes
        ],
        "findings": audit.findings,
        "errors": audit.errors,
    }


def _write_table(audit: Dataset) -> None:
    """Writes a row for each episode, with its estimates as columns."""
    names = sorted({amount.column for one in audit.episodes for amount in one.amounts})
    with audit.table.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["episode", "path", "status", "verdict", "codes", *names])
        for one in audit.episodes:
            values = {amount.column: f"{amount.value:.6g}" for amount in one.amounts}
            rows.writerow(
                [
                    "" if one.episode is None else one.episode,
                    *(one.path, one.status, one.verdict or "", " ".join(one.codes)),
                    *(values.get(name, "") for name in names),
                ]
            )
