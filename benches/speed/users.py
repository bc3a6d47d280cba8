"""Equivalent user scripts, timed for comparison with the audit: `users.py fk|count|info LOG`.

fk: compares Pinocchio's forward kinematics of the joint states with the poses, both read by rosbags.
count: counts the messages of a log with the mcap package, unpacked but not decoded.
info: pymcap-cli's summary of the log.
"""

import sys
from pathlib import Path


def fk(log: str) -> str:
    import numpy as np
    import pinocchio
    from rosbags.highlevel import AnyReader

    joint_topic, pose_topic = "/joint_states", "/tcp_pose_broadcaster/pose"
    with AnyReader([Path(log)]) as reader:

        def messages(*topics):
            connections = [one for one in reader.connections if one.topic in topics]
            for connection, _, data in reader.messages(connections=connections):
                yield connection.topic, reader.deserialize(data, connection.msgtype)

        _, description = next(messages("/robot_description"))
        model = pinocchio.buildModelFromXML(description.data)
        state = model.createData()
        base, tip = model.getFrameId("base"), model.getFrameId("tool0")
        q, errors_m = None, []
        for topic, message in messages(joint_topic, pose_topic):
            if topic == joint_topic:
                place = dict(zip(message.name, message.position))
                q = np.array([place[name] for name in model.names[1:]])
            elif q is not None:
                pinocchio.forwardKinematics(model, state, q)
                pinocchio.updateFramePlacements(model, state)
                tool = state.oMf[base].actInv(state.oMf[tip]).translation
                logged = message.pose.position
                errors_m.append(np.linalg.norm(tool - (logged.x, logged.y, logged.z)))
    return f"{len(errors_m)} poses, the median one {1e3 * np.median(errors_m):.1f} mm apart"


def count(log: str) -> str:
    from mcap.reader import make_reader

    with open(log, "rb") as file:
        return f"{sum(1 for _ in make_reader(file).iter_messages())} messages"


def info(log: str) -> str:
    import subprocess

    command = [Path(sys.executable).with_name("pymcap-cli"), "info", log]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    mode, log = sys.argv[1:]
    print({"fk": fk, "count": count, "info": info}[mode](log))
