"""The notebook of the docs runs completely, and shows its reports."""

import ast
import json
from pathlib import Path
from typing import Any

import pytest

import poseaudit

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebook.ipynb"


def value_of_cell(cell: str, names: dict[str, Any]) -> Any:
    """Runs a cell, and returns the value of its last line."""
    body = ast.parse(cell).body
    last = body[-1] if isinstance(body[-1], ast.Expr) else None
    body = body[:-1] if last else body
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return last and eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def test_every_cell_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("polars")
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    values = [value_of_cell("".join(cell["source"]), names) for cell in cells if cell["cell_type"] == "code"]
    report, printed = values[0], capsys.readouterr().out
    assert isinstance(report, poseaudit.Report) and report.verdict == "fail"
    assert "FAIL" in printed and "NO REGRESSION" in printed
    frame = names["samples"]
    assert frame.height > 1000 and (frame["after_m"].mean() or 1) < (frame["before_m"].mean() or 0)
    [*_, numbers, verdict, _] = values
    assert numbers and verdict in ("reconciled", "ambiguous", "open")
