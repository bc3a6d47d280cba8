"""The binary that does the work: where it is, and how it is run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from ._errors import CallError, ProgramError

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
    shows_progress: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Runs the binary to its end and keeps what it says; what it says to stderr is shown instead where
    progress is. A status is the caller's to judge; a death by a signal is a `ProgramError`."""
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


def answer(arguments: Sequence[str], *, may_find: bool = False) -> str:
    """What the binary prints. Status 1 is an answer where it `may_find` something; any other is raised."""
    done = run(arguments)
    if done.returncode == 0 or (may_find and done.returncode == 1):
        return done.stdout
    error = CallError if done.returncode == 2 else ProgramError
    raise error(trouble_in(done.stderr))


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def sources(named: Sequence[str]) -> tuple[list[str], str | None]:
    """The sources of a fleet as arguments, and as a list on stdin: paths are listed, of which there may be
    more than a command line holds; patterns and addresses are arguments."""
    listed = [source for source in named if os.path.lexists(source)]
    others = [source for source in named if not os.path.lexists(source)]
    return (["-", *others], "\0".join([*listed, ""])) if listed else (others, None)


def trouble_in(stderr: str | None) -> str:
    """The line that says what went wrong, of what the binary wrote to stderr."""
    if stderr is None:
        return "poseaudit could not do it; stderr says why"
    lines = [line for line in stderr.splitlines() if line.startswith("error: ")]
    return lines[0].removeprefix("error: ") if lines else stderr.strip().partition("\n")[0]


def become(arguments: Sequence[str]) -> int:
    """Runs the binary in place of this process; where a system has no such thing, beside it."""
    binary = str(find_binary())
    if sys.platform == "win32":
        return subprocess.run([binary, *arguments], check=False).returncode
    os.execv(binary, [binary, *arguments])
