"""Rows of a report as a data frame, with the columns of `--parquet` (docs/tables.md)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

if TYPE_CHECKING:
    import pandas
    import polars

Row = TypeVar("Row", covariant=True)

_TEXT, _NUMBER, _STAMP = "text", "number", "stamp"
_SUBJECT = dict.fromkeys(("robot", "topic", "joint", "frame"), _TEXT)
_ESTIMATE = {
    "value": _NUMBER,
    "unit": _TEXT,
    "ci95_low": _NUMBER,
    "ci95_high": _NUMBER,
    "estimate_json": _TEXT,
}
_FINDING = {
    **dict.fromkeys(("code", "severity", "title", "message"), _TEXT),
    **_SUBJECT,
    **_ESTIMATE,
    **dict.fromkeys(("fix", "evidence_json"), _TEXT),
    **dict.fromkeys(("start_ns", "end_ns"), _STAMP),
}
#: Columns of the rows with a subject and an estimate, by class name. All other columns are the keys of the
#: JSON report.
_COLUMNS = {
    "Finding": _FINDING,
    "Ignored": {**_FINDING, **dict.fromkeys(("reason", "place"), _TEXT)},
    "Check": {
        **dict.fromkeys(("code", "name", "status", "reason"), _TEXT),
        **_SUBJECT,
        **_ESTIMATE,
        "evidence_json": _TEXT,
    },
    "Stream": {
        **dict.fromkeys(("topic", "type", "role", "reason", "robot", "frame_id", "child_frame_id"), _TEXT),
        **dict.fromkeys(("reference", "link", "witness"), _TEXT),
        **dict.fromkeys(("count", "dropped"), _STAMP),
        "rate_hz": _NUMBER,
        **dict.fromkeys(("start_ns", "end_ns"), _STAMP),
    },
}


class Rows(tuple[Row, ...]):
    """A tuple of rows of one kind, convertible to a data frame: `to_polars()`, `to_pandas()`."""

    _columns: dict[str, str]
    _cells: list[dict[str, object]]

    def __new__(cls, kind: type, rows: Iterable[Row], json_rows: Sequence[Mapping[str, Any]]) -> Rows[Row]:
        self = super().__new__(cls, rows)
        self._columns = _COLUMNS[kind.__name__]
        self._cells = [_flat(row) for row in json_rows]
        return self

    @overload
    def frame(self, library: Literal["polars"]) -> polars.DataFrame: ...
    @overload
    def frame(self, library: Literal["pandas"]) -> pandas.DataFrame: ...
    def frame(self, library: Literal["polars", "pandas"]) -> polars.DataFrame | pandas.DataFrame:
        """The rows as a data frame of the library, which must be installed."""
        if library == "polars":
            return self.to_polars()
        if library == "pandas":
            return self.to_pandas()
        raise ValueError(f"frame({library!r}): expected 'polars' or 'pandas'")

    def to_polars(self) -> polars.DataFrame:
        """The rows as a Polars data frame, with the columns of docs/tables.md."""
        import polars

        types = {_TEXT: polars.String, _NUMBER: polars.Float64, _STAMP: polars.Int64}
        schema = {name: types[kind] for name, kind in self._columns.items()}
        return polars.DataFrame(self._by_column(), schema=schema)

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a pandas data frame, with the columns of docs/tables.md."""
        import pandas

        types = {_TEXT: "string", _NUMBER: "float64", _STAMP: "Int64"}
        columns = self._by_column()
        return pandas.DataFrame(
            {name: pandas.Series(columns[name], dtype=types[kind]) for name, kind in self._columns.items()}
        )

    def _by_column(self) -> dict[str, list[Any]]:
        return {name: [row.get(name) for row in self._cells] for name in self._columns}


def read_parquet(path: Path, library: Literal["polars", "pandas"]) -> Any:
    """A table written by the program, as a data frame of the library, which must be installed."""
    if library == "polars":
        import polars

        # Not mapped, because the file may be deleted.
        return polars.read_parquet(path, memory_map=False)
    if library == "pandas":
        import pandas

        return pandas.read_parquet(path)
    raise ValueError(f"{library!r}: expected 'polars' or 'pandas'")


def _flat(row: Mapping[str, Any]) -> dict[str, object]:
    """Flattens a row of the JSON report."""
    estimate = row.get("estimate") or {}
    low, high = estimate.get("ci95") or (None, None)
    flat = {
        **row,
        **(row.get("subject") or {}),
        "value": estimate.get("value"),
        "unit": estimate.get("unit"),
        "ci95_low": low,
        "ci95_high": high,
        "estimate_json": _compact(row.get("estimate")),
        "evidence_json": _compact(row.get("evidence") or {}),
    }
    for stamp in ("start_ns", "end_ns"):
        flat[stamp] = None if row.get(stamp) is None else int(row[stamp])
    return flat


def _compact(value: object) -> str | None:
    return None if value is None else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
