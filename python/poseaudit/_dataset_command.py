"""The command `poseaudit dataset`, also installed as `poseaudit-dataset`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ._dataset import Dataset, dataset
from ._errors import PoseauditError
from ._options import SWITCHES, FleetOptions, names

_FAILING, _MISUSE, _NONE_AUDITED = 1, 2, 3

_EPILOG = """
The other options are passed to `poseaudit fleet`, such as --robot, --config, --select and --fail-on.

Exit status: 0 nothing at or above --fail-on; 1 a finding, or an episode that could not be audited;
2 invalid call, or huggingface_hub is missing; 3 no episode could be audited.

Examples:
  poseaudit dataset ~/.cache/huggingface/lerobot/me/pick_cube --robot so101
  poseaudit dataset me/pick_cube --out card
  hf upload me/pick_cube card . --repo-type dataset
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit status."""
    parser = _parser()
    given = vars(parser.parse_args(arguments))
    source, quiet = given.pop("source"), given.pop("quiet")
    try:
        audit = dataset(source, progress=not quiet, **given)
    except PoseauditError as error:
        print(f"error: {error}", file=sys.stderr)
        return _MISUSE
    print(_outcome(audit))
    if not audit.audited:
        return _NONE_AUDITED
    return _FAILING if audit.failing else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="poseaudit dataset",
        description="Audits each episode of a LeRobot dataset, and writes the result into its card.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "source",
        metavar="DATASET",
        help="the folder of a LeRobot dataset, or OWNER/NAME on the hub (also hf://datasets/OWNER/NAME@REVISION)",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for the card and the tables [default: the dataset's]"
    )
    parser.add_argument("--results", metavar="DIR", help="keep the results, so that later calls skip them")
    parser.add_argument("--revision", metavar="REV", help="branch, tag or commit of a dataset of the hub")
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="episodes to audit at a time [default: all cores]"
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress")
    for name in names(FleetOptions):
        flag = "--" + name.replace("_", "-")
        if name in SWITCHES:
            parser.add_argument(flag, dest=name, action="store_true", help=argparse.SUPPRESS)
        elif name in ("fail_on", "config", "base", "tip", "reference", "stamp", "identity", "labels_from"):
            parser.add_argument(flag, dest=name, help=argparse.SUPPRESS)
        else:
            parser.add_argument(flag, dest=name, action="append", help=argparse.SUPPRESS)
    return parser


def _outcome(audit: Dataset) -> str:
    """Two lines: the result, and the files written."""
    counts = ", ".join(f"{audit.count(verdict)} {verdict}" for verdict in ("pass", "fail", "inconclusive"))
    skipped = len(audit.episodes) - audit.audited
    missing = max(0, (audit.expected or 0) - len(audit.episodes))
    parts = [f"{len(audit.episodes)} episodes: {counts}"]
    parts += [f"{skipped} not audited"] if skipped else []
    parts += [f"{missing} listed in meta/info.json without data"] if missing else []
    return f"{audit.verdict.upper()}  {'; '.join(parts)}\nwrote {audit.card}, {audit.json}, {audit.table}"


if __name__ == "__main__":
    sys.exit(main())
