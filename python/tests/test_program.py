"""Every way to start the wheel's binary."""

import subprocess
import sys
import sysconfig
from importlib.metadata import version
from pathlib import Path

import pytest

import poseaudit
from poseaudit._binary import OVERRIDE


def run(*call: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in call], capture_output=True, text=True)


def test_the_module_is_the_binary(faulty: Path) -> None:
    version_call = run(sys.executable, "-m", "poseaudit", "--version")
    assert (version_call.returncode, version_call.stdout.split()) == (0, ["poseaudit", version("poseaudit")])
    audited = run(sys.executable, "-m", "poseaudit", "audit", faulty)
    assert audited.returncode == 1 and "LAT001" in audited.stdout
    assert run(sys.executable, "-m", "poseaudit", "audit", faulty, "--robt").returncode == 2


def test_the_demo_finds_its_planted_faults(tmp_path: Path) -> None:
    shown = run(sys.executable, "-m", "poseaudit", "demo", tmp_path)
    assert shown.returncode == 0, shown.stderr
    codes = {finding.code for finding in poseaudit.audit(tmp_path / "demo.mcap").findings}
    assert {"LAT001", "ZER001"} <= codes


@pytest.mark.skipif("not __import__('poseaudit').__file__.startswith(__import__('sys').prefix)")
def test_the_wheel_contains_both_programs(faulty: Path) -> None:
    scripts = Path(sysconfig.get_path("scripts"))
    assert run(scripts / "poseaudit", "--version").returncode == 0
    assert run(scripts / "rerun-importer-poseaudit", Path(__file__)).returncode == 66


def test_a_missing_or_killed_binary_raises(
    faulty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(OVERRIDE, str(tmp_path / "nothing"))
    with pytest.raises(poseaudit.ProgramError, match="no such program"):
        poseaudit.audit(faulty)
    assert "no such program" in run(sys.executable, "-m", "poseaudit").stderr
    dies = tmp_path / "dies"
    dies.write_text("#!/bin/sh\nkill -KILL $$\n")
    dies.chmod(0o755)
    monkeypatch.setenv(OVERRIDE, str(dies))
    with pytest.raises(poseaudit.ProgramError, match="ended by SIGKILL"):
        poseaudit.audit(faulty)
