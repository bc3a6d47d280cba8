#!/usr/bin/env python3
"""Reads the tables of `--parquet` with independent implementations.

    python3 tests/parquet/read.py target/debug/poseaudit

Needs duckdb and pyarrow (which pandas uses for Parquet). The tables must match the JSON report, every column must be in
docs/tables.md, and the errors in the aligned samples must match their poses.
"""

import json
import math
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import duckdb
import pyarrow.parquet

ROOT = Path(__file__).parents[2]
LOG = ROOT / "fixtures" / "faulty.mcap"
TABLES = {"aligned", "reach_map", "reached_poses", "joints", "findings", "checks"}


def audit_log(program: str, folder: str) -> dict:
    command = [program, "audit", str(LOG), "--format", "json", "--parquet", folder]
    run = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    assert run.returncode == 1, f"exit status {run.returncode}"
    return json.loads(run.stdout)


def check_schema(folder: Path) -> None:
    """Both readers must see the same columns, and docs/tables.md must describe them."""
    page = re.sub(r"```.*?```", "", (ROOT / "docs" / "tables.md").read_text(), flags=re.DOTALL)
    documented = set(re.findall(r"`([^`]+)`", page))
    prefixed = [name[:-1] for name in documented if name.endswith("_*")]
    joints = re.compile(r".+_(rad|m)")
    for file in sorted(folder.iterdir()):
        own = pyarrow.parquet.read_schema(file).names
        other = [row[0] for row in duckdb.sql(f"describe select * from '{file}'").fetchall()]
        assert own == other, f"{file.name}: {own} is not {other}"
        for name in own:
            is_known = (
                name in documented
                or name in ("qy", "qz")
                or any(name.startswith(prefix) for prefix in prefixed)
                or file.stem == "reached_poses" and joints.fullmatch(name)
            )
            assert is_known, f"{file.name}: docs/tables.md does not describe `{name}`"


def check_rows(folder: Path, report: dict) -> None:
    """Findings and checks must match the report, in its order."""
    def rows(table: str, columns: str) -> list[tuple]:
        return duckdb.sql(f"select {columns} from '{folder / table}.parquet'").fetchall()

    findings = [
        (found["code"], found["severity"], found["estimate"]["value"], *found["estimate"]["ci95"],
         int(found["start_ns"]))
        for found in report["findings"]
    ]
    assert findings, "the log has findings"
    assert rows("findings", "code, severity, value, ci95_low, ci95_high, start_ns") == findings
    checks = [(row["code"], row["status"], row["subject"].get("joint")) for row in report["checks"]]
    assert rows("checks", "code, status, joint") == checks
    for estimate, evidence in rows("findings", "estimate_json, evidence_json"):
        assert json.loads(estimate)["unit"] and json.loads(evidence)


def check_aligned(folder: Path) -> None:
    """The distance column must match the poses, and the explanation must reduce it."""
    distance = "sqrt(pow(logged_x_m - fk_x_m, 2) + pow(logged_y_m - fk_y_m, 2) + pow(logged_z_m - fk_z_m, 2))"
    count, off, norm, before, after = duckdb.sql(
        f"""select count(*), max(abs({distance} - before_m)),
                   max(abs(fk_qx * fk_qx + fk_qy * fk_qy + fk_qz * fk_qz + fk_qw * fk_qw - 1)),
                   max(before_m), max(after_m)
            from '{folder / "aligned.parquet"}'"""
    ).fetchall()[0]
    assert count > 500 and off < 1e-9 and norm < 1e-9, (count, off, norm)
    assert math.isfinite(after) and after < 0.1 * before, (before, after)


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        report = audit_log(sys.argv[1], scratch)
        folder = Path(scratch)
        assert {file.stem for file in folder.iterdir()} == TABLES
        check_schema(folder)
        check_rows(folder, report)
        check_aligned(folder)
    print(f"tables: read by DuckDB {duckdb.__version__} and Arrow {pyarrow.__version__}")


if __name__ == "__main__":
    main()
