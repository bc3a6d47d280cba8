"""Ray as the engine, on loopback: a head and two workers, one of which is killed during the run."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import poseaudit
from cluster import Cluster
from logs import distinct
from poseaudit import _ray

ray = pytest.importorskip("ray")
polars = pytest.importorskip("polars")

LOGS = 24


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    cluster = Cluster(workers=2)
    try:
        yield cluster
    finally:
        ray.shutdown()
        cluster.close()


@pytest.fixture
def logs(faulty: Path, tmp_path: Path) -> list[Path]:
    """Logs with equal content but different bytes, an invalid one, and a copy of the first."""
    folder = tmp_path / "logs"
    folder.mkdir()
    logs = [distinct(faulty, number, folder / f"{number:03}.mcap") for number in range(LOGS)]
    none = folder / "none.mcap"
    none.write_text("not a log\n")
    copy = folder / "copy.mcap"
    copy.write_bytes(logs[0].read_bytes())
    return [*logs, none, copy]


def rows(out: Path, table: str) -> Any:
    """All rows of a table in its files, including duplicates."""
    return polars.concat(polars.read_parquet(part) for part in sorted((out / table).glob("*.parquet")))


def test_a_worker_that_is_killed_costs_no_row_and_doubles_none(
    cluster: Cluster, logs: list[Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out"
    killed: list[int] = []

    def kill_in_the_middle() -> None:
        while len(list((out / "runs").glob("[0-9a-f]*.parquet"))) < LOGS // 4:
            time.sleep(0.02)
        killed.append(cluster.kill_busy_worker())

    caplog.set_level(logging.INFO, logger="poseaudit")
    killer = threading.Thread(target=kill_in_the_middle, daemon=True)
    killer.start()
    done = poseaudit.fleet(logs, out, engine="ray", address=cluster.address, select=["LAT", "ING"])
    killer.join(timeout=10)
    runs = rows(out, "runs")
    print(
        f"logs in {len(logs)}, rows out {runs.height}, distinct {runs['key'].n_unique()}, "
        f"retried {done.retried}, processes killed {killed}"
    )
    assert killed and killed[0] > 1, "no worker was killed while there was work"
    assert done.retried >= 1, caplog.text
    assert (done.logs, done.duplicates, done.done_before, done.done_now) == (LOGS + 2, 1, 0, LOGS + 1)
    assert runs.height == runs["key"].n_unique() == LOGS + 1
    assert set(runs["path"]) | {str(logs[0]), str(logs[-1])} == {str(log) for log in logs}
    assert dict(runs.group_by("status").len().iter_rows()) == {"audited": LOGS, "not_audited": 1}
    findings = rows(out, "findings")
    assert findings.height == findings.unique(["key", "row"]).height == LOGS
    assert done.to_polars("findings").height == done.to_pandas("findings").shape[0] == LOGS

    again = poseaudit.fleet(logs, out, engine="ray", address="127.0.0.1:1", select=["LAT", "ING"])
    assert (again.done_before, again.done_now, again.retried) == (LOGS + 1, 0, 0)


def test_the_engines_write_the_same_rows(cluster: Cluster, logs: list[Path], tmp_path: Path) -> None:
    few = [*logs[:3], logs[-2]]
    local = poseaudit.fleet(few, tmp_path / "local", jobs=2, label={"site": "here"})
    spread = poseaudit.fleet(
        few, tmp_path / "ray", engine="ray", address=cluster.address, batch=3, label={"site": "here"}
    )
    assert (spread.statuses, spread.verdicts, spread.failing) == (
        local.statuses,
        local.verdicts,
        local.failing,
    )
    for table in ("runs", "streams", "checks", "findings", "errors"):
        names = ["key", "row"] if table != "runs" else ["key"]
        ours, theirs = (rows(fleet.out, table).sort(names) for fleet in (spread, local))
        assert ours.equals(theirs), table
    assert [path.name for path in sorted((spread.out / "settings").iterdir())] == [
        path.name for path in sorted((local.out / "settings").iterdir())
    ]


def test_a_task_has_as_many_logs_as_take_some_seconds() -> None:
    course = _ray.Course(total=1000)
    assert _ray._size(course, 1000, 2) == 1, "nothing is known yet"
    course.done, course.spent_s = 10, 2.0
    assert _ray._size(course, 1000, 2) == _ray.TASK_S / 0.2
    # At the end, all cores are busy.
    assert _ray._size(course, 40, 2) == 5 and _ray._size(course, 1, 2) == 1
    course.spent_s = 600.0
    assert _ray._size(course, 1000, 2) == 1


def test_what_no_worker_can_do_the_driver_does(
    cluster: Cluster, logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dies(*_: object) -> None:
        os.abort()

    monkeypatch.setattr(_ray, "_audited", dies)
    done = poseaudit.fleet(logs[:2], tmp_path / "out", engine="ray", address=cluster.address, retries=1)
    assert (done.done_now, done.retried) == (2, 2)
    assert rows(tmp_path / "out", "runs").height == 2
