"""The options of an audit, as arguments of the binary."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

if TYPE_CHECKING:
    from typing import TypeAlias

Path: TypeAlias = "str | os.PathLike[str]"
Texts: TypeAlias = "str | Sequence[str]"
#: One, several, or by what they are of: a prefix of joint names, a topic.
Of: TypeAlias = "Path | Sequence[Path] | Mapping[str, Path]"


class How(TypedDict, total=False):
    """How a log is audited, by the names of the program's flags. None and False are as if not given."""

    robot: Of | None
    """URDF, table or catalogue name; `{prefix: file}` with several arms."""
    calibration: Of | None
    """A UR's calibration; `{prefix: file}` with several arms."""
    joint_map: Texts | Mapping[str, str] | None
    """Joints that the log and the model name otherwise: `{log: model}`."""
    base: str | None
    """Link that the chain begins at."""
    tip: str | None
    """Link that the chain ends at."""
    config: Path | None
    """A `poseaudit.toml`."""
    select: Texts | None
    """Rules to ask: codes, or the letters that a family begins with."""
    ignore: Texts | None
    """Rules not to ask."""
    fail_on: Literal["error", "warning", "inconclusive", "never"] | None
    """From which severity on a finding fails the run."""
    stamp: Literal["header", "log", "publish"] | None
    """The time that places a sample."""
    max_latency: float | None
    """Largest latency, s."""
    verify: bool | None
    """Check every checksum."""
    max_unpacked: int | None
    """What a file may unpack to, GiB."""
    declare: Texts | Mapping[str, str] | None
    """How streams are coded: `{topic: convention}`, or `topic=convention`."""


class Options(How, total=False):
    """Options of `poseaudit audit`."""

    require: Texts | None
    """Rules that must conclude."""
    corrections: Path | None
    """A `corrections.toml` to apply first."""
    fix: Path | None
    """Folder for what would mend the findings."""
    rrd: Path | None
    """File for a recording for the Rerun viewer."""
    mesh_root: Path | Sequence[Path] | None
    """Folders that the meshes of the robot's URDF are sought below, for the recording."""
    parquet: Path | None
    """Folder for tables."""
    write_baseline: Path | None
    """File for the report as JSON, to hold later logs against."""


class FleetOptions(How, total=False):
    """Options of `poseaudit fleet`."""

    label: Texts | Mapping[str, str] | None
    """What all logs are of: `{"site": "berlin"}`."""
    labels_from: str | None
    """What the ends of their paths say they are of: `{site}/{arm}/*`."""
    timeout: float | None
    """What the audit of one log may take, s."""
    memory: str | int | None
    """What it may take of memory, as in `2GiB`."""
    retry: bool | None
    """Try again what took too much, or made the audit fail."""
    identity: Literal["content", "file"] | None
    """What tells that a log is done."""


#: The options that take no value.
_SWITCHES = ("retry", "verify")


def names(kind: type[How]) -> list[str]:
    """The names of the options in a dict of that kind."""
    return list(kind.__annotations__)


def arguments(function: str, options: Mapping[str, object], kind: type[How]) -> list[str]:
    """The options as arguments of the binary; one that there is not is a `TypeError` of `function`."""
    known = names(kind)
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise TypeError(f"{function}() got an unexpected keyword argument {name!r}{hint}")
    return [argument for name, value in options.items() for argument in _argument(function, name, value)]


def _argument(function: str, name: str, value: object) -> list[str]:
    flag = "--" + name.replace("_", "-")
    if value is None or value is False:
        return []
    if value is True:
        if name not in _SWITCHES:
            raise TypeError(f"{function}(): {name}=True: this option takes a value")
        return [flag]
    return [f"{flag}={text}" for text in _texts(function, name, value)]


def _texts(function: str, name: str, value: object) -> list[str]:
    """A value as the texts that its flag is given with, once for each."""
    if isinstance(value, (str, os.PathLike)):
        return [os.fspath(value)]
    if isinstance(value, (int, float)):
        return [repr(value)]
    if isinstance(value, Mapping):
        return [f"{of}={text}" for of, one in value.items() for text in _texts(function, name, one)]
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [text for one in value for text in _texts(function, name, one)]
    raise TypeError(f"{function}(): {name}={value!r}: expected a text, a path, a number or several of them")
