"""Overhead of Ray relative to the local engine: both audit the same logs alternately, on one machine.

    python python/benches/engines.py LOGS [ROUNDS]

`LOGS` is a folder of logs (`POSEAUDIT_FLEET_KEEP=LOGS cargo bench --bench fleet` writes some). The cluster
is a head without cores and a worker for each core, all on loopback. Ray's own processes therefore share the
cores with the audits; on separate machines they cost less.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import poseaudit
from cluster import Cluster


def main(folder: Path, rounds: int) -> None:
    logs = sorted(folder.glob("*.mcap"))
    cores = len(os.sched_getaffinity(0))
    cluster = Cluster(workers=cores)
    engines: dict[str, dict[str, object]] = {"local": {"engine": "local", "jobs": cores}}
    engines["ray"] = {"engine": "ray", "address": cluster.address}
    try:
        walls: dict[str, list[float]] = {name: [] for name in engines}
        # Warm up: Ray starts its processes with the first tasks.
        fleet_time_s(logs[:20], engines["ray"])
        for _ in range(rounds):
            for name, options in engines.items():
                walls[name].append(fleet_time_s(logs, options))
    finally:
        cluster.close()
    print(f"{len(logs)} logs on {cores} cores, medians of {rounds} alternating rounds")
    for name, seconds in walls.items():
        wall = statistics.median(seconds)
        overhead = statistics.median(
            one / other - 1 for one, other in zip(seconds, walls["local"], strict=True)
        )
        print(f"{name:24} {wall:7.2f} s {len(logs) / wall:6.1f} logs/s {100 * overhead:+6.1f} %")
    print(f"local: {min(walls['local']):.2f} to {max(walls['local']):.2f} s")


def fleet_time_s(logs: list[Path], options: dict[str, object]) -> float:
    """Wall time of a fleet into a new folder, s."""
    with tempfile.TemporaryDirectory() as out:
        started = time.monotonic()
        done = poseaudit.fleet(logs, Path(out) / "out", **options)  # type: ignore[arg-type]
        assert done.done_now == len(logs), done
        return time.monotonic() - started


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 3)
