#!/usr/bin/env python3
"""Opens HTML reports in headless Chromium and checks them like a reader.

    python3 tests/browser/html.py target/debug/poseaudit                    # checks
    python3 tests/browser/html.py target/debug/poseaudit docs/images        # and writes html-*.png there
    python3 tests/browser/html.py --probe                                   # only checks that a browser opens a page

Needs Playwright and Chromium: the one named by CHROMIUM (if empty, Playwright's), else the one on the path, else
Playwright's. The pictures need Pillow, and that of a fleet needs `cargo build --example fleet_logs`. A page must make no
network requests, raise no errors, draw every plot, show values for pointer and keyboard, fit a phone, and print its
plots.
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
    """Writes a report to a file and returns its URL."""
    page = folder / f"{len(list(folder.iterdir()))}.html"
    run = subprocess.run([program, *arguments, "--format", "html"], cwd=folder, stdout=subprocess.PIPE)
    assert run.returncode in (0, 1), f"{arguments}: exit status {run.returncode}"
    page.write_bytes(run.stdout)
    return page.as_uri()


def open_page(browser, address: str, viewport: dict, scheme: str = "light") -> Page:
    """Opens the page. Console messages, errors and requests fail the check."""
    context = browser.new_context(viewport=viewport, color_scheme=scheme, device_scale_factor=1.5)
    page = context.new_page()

    def refuse(what: str):
        raise AssertionError(f"{address}: {what}")

    page.on("console", lambda message: refuse(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: refuse(str(error)))
    page.on("request", lambda request: refuse(request.url) if request.url != address else None)
    page.goto(address)
    return page


def check(browser, address: str) -> None:
    page = open_page(browser, address, WIDE)
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
    # Printing includes every plot, on a light background.
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator(".plot canvas").count() == plots.count()
    assert len(page.pdf(format="A4")) > 10_000
    page.context.close()

    phone = open_page(browser, address, PHONE)
    over = phone.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert over <= 0, f"{over} pixels too wide for a phone"
    phone.context.close()
    open_page(browser, address, WIDE, "dark").context.close()


def check_width(browser, address: str, width: int) -> None:
    """Checks that no table of a fleet page needs horizontal scrolling."""
    page = open_page(browser, address, {"width": width, "height": 900})
    cut = page.evaluate(
        """() => [document.documentElement, ...document.querySelectorAll("table.stack, table.stack th, table.stack td")]
             .filter(part => part.scrollWidth > part.clientWidth + 1).map(part => part.outerHTML.slice(0, 200))"""
    )
    assert not cut, f"{address}: too wide for {width} pixels: {cut[:2]}"
    page.context.close()


def write_screenshots(browser, address: str, to: Path) -> None:
    """Writes screenshots from the top of the page to the end of an element."""
    from PIL import Image

    looks = {
        "wide": (WIDE, "light", "#finding-2"),
        "dark": (WIDE, "dark", "#finding-2"),
        "phone": (PHONE, "light", "#finding-1 .picture"),
    }
    for name, (viewport, scheme, last) in looks.items():
        page = open_page(browser, address, viewport, scheme)
        box = page.locator(last).first.bounding_box()
        clip = {"x": 0, "y": 0, "width": viewport["width"], "height": box["y"] + box["height"] + 12}
        picture = Image.open(io.BytesIO(page.screenshot(full_page=True, clip=clip))).convert("RGB")
        page.context.close()
        path = to / f"html-{name}.png"
        small = picture.quantize(160, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        small.save(path, optimize=True)
        print(f"{path}: {picture.size[0]} x {picture.size[1]}, {path.stat().st_size} bytes")


def launch_browser(playwright):
    """Starts the browser named by CHROMIUM, else the one on the path, else Playwright's."""
    found = os.environ.get("CHROMIUM", shutil.which("chromium") or shutil.which("google-chrome"))
    return playwright.chromium.launch(executable_path=found or None, args=["--no-sandbox"])


def probe() -> None:
    """Fails if no browser opens a page."""
    with sync_playwright() as playwright:
        browser = launch_browser(playwright)
        page = browser.new_page()
        page.goto("data:text/html,<title>there</title>")
        assert page.title() == "there", "the browser opens no page"
        browser.close()


def fleet_report(program: str, folder: Path) -> str:
    """Reports on a fleet: on the example's logs if the example is built, else on the fixtures."""
    example, logs = Path(program).parent / "examples" / "fleet_logs", FIXTURES
    if example.exists():
        logs = folder / "logs"
        subprocess.run([example, logs], check=True)
    results = str(folder / "results")
    call = ["fleet", str(logs), "--out", results, "--labels-from", "{site}/{arm}/*"]
    subprocess.run([program, *call], cwd=folder, stdout=subprocess.DEVNULL)
    return report(program, ["fleet", "report", results], folder)


def write_fleet_screenshot(browser, address: str, to: Path) -> None:
    """Writes a screenshot of the fleet page, down to the end of the trends."""
    from PIL import Image

    page = open_page(browser, address, WIDE)
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
        browser = launch_browser(playwright)
        folder = Path(folder)
        demo = report(program, ["demo", "demo"], folder)
        # With plots of every kind.
        logs = ["clean.mcap", "faulty.mcap", "shake.mcap", "line.mcap", "goal.mcap", "slipped_target.mcap", "stop.mcap"]
        others = [report(program, ["audit", str(FIXTURES / log)], folder) for log in logs]
        fleet_page = fleet_report(program, folder)
        for address in [demo, *others, fleet_page]:
            check(browser, address)
        for width in (1400, 400):
            check_width(browser, fleet_page, width)
        print(f"html: {2 + len(logs)} reports checked in Chromium {browser.version}")
        if len(sys.argv) > 2:
            write_screenshots(browser, demo, Path(sys.argv[2]))
            write_fleet_screenshot(browser, fleet_page, Path(sys.argv[2]))
        browser.close()


probe() if sys.argv[1:] == ["--probe"] else main()
