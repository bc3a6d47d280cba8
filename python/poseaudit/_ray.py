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
IN_FLIGHT = 1000

#: Target duration of a task, unless the caller sets the number of logs. Starting a task costs some tens of
#: milliseconds, and the logs of a terminated worker are restarted.
TASK_S = 5.0

#: Minimum number of remaining tasks per core, which limits the size of a task.
TASKS_A_CORE = 4

#: Interval of progress messages.
SHOWN_EVERY_S = 10.0

#: A log is done when its row is in this table, which is therefore written last.
LAST = "runs"


@dataclass(frozen=True)
class Batch:
    """The logs of one task, and the number of its attempt."""

    logs: tuple[str, ...]
    attempt: int = 1


@dataclass(frozen=True)
class Answer:
    """The result of a task."""

    version: str
    files: tuple[tuple[str, bytes], ...]
    """Path below the fleet's folder, and content."""
    seconds: float = 0.0
    """Duration of the task."""


@dataclass
class Course:
    """Statistics of a run on the cluster."""

    total: int
    began: float = field(default_factory=time.monotonic)
    done: int = 0
    """Logs with returned rows."""
    spent_s: float = 0.0
    """Total duration of their tasks."""
    keys: set[str] = field(default_factory=set)
    """Keys of these rows; logs with the same content share a key."""
    retried: int = 0
    """Number of restarts of logs because their task was terminated."""
    given_up: int = 0
    """Logs whose task was terminated too often; the driver audits them."""

    def show(self) -> None:
        """Prints a progress line to stderr."""
        rate = self.done / max(time.monotonic() - self.began, 1e-9)
        left = f", {(self.total - self.done) / rate:.0f} s left" if rate else ""
        again = f", {self.retried} restarted" if self.retried else ""
        print(f"{self.done} of {self.total} logs, {rate:.2f}/s{left}{again}", file=sys.stderr)


def spread(
    logs: Sequence[str],
    out: Path,
    arguments: Sequence[str],
    *,
    retries: int,
    batch: int | None,
    address: str | None,
    progress: bool,
) -> Course:
    """Audits the logs on the cluster, and stores the results of the tasks in `out`."""
    course = Course(len(logs))
    if not logs:
        return course
    ray = _ray()
    if not ray.is_initialized():
        ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
    # The driver retries, not Ray, so that retries are counted and limited.
    task = ray.remote(num_cpus=1, max_retries=0)(_audited)
    left = deque(logs)
    again: deque[Batch] = deque()
    running: dict[Any, Batch] = {}
    shown = course.began
    while left or again or running:
        cores = max(1, int(ray.cluster_resources().get("CPU", 0)))
        # The duration of a log is unknown until one is done.
        most = IN_FLIGHT if batch or course.done else 2 * cores
        while (left or again) and len(running) < most:
            next_one = again.popleft() if again else _taken(left, batch or _size(course, len(left), cores))
            running[task.remote(next_one.logs, tuple(arguments))] = next_one
        ended, _ = ray.wait(list(running), num_returns=len(running), timeout=0.1)
        if not ended:
            ended, _ = ray.wait(list(running), num_returns=1)
        for reference in ended:
            done = running.pop(reference)
            try:
                answer = ray.get(reference)
            except ray.exceptions.RayError as error:
                again.extend(_again(done, retries, error, course))
                continue
            course.keys |= _keep(answer, out)
            course.done += len(done.logs)
            course.spent_s += answer.seconds
        if progress and time.monotonic() - shown > SHOWN_EVERY_S:
            shown = time.monotonic()
            course.show()
    return course


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ProgramError("engine='ray': Ray is not installed; pip install 'poseaudit[ray]'") from error
    return ray


def _taken(left: deque[str], size: int) -> Batch:
    return Batch(tuple(left.popleft() for _ in range(min(size, len(left)))))


def _size(course: Course, left: int, cores: int) -> int:
    """Number of logs of the next task."""
    if not course.done:
        return 1
    in_time = TASK_S * course.done / max(course.spent_s, 1e-9)
    return max(1, int(min(in_time, left / (TASKS_A_CORE * cores))))


def _again(batch: Batch, retries: int, error: Exception, course: Course) -> Iterator[Batch]:
    """Restarts the logs of a terminated task one by one, because one of them may be the cause."""
    first = str(error).strip().partition("\n")[0]
    if batch.attempt > retries:
        _log.warning("%s: given up after %d attempts: %s", batch.logs[0], batch.attempt, first)
        course.given_up += len(batch.logs)
        return
    _log.info("%s and %d more: restarted: %s", batch.logs[0], len(batch.logs) - 1, first)
    course.retried += len(batch.logs)
    for log in batch.logs:
        yield Batch((log,), batch.attempt + 1)


def _audited(logs: tuple[str, ...], arguments: tuple[str, ...]) -> Answer:
    """Runs on a worker: audits the logs into a temporary folder, one at a time."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
        named, listed = _binary.sources(logs)
        call = ["fleet", f"--out={folder}", "--jobs=1", *arguments, "--", *named]
        done = _binary.run(call, stdin=listed)
        if done.returncode not in (0, 1, 3):
            raise ProgramError(_binary.trouble_in(done.stderr))
        files = tuple(_files(Path(folder)))
        return Answer(version("poseaudit"), files, time.monotonic() - began)


def _files(folder: Path) -> Iterator[tuple[str, bytes]]:
    """The files written by the program, without locks and incomplete files."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in (".parquet", ".json") and not path.name.startswith("."):
            yield path.relative_to(folder).as_posix(), path.read_bytes()


def _keep(answer: Answer, out: Path) -> set[str]:
    """Stores the files of a task, and returns the keys of its logs. File names contain the key, so they
    replace files of an earlier attempt."""
    ours = version("poseaudit")
    if answer.version != ours:
        raise ProgramError(
            f"a worker has poseaudit {answer.version}, the driver {ours}: install the same on both"
        )
    for name, content in sorted(answer.files, key=lambda file: file[0].startswith(f"{LAST}/")):
        place = out / name
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=place.parent, prefix=".", delete=False) as staged:
            staged.write(content)
            staged.flush()
            os.fsync(staged.fileno())
        os.replace(staged.name, place)
    return {Path(name).stem for name, _ in answer.files if name.startswith(f"{LAST}/")}
