#!/usr/bin/env python3
"""Makes report.png: what `poseaudit demo` prints, with its colours, as a picture.

    python3 docs/images/report.py target/debug/poseaudit

Needs Chromium and Pillow. The text is the program's own output, nothing is typed in here.
"""

import contextlib
import html
import os
import pty
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageChops

BACKGROUND, TEXT, BRIGHT, DIM = "#0d1117", "#c9d1d9", "#f0f6fc", "#8b949e"
COLOURS = {31: "#ff7b72", 32: "#7ee787", 33: "#e3b341", 36: "#79c0ff"}
MARGIN = 24
COLUMNS = 110


def page(ansi: str, command: str) -> str:
    bold, dim, colour, spans = False, False, None, []
    for part in re.split(r"(\x1b\[[\d;]*m)", ansi):
        codes = re.fullmatch(r"\x1b\[([\d;]*)m", part)
        if codes:
            for code in map(int, (codes[1] or "0").split(";")):
                if code == 0:
                    bold, dim, colour = False, False, None
                elif code == 1:
                    bold = True
                elif code == 2:
                    dim = True
                else:
                    colour = COLOURS.get(code)
        elif part:
            shown = colour or (DIM if dim else BRIGHT if bold else TEXT)
            weight = 700 if bold else 400
            spans.append(f'<span style="color:{shown};font-weight:{weight}">{html.escape(part)}</span>')
    return (
        f'<!doctype html><meta charset="utf-8"><body style="margin:0;background:{BACKGROUND}">'
        f'<pre style="margin:{MARGIN}px;font:15px/1.45 \'DejaVu Sans Mono\',monospace">'
        f'<span style="color:{DIM}">$ {html.escape(command)}</span>\n{"".join(spans)}</pre>'
    )


def terminal_output(command: list[str], folder: str, *, status: int = 0, **variables: str) -> str:
    """Output on a terminal of COLUMNS columns, without stderr."""
    child, terminal = pty.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        os.chdir(folder)
        os.execvpe(command[0], command, {**os.environ, "COLUMNS": str(COLUMNS), "CLICOLOR_FORCE": "1", **variables})
    output = b""
    # Linux reports the end of a terminal as an error.
    with contextlib.suppress(OSError):
        while part := os.read(terminal, 1 << 16):
            output += part
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != status:
        sys.exit(f"{command[0]} failed")
    return output.decode().replace("\r\n", "\n")


def screenshot(content: str, width: int, height: int, to: Path, background: str = BACKGROUND) -> None:
    """Writes a picture of an HTML page, without its empty margins."""
    with tempfile.TemporaryDirectory() as folder:
        source, shot = Path(folder, "page.html"), Path(folder, "page.png")
        source.write_text(content, encoding="utf-8")
        chromium = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        size = [f"--window-size={width},{height}", "--force-device-scale-factor=1.5"]
        subprocess.run(
            [*chromium, *size, f"--screenshot={shot}", source.as_uri()], capture_output=True, check=True
        )
        image = Image.open(shot).convert("RGB")
    empty = Image.new("RGB", image.size, background)
    left, top, right, bottom = ImageChops.difference(image, empty).getbbox()
    edge = int(MARGIN * 1.5)
    image = image.crop((max(left - edge, 0), max(top - edge, 0), right + edge, bottom + edge))
    image.quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(to, optimize=True)
    print(f"{to}: {image.size[0]} x {image.size[1]}, {to.stat().st_size} bytes")


def terminal(text: str, command: str, to: Path) -> None:
    """Writes a picture of a terminal."""
    widest = max(len(re.sub(r"\x1b\[[\d;]*m", "", line)) for line in text.splitlines())
    width, height = int(widest * 9.1) + 3 * MARGIN, len(text.splitlines()) * 23 + 200
    screenshot(page(text, command), width, height, to)


def main() -> None:
    program = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        text = terminal_output([str(program), "demo"], folder)
    terminal(text, "poseaudit demo", Path(__file__).with_name("report.png"))


if __name__ == "__main__":
    main()
