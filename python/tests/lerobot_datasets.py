"""LeRobot datasets v2.1 and v3.0 for tests: an SO-101 whose states follow the commands late."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

FPS = 30
LENGTH = 240
NAMES = [
    f"{joint}.pos" for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
]
CARD = """---
license: apache-2.0
tags: [LeRobot]
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# Pick a cube

Recorded on a desk.
"""


def episode(index: int, delay_s: float) -> pa.Table:
    """One episode in degrees; its states are the commands of `delay_s` ago."""
    rng = np.random.default_rng(index)
    amplitude = rng.uniform(5, 15, (3, len(NAMES)))
    rate, phase = rng.uniform(0.5, 4.0, amplitude.shape), rng.uniform(0, 6, amplitude.shape)

    def angles(time_s: np.ndarray) -> np.ndarray:
        angles_deg = amplitude * np.sin(rate * time_s[:, None, None] + phase)
        return np.asarray(angles_deg.sum(axis=1))

    time_s = np.arange(LENGTH) / FPS
    state = angles(time_s - delay_s) + rng.normal(0, 0.02, (LENGTH, len(NAMES)))
    vectors = {"action": angles(time_s), "observation.state": state}
    return pa.table(
        {
            **{
                name: pa.FixedSizeListArray.from_arrays(
                    pa.array(values.astype(np.float32).ravel()), len(NAMES)
                )
                for name, values in vectors.items()
            },
            "timestamp": pa.array(time_s.astype(np.float32)),
            "frame_index": pa.array(np.arange(LENGTH)),
            "episode_index": pa.array(np.full(LENGTH, index)),
            "index": pa.array(np.arange(LENGTH) + index * LENGTH),
            "task_index": pa.array(np.zeros(LENGTH, dtype=np.int64)),
        }
    )


def write(folder: Path, version: str, delays_s: list[float], *, per_file: int = 3) -> Path:
    """Writes a dataset with a card; `per_file` episodes share a file in v3.0."""
    tables = [episode(index, delay_s) for index, delay_s in enumerate(delays_s)]
    is_v3 = version == "v3.0"
    name = "file-{file_index:03d}" if is_v3 else "episode_{episode_index:06d}"
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    groups = [tables[at : at + per_file] for at in range(0, len(tables), per_file)] if is_v3 else None
    for index, group in enumerate(groups or [[table] for table in tables]):
        pq.write_table(
            pa.concat_tables(group), data / f"{name.format(file_index=index, episode_index=index)}.parquet"
        )
    feature = {"dtype": "float32", "names": NAMES, "shape": [len(NAMES)]}
    info = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "fps": FPS,
        "total_episodes": len(tables),
        "total_frames": len(tables) * LENGTH,
        "chunks_size": 1000,
        "data_path": f"data/chunk-{{{'chunk_index' if is_v3 else 'episode_chunk'}:03d}}/{name}.parquet",
        "features": {"action": feature, "observation.state": feature},
    }
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "README.md").write_text(CARD)
    return folder
