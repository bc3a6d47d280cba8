"""`poseaudit watch` on logs that another process writes with the MCAP library."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from poseaudit._binary import find_binary

RECORDER = Path(__file__).parent / "recorder.py"


def record(log: Path, out: Path, stop: str = "inf") -> int:
    return subprocess.run([sys.executable, str(RECORDER), str(log), str(out), "3", stop]).returncode


def test_a_recorder_that_is_killed_and_restarted(tmp_path: Path, clean: Path, faulty: Path) -> None:
    out = tmp_path / "run.mcap"
    out.touch()
    call = [str(find_binary()), "watch", str(out), "--every", "0.2", "--idle", "20", "--format", "json"]
    watching = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
    assert record(clean, out, stop="6") == 9
    assert record(faulty, out) == 0
    output, _ = watching.communicate(timeout=60)
    lines: list[dict[str, Any]] = [json.loads(line) for line in output.splitlines()]
    events = [line["event"] for line in lines]
    again = events.index("begun-again")
    assert all(line["verdict"] != "fail" for line in lines[:again])
    found = {new["finding"].split()[0] for line in lines[again:] for new in line.get("new", [])}
    assert {"LAT001", "ZER001"} <= found
    assert lines[-1]["event"] == "ended" and lines[-1]["verdict"] == "fail"
    # It was reported before the recording ended, and each byte was read once until then.
    assert any(line.get("verdict") == "fail" for line in lines[again:-1])
    assert lines[-1]["read_bytes"] <= out.stat().st_size == lines[-1]["read_again_bytes"]
    assert watching.returncode == 1
