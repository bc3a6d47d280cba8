#!/usr/bin/env python3
"""Audits logs in a bucket of moto, a local S3 server started by this script.

    python3 tests/remote/bucket.py target/debug/poseaudit

Needs `moto[s3]` and `flask-cors`. The reports on a log in the bucket and on the local file must be equal. Only a small
part of a log with images may be fetched. Each error must print one line and exit with its status.
tests/remote/main.rs tests the rest without Python.
"""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

FIXTURES = Path(__file__).parents[2] / "fixtures"
BUCKET = "logs"


def run(program: str, endpoint: str, *arguments: str) -> tuple[int, str, str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
    environment |= {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "NO_PROXY": "127.0.0.1",
    }
    done = subprocess.run([program, *arguments], env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def audit_log(program: str, endpoint: str, log: str) -> tuple[int, dict, int | None]:
    """Exit status, report without the log's name, and number of fetched bytes."""
    status, out, err = run(program, endpoint, "audit", log, "--format", "json")
    assert status in (0, 1), f"{log}: {err}"
    report = json.loads(out.replace(shlex.quote(log), "LOG").replace(log, "LOG"))
    fetched = [file.pop("fetched_bytes", None) for file in report["log"]["files"]]
    return status, report, fetched[0]


def main(program: str) -> None:
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    client = boto3.client(
        "s3",
        endpoint_url=endpoint,
        region_name="us-east-1",
        aws_access_key_id="testing",
        aws_secret_access_key="testing",
    )
    client.create_bucket(Bucket=BUCKET)
    logs = [FIXTURES / name for name in ("faulty.mcap", "clean.mcap")]
    logs += [Path(log) for log in sys.argv[2:]]
    for log in logs:
        client.upload_file(str(log), BUCKET, f"cell 7/{log.name}")
        here, there = (
            audit_log(program, endpoint, str(log)),
            audit_log(program, endpoint, f"s3://{BUCKET}/cell 7/{log.name}"),
        )
        assert here[2] is None and here[:2] == there[:2], f"{log}: the reports on object and file differ"
        size = log.stat().st_size
        print(f"{log.name}: {there[2]} of {size} bytes fetched ({100 * there[2] / size:.1f} %)")
    for url, status, part in [
        (f"s3://{BUCKET}/none.mcap", 2, "no such object"),
        ("s3://nowhere/none.mcap", 2, "no such bucket"),
    ]:
        got, _, err = run(program, endpoint, "audit", url)
        assert got == status and part in err and err.count("\n") == 1, (got, err)
        print(err.strip())
    server.stop()
    got, _, err = run(program, endpoint, "audit", f"s3://{BUCKET}/cell 7/clean.mcap")
    assert got == 3 and "cannot be reached" in err and err.count("\n") == 1, (got, err)
    print(err.strip())


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()))
