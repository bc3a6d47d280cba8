"""Writes riddles.csv: pairs of poses in two conventions, from NumPy and SciPy, with the expected answers.

Needs numpy and scipy: python tests/desk/make.py > tests/desk/riddles.csv

Where each coding is from stands in src/ground/geometry/vendors.toml and src/desk/frames.toml. The first
pose is that of UR driver issue 791, the others are random.
"""

import csv
import sys

import numpy as np
from scipy.spatial.transform import Rotation

rng = np.random.default_rng(7)


def transform(xyz, rotation):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.as_matrix()
    matrix[:3, 3] = xyz
    return matrix


def pose_from_rpy(roll, pitch, yaw, xyz=(0, 0, 0)):
    return transform(xyz, Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True))


POSES = [pose_from_rpy(149.49, -12.78, 72.64, [0.2437, -0.2490, 0.6183])]
for _ in range(5):
    xyz = rng.uniform([-0.6, -0.6, 0.1], [0.6, 0.6, 0.9])
    POSES.append(transform(xyz, Rotation.random(random_state=int(rng.integers(1e9)))))


def p(m):
    return m[:3, 3]


def q(m):
    return Rotation.from_matrix(m[:3, :3]).as_quat()


def euler(m, order, degrees=True):
    return Rotation.from_matrix(m[:3, :3]).as_euler(order, degrees=degrees)


def rotvec(m):
    return Rotation.from_matrix(m[:3, :3]).as_rotvec()


def angle(m):
    return np.linalg.norm(rotvec(m))


def ros(m):
    return p(m), q(m)


def basis(m, axes):
    """The same pose with different axes of world and body; left-handed axes mirror both."""
    axes = np.array(axes, float)
    return transform(axes @ p(m), Rotation.from_matrix(axes @ m[:3, :3] @ axes.T))


UNITY = [[0, -1, 0], [0, 0, 1], [1, 0, 0]]
UNREAL = np.diag([1, -1, 1])
Y_UP = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
MOTIVE = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
NED = transform([0, 0, 0], Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]))
BODY_FROM_OPTICAL = pose_from_rpy(-90, 0, -90)
OPENCV_FROM_OPENGL = pose_from_rpy(180, 0, 0)


def unity_euler(m):
    # Unity turns about z, then x, then y, and lists the angles as x, y, z.
    y, x, z = euler(basis(m, UNITY), "YXZ")
    return x, y, z


RIDDLES = {}


def riddle(name, first, second, how="", claim="", pairs=1):
    """Adds a row: the interpretation of B, the expected claim, and the minimum number of pairs."""
    RIDDLES[name] = (first, second, how, claim, pairs)


riddle("UR rotvec", ros, lambda m: (p(m), rotvec(m)), "rotvec, rad, m")
riddle("UR pendant, mm, against base_link", lambda m: ros(pose_from_rpy(0, 0, 180) @ m),
       lambda m: (1000 * p(m), rotvec(m)), "rotvec, rad, mm", "base_link")
riddle("KUKA", ros, lambda m: (1000 * p(m), euler(m, "ZYX")), "euler:ZYX, deg, mm")
riddle("ABB", ros, lambda m: (1000 * p(m), np.roll(q(m), 1)), "quat:wxyz, mm")
riddle("FANUC, tool0 against flange", lambda m: ros(m @ pose_from_rpy(180, -90, 0)),
       lambda m: (1000 * p(m), euler(m, "xyz")), "euler:xyz, deg, mm", "ROS-Industrial, as FANUC")
riddle("Doosan", ros, lambda m: (1000 * p(m), euler(m, "ZYZ")), "euler:ZYZ, deg, mm")
riddle("Staubli", ros, lambda m: (1000 * p(m), euler(m, "XYZ")), "euler:XYZ, deg, mm")
riddle("Mitsubishi", ros, lambda m: (1000 * p(m), euler(m, "xyz")), "euler:xyz, deg, mm")
riddle("Epson", ros, lambda m: (1000 * p(m), euler(m, "ZYX")), "euler:ZYX, deg, mm")
riddle("Kinova, degrees and metres", ros, lambda m: (p(m), euler(m, "xyz")), "euler:xyz, deg, m")
riddle("Yaskawa's integers", ros,
       lambda m: (np.round(1e6 * p(m)), np.round(1e4 * euler(m, "xyz"))), "euler:xyz, 0.0001 deg, µm")
riddle("Franka O_T_EE", ros, lambda m: m.T, "matrix:columns, m")
riddle("Franka O_T_EE of the hand", ros, lambda m: (m @ pose_from_rpy(0, 0, -45, (0, 0, 0.1034))).T,
       "matrix:columns, m", "fr3_hand_tcp")
riddle("Unity, quaternion", ros, lambda m: ros(basis(m, UNITY)), "quat:xyzw, m", "B: Unity")
riddle("Unity, eulerAngles", ros, lambda m: (p(basis(m, UNITY)), unity_euler(m)),
       "euler:zxy@axes, deg, m", "B: Unity")
riddle("Unreal, cm", ros, lambda m: (100 * p(basis(m, UNREAL)), q(basis(m, UNREAL))), "quat:xyzw, cm",
       "Unreal")
riddle("Unreal, m", ros, lambda m: ros(basis(m, UNREAL)), "quat:xyzw, m", "Unreal")
riddle("y mirrored, roll pitch yaw", ros, lambda m: (p(basis(m, UNREAL)), euler(basis(m, UNREAL), "xyz")),
       "euler:xyz, deg, m", "opposite handedness")
riddle("glTF, three.js", ros, lambda m: ros(basis(m, Y_UP)), "quat:xyzw, m", "three.js")
riddle("a world with y up", ros, lambda m: ros(transform([0, 0, 0], Rotation.from_matrix(Y_UP)) @ m),
       "quat:xyzw, m", "y up")
riddle("OptiTrack Motive", ros, lambda m: ros(basis(m, MOTIVE)), "quat:xyzw, m", "OptiTrack")
riddle("NED and FRD", ros, lambda m: ros(NED @ m @ pose_from_rpy(180, 0, 0)), "quat:xyzw, m", "NED")
riddle("optical against body frame", ros, lambda m: ros(m @ BODY_FROM_OPTICAL), "quat:xyzw, m", "optical")
riddle("solvePnP against the camera's pose", ros,
       lambda m: (p(np.linalg.inv(m)), rotvec(np.linalg.inv(m))), "rotvec, rad, m", "inverse")
riddle("solvePnP against the camera's body", lambda m: ros(m @ np.linalg.inv(BODY_FROM_OPTICAL)),
       lambda m: (p(np.linalg.inv(m)), rotvec(np.linalg.inv(m))), "rotvec, rad, m", "optical")
riddle("OpenGL's camera against OpenCV's", ros, lambda m: ros(m @ OPENCV_FROM_OPENGL), "quat:xyzw, m",
       "OpenGL")
riddle("tf_transformations, sxyz for rxyz", ros, lambda m: (p(m), euler(m, "XYZ", False)),
       "euler:XYZ, rad, m")
riddle("SciPy, zyx for ZYX", ros, lambda m: (p(m), euler(m, "zyx", False)), "euler:zyx, rad, m")
riddle("Eigen's Quaterniond(x, y, z, w)", ros, lambda m: (p(m), np.roll(q(m), -1)), "quat:xyzw, m")
riddle("w, x, y, z", ros, lambda m: (p(m), np.roll(q(m), 1)), "quat:wxyz, m")
riddle("negated quaternion", ros, lambda m: (p(m), -q(m)), "quat:xyzw, m")
riddle("conjugate", ros, lambda m: (p(m), q(m) * [-1, -1, -1, 1]), "quat:xyzw, m", "transpose")
riddle("inverse", ros, lambda m: ros(np.linalg.inv(m)), "quat:xyzw, m", "inverse")
riddle("row vectors", ros, lambda m: m.T, "matrix:columns, m")
riddle("4x4", ros, lambda m: m, "matrix:rows, m")
riddle("3x4", ros, lambda m: m[:3], "matrix:rows, m")
riddle("two columns", ros, lambda m: (p(m), m[:3, 0], m[:3, 1]), "rot6d:columns, m")
riddle("two rows", ros, lambda m: (p(m), m[0, :3], m[1, :3]), "rot6d:rows, m")
riddle("axis and angle, degrees", ros, lambda m: (p(m), rotvec(m) / angle(m), np.degrees(angle(m))),
       "axis-angle, deg, m")
riddle("axis and angle, radians", ros, lambda m: (p(m), rotvec(m) / angle(m), angle(m)),
       "axis-angle, rad, m")
riddle("rotation vector in degrees", ros, lambda m: (1000 * p(m), np.degrees(rotvec(m))),
       "rotvec, deg, mm")
riddle("RoboDK", ros, lambda m: (1000 * p(m), euler(m, "xyz")), "euler:xyz, deg, mm")
riddle("KUKA with a tool of 150 mm", ros,
       lambda m: (1000 * p(m @ pose_from_rpy(0, 0, 0, (0, 0, 0.15))), euler(m, "ZYX")), "euler:ZYX, deg, mm",
       "a constant tool", 2)
riddle("a table of unknown place", ros, lambda m: ros(pose_from_rpy(0, 0, 30, (0.5, 0.2, 0)) @ m),
       "quat:xyzw, m", "a constant base offset", 2)
riddle("yaw, pitch, roll", ros, lambda m: (p(m), euler(m, "xyz", False)[::-1]), "euler:ZYX, rad, m")
# Cases without a source on the web.
riddle("a tracker's world and marker", ros,
       lambda m: ros(pose_from_rpy(20, -35, 100, (1.2, -0.4, 0.3)) @ m @ pose_from_rpy(10, 80, -30, (0.02, -0.05, 0.09))),
       "quat:xyzw, m", "a constant base offset", 6)
riddle("Unity with a tool", ros, lambda m: ros(basis(m @ pose_from_rpy(0, 90, 0, (0, 0, 0.12)), UNITY)),
       "quat:xyzw, m", "Unity", 6)
riddle("base and base_link 400 mm apart", ros, lambda m: ros(pose_from_rpy(0, 0, 0, (0, 0, 0.4)) @ m),
       "quat:xyzw, m", "a constant base offset", 2)


def text(values):
    return " ".join(f"{value:.6g}" for value in np.hstack([np.ravel(value) for value in values]))


out = csv.writer(sys.stdout, lineterminator="\n")
out.writerow(["riddle", "read", "claim", "pairs", "is", "but"])
for name, (first, second, how, claim, pairs) in RIDDLES.items():
    for pose in POSES:
        out.writerow([name, how, claim, pairs, text(first(pose)), text(second(pose))])
