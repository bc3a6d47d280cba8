"""Converts audit options to arguments of the binary."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

if TYPE_CHECKING:
    from typing import TypeAlias

Path: TypeAlias = "str | os.PathLike[str]"
Texts: TypeAlias = "str | Sequence[str]"
#: One value, several, or a mapping from a joint name prefix or a topic.
PathsByKey: TypeAlias = "Path | Sequence[Path] | Mapping[str, Path]"


class CommonOptions(TypedDict, total=False):
    """Audit options with the names of the program's flags. None and False are ignored."""

    robot: PathsByKey | None
    """URDF, table or catalogue name; `{prefix: file}` with several arms."""
    calibration: PathsByKey | None
    """A UR's calibration; `{prefix: file}` with several arms."""
    joint_map: Texts | Mapping[str, str] | None
    """Joint names that differ between log and model: `{log: model}`."""
    base: str | None
    """First link of the chain."""
    tip: str | None
    """Last link of the chain."""
    reference: str | None
    """Pose topic that the others are compared with, if the log has no joint states."""
    config: Path | None
    """A `poseaudit.toml`."""
    select: Texts | None
    """Rules to run: codes, or prefixes of families."""
    ignore: Texts | None
    """Rules to skip."""
    fail_on: Literal["error", "warning", "inconclusive", "never"] | None
    """Minimum severity of findings that fail the run."""
    stamp: Literal["header", "log", "publish"] | None
    """Clock of the samples."""
    max_latency: float | None
    """Maximum latency, s."""
    verify: bool | None
    """Check every checksum."""
    max_unpacked: int | None
    """Maximum unpacked size of a file, GiB."""
    columns: Texts | Mapping[str, str] | None
    """Meaning of the columns of a table: `"t,q[6],xyz,rotvec"`, or `{file: text}`."""
    declare: Texts | Mapping[str, str] | None
    """Encoding of streams: `{topic: convention}`, or `topic=convention`."""


class Options(CommonOptions, total=False):
    """Options of `poseaudit audit`."""

    require: Texts | None
    """Rules that must not be inconclusive."""
    corrections: Path | None
    """A `corrections.toml` to apply first."""
    fix: Path | None
    """Folder for corrections of the findings."""
    rrd: Path | None
    """File for a recording for the Rerun viewer."""
    rrd_layer: Path | None
    """Recording of the log, of which `rrd` becomes a layer."""
    mcap: Path | None
    """File for the findings as messages for Foxglove."""
    plotjuggler: Path | None
    """File for errors and limits as CSV for PlotJuggler."""
    mesh_root: Path | Sequence[Path] | None
    """Folders to search for meshes of the robot's URDF, for the recording."""
    parquet: Path | None
    """Folder for tables."""
    tum: Path | None
    """Folder for aligned poses as TUM trajectories."""
    write_baseline: Path | None
    """File for the JSON report, as a baseline for later logs."""


class FleetOptions(CommonOptions, total=False):
    """Options of `poseaudit fleet`."""

    label: Texts | Mapping[str, str] | None
    """Labels of all logs: `{"site": "berlin"}`."""
    labels_from: str | None
    """Pattern of the end of the paths that gives labels: `{site}/{arm}/*`."""
    timeout: float | None
    """Maximum time for one log, s."""
    memory: str | int | None
    """Maximum memory for one log, as in `2GiB`."""
    retry: bool | None
    """Retry logs that exceeded a limit or failed."""
    pages: bool | None
    """Keep the HTML report of each log."""
    identity: Literal["content", "file"] | None
    """How finished logs are recognised."""


#: Options without a value.
SWITCHES = ("pages", "retry", "verify")


def names(kind: type[CommonOptions]) -> list[str]:
    """Names of the options in a TypedDict."""
    return list(kind.__annotations__)


def arguments(function: str, options: Mapping[str, object], kind: type[CommonOptions]) -> list[str]:
    """Converts options to arguments of the binary. Unknown options raise a `TypeError` of `function`."""
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
        if name not in SWITCHES:
            raise TypeError(f"{function}(): {name}=True: this option takes a value")
        return [flag]
    return [f"{flag}={text}" for text in _texts(function, name, value)]


def _texts(function: str, name: str, value: object) -> list[str]:
    """Converts a value to texts; the flag is repeated for each."""
    if isinstance(value, (str, os.PathLike)):
        return [os.fspath(value)]
    if isinstance(value, (int, float)):
        return [repr(value)]
    if isinstance(value, Mapping):
        return [f"{of}={text}" for of, one in value.items() for text in _texts(function, name, one)]
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [text for one in value for text in _texts(function, name, one)]
    raise TypeError(f"{function}(): {name}={value!r}: expected a text, a path, a number or several of them")
