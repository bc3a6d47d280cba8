"""`ros2 poseaudit`: the program as a ros2cli command, found by its entry point."""

from __future__ import annotations

import argparse
import subprocess
from typing import Any

from ros2cli.command import CommandExtension

from ._binary import find_binary
from ._errors import ProgramError


class PoseauditCommand(CommandExtension):
    """Audit robot-arm pose logs."""

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str, *, argv: Any = None) -> None:
        """Passes all arguments after the command to the program."""
        parser.add_argument("command", help="A command of poseaudit, such as audit; `help` lists them")
        parser.add_argument("arguments", nargs=argparse.REMAINDER, help="Arguments of the command")

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        """Runs the program in the same terminal, and returns its exit status."""
        call = ["--help"] if args.command == "help" else [args.command, *args.arguments]
        try:
            return subprocess.run([str(find_binary()), *call], check=False).returncode
        except ProgramError as error:
            parser.error(str(error))
