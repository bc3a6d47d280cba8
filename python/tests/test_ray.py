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
from logs import copy_with_other_bytes
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
    logs = [copy_with_other_bytes(faulty, number, folder / f"{number:03}.mcap") for number in range(LOGS)]
    none = folder / "none.mcap"
    none.write_text("not a log\n")
    copy = folder / "copy.mcap"
    copy.write_bytes(logs[0].read_bytes())
    return [*logs, none, copy]


def rows(out: Path, table: str) -> Any:
    """All rows of a table in its files, including duplicates."""
    return polars.concat(polars.read_parquet(part) for part in sorted((out / table).glob("*.parquet")))


def test_a_killed_worker_causes_no_lost_and_no_repeated_row(
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

    repeated = poseaudit.fleet(logs, out, engine="ray", address="127.0.0.1:1", select=["LAT", "ING"])
    assert (repeated.done_before, repeated.done_now, repeated.retried) == (LOGS + 1, 0, 0)


def test_the_engines_write_the_same_rows(cluster: Cluster, logs: list[Path], tmp_path: Path) -> None:
    some_logs = [*logs[:3], logs[-2]]
    local_fleet = poseaudit.fleet(some_logs, tmp_path / "local", jobs=2, label={"site": "here"})
    ray_fleet = poseaudit.fleet(
        some_logs, tmp_path / "ray", engine="ray", address=cluster.address, batch=3, label={"site": "here"}
    )
    assert (ray_fleet.statuses, ray_fleet.verdicts, ray_fleet.failing) == (
        local_fleet.statuses,
        local_fleet.verdicts,
        local_fleet.failing,
    )
    for table in ("runs", "streams", "checks", "findings", "errors"):
        names = ["key", "row"] if table != "runs" else ["key"]
        ours, theirs = (rows(fleet.out, table).sort(names) for fleet in (ray_fleet, local_fleet))
        assert ours.equals(theirs), table
    assert [path.name for path in sorted((ray_fleet.out / "settings").iterdir())] == [
        path.name for path in sorted((local_fleet.out / "settings").iterdir())
    ]


def test_the_size_of_a_task_follows_the_duration_of_logs() -> None:
    progress = _ray.Progress(total=1000)
    assert _ray._next_task_size(progress, 1000, 2) == 1, "nothing is known yet"
    progress.done, progress.task_time_s = 10, 2.0
    assert _ray._next_task_size(progress, 1000, 2) == _ray.TASK_S / 0.2
    # At the end, all cores are busy.
    assert _ray._next_task_size(progress, 40, 2) == 5 and _ray._next_task_size(progress, 1, 2) == 1
    progress.task_time_s = 600.0
    assert _ray._next_task_size(progress, 1000, 2) == 1


def test_the_driver_audits_logs_that_kill_workers(
    cluster: Cluster, logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die_at_once(*_: object) -> None:
        os.abort()

    monkeypatch.setattr(_ray, "_audit_on_worker", die_at_once)
    done = poseaudit.fleet(logs[:2], tmp_path / "out", engine="ray", address=cluster.address, retries=1)
    assert (done.done_now, done.retried) == (2, 2)
    assert rows(tmp_path / "out", "runs").height == 2
