"""Audits logs on the Ray cluster that runs this script.

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
        # Identify large logs by path, size and time, without reading them for a hash.
        identity="file",
        memory="2GiB",
        timeout=600,
        labels_from="{site}/{arm}/*",
    )
    print(
        f"{done.logs} logs: {done.done_now} done now, {done.done_before} before, {done.retried} restarted"
    )
    for failure in done.errors[:20]:
        print(f"{failure.path}: {failure.status}: {failure.what}", file=sys.stderr)
    return 1 if done.failing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
