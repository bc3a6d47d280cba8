"""Finds and runs the binary."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from ._errors import CallError, ProgramError

#: Path of a binary to use instead of the wheel's, for own builds.
OVERRIDE = "POSEAUDIT_BIN"


def find_binary() -> Path:
    """Returns the binary named by `POSEAUDIT_BIN`, else the one installed by the wheel.

    The PATH is not searched, because it may contain another version.
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
    searched = ", ".join(map(str, folders))
    raise ProgramError(f"{name}: not in {searched}; install the wheel again, or name it in {OVERRIDE}")


def _script_folders() -> list[Path]:
    """Folders in which installers place programs: of this environment, of the user, of `--target`."""
    schemes = [sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")]
    folders = [Path(sysconfig.get_path("scripts", scheme)) for scheme in schemes]
    folders.append(Path(__file__).parent.parent / "bin")
    return list(dict.fromkeys(folders))


def run(
    arguments: Sequence[str],
    *,
    stdin: str | None = None,
    shows_progress: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Runs the binary and captures its output; with progress, stderr is shown instead.

    Callers check the status. Termination by a signal is a `ProgramError`.
    """
    binary = find_binary()
    try:
        done = subprocess.run(
            [str(binary), *arguments],
            input=stdin,
            stdin=subprocess.DEVNULL if stdin is None else None,
            stdout=subprocess.PIPE,
            stderr=None if shows_progress else subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="surrogateescape",
        )
    except OSError as error:
        raise ProgramError(f"{binary}: it cannot be started: {error.strerror}; install it again") from error
    if done.returncode < 0:
        raise ProgramError(
            f"{binary}: it was ended by {_signal_name(-done.returncode)}; see the system's log"
        )
    return done


def output_of(arguments: Sequence[str], *, may_find: bool = False) -> str:
    """Returns the output of the binary. Status 1 is accepted if it `may_find` something; others raise."""
    done = run(arguments)
    if done.returncode == 0 or (may_find and done.returncode == 1):
        return done.stdout
    error = CallError if done.returncode == 2 else ProgramError
    raise error(error_line(done.stderr))


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def split_sources(named: Sequence[str]) -> tuple[list[str], str | None]:
    """Splits the sources of a fleet into arguments and a list for stdin.

    Paths are listed, because they may exceed the length of a command line; patterns and URLs are arguments.
    """
    listed = [source for source in named if os.path.lexists(source)]
    others = [source for source in named if not os.path.lexists(source)]
    return (["-", *others], "\0".join([*listed, ""])) if listed else (others, None)


def error_line(stderr: str | None) -> str:
    """Extracts the error line from the stderr of the binary."""
    if stderr is None:
        return "poseaudit failed; see stderr for the reason"
    lines = [line for line in stderr.splitlines() if line.startswith("error: ")]
    return lines[0].removeprefix("error: ") if lines else stderr.strip().partition("\n")[0]


def exec_binary(arguments: Sequence[str]) -> int:
    """Replaces this process by the binary; on Windows, runs it as a child."""
    binary = str(find_binary())
    if sys.platform == "win32":
        return subprocess.run([binary, *arguments], check=False).returncode
    os.execv(binary, [binary, *arguments])
