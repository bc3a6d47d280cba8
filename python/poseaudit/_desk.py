"""`pose` and `fk`: single poses, and forward kinematics."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast, overload

from . import _binary

Pose = str | Sequence[float]


def pose(
    a: Pose,
    b: Pose | None = None,
    *,
    a_as: str | None = None,
    b_as: str | None = None,
    robot: str | os.PathLike[str] | None = None,
) -> Mapping[str, Any]:
    """Converts a pose to every convention, or finds the difference that reconciles two poses.

    A pose is numbers, or text as printed by a controller. `a_as` and `b_as` declare the encodings
    (`"rotvec"`, `"euler:ZYX,deg,mm"`, `"kuka"`). `robot` is an arm whose fixed frames may explain the
    difference. Returns the JSON of `poseaudit pose --format json`. Raises `CallError` for an invalid pose.
    """
    call = ["pose", "--format=json"]
    if b is None:
        call += [f"--from={a_as}"] if a_as else []
    else:
        call += [f"--is={_text(a)}", f"--but={_text(b)}"]
        call += [f"--is-as={a_as}"] if a_as else []
        call += [f"--but-as={b_as}"] if b_as else []
        call += [f"--robot={os.fspath(robot)}"] if robot else []
    output = _binary.output_of(call + ([] if b is not None else ["--", _text(a)]), may_find=True)
    answer: Mapping[str, Any] = json.loads(output)
    return answer


def _text(value: Pose) -> str:
    return value if isinstance(value, str) else " ".join(repr(float(number)) for number in value)


@overload
def fk(
    robot: str | os.PathLike[str], q: Sequence[float], *, base: str | None = None, tip: str | None = None
) -> Mapping[str, Any]: ...
@overload
def fk(
    robot: str | os.PathLike[str],
    q: Iterable[Sequence[float]],
    *,
    base: str | None = None,
    tip: str | None = None,
) -> list[Mapping[str, Any]]: ...
def fk(
    robot: str | os.PathLike[str],
    q: Sequence[float] | Iterable[Sequence[float]],
    *,
    base: str | None = None,
    tip: str | None = None,
) -> Mapping[str, Any] | list[Mapping[str, Any]]:
    """Pose of an arm's tip in its base, as `xyz_m` and `xyzw`; a list for several configurations.

    `robot` is a URDF, a DH table or a catalogue name; `q` are joint positions from base to tip, rad or m.
    Raises `CallError` if the robot is unknown or has a different number of joints.
    """
    links = [f"--base={base}"] if base else []
    links += [f"--tip={tip}"] if tip else []
    configurations = list(q)
    rows = [list(row) for row in configurations if isinstance(row, Iterable)]
    if len(rows) < len(configurations):
        numbers = [repr(float(cast(float, number))) for number in configurations]
        output = _binary.output_of(["fk", "--format=json", *links, os.fspath(robot), "--", *numbers])
        one: Mapping[str, Any] = json.loads(output)
        return one
    if not rows:
        return []
    first = fk(robot, rows[0], base=base, tip=tip)
    with tempfile.TemporaryDirectory(prefix="poseaudit-") as folder:
        table, poses = Path(folder, "q.csv"), Path(folder, "poses.csv")
        with table.open("w", newline="") as file:
            csv.writer(file).writerows([first["joints"], *rows])
        call = ["fk", "--quiet", *links, os.fspath(robot), f"--file={table}", f"--output={poses}"]
        _binary.output_of(call)
        with poses.open(newline="") as file:
            return [
                {
                    "xyz_m": [float(row[name]) for name in ("x_m", "y_m", "z_m")],
                    "xyzw": [float(row[name]) for name in ("qx", "qy", "qz", "qw")],
                }
                for row in csv.DictReader(file)
            ]
