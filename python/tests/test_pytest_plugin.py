"""The pytest plugin, in runs of pytest of its own, and the launch tests of `examples/ros2`."""

import importlib.util
import os
import xml.etree.ElementTree as ElementTree
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import launch_stub

pytest_plugins = "pytester"

EXAMPLES = Path(__file__).parents[2] / "examples" / "ros2"
_PLUGIN = "poseaudit.pytest_plugin"
_REGISTERED = _PLUGIN in [one.value for one in entry_points(group="pytest11")]


def run(pytester: pytest.Pytester, *options: str) -> pytest.RunResult:
    """Runs pytest, with the plugin also if the package is not installed."""
    named = [] if _REGISTERED else ["-p", _PLUGIN]
    return pytester.runpytest_subprocess(*named, *options)


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """pytest shortens the lines of its summary."""
    monkeypatch.setenv("COLUMNS", "200")


@pytest.mark.skipif("not __import__('poseaudit').__file__.startswith(__import__('sys').prefix)")
def test_the_wheel_registers_the_plugin() -> None:
    assert _REGISTERED


def test_a_fault_fails_the_test_with_the_short_report(
    pytester: pytest.Pytester, faulty: Path, clean: Path
) -> None:
    pytester.makepyfile(f"""
        def test_faulty(pose_audit):
            pose_audit({str(faulty)!r})

        def test_clean(pose_audit):
            report = pose_audit({str(clean)!r}, robot="ur5e", require=["LAT001", "ZER001"])
            assert report.verdict == "pass" and report.robots[0].name == "ur5e"

        def test_several(pose_audit):
            pose_audit({str(clean)!r})
            pose_audit({str(faulty)!r}, fail_on="never")
    """)
    result = run(pytester, "--junitxml=result.xml")
    result.assert_outcomes(passed=2, failed=1)
    result.stdout.fnmatch_lines(
        ["fail: LAT001, ZER001", "error?LAT001? /tcp_pose*ms late*", "FAILED *::test_faulty - *ZER001*"]
    )
    assert "Traceback" not in result.stdout.str() and "pytest_plugin.py" not in result.stdout.str()
    cases = {
        case.attrib["name"]: {one.attrib["name"]: one.attrib["value"] for one in case.iter("property")}
        for case in ElementTree.parse(pytester.path / "result.xml").iter("testcase")
    }
    found = cases["test_faulty"]
    assert found["poseaudit.log"] == str(faulty) and found["poseaudit.verdict"] == "fail"
    latency = "poseaudit.LAT001./tcp_pose_broadcaster/pose"
    low, high = map(float, found[f"{latency} ci95 (s)"].split())
    assert low <= float(found[f"{latency} (s)"]) <= high and low <= 0.015 <= high
    assert float(found["poseaudit.ZER001.elbow_joint (rad)"]) == pytest.approx(0.0104720, abs=2e-5)
    assert {"poseaudit.FRM003./tcp_pose_broadcaster/pose tool0 (m)"} < set(cases["test_clean"])
    assert {one["poseaudit.verdict"] for name, one in cases.items() if name != "test_faulty"} == {"pass"}
    assert cases["test_several"]["poseaudit#2.log"] == str(faulty)
    assert "poseaudit#2.ZER001.elbow_joint (rad)" in cases["test_several"]


def test_markers_set_options_and_limits(pytester: pytest.Pytester, faulty: Path, clean: Path) -> None:
    pytester.makepyfile(f"""
        import pytest

        pytestmark = [
            pytest.mark.pose_audit(select=["LAT001", "ZER001", "MDL001"]),
            pytest.mark.pose_limits(LAT001="20 ms", ZER001="0.3°"),
        ]

        def test_one_limit_of_the_module_is_exceeded(pose_audit):
            pose_audit({str(faulty)!r})

        @pytest.mark.pose_limits(ZER001="1°", MDL001=["2 mm", "0.2°"], MOT002={{"turning": "40 rad/s²"}})
        def test_the_limits_of_the_test_are_wider(pose_audit):
            report = pose_audit({str(faulty)!r})
            assert {{check.code for check in report.checks}} == {{"LAT001", "ZER001", "MDL001"}}

        @pytest.mark.pose_audit(fail_on="never")
        def test_an_option_of_the_call_overrides_the_marker(pose_audit):
            pose_audit({str(faulty)!r}, fail_on="warning")

        @pytest.mark.pose_limits(LAT01="20 ms")
        def test_an_unknown_rule(pose_audit):
            pose_audit({str(clean)!r})

        def test_two_configs(pose_audit):
            pose_audit({str(clean)!r}, config="cell.toml")

        @pytest.mark.pose_limits("20 ms")
        def test_a_limit_without_its_rule(pose_audit):
            pose_audit({str(clean)!r})
    """)
    result = run(pytester, "--strict-markers")
    result.assert_outcomes(passed=1, failed=5)
    result.stdout.fnmatch_lines(
        [
            "FAILED *::test_one_limit_of_the_module_is_exceeded - Failed: fail: ZER001",
            "FAILED *::test_an_option_of_the_call_overrides_the_marker - Failed: fail: ZER001",
            "FAILED *::test_an_unknown_rule - *",
            "FAILED *::test_two_configs - *",
            "FAILED *::test_a_limit_without_its_rule - *",
        ]
    )
    result.stdout.fnmatch_lines(["*poseaudit.toml:*LAT01*did you mean LAT001*"])
    result.stdout.fnmatch_lines(["cell.toml and the marker pose_limits: an audit reads one config; move *"])
    result.stdout.fnmatch_lines(["*the marker pose_limits takes only keyword arguments"])


def test_an_open_question_and_an_unusable_log_fail_in_one_line(
    pytester: pytest.Pytester, clean: Path
) -> None:
    pytester.makepyfile(f"""
        def test_open(pose_audit):
            pose_audit({str(clean)!r}, require="MOT004")

        def test_missing(pose_audit):
            pose_audit("nowhere.mcap")
    """)
    result = run(pytester)
    result.assert_outcomes(failed=2)
    result.stdout.fnmatch_lines(["--require MOT004: inconclusive"])
    result.stdout.fnmatch_lines(["nowhere.mcap: no such file; pass a log that a recorder wrote"])
    assert "During handling" not in result.stdout.str()


def test_pages_are_kept_for_ci(pytester: pytest.Pytester, faulty: Path) -> None:
    pytester.makepyfile(
        test_cell=f"""
        import pytest

        @pytest.mark.parametrize("arm", ["ur5e"])
        def test_arm(pose_audit, arm):
            pose_audit({str(faulty)!r}, robot=arm)
    """
    )
    run(pytester, "--pose-audit-pages=pages").assert_outcomes(failed=1)
    [page] = (pytester.path / "pages").iterdir()
    assert page.name == "test_cell.py-test_arm-ur5e.html" and "LAT001" in page.read_text(encoding="utf-8")


@pytest.fixture
def ros2(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stub of the program `ros2` on the PATH."""
    launch_stub.install_ros2(pytester.path)
    monkeypatch.setenv("PATH", str(pytester.path), prepend=os.pathsep)


@pytest.mark.usefixtures("ros2")
@pytest.mark.parametrize(("log", "outcomes"), [("clean", (2, 0)), ("faulty", (1, 1))])
def test_the_example_for_launch_pytest(
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
    log: str,
    outcomes: tuple[int, int],
) -> None:
    monkeypatch.setenv("RECORDED", str(request.getfixturevalue(log)))
    pytester.makepyfile(test_recorded_run=(EXAMPLES / "test_recorded_run.py").read_text(encoding="utf-8"))
    if not importlib.util.find_spec("launch_pytest"):
        pytester.makeconftest('pytest_plugins = "launch_stub"')
        monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
    passed, failed = outcomes
    run(pytester).assert_outcomes(passed=passed, failed=failed)


@pytest.mark.usefixtures("ros2")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnknownMarkWarning")
@pytest.mark.skipif("__import__('importlib.util').util.find_spec('launch_testing')")
@pytest.mark.parametrize(("log", "failures"), [("clean", 0), ("faulty", 1)])
def test_the_example_for_launch_testing(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, log: str, failures: int
) -> None:
    monkeypatch.setenv("RECORDED", str(request.getfixturevalue(log)))
    launch_stub.install_modules()
    example = EXAMPLES / "recorded_run_launch_test.py"
    spec = importlib.util.spec_from_file_location(example.stem, example)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    result = launch_stub.run_launch_test(module)
    assert (result.testsRun, len(result.errors)) == (2, 0), result.errors
    assert len(result.failures) == failures
    assert all("LAT001" in text for _, text in result.failures)
