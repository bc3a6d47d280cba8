"""`ros2 poseaudit`, with a stub of ros2cli, because ROS is not on a package index."""

import argparse
import sys
import types
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Creates the command like ros2cli: the class of the entry point, without arguments."""
    stub = types.ModuleType("ros2cli.command")
    stub.CommandExtension = type("CommandExtension", (), {"NAME": None})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ros2cli", types.ModuleType("ros2cli"))
    monkeypatch.setitem(sys.modules, "ros2cli.command", stub)
    monkeypatch.delitem(sys.modules, "poseaudit._ros2", raising=False)
    [found] = entry_points(group="ros2cli.command", name="poseaudit")
    return found.load()()


def run(command: Any, *words: str | Path) -> int:
    """Parses the arguments of `ros2 poseaudit` like ros2cli."""
    root = argparse.ArgumentParser(prog="ros2")
    parser = root.add_subparsers().add_parser("poseaudit")
    command.add_arguments(parser, "ros2")
    args = root.parse_args(["poseaudit", *map(str, words)])
    status: int = command.main(parser=parser, args=args)
    return status


def test_options_are_passed_and_the_status_is_returned(
    command: Any, faulty: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(command, "audit", faulty, "--select", "LAT", "--format", "github") == 1
    assert "LAT001" in capfd.readouterr().out
    assert run(command, "audit", faulty, "--select", "YAW", "-q") == 0
    assert run(command, "audit", faulty, "--robt") == 2
    assert run(command, "help") == 0
    assert "record-list" in capfd.readouterr().out


def test_the_command_has_a_description(command: Any) -> None:
    assert type(command).__doc__ == "Audit robot-arm pose logs."
