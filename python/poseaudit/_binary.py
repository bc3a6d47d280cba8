"""The binary that does the work: where it is, and how it is run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path

from ._errors import ProgramError

#: Names another binary than the one in the wheel, for those who build it themselves.
OVERRIDE = "POSEAUDIT_BIN"


def find_binary() -> Path:
    """The binary: the one that `POSEAUDIT_BIN` names, else the one that the wheel installed.

    The path is not searched: another version there would answer in its place.
    """
    override = os.environ.get(OVERRIDE)
    if override:
        if not os.access(override, os.X_OK) or not Path(override).is_file():
            raise ProgramError(f"{OVERRIDE}={override}: no such program; name the binary, or unset it")
        return Path(override)
    name = "poseaudit" + (sysconfig.get_config_var("EXE") or "")
    folders = _script_folders()
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    looked = ", ".join(map(str, folders))
    raise ProgramError(f"{name}: not in {looked}; install the wheel again, or name it in {OVERRIDE}")


def _script_folders() -> list[Path]:
    """Where installers put a package's programs: of this environment, of the user, of `--target`."""
    schemes = [sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")]
    folders = [Path(sysconfig.get_path("scripts", scheme)) for scheme in schemes]
    folders.append(Path(__file__).parent.parent / "bin")
    return list(dict.fromkeys(folders))


def run(
    arguments: Sequence[str],
    *,
    stdin: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Runs the binary to its end and keeps what it says. A status is the caller's to judge; a death
    by a signal is a `ProgramError`."""
    binary = find_binary()
    try:
        done = subprocess.run(
            [str(binary), *arguments],
            input=stdin,
            stdin=subprocess.DEVNULL if stdin is None else None,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **(environment or {})},
        )
    except OSError as error:
        raise ProgramError(f"{binary}: it cannot be started: {error.strerror}; install it again") from error
    if done.returncode < 0:
        raise ProgramError(
            f"{binary}: it was ended by {_signal_name(-done.returncode)}; see the system's log"
        )
    return done


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def trouble_in(stderr: str) -> str:
    """The line that says what went wrong, of what the binary wrote to stderr."""
    lines = [line for line in stderr.splitlines() if line.startswith("error: ")]
    return lines[0].removeprefix("error: ") if lines else stderr.strip().partition("\n")[0]


def become(arguments: Sequence[str]) -> int:
    """Runs the binary in place of this process; where a system has no such thing, beside it."""
    binary = str(find_binary())
    if sys.platform == "win32":
        return subprocess.run([binary, *arguments], check=False).returncode
    os.execv(binary, [binary, *arguments])
