"""What keeps an audit from being one. A finding is no error: it is in the report."""

from __future__ import annotations


class PoseauditError(Exception):
    """Every error of this package. Its text is one line: where, what, and what to do."""


class CallError(PoseauditError):
    """The call or the config is wrong: an option, a file that is not there (exit status 2)."""


class LogError(PoseauditError):
    """The log cannot be audited: unreadable, no arm in it, no model of the arm (exit status 3)."""


class ReportError(PoseauditError):
    """What should be a report is none, or one of another schema."""


class ProgramError(PoseauditError):
    """The binary is not there, or it died."""
