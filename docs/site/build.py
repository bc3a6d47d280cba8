"""Builds the documentation site: `python docs/site/build.py POSEAUDIT OUT [--audit FOLDER]`.

The pages are the documents of this repository at the same paths, so their links stay valid. The site also contains
new reports: one for every fixture, and one for the command on each rule's page, embedded in that page. `--audit`
gives the folder of the audit in the browser, if it was built. A broken link ends the build. Needs `mkdocs-material`.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = ("*.md", "docs/*.md", "docs/rules/*.md", "fixtures/*.md", "examples/ci/*.md", "python/*.md")
LINK = re.compile(r"\]\(([^)# ]+)[^)]*\)")
CALL = re.compile(r"^poseaudit (audit fixtures/.*)$", re.MULTILINE)
FINDING = re.compile(r'<article [^>]*id="(finding-\d+)".*?<code>(\w+)</code>', re.DOTALL)


def stage(pages: Path) -> None:
    """Copies the documents, and the files that they link to."""
    for pattern in DOCUMENTS:
        for document in ROOT.glob(pattern):
            copy(document, pages)
            for target in LINK.findall(document.read_text(encoding="utf-8")):
                linked = (document.parent / target).resolve()
                if linked.is_file() and linked.suffix != ".md":
                    copy(linked, pages)


def copy(file: Path, pages: Path) -> None:
    target = pages / file.relative_to(ROOT)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(file, target)


def audit(program: Path, call: str, page: Path) -> None:
    """Writes the report of a call as one page. Findings do not fail the build."""
    # `-v` changes only the text report.
    call_words = [word for word in shlex.split(call) if word != "-v"]
    words = [str(program), *call_words, "--quiet", "--format", "html", "--output", str(page)]
    done = subprocess.run(words, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    if done.returncode not in (0, 1):
        sys.exit(f"{shlex.join(words)}: exit status {done.returncode}")


def report(call: str) -> str:
    """The file name of a call's report."""
    return re.sub(r"[^A-Za-z0-9]+", "-", call.removeprefix("audit fixtures/")).strip("-") + ".html"


def write_reports(program: Path, pages: Path) -> None:
    """Writes the reports and their index, and embeds a report in the page of each rule."""
    folder = pages / "reports"
    folder.mkdir()
    fixtures = [f"audit fixtures/{log.name}" for log in sorted((ROOT / "fixtures").glob("*.mcap"))]
    rules = sorted((pages / "docs/rules").glob("[A-Z]*[0-9].md"))
    shown = {rule: CALL.search(rule.read_text(encoding="utf-8")) for rule in rules}
    calls = dict.fromkeys([*fixtures, *(call[1] for call in shown.values() if call)])
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda call: audit(program, call, folder / report(call)), calls))
    index = "# Reports of the fixtures\n\nMade with this site by the version that it describes.\n\n"
    index += "".join(f"- [`poseaudit {call}`]({report(call)})\n" for call in fixtures)
    (folder / "README.md").write_text(index, encoding="utf-8")
    for rule, call in shown.items():
        # Prefer a report with a finding of the rule.
        own = [folder / report(call[1])] if call else []
        others = [folder / report(fixture) for fixture in fixtures]
        with_finding = (page for page in [*own, *others] if first_finding(page, rule.stem))
        page = next(with_finding, None) or next(iter(own), None)
        if page:
            place = f"../../reports/{page.name}"
            at = first_finding(page, rule.stem)
            with rule.open("a", encoding="utf-8") as text:
                text.write(f"\n[Example report]({place}{at}):\n\n")
                # The address of a page ends in a folder.
                text.write(f'<iframe src="../{place}{at}" title="The report" loading="lazy" ')
                text.write('style="width: 100%; height: 42rem; border: 1px solid #8888"></iframe>\n')


def first_finding(page: Path, code: str) -> str:
    """The fragment of the rule's first finding in a report, or an empty string."""
    for place, found in FINDING.findall(page.read_text(encoding="utf-8")):
        if found == code:
            return f"#{place}"
    return ""


def configure(folder: Path, pages: Path, has_audit: bool) -> None:
    config = (Path(__file__).parent / "mkdocs.yml").read_text(encoding="utf-8")
    rules = sorted(path.name for path in (pages / "docs/rules").glob("*.md") if path.name != "README.md")
    nested = "".join(f"\n          - docs/rules/{name}" for name in ["README.md", *rules])
    config = config.replace(" RULES", nested)
    if has_audit:
        config = config.replace("  - Install:", "  - Audit in the browser: audit/index.html\n  - Install:", 1)
    (folder / "mkdocs.yml").write_text(config, encoding="utf-8")


def stage_audit(built: Path, folder: Path) -> None:
    """Copies the audit in the browser and links its title to the site."""
    shutil.copytree(built, folder)
    page, title = folder / "index.html", "<h1>poseaudit</h1>"
    text = page.read_text(encoding="utf-8")
    if title not in text:
        sys.exit(f"{built}/index.html has no {title} to link to the site")
    page.write_text(text.replace(title, '<h1><a href="../index.html">poseaudit</a></h1>'), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path, metavar="POSEAUDIT")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--audit", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    if given.out.exists():
        sys.exit(f"{given.out} exists; name a new folder")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pages = folder / "pages"
        stage(pages)
        write_reports(given.program.resolve(), pages)
        has_audit = given.audit is not None and (given.audit / "index.html").is_file()
        if has_audit:
            stage_audit(given.audit, pages / "audit")
        configure(folder, pages, has_audit)
        build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file"]
        quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
        done = subprocess.run([*build, str(folder / "mkdocs.yml")], env=quiet)
        if done.returncode:
            sys.exit("the site was not built; see the lines above")
        shutil.copytree(folder / "site", given.out)


if __name__ == "__main__":
    main()
