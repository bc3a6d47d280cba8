"""LeRobot v3.0 dataset of a UR5e at 30 Hz, for the benchmark: `lerobot.py write FOLDER EPISODES` or `read FOLDER`.

Written by numpy and pyarrow. The joint states follow their commands 133 ms later.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

FRAMES, RATE_HZ, EPISODES_PER_FILE, DELAY_FRAMES = 300, 30.0, 500, 4
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
POSE = ["x", "y", "z", "rx", "ry", "rz"]
HOME = np.array([0.3, -1.4, 1.6, -1.7, -1.5, 0.4])
# a, d and alpha of a UR5e, by Universal Robots.
DH = np.array([
    [0, 0.1625, np.pi / 2],
    [-0.425, 0, 0],
    [-0.3922, 0, 0],
    [0, 0.1333, np.pi / 2],
    [0, 0.0997, -np.pi / 2],
    [0, 0.0996, 0],
])


def forward(q):
    poses = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for joint, (a, d, alpha) in zip(q.T, DH):
        step = np.zeros((len(q), 4, 4))
        c, s, ca, sa = np.cos(joint), np.sin(joint), np.cos(alpha), np.sin(alpha)
        step[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
        step[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
        step[:, 2] = [0, sa, ca, d]
        step[:, 3, 3] = 1
        poses = poses @ step
    return poses


def rotation_vectors(rotations):
    """From the eigenvector of the largest eigenvalue of each rotation's 4 x 4 matrix (Bar-Itzhack 2000)."""
    r = rotations
    matrix = np.zeros((len(r), 4, 4))
    matrix[:, :3, :3] = r + r.transpose(0, 2, 1)
    trace = np.trace(r, axis1=1, axis2=2)
    matrix[:, range(3), range(3)] -= trace[:, None]
    axis = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    matrix[:, 3, :3] = matrix[:, :3, 3] = axis
    matrix[:, 3, 3] = trace
    quaternions = np.linalg.eigh(matrix)[1][:, :, 3]
    quaternions *= np.where(quaternions[:, 3:] < 0, -1, 1)
    sines = np.linalg.norm(quaternions[:, :3], axis=1, keepdims=True)
    angles = 2 * np.arctan2(sines, quaternions[:, 3:])
    return quaternions[:, :3] * angles / np.maximum(sines, 1e-12)


def episode(number):
    random = np.random.default_rng(number)
    t_s = np.arange(FRAMES + DELAY_FRAMES) / RATE_HZ
    path = np.tile(HOME, (len(t_s), 1))
    for wave in range(1, 5):
        rates_hz, phases, amplitudes = random.random((3, 6))
        angles = 2 * np.pi * ((0.05 + 0.4 * rates_hz) * t_s[:, None] + phases)
        path += 0.25 * amplitudes / wave * np.sin(angles)
    q, commands = path[:FRAMES], path[DELAY_FRAMES:]
    poses = forward(q)
    logged = np.hstack([poses[:, :3, 3], rotation_vectors(poses[:, :3, :3])])
    q = q + random.normal(0, 2e-5, q.shape)
    logged = logged + random.normal(0, [1e-4] * 3 + [2e-4] * 3, logged.shape)
    return q, logged, commands, t_s[:FRAMES]


def write(folder, episodes):
    folder = Path(folder)
    for part in ["meta/episodes/chunk-000", "data/chunk-000"]:
        (folder / part).mkdir(parents=True, exist_ok=True)
    rows = []
    for file, first in enumerate(range(0, episodes, EPISODES_PER_FILE)):
        numbers = range(first, min(episodes, first + EPISODES_PER_FILE))
        q, poses, commands, t_s = (np.concatenate(column) for column in zip(*map(episode, numbers)))
        index = np.repeat(numbers, FRAMES)
        frame = np.tile(np.arange(FRAMES), len(numbers))
        lists = lambda values: pa.FixedSizeListArray.from_arrays(values.astype(np.float32).ravel(), 6)
        table = pa.table({
            "observation.state": lists(q),
            "observation.tcp_pose": lists(poses),
            "action": lists(commands),
            "timestamp": t_s.astype(np.float32),
            "frame_index": frame,
            "episode_index": index,
            "index": index * FRAMES + frame,
            "task_index": np.zeros(len(index), np.int64),
        })
        pq.write_table(table, folder / f"data/chunk-000/file-{file:03d}.parquet")
        rows += [
            {
                "episode_index": number,
                "tasks": ["move"],
                "length": FRAMES,
                "dataset_from_index": number * FRAMES,
                "dataset_to_index": (number + 1) * FRAMES,
                "data/chunk_index": 0,
                "data/file_index": file,
            }
            for number in numbers
        ]
    pq.write_table(pa.Table.from_pylist(rows), folder / "meta/episodes/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"task_index": [0], "task": ["move"]}), folder / "meta/tasks.parquet")
    scalar = {name: {"dtype": "int64", "shape": [1], "names": None} for name in
              ["frame_index", "episode_index", "index", "task_index"]}
    names = [f"{joint}_joint" for joint in JOINTS]
    of = lambda names: {"dtype": "float32", "shape": [6], "names": names}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "ur5e",
        "total_episodes": episodes,
        "total_frames": episodes * FRAMES,
        "total_tasks": 1,
        "chunks_size": 1000,
        "fps": int(RATE_HZ),
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            "observation.state": of(names),
            "observation.tcp_pose": of(POSE),
            "action": of(names),
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **scalar,
        },
    }
    (folder / "meta/info.json").write_text(json.dumps(info, indent=1))


def read(folder):
    columns = ["observation.state", "observation.tcp_pose", "action", "timestamp", "episode_index"]
    files = sorted(Path(folder).glob("data/*/*.parquet"))
    print(sum(len(pq.read_table(file, columns=columns)) for file in files), "rows")


if __name__ == "__main__":
    mode, folder, *count = sys.argv[1:]
    if mode == "write":
        write(folder, int(count[0]))
    else:
        read(folder)
