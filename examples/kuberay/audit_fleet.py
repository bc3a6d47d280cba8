"""Audits the logs that are named over the Ray cluster that this runs on.

python audit_fleet.py OUT SOURCE...
"""

import sys

import poseaudit


def main(out: str, *sources: str) -> int:
    done = poseaudit.fleet(
        sources,
        out,
        engine="ray",
        progress=True,
        # Logs of a gigabyte each are told by path, size and time, and not read for a hash.
        identity="file",
        memory="2GiB",
        timeout=600,
        labels_from="{site}/{arm}/*",
    )
    print(
        f"{done.logs} logs: {done.done_now} done now, {done.done_before} before, {done.retried} begun again"
    )
    for failure in done.errors[:20]:
        print(f"{failure.path}: {failure.status}: {failure.what}", file=sys.stderr)
    return 1 if done.failing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
