#!/usr/bin/env python3
"""Opens HTML reports in headless Chromium and looks at them as a reader would.

    python3 tests/browser/html.py target/debug/poseaudit                    # checks
    python3 tests/browser/html.py target/debug/poseaudit docs/images        # and makes html-*.png there
    python3 tests/browser/html.py --probe                                   # only whether a browser opens a page

Needs Playwright, and Chromium (CHROMIUM says which, empty Playwright's own; else the one on the path, else that);
the pictures need Pillow, and `cargo build --example fleet_logs` for that of a fleet. A page must ask the network for nothing, raise no error, draw every plot, show
a value under the pointer and to the keyboard, fit a phone, and print with its plots.
"""

import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

WIDE, PHONE = {"width": 1100, "height": 900}, {"width": 375, "height": 780}
FIXTURES = Path(__file__).parents[2] / "fixtures"


def report(program: str, arguments: list[str], folder: Path) -> str:
    """The report in a file, as an address."""
    page = folder / f"{len(list(folder.iterdir()))}.html"
    run = subprocess.run([program, *arguments, "--format", "html"], cwd=folder, stdout=subprocess.PIPE)
    assert run.returncode in (0, 1), f"{arguments}: exit status {run.returncode}"
    page.write_bytes(run.stdout)
    return page.as_uri()


def opened(browser, address: str, viewport: dict, scheme: str = "light") -> Page:
    """The page; whatever it complains of or asks for fails the check."""
    context = browser.new_context(viewport=viewport, color_scheme=scheme, device_scale_factor=1.5)
    page = context.new_page()

    def refuse(what: str):
        raise AssertionError(f"{address}: {what}")

    page.on("console", lambda said: refuse(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: refuse(str(error)))
    page.on("request", lambda asked: refuse(asked.url) if asked.url != address else None)
    page.goto(address)
    return page


def check(browser, address: str) -> None:
    page = opened(browser, address, WIDE)
    plots = page.locator(".plot")
    assert plots.count() == page.locator(".plot canvas").count(), "a plot is not drawn"
    for plot in plots.all():
        assert plot.get_attribute("aria-label"), "a plot has no name"
        plot.scroll_into_view_if_needed()
        box = plot.locator(".u-over").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        values = plot.locator(".u-value").all_inner_texts()
        assert any(any(c.isdigit() for c in value) for value in values[1:]), f"no value under the pointer: {values}"
        plot.focus()
        for key in ("ArrowRight", "ArrowRight"):
            page.keyboard.press(key)
        readout = plot.locator("xpath=..").locator(".readout").inner_text()
        assert any(c.isdigit() for c in readout.partition(": ")[2]), f"no value for the keyboard: {readout!r}"
        assert plot.locator("xpath=..").locator("details table tbody tr").count() > 1, "no table behind a plot"
    for plane in page.locator("svg.plane").all():
        assert plane.get_attribute("aria-label"), "a plane has no name"
        outside = plane.evaluate(
            """svg => [...svg.querySelectorAll("circle.dot, line, text")].filter(part => {
                 const [a, b] = [part.getBoundingClientRect(), svg.getBoundingClientRect()];
                 return a.left < b.left - 1 || a.right > b.right + 1 || a.top < b.top - 1 || a.bottom > b.bottom + 1;
               }).map(part => part.outerHTML)"""
        )
        assert not outside, f"clipped: {outside[:3]}"
    levels = [int(h.evaluate("h => h.tagName[1]")) for h in page.locator("h1, h2, h3, details[open] h4").all()]
    assert levels[0] == 1 and all(b - a <= 1 for a, b in zip(levels, levels[1:])), f"headings: {levels}"
    assert page.locator("main").count() == 1
    # On paper every plot is there, on light ground.
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator(".plot canvas").count() == plots.count()
    assert len(page.pdf(format="A4")) > 10_000
    page.context.close()

    phone = opened(browser, address, PHONE)
    over = phone.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert over <= 0, f"{over} pixels too wide for a phone"
    phone.context.close()
    opened(browser, address, WIDE, "dark").context.close()


def shoot(browser, address: str, to: Path) -> None:
    """Pictures of the top of the page, down to the end of a part of it."""
    from PIL import Image

    looks = {
        "wide": (WIDE, "light", "#finding-2"),
        "dark": (WIDE, "dark", "#finding-2"),
        "phone": (PHONE, "light", "#finding-1 .picture"),
    }
    for name, (viewport, scheme, last) in looks.items():
        page = opened(browser, address, viewport, scheme)
        box = page.locator(last).first.bounding_box()
        clip = {"x": 0, "y": 0, "width": viewport["width"], "height": box["y"] + box["height"] + 12}
        picture = Image.open(io.BytesIO(page.screenshot(full_page=True, clip=clip))).convert("RGB")
        page.context.close()
        path = to / f"html-{name}.png"
        small = picture.quantize(160, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        small.save(path, optimize=True)
        print(f"{path}: {picture.size[0]} x {picture.size[1]}, {path.stat().st_size} bytes")


def launched(playwright):
    """The browser that CHROMIUM names, else the one on the path, else Playwright's own."""
    found = os.environ.get("CHROMIUM", shutil.which("chromium") or shutil.which("google-chrome"))
    return playwright.chromium.launch(executable_path=found or None, args=["--no-sandbox"])


def probe() -> None:
    """Fails where no browser opens a page."""
    with sync_playwright() as playwright:
        browser = launched(playwright)
        page = browser.new_page()
        page.goto("data:text/html,<title>there</title>")
        assert page.title() == "there", "the browser opens no page"
        browser.close()


def fleet(program: str, folder: Path) -> str:
    """The report on a fleet: of the example's logs where it is built beside the program, else of the fixtures."""
    example, logs = Path(program).parent / "examples" / "fleet_logs", FIXTURES
    if example.exists():
        logs = folder / "logs"
        subprocess.run([example, logs], check=True)
    results = str(folder / "results")
    call = ["fleet", str(logs), "--out", results, "--labels-from", "{site}/{arm}/*"]
    subprocess.run([program, *call], cwd=folder, stdout=subprocess.DEVNULL)
    return report(program, ["fleet", "report", results], folder)


def shoot_fleet(browser, address: str, to: Path) -> None:
    """A picture of the fleet's page, down to the end of what moves."""
    from PIL import Image

    page = opened(browser, address, WIDE)
    box = page.locator("#findings-title").bounding_box()
    clip = {"x": 0, "y": 0, "width": WIDE["width"], "height": box["y"]}
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True, clip=clip))).convert("RGB")
    page.context.close()
    path = to / "fleet.png"
    picture.quantize(160, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {picture.size[0]} x {picture.size[1]}, {path.stat().st_size} bytes")


def main() -> None:
    program = str(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = launched(playwright)
        folder = Path(folder)
        demo = report(program, ["demo", "demo"], folder)
        # With pictures of every kind.
        logs = ["clean.mcap", "faulty.mcap", "shake.mcap", "line.mcap", "goal.mcap", "slipped_target.mcap", "stop.mcap"]
        others = [report(program, ["audit", str(FIXTURES / log)], folder) for log in logs]
        many = fleet(program, folder)
        for address in [demo, *others, many]:
            check(browser, address)
        print(f"html: {2 + len(logs)} reports looked at in Chromium {browser.version}")
        if len(sys.argv) > 2:
            shoot(browser, demo, Path(sys.argv[2]))
            shoot_fleet(browser, many, Path(sys.argv[2]))
        browser.close()


probe() if sys.argv[1:] == ["--probe"] else main()
