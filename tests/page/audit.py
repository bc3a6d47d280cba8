#!/usr/bin/env python3
"""Audits every fixture in the page built by `.ci/wasm`, in headless Chromium, and compares the reports with the
program's.

    python3 tests/page/audit.py target/debug/poseaudit FOLDER                # checks
    python3 tests/page/audit.py target/debug/poseaudit FOLDER --time LOG ... # compares the run times
    python3 tests/page/audit.py target/debug/poseaudit FOLDER --picture FILE # and writes a screenshot of the page

Needs Playwright and Chromium, see tests/browser/html.py. After loading, the page must make no network requests and raise
no errors. Its reports must equal the program's, with numbers equal up to rounding.
"""

import base64
import json
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Page, sync_playwright

FIXTURES = Path(__file__).parents[2] / "fixtures"
# Maximum size of the packed module.
MAX_MODULE_BYTES = 8_000_000
# Rounding of math functions differs between program and page; iterations that stop at a tolerance amplify it: 0.1 µm, 0.1 µrad.
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-6, 1e-7
# In standard deviations of the noise: square root of the cancellation error, far below the observable minimum.
SINGULAR_VALUE_TOLERANCE = 1e-4
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TIMEOUT_MS = 300_000


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves a folder without logging."""

    def log_message(self, *_):
        pass


def serve_folder(folder: Path) -> str:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/index.html"


def open_page(browser, address: str) -> Page:
    """Opens the page. Errors and requests for other resources fail the check."""
    page = browser.new_context(viewport={"width": 1100, "height": 1000}, accept_downloads=True).new_page()
    own, loaded = address.rsplit("/", 1)[0], []

    def refuse(what: str):
        raise AssertionError(f"{address}: {what}")

    def check_request(url: str):
        # Created by the page, such as a worker or a download link.
        if url.startswith(("blob:", "data:", "about:")):
            return
        if loaded or not url.startswith(own):
            refuse(f"it asks for {url}")

    page.on("console", lambda message: refuse(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: refuse(str(error)))
    page.on("request", lambda request: check_request(request.url))
    page.goto(address)
    loaded.append(True)
    return page


def download_text(page: Page, link: str) -> str:
    with page.expect_download() as download:
        page.click(link)
    return Path(download.value.path()).read_text(encoding="utf-8")


def audit_in_page(page: Page, *files: Path, robot: str = "") -> tuple[int, str, str]:
    """Audits in the page: returns the exit status, the line below the form, and the report as JSON."""
    page.click("#clear")
    page.fill("#robot", robot)
    page.set_input_files("#files", [str(file) for file in files])
    page.click("#start")
    page.locator("#said:not(:empty)").wait_for(timeout=TIMEOUT_MS)
    line = page.inner_text("#said")
    status = page.get_attribute("#said", "data-status")
    return int(status or -1), line, download_text(page, "#save-json")


def run_program(program: str, *arguments: str) -> tuple[int, str, str]:
    """Runs the program with one thread."""
    run = subprocess.run(
        [program, *arguments, "--format", "json"],
        cwd=FIXTURES,
        capture_output=True,
        text=True,
        env={**os.environ, "RAYON_NUM_THREADS": "1"},
    )
    return run.returncode, run.stderr.strip(), run.stdout


def max_difference(a, b, place: str = "") -> float:
    """Largest relative difference of two reports; fails if it exceeds rounding."""
    if isinstance(a, dict) and isinstance(b, dict):
        assert a.keys() == b.keys(), f"{place}: {a.keys() ^ b.keys()}"
        return max((max_difference(a[key], b[key], f"{place}.{key}") for key in a), default=0.0)
    if isinstance(a, list) and isinstance(b, list):
        assert len(a) == len(b), f"{place}: {len(a)} entries, {len(b)} in the page"
        return max((max_difference(x, y, f"{place}[{at}]") for at, (x, y) in enumerate(zip(a, b))), default=0.0)
    if isinstance(a, float) or isinstance(b, float):
        assert a is not None and b is not None, f"{place}: {a}, {b} in the page"
        tolerance = SINGULAR_VALUE_TOLERANCE if place.endswith(".singular_value") else ABSOLUTE_TOLERANCE
        assert math.isclose(a, b, rel_tol=RELATIVE_TOLERANCE, abs_tol=tolerance), f"{place}: {a!r}, {b!r} in the page"
        return abs(a - b) / max(abs(a), abs(b), tolerance)
    assert a == b, f"{place}: {a!r}, {b!r} in the page"
    return 0.0


def check_fixtures(page: Page, program: str) -> None:
    difference = 0.0
    for log in sorted(FIXTURES.glob("*.mcap")):
        status, message, native = run_program(program, "audit", log.name)
        shown_status, line, shown = audit_in_page(page, log)
        assert status == shown_status, f"{log.name}: exit status {status}, {shown_status} in the page: {line}"
        assert status in (0, 1), f"{log.name}: {message}"
        own = max_difference(json.loads(native), json.loads(shown), log.name)
        difference = max(difference, own)
        print(f"{log.name}: equal to the program, numbers to {own:.1e}; {line}")
    print(f"largest relative difference of a number: {difference:.1e}")


def check_damaged_logs(page: Page, program: str, scratch: Path) -> None:
    """The page reports invalid and truncated logs like the program."""
    content = (FIXTURES / "clean.mcap").read_bytes()
    for name, part in (("noise.mcap", bytes(range(256)) * 9), ("cut.mcap", content[:40]), ("empty.mcap", b"")):
        file = scratch / name
        file.write_bytes(part)
        status, _, native = run_program(program, "audit", str(file))
        shown_status, line, shown = audit_in_page(page, file)
        error = json.loads(native)["error"]
        expected = f"error: {name}: {error['what']}; {error['do']}"
        assert (status, expected) == (shown_status, line), f"{name}: {expected!r}, {line!r} in the page"
        print(f"{name}: {line}")


def check_desk(page: Page, program: str) -> None:
    a, b = "0.246 -0.249 0.619 0.170 0.472 -0.074 0.862", "243.69 -249.04 618.32 149.49 -12.78 72.64"
    page.click("#tab-desk")
    for poses, robot in (([a], []), ([a, b], []), ([a, b], ["--robot", "ur10e"])):
        page.fill("#pose-a", poses[0])
        page.fill("#pose-b", poses[1] if len(poses) > 1 else "")
        page.fill("#desk-robot", robot[1] if robot else "")
        page.click("#tell")
        page.locator("#tell:enabled").wait_for(timeout=TIMEOUT_MS)
        assert page.inner_text("#told").strip(), "the desk shows no answer"
        _, _, native = run_program(program, "pose", *poses, *robot)
        max_difference(json.loads(native), json.loads(download_text(page, "#save-pose")), " and ".join(poses))
    page.fill("#pose-a", "1 2")
    page.click("#tell")
    page.locator("#desk-said:not(:empty)").wait_for(timeout=TIMEOUT_MS)
    line = page.inner_text("#desk-said")
    assert line.startswith("error: pose A: ") and "\n" not in line, line
    page.click("#tab-audit")
    print("the desk gives the program's answers")


def check_report_is_live(page: Page) -> None:
    """The report in the page must draw its plots."""
    audit_in_page(page, FIXTURES / "faulty.mcap")
    frame = page.frame_locator("#report")
    frame.locator(".plot canvas").first.wait_for(timeout=TIMEOUT_MS)
    assert frame.locator(".plot").count() == frame.locator(".plot canvas").count(), "a plot is not drawn"
    assert frame.locator(".verdict").inner_text().startswith("FAIL"), frame.locator(".verdict").inner_text()


def check_dropped_log(page: Page) -> None:
    """A dropped log must be audited immediately, with progress, and Stop must cancel it."""
    page.click("#clear")
    page.evaluate(
        """() => {
            window.steps = [];
            const step = () => steps.push(document.getElementById("doing").textContent.split(",")[0]);
            new MutationObserver(step).observe(document.getElementById("doing"), { childList: true });
        }"""
    )
    content = base64.b64encode((FIXTURES / "faulty.mcap").read_bytes()).decode()
    drop = page.evaluate_handle(
        """(content) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([Uint8Array.from(atob(content), (it) => it.charCodeAt(0))], "dropped.mcap"));
            return transfer;
        }""",
        content,
    )
    page.dispatch_event("body", "drop", {"dataTransfer": drop})
    page.locator("#course").wait_for(state="visible", timeout=TIMEOUT_MS)
    page.locator("#said:not(:empty)").wait_for(timeout=TIMEOUT_MS)
    assert page.get_attribute("#said", "data-status") == "1", page.inner_text("#said")
    assert page.locator("#course").is_hidden(), "the bar stays"
    steps = list(dict.fromkeys(page.evaluate("steps")))
    expected = ["Starting", "Reading", "Sorting streams", "Estimating", "Judging", "Drawing the report"]
    assert [step for step in expected if step in steps] == steps and len(steps) >= 4, steps
    # Before the worker can answer.
    page.evaluate('document.getElementById("ask").requestSubmit(); document.getElementById("stop").click()')
    page.locator("#said:not(:empty)").wait_for(timeout=TIMEOUT_MS)
    assert page.inner_text("#said") == "Stopped." and page.locator("#result").is_hidden(), page.inner_text("#said")
    assert page.locator("#start").is_enabled(), "Start is disabled after Stop"
    print(f"a dropped log is audited ({', '.join(steps)}), and Stop ends it")


def print_run_times(page: Page, program: str, logs: list[str]) -> None:
    """Best of three run times, of the program on one core."""
    for log in logs:
        log = Path(log).resolve()
        native, shown = [], []
        for _ in range(3):
            started = time.perf_counter()
            run_program(program, "audit", str(log))
            native.append(time.perf_counter() - started)
            _, line, _ = audit_in_page(page, log)
            shown.append(float(line.removeprefix("Audited in ").split()[0]))
        print(f"{log.name}: program {min(native):.2f} s, page {min(shown):.1f} s, {min(shown) / min(native):.1f} times")


def main() -> None:
    program, folder = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve()
    browser_path = os.environ.get("CHROMIUM", shutil.which("chromium") or shutil.which("chromium-browser") or "")
    module_bytes = len((folder / "poseaudit.wasm.js").read_bytes()) * 3 // 4
    assert module_bytes <= MAX_MODULE_BYTES, f"the module has {module_bytes} bytes packed, and {MAX_MODULE_BYTES} are allowed"
    with sync_playwright() as playwright, TemporaryDirectory() as scratch:
        browser = playwright.chromium.launch(executable_path=browser_path or None, args=["--no-sandbox"])
        page = open_page(browser, serve_folder(folder))
        if "--time" in sys.argv:
            return print_run_times(page, program, sys.argv[sys.argv.index("--time") + 1 :])
        check_report_is_live(page)
        if "--picture" in sys.argv:
            page.screenshot(path=sys.argv[sys.argv.index("--picture") + 1])
        check_damaged_logs(page, program, Path(scratch))
        check_dropped_log(page)
        check_desk(page, program)
        check_fixtures(page, program)
        # The same from a local file.
        disk = open_page(browser, (folder / "index.html").as_uri())
        status, line, _ = audit_in_page(disk, FIXTURES / "faulty.mcap")
        assert status == 1, line
        print("the page also works from a local file")


if __name__ == "__main__":
    main()
