"""Audits recorded runs of robot arms: finds wrong poses, stamps and conventions, with their magnitude and
uncertainty.

    >>> import poseaudit
    >>> report = poseaudit.audit("run.mcap", robot="ur5e")
    >>> report.verdict
    'fail'
    >>> report.findings.to_polars()

The package runs its binary `poseaudit`, which is also available as `python -m poseaudit`.
"""

from ._audit import audit
from ._compare import Comparison, compare
from ._dataset import Amount, Dataset, Episode, dataset
from ._desk import fk, pose
from ._errors import CallError, LogError, PoseauditError, ProgramError, ReportError
from ._fleet import Failure, Fleet, fleet
from ._frame import Rows
from ._options import FleetOptions, Options
from ._report import (
    Check,
    Estimate,
    File,
    Finding,
    Ignored,
    JointCoverage,
    Log,
    Note,
    Plan,
    Report,
    Robot,
    Rotation,
    Stream,
    StreamComparison,
    Subject,
    Tool,
    TrajectoryError,
    Trouble,
    Workspace,
)

__all__ = [
    "Amount",
    "CallError",
    "Check",
    "Comparison",
    "Dataset",
    "Episode",
    "Estimate",
    "Failure",
    "File",
    "Finding",
    "Fleet",
    "FleetOptions",
    "Ignored",
    "JointCoverage",
    "Log",
    "LogError",
    "Note",
    "Options",
    "Plan",
    "PoseauditError",
    "ProgramError",
    "Report",
    "ReportError",
    "Robot",
    "Rotation",
    "Rows",
    "Stream",
    "StreamComparison",
    "Subject",
    "Tool",
    "TrajectoryError",
    "Trouble",
    "Workspace",
    "audit",
    "compare",
    "dataset",
    "fk",
    "fleet",
    "pose",
]
