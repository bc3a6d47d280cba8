"""The section of a dataset card with the audit, in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ._errors import CallError

if TYPE_CHECKING:
    from ._dataset import Amount, Dataset, Episode

BEGIN = "<!-- poseaudit: begin (`poseaudit dataset` replaces this section) -->"
END = "<!-- poseaudit: end -->"

#: Rows of a table in the card; the rest is in the CSV file.
_MAX_ROWS = 50
#: Units for people: factor and name.
_SHOWN = {"m": (1e3, "mm"), "rad": (180 / math.pi, "°"), "s": (1e3, "ms"), "rad/s": (180 / math.pi, "°/s")}


def section(audit: Dataset) -> str:
    """The section, from its first to its last line."""
    arms = f" of {_text(', '.join(audit.robots))}" if audit.robots else ""
    counts = ", ".join(f"{audit.count(verdict)} {verdict}" for verdict in ("pass", "fail", "inconclusive"))
    parts = [
        BEGIN,
        f"## Pose audit: {audit.verdict.upper()}\n",
        f"{len(audit.episodes)} episodes{arms}: {counts}, "
        f"{len(audit.episodes) - audit.audited} not audited (poseaudit {audit.version}).",
        *_missing(audit),
        *_findings(audit),
        *_errors(audit),
        *_episodes(audit),
        END,
    ]
    return "\n".join(parts) + "\n"


def _missing(audit: Dataset) -> Iterable[str]:
    missing = (audit.expected or 0) - len(audit.episodes)
    if missing > 0:
        yield (
            f"\n**{missing} of the {audit.expected} episodes in `meta/info.json` have no data here** "
            "and were not audited."
        )


def _findings(audit: Dataset) -> Iterable[str]:
    if not audit.findings:
        return
    yield from _table(
        ("severity", "rule", "subject", "episodes", "found"),
        (
            (
                one["severity"],
                f"{one['code']}: {one['title']}",
                " ".join(filter(None, (one.get(key) for key in ("joint", "topic", "frame")))),
                str(one["logs"]),
                (one.get("worst") or one)["message"],
            )
            for one in audit.findings
        ),
        "all findings",
    )


def _errors(audit: Dataset) -> Iterable[str]:
    reasons = Counter((one["what"] or one["status"], one["do"] or "") for one in audit.errors)
    if reasons:
        rows = ((str(count), what, do) for (what, do), count in reasons.most_common())
        yield from _table(("episodes not audited", "reason", "what to do"), rows, "all reasons")


def _episodes(audit: Dataset) -> Iterable[str]:
    yield "\n<details><summary>Episodes</summary>"
    ordered = sorted(audit.episodes, key=lambda one: one.verdict == "pass")
    yield from _table(
        ("episode", "verdict", "findings", "amounts"),
        (
            (
                one.path if one.episode is None else str(one.episode),
                one.verdict or one.status.replace("_", " "),
                ", ".join(one.codes),
                ", ".join(_shown(amount) for amount in _largest(one)),
            )
            for one in ordered
        ),
        "all episodes",
    )
    yield "\n</details>\n"


def _largest(episode: Episode) -> list[Amount]:
    """The largest amount of each rule with a finding."""
    largest: dict[str, Amount] = {}
    for amount in episode.amounts:
        known = largest.get(amount.code)
        if amount.code in episode.codes and (known is None or abs(known.value) < abs(amount.value)):
            largest[amount.code] = amount
    return list(largest.values())


def _shown(amount: Amount) -> str:
    """The amount in units for people, to the first digit of its half-width."""
    factor, unit = _SHOWN.get(amount.unit, (1.0, amount.unit.removeprefix("1")))
    spread = (amount.ci95[1] - amount.ci95[0]) / 2 * factor if amount.ci95 else 0.0
    if spread <= 0.0:
        return f"{amount.code} {amount.value * factor:.3g} {unit}".rstrip()
    digits = max(0, -math.floor(math.log10(spread)))
    return f"{amount.code} {amount.value * factor:.{digits}f} ± {spread:.{digits}f} {unit}".rstrip()


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], rest: str) -> Iterable[str]:
    """A table; a line states how many rows were omitted."""
    listed = list(rows)
    yield "\n" + _row(header)
    yield "|" + "---|" * len(header)
    yield from (_row([_text(cell) for cell in row]) for row in listed[:_MAX_ROWS])
    if len(listed) > _MAX_ROWS:
        yield f"\n{len(listed) - _MAX_ROWS} more rows; `poseaudit/` contains {rest}."


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(text: str) -> str:
    """Escapes text for a cell of a table: it is one line, and shown literally."""
    for mark in "\\`*_[]<>|#":
        text = text.replace(mark, "\\" + mark)
    return " ".join(text.split())


def replace_section(card: str, new: str, path: Path) -> str:
    """Returns the card with the section replaced; it is appended to a card without one.

    Raises `CallError` if only one of the markers is there, or if there are several sections.
    """
    if card.count(BEGIN) != card.count(END) or card.count(BEGIN) > 1 or card.find(END) < card.find(BEGIN):
        raise CallError(
            f"{path}: its poseaudit markers are not one pair; remove the lines `{BEGIN}` and `{END}`"
        )
    if BEGIN not in card:
        return f"{card.rstrip()}\n\n{new}" if card.strip() else new
    before, _, rest = card.partition(BEGIN)
    return before + new.removesuffix("\n") + rest.partition(END)[2]
