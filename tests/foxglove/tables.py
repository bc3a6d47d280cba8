"""Writes one motion of a UR5e in the formats of tables, with a zero offset of the elbow in its joint states."""

import csv
import io
import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow
import pyarrow.parquet

JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
RATE_HZ, SECONDS = 50, 12
ELBOW_OFFSET_RAD = np.radians(0.6)


@dataclass
class Motion:
    """Stamps (s), logged joint positions (rad), and the poses of tool0 in base: m and quaternions xyzw."""

    t: np.ndarray
    q: np.ndarray
    xyz: np.ndarray
    xyzw: np.ndarray

    @property
    def rotation_vectors(self) -> np.ndarray:
        half = np.where(self.xyzw[:, 3:] < 0, -self.xyzw, self.xyzw)
        sine = np.linalg.norm(half[:, :3], axis=1)
        return half[:, :3] * (2 * np.arctan2(sine, half[:, 3]) / sine)[:, None]

    @property
    def kuka_abc_deg(self) -> np.ndarray:
        """Angles about z, y and x."""
        x, y, z, w = self.xyzw.T
        a = np.arctan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))
        b = -np.arcsin(2 * (x * z - y * w))
        c = np.arctan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y))
        return np.degrees(np.column_stack([a, b, c]))


def motion(program: str, folder: Path) -> Motion:
    """Poses by `poseaudit fk`, with 20 µm and 20 µrad of noise. Uses `folder` for its files."""
    t = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    centre = [0.2, -1.4, 1.3, -0.9, -1.5, 0.3]
    q = np.column_stack([q + 0.3 * np.sin((0.6 + 0.13 * joint) * t + joint) for joint, q in enumerate(centre)])
    (folder / "joints.csv").write_text(write_csv(JOINTS, q))
    command = [program, "fk", "ur5e", "--file", folder / "joints.csv", "--output", folder / "poses.csv", "--quiet"]
    subprocess.run(command, check=True)
    rows = list(csv.DictReader((folder / "poses.csv").open(newline="")))
    column = lambda *names: np.array([[float(row[name]) for name in names] for row in rows])  # noqa: E731
    noise = np.random.default_rng(1)
    q[:, 2] += ELBOW_OFFSET_RAD
    return Motion(
        t,
        q + 2e-5 * noise.standard_normal(q.shape),
        (xyz := column("x_m", "y_m", "z_m")) + 2e-5 * noise.standard_normal(xyz.shape),
        column("qx", "qy", "qz", "qw"),
    )


def write_csv(names: list[str], rows: np.ndarray, delimiter: str = ",") -> str:
    out = io.StringIO()
    writer = csv.writer(out, delimiter=delimiter)
    writer.writerow(names)
    writer.writerows(rows.tolist())
    return out.getvalue()


def rsi_packets(of: Motion) -> str:
    def element(name: str, axes: str, values: np.ndarray) -> str:
        return f"<{name} " + " ".join(f'{axis}="{value:.6f}"' for axis, value in zip(axes.split(), values)) + "/>"

    poses, axes = np.column_stack([1e3 * of.xyz, of.kuka_abc_deg]), np.degrees(of.q)
    packets = (
        f'<Rob Type="KUKA">{element("RIst", "X Y Z A B C", pose)}{element("RSol", "X Y Z A B C", pose)}'
        f'{element("AIPos", "A1 A2 A3 A4 A5 A6", axis)}<Delay D="0"/><IPOC>{4_208_163_634 + 20 * row}</IPOC></Rob>\n'
        for row, (pose, axis) in enumerate(zip(poses, axes))
    )
    return "".join(packets)


def write_tables(of: Motion, folder: Path) -> list[Path]:
    names = ["timestamp", *JOINTS, "x", "y", "z", "qx", "qy", "qz", "qw", "gripper_force"]
    rows = np.column_stack([of.t, of.q, of.xyz, of.xyzw, np.ones_like(of.t)])
    vectors = {"timestamp": of.t, "joint_positions": of.q, "tool_position": of.xyz}
    file = lambda name: folder / name  # noqa: E731
    file("named.csv").write_text(write_csv(names, rows))
    # The scalar of the quaternion first.
    order = [*range(10), 13, 10, 11, 12]
    lines = (json.dumps({names[at]: row[at] for at in order}) + "\n" for row in rows.tolist())
    file("lines.jsonl").write_text("".join(lines))
    file("packets.xml").write_text(rsi_packets(of))
    numbered = [f"{field}_{axis}" for field in ("actual_q", "actual_TCP_pose") for axis in range(6)]
    rtde = np.column_stack([100 + of.t, of.q, of.xyz, of.rotation_vectors])
    file("rtde.csv").write_text(write_csv(["timestamp", *numbered], rtde, " "))
    tum = np.column_stack([of.t, of.xyz, of.xyzw])
    file("trajectory.tum").write_text("".join(" ".join(map(repr, row)) + "\n" for row in tum.tolist()))
    pyarrow.parquet.write_table(pyarrow.table(dict(zip(names, rows.T))), file("named.parquet"))
    episode = {"timestamp": of.t, "observation.state": list(of.q), "action": list(of.q)}
    pyarrow.parquet.write_table(pyarrow.table(episode), file("episode.parquet"))
    with h5py.File(file("vectors.h5"), "w") as out:
        for name, values in vectors.items():
            out[name] = values
    np.savez(file("vectors.npz"), **vectors)
    np.save(file("unnamed.npy"), rows[:, :14])
    workbook = openpyxl.Workbook()
    for row in [names, *rows.tolist()]:
        workbook.active.append(row)
    workbook.save(file("named.xlsx"))
    return sorted(folder.iterdir())
