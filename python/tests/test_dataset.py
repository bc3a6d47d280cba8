"""`dataset`: each episode of a LeRobot dataset is audited, and the card tells it."""

import csv
import json
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

import poseaudit
from poseaudit._card import BEGIN, END, replace_section

pytest.importorskip("pyarrow")
pytest.importorskip("numpy")

import numpy as np
import pyarrow.parquet as pq

import lerobot_datasets

DELAYS_S = [0.12, 0.12, 0.2, 0.0]


@pytest.fixture
def v3(tmp_path: Path) -> Path:
    return lerobot_datasets.write(tmp_path / "pick_cube", "v3.0", DELAYS_S)


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    call = [sys.executable, "-m", "poseaudit", "dataset", *map(str, words)]
    return subprocess.run(call, capture_output=True, text=True)


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def delay_by_correlation(folder: Path, episode: int) -> float:
    """Delay of the states in s, to one frame, from the files as pyarrow reads them."""
    tables = [pq.read_table(path).to_pandas() for path in sorted((folder / "data").rglob("*.parquet"))]
    [rows] = [
        group for table in tables for index, group in table.groupby("episode_index") if index == episode
    ]
    action, state = (np.stack(rows[name].to_numpy()) for name in ("action", "observation.state"))
    errors = [np.mean((action[: len(action) - lag] - state[lag:]) ** 2) for lag in range(15)]
    return float(np.argmin(errors)) / lerobot_datasets.FPS


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_planted_delays_are_found_in_each_episode(tmp_path: Path, version: str) -> None:
    folder = lerobot_datasets.write(tmp_path / "set", version, DELAYS_S)
    audit = poseaudit.dataset(folder)
    assert (audit.verdict, audit.failing, audit.robots, audit.expected) == ("fail", True, ("so101",), 4)
    assert [one.episode for one in audit.episodes] == [0, 1, 2, 3]
    assert [one.verdict for one in audit.episodes] == ["fail", "fail", "fail", "inconclusive"]
    for one, delay_s in zip(audit.episodes, DELAYS_S, strict=True):
        amounts = [amount.value for amount in one.amounts if amount.code == "LAT004"]
        assert max(amounts) == pytest.approx(delay_s, abs=2e-3)
        assert delay_by_correlation(folder, one.episode or 0) == pytest.approx(
            delay_s, abs=0.5 / lerobot_datasets.FPS
        )
    stored = json.loads(audit.json.read_bytes())
    assert stored["schema"] == "poseaudit.dataset/1" and str(tmp_path) not in audit.json.read_text()
    assert [one["codes"] for one in stored["episodes"]] == [["LAT004"], ["LAT004"], ["LAT004"], []]
    rows = rows_of(audit.table)
    assert [row["episode"] for row in rows] == ["0", "1", "2", "3"]
    assert float(rows[2]["LAT004 action (s)"]) == pytest.approx(0.2, abs=2e-3)


def test_the_card_keeps_its_text_and_its_section_is_replaced(v3: Path) -> None:
    first = run(v3, "--quiet")
    assert first.returncode == 1 and first.stdout.startswith(
        "FAIL  4 episodes: 0 pass, 3 fail, 1 inconclusive"
    )
    card = (v3 / "README.md").read_text(encoding="utf-8")
    assert card.startswith(lerobot_datasets.CARD)
    assert "## Pose audit: FAIL" in card and "| 2 | fail | LAT004 | LAT004 200.1 ± 0.2 ms |" in card
    assert re.search(r"LAT004: state follows its command late \| action \| 3 \|", card)
    outputs = [path for path in v3.rglob("*") if path.is_file()]
    before = {path: path.read_bytes() for path in outputs}
    assert run(v3, "--quiet").returncode == 1
    assert {path: path.read_bytes() for path in v3.rglob("*") if path.is_file()} == before
    # Text after the section stays, and the section follows the options.
    (v3 / "README.md").write_text(card + "\n## Licence\n", encoding="utf-8")
    assert run(v3, "--quiet", "--ignore", "LAT004", "--fail-on=never").returncode == 0
    card = (v3 / "README.md").read_text(encoding="utf-8")
    assert card.count(BEGIN) == card.count(END) == 1 and "LAT004" not in card
    assert card.startswith(lerobot_datasets.CARD) and card.endswith("\n## Licence\n")


def test_only_new_episodes_are_audited_if_the_results_are_kept(v3: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    assert run(v3, "--results", results, "--out", tmp_path / "page").returncode == 1
    assert not (v3 / "poseaudit").exists() and "poseaudit" not in (v3 / "README.md").read_text()
    assert (tmp_path / "page" / "README.md").read_text().startswith(lerobot_datasets.CARD)
    again = run(v3, "--results", results, "--out", tmp_path / "page")
    assert again.returncode == 1 and poseaudit.fleet(v3, results).done_now == 0


def test_missing_episodes_do_not_pass(v3: Path) -> None:
    info = json.loads((v3 / "meta" / "info.json").read_text())
    (v3 / "meta" / "info.json").write_text(json.dumps({**info, "total_episodes": 6}))
    done = run(v3, "--quiet", "--select", "TIM004", "--fail-on", "never")
    assert (
        done.stdout.startswith("INCONCLUSIVE  ") and "2 listed in meta/info.json without data" in done.stdout
    )
    assert "**2 of the 6 episodes" in (v3 / "README.md").read_text()


def test_invalid_calls_are_one_line(tmp_path: Path, v3: Path) -> None:
    for words, part in (
        ([tmp_path / "none"], "no such folder"),
        ([tmp_path], "no meta/info.json: not a LeRobot dataset"),
        ([v3, "--robot", "ur55"], "neither a file nor an arm"),
        ([v3, "--revision", "main"], "revisions exist only on the hub"),
    ):
        done = run("--quiet", *words)
        assert done.returncode == 2 and part in done.stderr, done.stderr
        assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert not (v3 / "poseaudit").exists()
    assert run(v3, "--robt", "ur5e").returncode == 2


@pytest.mark.skipif("not __import__('poseaudit').__file__.startswith(__import__('sys').prefix)")
def test_the_wheel_has_the_command(v3: Path) -> None:
    scripts = Path(sysconfig.get_path("scripts"))
    for command in ([scripts / "poseaudit-dataset"], [scripts / "poseaudit", "dataset"]):
        done = subprocess.run([*command, "--quiet", v3], capture_output=True, text=True)
        assert done.returncode == 1 and done.stdout.startswith("FAIL  4 episodes"), done.stderr


def test_without_huggingface_hub_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    for source in ("me/pick_cube", "hf://datasets/me/pick_cube"):
        with pytest.raises(poseaudit.ProgramError, match=r"pip install 'poseaudit\[hub\]'"):
            poseaudit.dataset(source)


def test_a_dataset_of_the_hub_is_not_changed(
    v3: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a stub of huggingface_hub whose cache has links to nameless files, as the real one."""
    blobs, snapshot = tmp_path / "blobs", tmp_path / "snapshots" / "0123abc"
    blobs.mkdir()
    for number, file in enumerate(sorted(path for path in v3.rglob("*") if path.is_file())):
        link = snapshot / file.relative_to(v3)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(file.rename(blobs / f"{number:040x}"))
    calls: list[tuple[str, object]] = []

    def snapshot_download(name: str, *, revision: object, **options: object) -> str:
        assert options["repo_type"] == "dataset"
        calls.append((name, revision))
        return str(snapshot)

    hub = ModuleType("huggingface_hub")
    hub.snapshot_download = snapshot_download  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    monkeypatch.chdir(tmp_path)
    audit = poseaudit.dataset("hf://datasets/me/cube@v1.0")
    assert calls == [("me/cube", "v1.0")]
    assert (audit.name, audit.revision, audit.card) == ("me/cube", "0123abc", Path("cube/README.md"))
    assert [one.verdict for one in audit.episodes] == ["fail", "fail", "fail", "inconclusive"]
    assert audit.episodes[3].path == "data/chunk-000/file-001.parquet#3"
    assert audit.card.read_text(encoding="utf-8").startswith(lerobot_datasets.CARD)
    assert (
        not (snapshot / "poseaudit").exists()
        and (snapshot / "README.md").read_text() == lerobot_datasets.CARD
    )


def test_broken_markers_are_refused() -> None:
    path = Path("README.md")
    assert replace_section("", "new\n", path) == "new\n"
    assert replace_section(f"a\n{BEGIN}\nold\n{END}\nb\n", "new\n", path) == "a\nnew\nb\n"
    for card in (BEGIN, f"{END}\n{BEGIN}", f"{BEGIN}{END}{BEGIN}{END}"):
        with pytest.raises(poseaudit.CallError, match="not one pair"):
            replace_section(card, "new\n", path)
