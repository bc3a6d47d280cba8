#!/usr/bin/env python3
"""Verifies the recordings of the demo and of every fixture with `rerun rrd verify`.

    python3 tests/viewer/verify.py target/debug/poseaudit

Needs rerun-sdk of the crate's minor version (pip install rerun-sdk==0.36.*), but no display and no graphics driver.
Each log is recorded twice, and both recordings must have the same bytes.
"""

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FIXTURES = Path(__file__).parents[2] / "fixtures"
RERUN = Path(sys.executable).with_name("rerun")


def record(program: Path, log: Path, folder: Path) -> Path:
    """Records a log twice and returns one of the recordings."""
    recordings = [folder / f"{log.stem}.rrd", folder / f"{log.stem}.again.rrd"]
    for recording in recordings:
        command = [program, "audit", log, "--quiet", "--rrd", recording]
        run = subprocess.run(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        assert run.returncode in (0, 1), f"{log.name}: exit status {run.returncode}"
    first, second = (recording.read_bytes() for recording in recordings)
    assert first == second, f"{log.name}: two recordings of it differ"
    return recordings[0]


def main() -> None:
    program = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = subprocess.run([program, "demo", "demo"], cwd=folder, stdout=subprocess.DEVNULL)
        assert run.returncode == 0, f"demo: exit status {run.returncode}"
        logs = [folder / "demo/demo.mcap", *sorted(FIXTURES.glob("*.mcap"))]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            recordings = list(pool.map(lambda log: record(program, log, folder), logs))
        # Separate settings, to ignore the user's settings. No telemetry.
        homes = {key: name for key in ("XDG_RUNTIME_DIR", "XDG_CONFIG_HOME", "XDG_DATA_HOME")}
        environment = {**os.environ, **homes, "NO_COLOR": "1"}
        subprocess.run([RERUN, "analytics", "disable"], env=environment, capture_output=True, check=True)
        subprocess.run([RERUN, "rrd", "verify", *recordings], env=environment, check=True)
        print(f"recordings: {len(recordings)} verified, each the same twice")


main()
