#!/usr/bin/env python3
"""Makes the pictures of the pages on pytest, LeRobot, PlotJuggler and Foxglove.

    python3 docs/images/integrations.py target/debug/poseaudit PYTHON [EXTENSION.foxe]

PYTHON is an interpreter with pytest, pyarrow, numpy, markdown and the package poseaudit, and for an EXTENSION with the
packages of tests/foxglove/load.py. Needs Chromium and Pillow. The pictures show real output: that of pytest, the card of a
generated dataset, the curves of a layout, read from its table, and a generated RTDE recording in the extension.
"""

import csv
import html
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import report

IMAGES = Path(__file__).resolve().parent
ROOT = IMAGES.parents[1]

TEST = """def test_calibration_run(pose_audit):
    pose_audit("faulty.mcap", robot="ur5e", require=["LAT001", "ZER001"])
"""

CARD = """
import sys
from pathlib import Path
import lerobot_datasets, markdown, poseaudit

audit = poseaudit.dataset(lerobot_datasets.write(Path(sys.argv[1], "pick_cube"), "v3.0", [0.12, 0.12, 0.2, 0.0, 0.13]))
text = audit.card.read_text(encoding="utf-8").partition("\\n---\\n")[2]
text = text.replace("<details>", '<details open markdown="1">').replace("<summary>", '<summary markdown="0">')
print(markdown.markdown(text, extensions=["tables", "md_in_html"]))
"""

LOADER = """
import sys
from pathlib import Path
import load, tables

program, extension, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
tables.write_tables(tables.motion(program, folder), folder)
load.describe(load.Opened(load.Extension(extension), folder / "rtde.csv"))
"""

STYLE = """
body { margin: 24px; font: 15px/1.5 "DejaVu Sans", sans-serif; color: #1f2328; background: #ffffff; width: 1000px }
td, th { border: 1px solid #d1d9e0; padding: 5px 12px; text-align: left }
table { border-collapse: collapse; margin: 12px 0 }
h2 { border-bottom: 1px solid #d1d9e0; padding-bottom: 6px }
svg { display: block; margin-bottom: 8px } text { font: 12px "DejaVu Sans", sans-serif }
"""


def page(body: str) -> str:
    return f'<!doctype html><meta charset="utf-8"><style>{STYLE}</style><body>{body}'


def picture_of_pytest(python: str, folder: Path, environment: dict[str, str]) -> None:
    (folder / "test_cell.py").write_text(TEST)
    (folder / "faulty.mcap").write_bytes((ROOT / "fixtures" / "faulty.mcap").read_bytes())
    command = [python, "-m", "pytest", "-p", "no:cacheprovider", "--color=yes", "--no-header", "-q"]
    text = report.terminal_output(command, str(folder), status=1, **environment)
    report.terminal(text, "pytest -q", IMAGES / "pytest.png")


def picture_of_card(python: str, folder: Path, environment: dict[str, str]) -> None:
    environment = {**os.environ, **environment}
    environment["PYTHONPATH"] += f"{os.pathsep}{ROOT / 'python' / 'tests'}"
    done = subprocess.run([python, "-c", CARD, folder], env=environment, stdout=subprocess.PIPE, text=True, check=True)
    report.screenshot(page(done.stdout), 1060, 1100, IMAGES / "dataset-card.png", "#ffffff")


def picture_of_loader(program: Path, python: str, extension: Path, folder: Path) -> None:
    environment = {"PYTHONPATH": str(ROOT / "tests" / "foxglove")}
    text = report.terminal_output([python, "-c", LOADER, str(program), str(extension), folder], folder, **environment)
    report.terminal(text, "tests/foxglove/load.py target/debug/poseaudit poseaudit.foxe rtde.csv", IMAGES / "foxglove.png")


def picture_of_layout(program: Path, folder: Path) -> None:
    table = folder / "errors.csv"
    command = [program, "audit", ROOT / "fixtures" / "faulty.mcap", "--quiet", "--plotjuggler", table]
    subprocess.run(command, stdout=subprocess.DEVNULL)
    layout = ElementTree.parse(folder / "errors.layout.xml").getroot()
    with (folder / layout.find(".//fileInfo").attrib["filename"]).open(newline="") as file:
        rows = list(csv.DictReader(file))
    time = layout.find(".//parameters").attrib["time_axis"]
    areas = "".join(plot(area, rows, time) for area in layout.iter("DockArea"))
    tab = html.escape(layout.find(".//Tab").attrib["tab_name"])
    report.screenshot(page(f"<b>{tab}</b>{areas}"), 1060, 800, IMAGES / "plotjuggler.png", "#ffffff")


def plot(area: ElementTree.Element, rows: list[dict[str, str]], time: str) -> str:
    """Draws a plot of the layout as SVG."""
    width, height, left, top = 980, 260, 60, 40
    start, end = float(rows[0][time]), float(rows[-1][time])
    curves = {
        curve.attrib["name"]: (
            curve.attrib["color"],
            [(float(row[time]), float(row[curve.attrib["name"]])) for row in rows if row[curve.attrib["name"]]],
        )
        for curve in area.iter("curve")
    }
    largest = max(value for _, points in curves.values() for _, value in points) * 1.05
    parts = [f'<text x="{left}" y="16">{html.escape(area.attrib["name"])}</text>']
    for at in range(6):
        x, y = left + (width - left) * at / 5, top + (height - top - 24) * at / 5
        parts.append(f'<line x1="{left}" x2="{width}" y1="{y}" y2="{y}" stroke="#e5e8eb"/>')
        parts.append(f'<text x="4" y="{y + 4}">{largest * (1 - at / 5):.2f}</text>')
        parts.append(f'<text x="{x - 44 * (at > 0)}" y="{height}">{(end - start) * at / 5:.1f} s</text>')
    for number, (name, (colour, points)) in enumerate(curves.items()):
        drawn = " ".join(
            f"{left + (width - left) * (t - start) / (end - start):.1f},"
            f"{top + (height - top - 24) * (1 - value / largest):.1f}"
            for t, value in points
        )
        parts.append(f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        label = html.escape(name.rpartition("/")[2])
        parts.append(f'<text x="{left + 90 * number}" y="32" fill="{colour}">{label}</text>')
    return f'<svg width="{width}" height="{height + 8}">{"".join(parts)}</svg>'


def main() -> None:
    program, python = Path(sys.argv[1]).resolve(), sys.argv[2]
    environment = {"POSEAUDIT_BIN": str(program), "PYTHONPATH": str(ROOT / "python")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        picture_of_pytest(python, folder, environment)
        picture_of_card(python, folder, environment)
        picture_of_layout(program, folder)
        if extension := sys.argv[3:]:
            picture_of_loader(program, python, Path(extension[0]).resolve(), folder)


main()
