"""Errors of an audit. Findings are not errors; they are in the report."""

from __future__ import annotations


class PoseauditError(Exception):
    """Base of all errors of this package. The text is one line: place, problem, remedy."""


class CallError(PoseauditError):
    """Invalid call or config, such as an unknown option or a missing file (exit status 2)."""


class LogError(PoseauditError):
    """The log cannot be audited: unreadable, without an arm, or without its model (exit status 3)."""


class ReportError(PoseauditError):
    """Invalid report, or a different schema."""


class ProgramError(PoseauditError):
    """The binary is missing or was terminated."""
