"""Ray as the engine of a fleet: tasks audit logs, and the driver stores the results.

A task audits its logs into a temporary folder and returns the files written there: a few Parquet files
of some kilobytes. Only the driver writes to the fleet's folder, with the program's file names. So workers
need not share that folder, partial results of a terminated worker are never visible, and a log audited
by two workers is still one row, because its file names contain its key.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from . import _binary
from ._errors import ProgramError

_log = logging.getLogger("poseaudit")

#: Maximum number of tasks submitted to Ray at a time: enough for its autoscaler, and few enough for the
#: driver's memory with any number of logs.
MAX_TASKS_IN_FLIGHT = 1000

#: Target duration of a task, unless the caller sets the number of logs. Starting a task costs some tens of
#: milliseconds, and the logs of a terminated worker are restarted.
TASK_S = 5.0

#: Minimum number of remaining tasks per core, which limits the size of a task.
TASKS_PER_CORE = 4

#: Interval of progress messages.
PROGRESS_INTERVAL_S = 10.0

#: A log is done when its row is in this table, which is therefore written last.
LAST_TABLE = "runs"


@dataclass(frozen=True)
class Batch:
    """The logs of one task, and the number of its attempt."""

    logs: tuple[str, ...]
    attempt: int = 1


@dataclass(frozen=True)
class TaskResult:
    """The result of a task."""

    version: str
    files: tuple[tuple[str, bytes], ...]
    """Path below the fleet's folder, and content."""
    seconds: float = 0.0
    """Duration of the task."""


@dataclass
class Progress:
    """Statistics of a run on the cluster."""

    total: int
    started: float = field(default_factory=time.monotonic)
    done: int = 0
    """Logs with returned rows."""
    task_time_s: float = 0.0
    """Total duration of their tasks."""
    keys: set[str] = field(default_factory=set)
    """Keys of these rows; logs with the same content share a key."""
    retried: int = 0
    """Number of restarts of logs because their task was terminated."""
    given_up: int = 0
    """Logs whose task was terminated too often; the driver audits them."""

    def show(self) -> None:
        """Prints a progress line to stderr."""
        rate = self.done / max(time.monotonic() - self.started, 1e-9)
        remaining = f", {(self.total - self.done) / rate:.0f} s left" if rate else ""
        restarts = f", {self.retried} restarted" if self.retried else ""
        print(f"{self.done} of {self.total} logs, {rate:.2f}/s{remaining}{restarts}", file=sys.stderr)


def run_tasks(
    logs: Sequence[str],
    out: Path,
    arguments: Sequence[str],
    *,
    retries: int,
    batch: int | None,
    address: str | None,
    progress: bool,
) -> Progress:
    """Audits the logs on the cluster, and stores the results of the tasks in `out`."""
    state = Progress(len(logs))
    if not logs:
        return state
    ray = _ray()
    if not ray.is_initialized():
        ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
    # The driver retries, not Ray, so that retries are counted and limited.
    task = ray.remote(num_cpus=1, max_retries=0)(_audit_on_worker)
    remaining = deque(logs)
    restarts: deque[Batch] = deque()
    running: dict[Any, Batch] = {}
    last_shown = state.started
    while remaining or restarts or running:
        cores = max(1, int(ray.cluster_resources().get("CPU", 0)))
        # The duration of a log is unknown until one is done.
        max_tasks = MAX_TASKS_IN_FLIGHT if batch or state.done else 2 * cores
        while (remaining or restarts) and len(running) < max_tasks:
            next_batch = (
                restarts.popleft()
                if restarts
                else _next_batch(remaining, batch or _next_task_size(state, len(remaining), cores))
            )
            running[task.remote(next_batch.logs, tuple(arguments))] = next_batch
        finished, _ = ray.wait(list(running), num_returns=len(running), timeout=0.1)
        if not finished:
            finished, _ = ray.wait(list(running), num_returns=1)
        for reference in finished:
            done = running.pop(reference)
            try:
                result = ray.get(reference)
            except ray.exceptions.RayError as error:
                restarts.extend(_restart(done, retries, error, state))
                continue
            state.keys |= _store_files(result, out)
            state.done += len(done.logs)
            state.task_time_s += result.seconds
        if progress and time.monotonic() - last_shown > PROGRESS_INTERVAL_S:
            last_shown = time.monotonic()
            state.show()
    return state


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ProgramError("engine='ray': Ray is not installed; pip install 'poseaudit[ray]'") from error
    return ray


def _next_batch(remaining: deque[str], size: int) -> Batch:
    return Batch(tuple(remaining.popleft() for _ in range(min(size, len(remaining)))))


def _next_task_size(state: Progress, remaining: int, cores: int) -> int:
    """Number of logs of the next task."""
    if not state.done:
        return 1
    in_time = TASK_S * state.done / max(state.task_time_s, 1e-9)
    return max(1, int(min(in_time, remaining / (TASKS_PER_CORE * cores))))


def _restart(batch: Batch, retries: int, error: Exception, state: Progress) -> Iterator[Batch]:
    """Restarts the logs of a terminated task one by one, because one of them may be the cause."""
    first = str(error).strip().partition("\n")[0]
    if batch.attempt > retries:
        _log.warning("%s: given up after %d attempts: %s", batch.logs[0], batch.attempt, first)
        state.given_up += len(batch.logs)
        return
    _log.info("%s and %d more: restarted: %s", batch.logs[0], len(batch.logs) - 1, first)
    state.retried += len(batch.logs)
    for log in batch.logs:
        yield Batch((log,), batch.attempt + 1)


def _audit_on_worker(logs: tuple[str, ...], arguments: tuple[str, ...]) -> TaskResult:
    """Runs on a worker: audits the logs into a temporary folder, one at a time."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
        named, listed = _binary.split_sources(logs)
        call = ["fleet", f"--out={folder}", "--jobs=1", *arguments, "--", *named]
        done = _binary.run(call, stdin=listed)
        if done.returncode not in (0, 1, 3):
            raise ProgramError(_binary.error_line(done.stderr))
        files = tuple(_files(Path(folder)))
        return TaskResult(version("poseaudit"), files, time.monotonic() - started)


def _files(folder: Path) -> Iterator[tuple[str, bytes]]:
    """The files written by the program, without locks and incomplete files."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in (".parquet", ".json") and not path.name.startswith("."):
            yield path.relative_to(folder).as_posix(), path.read_bytes()


def _store_files(result: TaskResult, out: Path) -> set[str]:
    """Stores the files of a task, and returns the keys of its logs. File names contain the key, so they
    replace files of an earlier attempt."""
    own_version = version("poseaudit")
    if result.version != own_version:
        raise ProgramError(
            f"a worker has poseaudit {result.version}, the driver {own_version}: install the same on both"
        )
    for name, content in sorted(result.files, key=lambda file: file[0].startswith(f"{LAST_TABLE}/")):
        place = out / name
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=place.parent, prefix=".", delete=False) as staged:
            staged.write(content)
            staged.flush()
            os.fsync(staged.fileno())
        os.replace(staged.name, place)
    return {Path(name).stem for name, _ in result.files if name.startswith(f"{LAST_TABLE}/")}
