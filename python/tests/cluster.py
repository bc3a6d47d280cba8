"""A Ray cluster on loopback. Its nodes can be killed like failing machines, with all their processes."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sysconfig
import tempfile
import time
from pathlib import Path

STARTS_WITHIN_S = 120
#: Ray only stores a few rows of a table at a time.
STORE_BYTES = 80_000_000


class Cluster:
    """A head that runs no tasks, and workers with one core each."""

    def __init__(self, workers: int) -> None:
        # The path is part of socket names, which must be short.
        self.folder = Path(tempfile.mkdtemp(prefix="pa-", dir="/tmp"))
        self.address = f"127.0.0.1:{free_port()}"
        port = self.address.rpartition(":")[2]
        self.head = self._node(
            "head", "--head", f"--port={port}", "--num-cpus=0", "--include-dashboard=false",
            f"--temp-dir={self.folder}",
        )  # fmt: skip
        self.workers = [
            self._node(f"worker {number}", f"--address={self.address}", "--num-cpus=1")
            for number in range(workers)
        ]

    def _node(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        ray = Path(sysconfig.get_path("scripts")) / "ray"
        log = self.folder / f"{name.replace(' ', '-')}.log"
        call = [
            str(ray), "start", "--block", "--node-ip-address=127.0.0.1", "--disable-usage-stats",
            f"--object-store-memory={STORE_BYTES}", *options,
        ]  # fmt: skip
        with log.open("wb") as out:
            node = subprocess.Popen(call, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        by = time.monotonic() + STARTS_WITHIN_S
        while b"Ray runtime started" not in log.read_bytes():
            if node.poll() is not None or time.monotonic() > by:
                kill_tree(node.pid)
                raise RuntimeError(f"ray {name} did not start:\n{log.read_text()[-2000:]}")
            time.sleep(0.1)
        return node

    def kill_busy_worker(self) -> int:
        """Kills a node that is auditing a log, with its processes. Returns their number."""
        while True:
            for node in self.workers:
                found = descendants(node.pid)
                # Stop it first, so that it cannot exit before it is killed.
                send(signal.SIGSTOP, found)
                if any(is_fleet(pid) for pid in found):
                    send(signal.SIGKILL, found)
                    node.wait()
                    return len(found)
                send(signal.SIGCONT, found)
            time.sleep(0.05)

    def close(self) -> None:
        for node in [*self.workers, self.head]:
            if node.poll() is None:
                kill_tree(node.pid)
                node.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def descendants(pid: int) -> list[int]:
    """The process and its descendants, from /proc."""
    parents: dict[int, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def is_fleet(pid: int) -> bool:
    """Whether the process is a running audit."""
    with contextlib.suppress(OSError):
        return b"\0fleet\0" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def send(what: signal.Signals, pids: list[int]) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, what)


def kill_tree(pid: int) -> None:
    """Stops and then kills the process and its descendants, so that none can clean up."""
    found = descendants(pid)
    send(signal.SIGSTOP, found)
    send(signal.SIGKILL, found)
