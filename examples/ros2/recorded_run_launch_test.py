"""The test of `test_recorded_run.py` for launch_testing, whose tests are unittest classes without fixtures.

`launch_test recorded_run_launch_test.py`, or `add_launch_test` in a package.
"""

import tempfile
import unittest
from pathlib import Path

import launch
import launch_testing
import pytest
from launch.actions import ExecuteProcess

import poseaudit

TOPICS = ["/joint_states", "/tcp_pose_broadcaster/pose", "/tf", "/tf_static", "/robot_description"]


@pytest.mark.launch_test
def generate_test_description():
    bag = Path(tempfile.mkdtemp(prefix="audit-")) / "run"
    robot = ExecuteProcess(cmd=["ros2", "launch", "my_cell", "robot.launch.py"])
    recorder = ExecuteProcess(
        cmd=["ros2", "bag", "record", "--storage", "mcap", "--output", str(bag), *TOPICS]
    )
    motion = ExecuteProcess(cmd=["ros2", "run", "my_cell", "calibration_motion"])
    actions = [robot, recorder, motion, launch_testing.actions.ReadyToTest()]
    return launch.LaunchDescription(actions), {"bag": bag, "motion": motion}


class TestMotion(unittest.TestCase):
    def test_the_motion_ends(self, proc_info, motion):
        proc_info.assertWaitForShutdown(process=motion, timeout=120)


@launch_testing.post_shutdown_test()
class TestRecording(unittest.TestCase):
    def test_the_recording_passes(self, bag):
        report = poseaudit.audit(bag, robot="ur5e", require=["LAT001", "ZER001"])
        self.assertTrue(report.ok, f"\n{report}")
