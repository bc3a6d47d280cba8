"""Starts a robot, records its run with `ros2 bag`, and audits the recording after everything has shut down.

For launch_pytest: `pytest test_recorded_run.py`, or `ament_add_pytest_test` in a package. Replace `my_cell`
and its programs by yours. `poseaudit record-list` prints the topics to record.
"""

import launch
import launch_pytest
import pytest
from launch.actions import ExecuteProcess
from launch_pytest.tools import process

TOPICS = ["/joint_states", "/tcp_pose_broadcaster/pose", "/tf", "/tf_static", "/robot_description"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return tmp_path_factory.mktemp("recorded") / "run"


@pytest.fixture(scope="module")
def motion():
    """The motion under test; it ends by itself."""
    return ExecuteProcess(cmd=["ros2", "run", "my_cell", "calibration_motion"])


@launch_pytest.fixture(scope="module")
def launch_description(bag, motion):
    robot = ExecuteProcess(cmd=["ros2", "launch", "my_cell", "robot.launch.py"])
    recorder = ExecuteProcess(
        cmd=["ros2", "bag", "record", "--storage", "mcap", "--output", str(bag), *TOPICS]
    )
    return launch.LaunchDescription([robot, recorder, motion, launch_pytest.actions.ReadyToTest()])


@pytest.mark.launch(fixture=launch_description)
def test_the_motion_ends(launch_context, motion):
    process.wait_for_exit_sync(launch_context, motion, timeout=120)
    assert motion.return_code == 0


# After the shutdown, so that the bag is complete.
@pytest.mark.launch(fixture=launch_description, shutdown=True)
@pytest.mark.pose_limits(LAT001="5 ms", ZER001="0.2°")
def test_the_recording_passes(bag, pose_audit):
    pose_audit(bag, robot="ur5e", require=["LAT001", "ZER001"])
