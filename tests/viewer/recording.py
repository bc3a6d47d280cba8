#!/usr/bin/env python3
"""Opens recordings in the Rerun viewer and checks its screenshots.

    python3 tests/viewer/recording.py target/debug/poseaudit                # checks
    python3 tests/viewer/recording.py target/debug/poseaudit docs/images    # and writes pictures there
    python3 tests/viewer/recording.py --probe                               # only checks that the viewer draws

Needs the viewer of the crate's minor version and Pillow (pip install rerun-sdk==0.36.* pillow), and Vulkan: a driver, or
Mesa's lavapipe (apt install mesa-vulkan-drivers). The viewer runs headless. It must open the demo's recording, a
layer with its log, and a log through the importer, without warnings. It must show a scene, plots, spans and text.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

FIXTURES = Path(__file__).parents[2] / "fixtures"
VIEWER = Path(sys.executable).with_name("rerun")
SIZE = (1400, 900)
TIMEOUT_S = 150
# Messages about the machine, not about the opened file.
MACHINE_MESSAGES = re.compile(
    "software rasterizer|docker|xsettings|xrandr|xdg_runtime_dir|parse locale|analytics", re.IGNORECASE
)


def free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


class Viewer:
    """A headless viewer with open files."""

    def __init__(self, files: list[Path], folder: Path, programs: Path | None = None, log: str = "warn"):
        self.port, self.folder, self.log_file = free_port(), folder, folder / f"{time.monotonic_ns()}.log"
        path = os.pathsep.join([str(programs)] * bool(programs) + [os.environ["PATH"]])
        # Separate settings, so that the user's have no effect.
        homes = {name: str(folder) for name in ("XDG_RUNTIME_DIR", "XDG_CONFIG_HOME", "XDG_DATA_HOME")}
        environment = {**os.environ, **homes, "PATH": path, "RUST_LOG": log, "NO_COLOR": "1"}
        command = [VIEWER, *files, "--headless", "--hide-welcome-screen", "--renderer", "vulkan"]
        command += ["--port", str(self.port), "--window-size", "x".join(map(str, SIZE))]
        # No telemetry.
        subprocess.run([VIEWER, "analytics", "disable"], env=environment, capture_output=True, check=True)
        with self.log_file.open("wb") as log_output:
            # A separate process group: the command is a script that starts the viewer.
            self.process = subprocess.Popen(
                command, env=environment, stdout=log_output, stderr=log_output, start_new_session=True
            )

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *_) -> None:
        import signal

        try:
            os.killpg(self.process.pid, signal.SIGTERM)
        except ProcessLookupError:
            pass
        self.process.wait()

    def warnings(self) -> list[str]:
        lines = self.log_file.read_text(errors="replace").splitlines()
        lines = [re.sub(r"\x1b\[[\d;]*m", "", line) for line in lines]
        severe = [line for line in lines if re.search(r"WARN|ERROR|error|panicked", line)]
        return [line for line in severe if not MACHINE_MESSAGES.search(line)]

    def picture(self, missing_part) -> Image.Image:
        """Returns a screenshot for which `missing_part` returns an empty string."""
        from rerun.experimental import ViewerClient

        deadline, why = time.monotonic() + TIMEOUT_S, "it shows nothing"
        while time.monotonic() < deadline:
            assert self.process.poll() is None, f"the viewer ended: {self.warnings()[-1:]}"
            time.sleep(1)
            at = self.folder / f"{time.monotonic_ns()}.png"
            try:
                ViewerClient.connect(f"rerun+http://127.0.0.1:{self.port}/proxy").save_screenshot(str(at))
            except (OSError, RuntimeError) as error:
                why = f"no picture of it: {error}"
                continue
            image = open_when_written(at, deadline)
            why = missing_part(image) if image else "no picture of it"
            if not why:
                return image
        raise AssertionError(f"{why}, after {TIMEOUT_S} s")


def open_when_written(picture: Path, deadline: float) -> Image.Image | None:
    """Returns a picture when it is completely written, which the viewer does asynchronously."""
    while time.monotonic() < deadline:
        try:
            return Image.open(picture).convert("RGB")
        except (OSError, SyntaxError):
            time.sleep(0.5)
    return None


def blank_part(image: Image.Image, parts: dict[str, tuple[float, float, float, float]]) -> str:
    """Names a blank part of the picture, each given by relative bounds. Empty if there is none."""
    width, height = image.size
    for name, (left, top, right, bottom) in parts.items():
        part = image.crop((int(left * width), int(top * height), int(right * width), int(bottom * height)))
        colours = part.resize((part.width // 2, part.height // 2)).quantize(64).getcolors()
        most = max(count for count, _ in colours) / sum(count for count, _ in colours)
        if len(colours) < 12 or most > 0.995:
            return f"{name} is blank"
    return ""


LOGGED, EXPLAINED = (240, 80, 60), (60, 200, 110)


def count_pixels(image: Image.Image, rgb: tuple[int, int, int], near: int = 40) -> int:
    """Counts pixels near a colour, in the image at half resolution."""
    small = image.resize((image.width // 2, image.height // 2), Image.Resampling.NEAREST)
    return sum(
        count
        for count, colour in small.getcolors(small.width * small.height)
        if all(abs(a - b) <= near for a, b in zip(colour, rgb))
    )


PARTS = {
    "the scene": (0.02, 0.08, 0.53, 0.68),
    "what proves the finding": (0.57, 0.08, 0.98, 0.68),
    "the spans and lines": (0.02, 0.75, 0.98, 0.95),
}


def missing_in_audit(image: Image.Image) -> str:
    if min(count_pixels(image, LOGGED), count_pixels(image, EXPLAINED)) < 30:
        return "the tool as logged and as explained is not there"
    return blank_part(image, PARTS)


def write_small(image: Image.Image, path: Path) -> None:
    image.resize(SIZE, Image.Resampling.LANCZOS).quantize(200, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {SIZE[0]} x {SIZE[1]}, {path.stat().st_size} bytes")


def check(files: list[Path], folder: Path, programs: Path | None = None) -> Image.Image:
    with Viewer(files, folder, programs) as viewer:
        image = viewer.picture(missing_in_audit)
        warnings = viewer.warnings()
    assert not warnings, f"{files[-1].name}: the viewer complains: {warnings}"
    return image


def record_demo(program: Path, folder: Path) -> Path:
    """The recording of the demo."""
    run = subprocess.run([program, "demo", "demo"], cwd=folder, stdout=subprocess.DEVNULL)
    assert run.returncode == 0, f"demo: exit status {run.returncode}"
    path = folder / "demo.rrd"
    command = [program, "audit", "demo/demo.mcap", "--rrd", path]
    run = subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL)
    assert run.returncode == 1, f"audit: exit status {run.returncode}"
    return path


def record_layer(program: Path, folder: Path) -> list[Path]:
    """A log as the viewer converts it, with a point cloud at the tool, and the audit as its layer."""
    import math

    import rerun

    log, cloud, base, layer = (folder / f"{name}.rrd" for name in ("run", "cloud", "log", "layer"))
    ids = ["--application-id", "cell", "--recording-id", "run-1"]
    call = [VIEWER, "mcap", "convert", FIXTURES / "faulty.mcap", *ids, "-o", log]
    subprocess.run(call, check=True, capture_output=True)
    with rerun.RecordingStream("cell", recording_id="run-1", send_properties=False) as recording:
        recording.save(cloud)
        turns = [(at / 40, at * 2.4) for at in range(600)]
        points = [(0.006 * r * math.cos(a), 0.006 * r * math.sin(a), 0.12 + 0.01 * r) for r, a in turns]
        frame, cloud_points = rerun.CoordinateFrame("tool0"), rerun.Points3D(points, colors=(90, 160, 255), radii=0.004)
        recording.log("camera/points", frame, cloud_points, static=True)
    merge([log, cloud], base)
    command = [program, "audit", FIXTURES / "faulty.mcap", "--rrd", layer, "--rrd-layer", base]
    run = subprocess.run(command, stdout=subprocess.DEVNULL)
    assert run.returncode == 1, f"audit: exit status {run.returncode}"
    merged = folder / "merged.rrd"
    merge([base, layer], merged)
    printed = subprocess.run([VIEWER, "rrd", "print", merged], check=True, capture_output=True, text=True).stdout
    recordings = len(set(re.findall(r"Recording,\s*\"([^\"]+)\",\s*\"([^\"]+)\"", printed)))
    assert recordings == 1, f"log and audit are {recordings} recordings"
    return [base, layer]


def merge(files: list[Path], to: Path) -> None:
    subprocess.run([VIEWER, "rrd", "merge", *files, "-o", to], check=True, capture_output=True)


def main() -> None:
    program = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        check([record_demo(program, folder)], folder)
        layered = record_layer(program, folder)
        check(layered, folder)
        # A finding without a scene: bars and a trace.
        shake = folder / "shake.rrd"
        subprocess.run([program, "audit", FIXTURES / "shake.mcap", "--rrd", shake], stdout=subprocess.DEVNULL)
        with Viewer([shake], folder) as viewer:
            viewer.picture(lambda image: blank_part(image, PARTS))
            assert not viewer.warnings(), f"{shake.name}: the viewer complains: {viewer.warnings()}"
        importers = folder / "importers"
        importers.mkdir()
        importer = shutil.which("rerun-importer-poseaudit", path=program.parent)
        assert importer, f"no importer in the folder of {program}"
        (importers / Path(importer).name).symlink_to(importer)
        # The viewer does not call importers for file types that it reads itself.
        log = folder / "faulty.log"
        shutil.copy(FIXTURES / "faulty.mcap", log)
        check([log], folder, importers)
        print("recording: the demo, a layer and a log with the importer looked at in the viewer")
        if len(sys.argv) > 2:
            for files, name in (([folder / "demo.rrd"], "recording.png"), (layered, "rerun-layer.png")):
                # Log messages would cover the picture.
                with Viewer(files, folder, log="off") as viewer:
                    # The recording plays, so take several pictures and keep the one that shows both tools best.
                    images = [viewer.picture(missing_in_audit) for _ in range(6)]
                image = max(images, key=lambda it: min(count_pixels(it, LOGGED), count_pixels(it, EXPLAINED)))
                write_small(image, Path(sys.argv[2]) / name)


def probe() -> None:
    """Fails if the viewer draws nothing."""
    with tempfile.TemporaryDirectory() as folder, Viewer([], Path(folder)) as viewer:
        everywhere = {"the window": (0.0, 0.0, 1.0, 1.0)}
        try:
            viewer.picture(lambda image: blank_part(image, everywhere))
        except AssertionError as error:
            raise SystemExit(f"the viewer draws nothing: {error}") from None


probe() if sys.argv[1:] == ["--probe"] else main()
