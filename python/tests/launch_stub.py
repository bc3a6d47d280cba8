"""Stub of the parts of `launch`, `launch_pytest` and `launch_testing` that `examples/ros2` uses, because
ROS 2 is not on a package index. A launched program is the stub of `ros2` on the PATH.
"""

from __future__ import annotations

import importlib.util
import inspect
import signal
import subprocess
import sys
import types
import unittest
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROS2 = f"""#!{sys.executable}
import os, shutil, sys, time
from pathlib import Path

words, recording = sys.argv[1:], Path(__file__).with_name("recording")
try:
    if words[:2] == ["bag", "record"]:
        bag = Path(words[words.index("--output") + 1])
        bag.mkdir()
        recording.touch()
    # A motion ends once it is recorded, all others at the shutdown.
    while words[0] != "run" or not recording.exists():
        time.sleep(0.1)
except KeyboardInterrupt:  # a recorder then completes its bag
    if words[0] == "bag":
        shutil.copyfile(os.environ["RECORDED"], bag / "run_0.mcap")
"""


class ExecuteProcess:
    """A program to launch."""

    def __init__(self, cmd: list[str]) -> None:
        self.cmd = cmd
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def return_code(self) -> int | None:
        return None if self.process is None else self.process.poll()

    def wait(self, timeout: float) -> None:
        assert self.process is not None
        self.process.wait(timeout)


class LaunchDescription:
    """Starts and ends its processes."""

    def __init__(self, actions: list[Any]) -> None:
        self.processes = [action for action in actions if isinstance(action, ExecuteProcess)]

    def start(self) -> None:
        for one in self.processes:
            one.process = subprocess.Popen(one.cmd)

    def shut_down(self) -> None:
        for one in self.processes:
            assert one.process is not None
            if one.process.poll() is None:
                one.process.send_signal(signal.SIGINT)
            one.process.wait(20)


class _ProcessInfo:
    """`proc_info` of launch_testing."""

    def assertWaitForShutdown(self, process: ExecuteProcess, timeout: float) -> None:
        process.wait(timeout)


def install_ros2(folder: Path) -> None:
    """Writes the stub of `ros2` into a folder of the PATH."""
    program = folder / "ros2"
    program.write_text(ROS2)
    program.chmod(0o755)


def install_modules() -> None:
    """Makes the packages importable, unless ROS 2 provides them."""
    if not importlib.util.find_spec("launch_pytest"):
        actions = {"ReadyToTest": type("ReadyToTest", (), {})}
        process = {"wait_for_exit_sync": lambda _, process, timeout: process.wait(timeout)}
        for name, content in (
            ("launch", {"LaunchDescription": LaunchDescription}),
            ("launch.actions", {"ExecuteProcess": ExecuteProcess}),
            ("launch_pytest", {"fixture": pytest.fixture}),
            ("launch_pytest.actions", actions),
            ("launch_pytest.tools", {}),
            ("launch_pytest.tools.process", process),
            ("launch_testing", {"post_shutdown_test": lambda: _mark_post_shutdown}),
            ("launch_testing.actions", actions),
        ):
            module = types.ModuleType(name)
            vars(module).update(content)
            sys.modules[name] = module
            parent, _, child = name.rpartition(".")
            if parent:
                setattr(sys.modules[parent], child, module)


def _mark_post_shutdown(case: type) -> type:
    case.post_shutdown = True  # type: ignore[attr-defined]
    return case


def run_launch_test(module: types.ModuleType) -> unittest.TestResult:
    """Runs a module like `launch_test`: its tests during the launch, then those after the shutdown."""
    description, context = module.generate_test_description()
    arguments = {**context, "proc_info": _ProcessInfo()}
    cases = [
        one for one in vars(module).values() if inspect.isclass(one) and issubclass(one, unittest.TestCase)
    ]
    result = unittest.TestResult()
    description.start()
    _tests(cases, arguments, post_shutdown=False).run(result)
    description.shut_down()
    _tests(cases, arguments, post_shutdown=True).run(result)
    return result


def _tests(cases: list[Any], arguments: dict[str, Any], *, post_shutdown: bool) -> unittest.TestSuite:
    suite = unittest.TestSuite()
    for case in cases:
        if getattr(case, "post_shutdown", False) == post_shutdown:
            for name in unittest.TestLoader().getTestCaseNames(case):
                setattr(case, name, _with_arguments(getattr(case, name), arguments))
                suite.addTest(case(name))
    return suite


def _with_arguments(test: Callable[..., None], arguments: dict[str, Any]) -> Callable[[Any], None]:
    wanted = [name for name in inspect.signature(test).parameters if name != "self"]
    return lambda self: test(self, **{name: arguments[name] for name in wanted})


# Plugin for the tests of launch_pytest.


def pytest_configure(config: pytest.Config) -> None:
    install_modules()
    config.addinivalue_line("markers", "launch(fixture, shutdown): launches processes before the test")


@pytest.fixture(scope="module")
def launch_context(launch_description: LaunchDescription) -> Iterator[LaunchDescription]:
    launch_description.start()
    yield launch_description
    launch_description.shut_down()


@pytest.fixture(autouse=True)
def _launched(request: pytest.FixtureRequest) -> None:
    marker = request.node.get_closest_marker("launch")
    if marker is not None and marker.kwargs.get("shutdown"):
        request.getfixturevalue("launch_context").shut_down()
