#!/usr/bin/env python3
"""Opens logs and tables in the Foxglove extension and compares them with the program's report.

    python3 tests/foxglove/load.py target/debug/poseaudit FOLDER/poseaudit.foxe

FOLDER is from `.ci/wasm`. Needs wasmtime, numpy, pyarrow, h5py, openpyxl, mcap-ros2-support and
foxglove-schemas-protobuf. The host (host.py) calls the module as the app does. Topics, counts, stamps, values and
problems must match the written tables, independent readers of the fixtures, and the JSON report.
"""

import bisect
import importlib
import json
import random
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections import Counter, defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from host import Extension, Loader, LoaderError
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from tables import JOINTS, RATE_HZ, Motion, motion, write_csv, write_tables

FIXTURES = Path(__file__).parents[2] / "fixtures"
LOGS = ["faulty.mcap", "imu.mcap", "convention.mcap"]
NANOS = 1_000_000_000
JOINT_STATES, POSE, NUMBERS = "foxglove.JointStates", "foxglove.PoseInFrame", "poseaudit.Numbers"


def report_of(program: str, log: Path) -> dict:
    command = [program, "audit", log, "--format", "json", "--quiet"]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout)


def equal(found: object, expected: object, what: str) -> None:
    assert found == expected, f"{what}: {found!r}, expected {expected!r}"


class Opened:
    """A file in the loader, with all its messages, decoded."""

    def __init__(self, extension: Extension, *files: Path) -> None:
        self.loader: Loader = extension.open(*files)
        self.summary = self.loader.initialize()
        self.name = files[0].name
        self.channels = {channel.topic_name: channel for channel in self.summary.channels}
        self.schemas = {schema.id: schema for schema in self.summary.schemas}
        self.raw = list(self.loader.messages([channel.id for channel in self.summary.channels]))
        self.messages: dict[int, list[SimpleNamespace]] = defaultdict(list)
        for message in self.raw:
            message.content = json.loads(message.data)
            self.messages[message.channel_id].append(message)

    def schema_name(self, topic: str) -> str:
        return self.schemas[self.channels[topic].schema_id].name

    def of(self, topic: str) -> list[SimpleNamespace]:
        assert topic in self.channels, f"{self.name}: no channel {topic}, only {sorted(self.channels)}"
        return self.messages[self.channels[topic].id]


def check_extension(extension: Extension) -> None:
    """The files of an extension, and a script that registers the loader."""
    equal(sorted(extension.names), ["CHANGELOG.md", "README.md", "dist/extension.js", "package.json"], "files")
    for field in ("name", "publisher", "version", "displayName", "description", "license"):
        assert extension.manifest.get(field), f"package.json has no {field}"
    if not (node := shutil.which("node")):
        return print("the script was not run: no node")
    run = """
        const module = { exports: {} };
        new Function("module", "exports", require("fs").readFileSync(0, "utf8"))(module, module.exports);
        const all = [];
        module.exports.activate({ registerDataLoader: (one) => all.push(one) });
        console.log(JSON.stringify(all.map(({ wasmUrl, ...rest }) => ({ ...rest, url: wasmUrl.length }))));
    """
    done = subprocess.run([node, "-e", run], input=extension.script, stdout=subprocess.PIPE, text=True, check=True)
    loaders = json.loads(done.stdout)
    types = [loader["supportedFileType"] for loader in loaders]
    assert len(set(types)) == len(types) and {".csv", ".parquet", ".h5", ".npy"} <= set(types), types
    expected = {"type": "file", "supportsMultiFile": True, "url": loaders[0]["url"]}
    for loader in loaders:
        equal({key: value for key, value in loader.items() if key != "supportedFileType"}, expected, "a loader")
    print(f"registered for {' '.join(types)}")


def check_problems(opened: Opened, report: dict) -> None:
    """The verdict or the error, then the findings in order with their fixes, then remarks."""
    first, *others = opened.summary.problems
    if error := report["error"]:
        equal((first.severity, first.message, first.tip), ("error", f"{error['where']}: {error['what']}", error["do"]), "error")
    else:
        assert first.severity == "info" and first.message.upper().startswith(report["verdict"].upper() + ": "), first
    findings = report["findings"]
    for problem, finding in zip(others, findings, strict=False):
        equal((problem.severity, problem.tip), (finding["severity"], finding["fix"]), finding["code"])
        assert problem.message.startswith(f"{finding['code']} ") and finding["message"] in problem.message, problem
    remarks = others[len(findings) :]
    assert len(others) >= len(findings) and all(remark.severity == "info" for remark in remarks), others
    notes = [note["note"] for note in report["log"].get("notes", [])]
    for note in notes:
        assert any(note in remark.message for remark in remarks), f"{opened.name}: no problem for the note: {note}"


def check_channels(opened: Opened, report: dict) -> None:
    """Every topic that has a role has a channel with its messages and stamps."""
    equal(max(Counter(channel.topic_name for channel in opened.summary.channels).values()), 1, "equal topics")
    kinds = {"joints": JOINT_STATES, "tf": "foxglove.FrameTransform", "imu": "poseaudit.Imu"}
    rows = Counter()
    for stream in report["streams"]:
        rows[stream["topic"]] += stream["count"]
    for stream in report["streams"]:
        topic, role = stream["topic"], stream["role"]
        if role in ("ignored", "description") or stream["count"] == 0:
            continue
        count = opened.channels[topic].message_count if topic in opened.channels else None
        if role in ("tf", "tf_static"):
            assert count and count >= rows[topic], f"{topic}: {count} transforms in {rows[topic]} messages"
        else:
            equal(count, rows[topic], f"{opened.name}: messages of {topic}")
        if role in kinds:
            equal(opened.schema_name(topic), kinds[role], topic)
        if report["log"]["files"][0]["container"] != "mcap":
            stamps = [str(opened.of(topic)[at].log_time) for at in (0, -1)]
            equal(stamps, [stream["start_ns"], stream["end_ns"]], f"{opened.name}: stamps of {topic}")
    for channel in opened.summary.channels:
        equal(len(opened.messages[channel.id]), channel.message_count, f"messages of {channel.topic_name}")
    times = [message.log_time for message in opened.raw]
    assert times == sorted(times), f"{opened.name}: messages are not in order of time"
    time_range = opened.summary.time_range
    equal((times[0], times[-1]), (time_range.start_time, time_range.end_time), "time range")
    audited = [stream["topic"] for stream in report["streams"] if stream["role"] == "pose" and not report["error"]]
    for topic in audited:
        for kind in ("pose", "fk"):
            own = f"/poseaudit/{kind}/{topic.lstrip('/')}"
            if own in opened.channels:
                equal(opened.schema_name(own), POSE, own)
        assert f"/poseaudit/error/{topic.lstrip('/')}" in opened.channels, f"{opened.name}: no errors of {topic}"


def check_schema(name: str, schema: dict, content: object, place: str) -> None:
    """A value has the type of its JSON schema, and no field that is not in it. A limit may be null."""
    kinds = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool}
    if content is None and name == "poseaudit.Error":
        return
    assert isinstance(content, kinds[schema["type"]]), f"{name}{place}: {content!r} is no {schema['type']}"
    if schema["type"] == "object":
        for key, value in content.items():
            assert key in schema["properties"], f"{name}{place}: field {key} is not in the schema"
            check_schema(name, schema["properties"][key], value, f"{place}.{key}")
    if schema["type"] == "array":
        for index, value in enumerate(content):
            check_schema(name, schema["items"], value, f"{place}[{index}]")


def check_schemas(opened: Opened) -> None:
    for topic, channel in opened.channels.items():
        schema = opened.schemas[channel.schema_id]
        equal((schema.encoding, channel.message_encoding), ("jsonschema", "json"), topic)
        fields = json.loads(schema.data)
        for message in opened.of(topic)[:: max(1, channel.message_count // 50)]:
            check_schema(schema.name, fields, message.content, "")
        if schema.name.startswith("foxglove."):
            check_known_fields(schema.name, fields)


def check_known_fields(name: str, schema: dict) -> None:
    """The fields are those of the schema that Foxglove publishes."""
    short = name.removeprefix("foxglove.")
    descriptor = getattr(importlib.import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short).DESCRIPTOR
    pending = [(schema, descriptor)]
    while pending:
        own, known = pending.pop()
        for field, inner in own["properties"].items():
            assert field in known.fields_by_name, f"{name}: Foxglove has no field {known.name}.{field}"
            message = known.fields_by_name[field].message_type
            inner = inner.get("items", inner)
            if message and not message.full_name.startswith("google."):
                pending.append((inner, message))


def check_seeking(opened: Opened) -> None:
    """Ranges and backfill match the complete list of messages."""
    pick = random.Random(1)
    start, end = opened.summary.time_range.start_time, opened.summary.time_range.end_time
    ids = [channel.id for channel in opened.summary.channels]
    exact = [pick.choice(opened.raw).log_time for _ in range(3)]
    for time in [max(start, 1) - 1, start, end, end + 1, *exact, *(pick.randint(start, end) for _ in range(3))]:
        own = pick.sample(ids, pick.randint(1, len(ids)))
        found = {message.channel_id: message.data for message in opened.loader.backfill(own, time)}
        expected = {}
        for channel in own:
            messages = opened.messages[channel]
            if count := bisect.bisect_right(messages, time, key=lambda message: message.log_time):
                expected[channel] = messages[count - 1].data
        equal(found, expected, f"{opened.name}: backfill at {time}")
        last = pick.randint(time, end) if time < end else time
        part = [(message.channel_id, message.log_time) for message in opened.loader.messages(own, time, last)]
        inside = lambda message: message.channel_id in own and time <= message.log_time <= last  # noqa: E731
        expected = [(message.channel_id, message.log_time) for message in opened.raw if inside(message)]
        equal(Counter(part), Counter(expected), f"{opened.name}: messages from {time} to {last}")
        equal([at for _, at in part], sorted(at for _, at in part), "order")


def positions(content: dict) -> list[float]:
    return [joint["position"] for joint in content["joints"]]


def xyz(point: dict) -> list[float]:
    return [point[axis] for axis in "xyz"]


def close(found: list, expected: np.ndarray, tolerance: float, what: str) -> None:
    found = np.array(found)
    equal(found.shape, expected.shape, what)
    error = np.abs(found - expected).max()
    assert error <= tolerance, f"{what} differ by {error}"


def check_table(opened: Opened, of: Motion) -> None:
    """Joints and poses are those of the table."""
    topics = {opened.schema_name(topic): topic for topic in opened.channels if not topic.startswith("/poseaudit/")}
    suffix = Path(opened.name).suffix
    tolerance = 1e-7 if suffix == ".xml" else 1e-12
    if JOINT_STATES in topics:
        messages = opened.of(topics[JOINT_STATES])
        close([positions(message.content) for message in messages], of.q, tolerance, f"{opened.name}: joint positions")
        names = [joint["name"] for joint in messages[0].content["joints"]]
        if opened.name.startswith(("named", "lines")):
            equal(names, JOINTS, opened.name)
        times = np.array([message.log_time - messages[0].log_time for message in messages])
        close(list(times), np.round(of.t * NANOS), 1, f"{opened.name}: stamps")
    # Logged poses, as the audit decoded them.
    poses = [topic for topic in opened.channels if topic.startswith("/poseaudit/pose/")]
    poses += [topics[POSE]] if POSE in topics else []
    tolerance = 1e-8 if suffix == ".xml" else 1e-12
    for topic in poses:
        contents = [message.content for message in opened.of(topic)]
        found = np.array([xyz(content["pose"]["position"]) for content in contents])
        start = opened.of(topic)[0].log_time - opened.summary.time_range.start_time
        first = round(start * RATE_HZ / NANOS)
        close(list(found), of.xyz[first : first + len(found)], tolerance, f"{opened.name}: positions of {topic}")
        if opened.name.startswith("vectors"):
            continue  # positions without rotation
        q = np.array([[content["pose"]["orientation"][axis] for axis in "xyzw"] for content in contents])
        aligned = np.abs(np.sum(q * of.xyzw[first : first + len(q)], axis=1))
        assert aligned.min() > 1 - 1e-9, f"{opened.name}: rotations of {topic} differ"
    if opened.name.startswith(("named", "lines", "packets", "rtde", "unnamed")):
        assert poses and JOINT_STATES in topics, f"{opened.name}: {sorted(topics.values())}"


def check_fixture(opened: Opened, log: Path) -> None:
    """Stamps and values are those that another reader of MCAP decodes."""
    decoded = 0
    with log.open("rb") as stream:
        others = defaultdict(list)
        for schema, channel, message, content in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if schema.name in ("sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"):
                others[channel.topic].append((message.log_time, schema.name, content))
    for topic, messages in others.items():
        own = opened.of(topic)
        equal([message.log_time for message in own], [time for time, _, _ in messages], f"{log.name}: stamps of {topic}")
        for message, (_, kind, other) in zip(own, messages):
            stamp = message.content["timestamp"]
            equal((stamp["sec"], stamp["nsec"]), (other.header.stamp.sec, other.header.stamp.nanosec), topic)
            if kind == "sensor_msgs/msg/JointState":
                found = {joint["name"]: joint["position"] for joint in message.content["joints"]}
                equal(found, dict(zip(other.name, other.position)), topic)
            else:
                pose = message.content["pose"]
                equal(xyz(pose["position"]), [getattr(other.pose.position, axis) for axis in "xyz"], topic)
                expected = {axis: getattr(other.pose.orientation, axis) for axis in "xyzw"}
                equal(pose["orientation"], expected, topic)
            decoded += 1
    assert decoded > 500, f"{log.name}: only {decoded} messages were compared"


def check_unreadable(extension: Extension, program: str, folder: Path) -> None:
    """A file that is not a log is refused with the program's words."""
    for name, content in (("noise.csv", bytes(range(256)) * 9), ("empty.npy", b"")):
        file = folder / name
        file.write_bytes(content)
        error = report_of(program, file)["error"]
        loader = extension.open(file)
        try:
            summary = loader.initialize()
        except LoaderError as refusal:
            equal(str(refusal), f"{error['where']}: {error['what']}; {error['do']}", name)
        else:
            raise AssertionError(f"{name} was opened: {summary}")
        equal(loader.console, [], name)
        print(f"{name}: {error['what']}")


def check_several_files(extension: Extension, folder: Path, of: Motion) -> None:
    """Files that are opened together are one run."""
    rows = np.column_stack([of.t, of.q]), np.column_stack([of.t, of.xyz, of.xyzw])
    files = folder / "joints_run.csv", folder / "tcp_run.csv"
    files[0].write_text(write_csv(["timestamp", *JOINTS], rows[0]))
    files[1].write_text(write_csv(["timestamp", "x", "y", "z", "qx", "qy", "qz", "qw"], rows[1]))
    opened = Opened(extension, *files)
    names = {opened.schema_name(topic) for topic in opened.channels}
    assert JOINT_STATES in names and any(topic.startswith("/poseaudit/fk/") for topic in opened.channels), names
    print(f"two files of one run: {len(opened.channels)} channels")


def describe(opened: Opened) -> None:
    """Channels and problems, as the picture shows them."""
    print("channels")
    for topic, channel in opened.channels.items():
        print(f"  {topic:<40} {opened.schema_name(topic):<24} {channel.message_count:>6} messages")
    print("problems")
    for problem in opened.summary.problems:
        colour = {"error": 31, "warning": 33, "info": 36}[problem.severity]
        print(f"  \x1b[{colour}m{problem.severity}\x1b[0m")
        for line in [*problem.message.splitlines(), *(f"tip: {line}" for line in (problem.tip or "").splitlines())]:
            print(textwrap.fill(line, 110, initial_indent="    ", subsequent_indent="      "))


def main() -> None:
    program, extension = str(Path(sys.argv[1]).resolve()), Extension(Path(sys.argv[2]))
    if files := [Path(name) for name in sys.argv[3:]]:
        return describe(Opened(extension, *files))
    check_extension(extension)
    with tempfile.TemporaryDirectory() as name:
        work, folder = Path(name), Path(name, "tables")
        folder.mkdir()
        of = motion(program, work)
        tables = write_tables(of, folder)
        for log in [*(FIXTURES / log for log in LOGS), *tables]:
            opened, report = Opened(extension, log), report_of(program, log)
            check_problems(opened, report)
            check_channels(opened, report)
            check_schemas(opened)
            check_seeking(opened)
            check_fixture(opened, log) if log.suffix == ".mcap" else check_table(opened, of)
            equal(opened.loader.console, [], log.name)
            codes = " ".join(finding["code"] for finding in report["findings"]) or report["verdict"]
            print(f"{log.name}: {len(opened.channels)} channels, {len(opened.raw)} messages, {codes}: as in the report")
        check_several_files(extension, work, of)
        check_unreadable(extension, program, work)


if __name__ == "__main__":
    main()
