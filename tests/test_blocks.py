"""Every block of code in the documentation is run by a test, or is listed here with the reason why none runs it."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from seatrial.ident.estimation.model_file import load_model
from seatrial.mocks.plant.bench import draw_bench
from tests import foreign_runs
from tests.daq.importers.test_mavlink import tlog
from tests.missions import bench_log, boat_log, boat_with
from tests.page_runner import command_lines, edited, run_commands, run_python
from tests.test_docs import PAGES, ROOT, blocks, name
from tests.test_tutorials import environment

pytestmark = [pytest.mark.pages, pytest.mark.usefixtures("quick_compilation")]

__all__ = ["environment"]

HERE, LIVE = "tests/test_blocks.py", "tests/test_live_blocks.py"
TUTORIALS, USE = "tests/test_tutorials.py", "tests/ident/workflows/test_use_a_model.py"
ALL = None
# Page, language, numbers of the blocks on the page, and the test that runs them or compares them with a file that it
# runs.
RUN = [
    ("README.md", "sh", [1, 2, 3, 4], f"{TUTORIALS}::test_the_commands_of_the_readme_lead_to_a_report"),
    ("README.md", "sh", [5], f"{HERE}::test_the_logs_of_the_readme_are_imported_and_fitted"),
    ("README.md", "python", ALL, f"{HERE}::test_the_python_of_the_readme_finds_the_effect"),
    ("docs/formats/export-ros.md", "sh", ALL,
     "tests/daq/tools/test_ros_signals.py::test_the_command_of_the_page_runs_as_written"),
    ("docs/formats/import.md", "sh", [0], f"{HERE}::test_the_bag_of_the_import_page_is_fitted"),
    ("docs/formats/import.md", "sh", [1], "tests/daq/importers/test_run_files.py::test_the_commands_of_the_page"),
    ("docs/formats/result.md", "sh", ALL, f"{HERE}::test_the_json_of_the_result_page_has_its_fields"),
    ("docs/formats/result.md", "python", ALL, f"{HERE}::test_the_curves_of_the_result_page_are_plotted"),
    ("docs/how-to/add-a-sensor.md", "python", ALL,
     "tests/test_how_to.py::test_the_sensor_of_the_how_to_passes_its_tests"),
    ("docs/how-to/add-an-effect.md", "python", [0, 1],
     "tests/test_how_to.py::test_the_effect_of_the_how_to_passes_its_own_test"),
    ("docs/how-to/add-an-effect.md", "python", [2], "tests/test_how_to.py::test_an_effect_of_one_boat_is_fitted"),
    ("docs/how-to/add-an-effect.md", "sh", [0, 1], f"{LIVE}::test_the_mocks_with_an_effect_start"),
    ("docs/how-to/add-an-effect.md", "sh", [2], "tests/test_how_to.py::test_an_effect_of_one_boat_is_fitted"),
    ("docs/how-to/changes.md", "python", ALL,
     "tests/ident/workflows/test_changes.py::test_the_page_runs_as_written"),
    ("docs/how-to/compare.md", "python", ALL,
     "tests/ident/workflows/test_compare.py::test_the_page_runs_as_written"),
    ("docs/how-to/check.md", "sh", [2, 3], f"{HERE}::test_the_logs_of_the_check_page_pass"),
    ("docs/how-to/check.md", "sh", [0], f"{LIVE}::test_the_rig_of_the_check_page_passes"),
    ("docs/how-to/coming-from.md", "sh", [0], "tests/test_coming_from.py::test_the_section_on_matlab_runs"),
    ("docs/how-to/coming-from.md", "sh", [1], "tests/test_coming_from.py::test_the_section_on_ctsm_runs"),
    ("docs/how-to/coming-from.md", "sh", [2], "tests/test_coming_from.py::test_the_section_on_ros_runs"),
    ("docs/how-to/coming-from.md", "sh", [3], "tests/test_coming_from.py::test_the_section_on_plotjuggler_runs"),
    ("docs/how-to/coming-from.md", "sh", [4], "tests/test_coming_from.py::test_the_section_on_ardupilot_runs"),
    ("docs/how-to/coming-from.md", "python", [0], "tests/test_coming_from.py::test_the_section_on_matlab_runs"),
    ("docs/how-to/coming-from.md", "python", [1], "tests/test_coming_from.py::test_the_section_on_ctsm_runs"),
    ("docs/how-to/coming-from.md", "python", [2], "tests/test_coming_from.py::test_the_section_on_ros_runs"),
    ("docs/how-to/control.md", "sh", ALL, "tests/ident/workflows/test_control.py::folder"),
    ("docs/how-to/control.md", "python", [0, 1, 2, 3, 4, 5, 7],
     "tests/ident/workflows/test_control.py::test_controller_of_the_page"),
    ("docs/how-to/control.md", "python", [6, 8], "tests/ident/workflows/test_control.py::test_mpc_with_do_mpc"),
    ("docs/how-to/control.md", "python", [9], "tests/ident/workflows/test_ros2_node.py::ros"),
    ("docs/how-to/control.md", "python", [10], "tests/ident/workflows/test_ros2_node.py::commanded"),
    ("docs/how-to/design.md", "sh", [0], f"{HERE}::test_the_designs_of_the_page"),
    ("docs/how-to/design.md", "sh", [2], f"{HERE}::test_the_information_of_the_design_page"),
    ("docs/how-to/devices.md", "python", ALL, f"{HERE}::test_the_tables_of_the_devices_page"),
    ("docs/how-to/diagnose-a-thruster.md", "sh", [0], f"{HERE}::test_the_thruster_of_the_page_is_diagnosed"),
    ("docs/how-to/many-logs.md", "sh", [0], f"{HERE}::test_the_fleet_of_the_page_is_fitted"),
    ("docs/how-to/many-logs.md", "python", ALL, "tests/ident/workflows/test_fleet.py::test_the_page_runs_as_written"),
    ("docs/how-to/mavlink.md", "sh", [0, 1, 2, 3],
     f"{TUTORIALS}::test_the_tutorial_over_mavlink_leads_to_the_model_of_the_boat"),
    ("docs/how-to/mavlink.md", "sh", [4], f"{HERE}::test_the_logs_of_an_autopilot_are_imported"),
    ("docs/how-to/navigate.md", "sh", ALL, f"{HERE}::test_the_commands_of_the_navigation_page"),
    ("docs/how-to/navigate.md", "python", ALL,
     "tests/ident/workflows/test_page_snippets.py::test_navigation_with_a_log_of_commands"),
    ("docs/how-to/own-boat.md", "sh", ALL, f"{HERE}::test_the_commands_of_the_own_boat_page"),
    ("docs/how-to/own-model.md", "python", ALL, "tests/test_how_to.py::test_the_models_of_the_how_to_are_the_examples"),
    ("docs/how-to/own-model.md", "sh", [0], "tests/test_how_to.py::test_a_user_model_works_with_all_commands"),
    ("docs/how-to/own-model.md", "sh", [1, 2], "tests/test_how_to.py::test_a_user_model_of_the_how_to_finds_the_truth"),
    ("docs/how-to/own-model.md", "sh", [3], "tests/ident/workflows/test_moved.py::work"),
    ("docs/how-to/python.md", "python", ALL, "tests/api/test_api.py::test_the_page_runs_as_written"),
    ("docs/how-to/study.md", "sh", [0, 1], f"{HERE}::test_the_studies_of_the_page"),
    ("docs/how-to/study.md", "python", ALL, "tests/ident/studies/test_study.py::test_snippet_of_the_how_to_runs"),
    ("docs/how-to/use-a-model.md", "python", [0], f"{USE}::test_simulation_snippet"),
    ("docs/how-to/use-a-model.md", "python", [1], f"{USE}::test_controller_snippet"),
    ("docs/how-to/use-a-model.md", "python", [2, 3], f"{USE}::test_snippets_with_a_model_of_commands"),
    ("docs/how-to/use-a-model.md", "python", [4], f"{USE}::test_fmu_snippet"),
    ("docs/how-to/use-a-model.md", "python", [5], f"{USE}::test_axes_of_ros"),
    ("docs/how-to/use-a-model.md", "sh", [0], f"{USE}::folder"),
    ("docs/how-to/use-a-model.md", "sh", [1], f"{USE}::test_controller_snippet"),
    ("docs/how-to/use-a-model.md", "sh", [2], f"{USE}::test_c_program"),
    ("docs/how-to/use-a-model.md", "sh", [3], f"{USE}::command_folder"),
    ("docs/how-to/use-a-model.md", "sh", [4], f"{USE}::test_c_program_with_a_model_of_commands"),
    ("docs/how-to/use-a-model.md", "sh", [5, 6, 7], f"{USE}::joined_folder"),
    ("docs/theory/estimation.md", "python", ALL,
     "tests/ident/estimation/test_likelihood.py::test_filter_in_the_documentation_equals_the_reference_filter"),
    ("docs/tutorials/bench-run.md", "sh", ALL, f"{TUTORIALS}::test_the_tutorials_give_the_results_that_they_show"),
    ("docs/tutorials/mission.md", "sh", ALL, f"{TUTORIALS}::test_the_tutorials_give_the_results_that_they_show"),
    ("docs/tutorials/first-hour.md", "sh", [1, 2, 3, 4], f"{TUTORIALS}::test_the_first_hour_makes_a_rig"),
]  # fmt: skip
DATA = "needs the measured data sets, which are not part of the project; tests/measured runs these fits where they are"
SETUP = "installs or starts programs of the reader's computer"
NOT_RUN = [
    ("README.md", "sh", [0], "takes minutes; .github/workflows/tests.yml runs both"),
    ("CONTRIBUTING.md", "console", ALL, "takes minutes; .github/workflows/tests.yml runs both"),
    ("docs/examples/ardurover/README.md", "sh", ALL, "needs logs and the SITL of ArduPilot"),
    ("docs/examples/blueboat/README.md", "sh", ALL, DATA),
    ("docs/examples/kingfisher/README.md", "sh", ALL, DATA),
    ("docs/examples/milliampere/README.md", "sh", ALL, DATA),
    ("docs/examples/otter/README.md", "sh", ALL, DATA),
    ("docs/examples/static/README.md", "sh", ALL, DATA),
    ("docs/formats/log.md", "python", ALL,
     "calls for logs of several devices; tests/test_docs.py compares the names with the class"),
    ("docs/how-to/blind-tests.md", "sh", ALL, "takes hours; tests/recovery tests the scripts"),
    ("docs/how-to/changes.md", "sh", ALL,
     "needs two campaigns of logs; tests/ident/workflows/test_changes.py runs the command on short ones"),
    ("docs/how-to/compare.md", "sh", ALL,
     "needs three fitted models; tests/ident/workflows/test_compare.py runs the command on short logs"),
    ("docs/how-to/check.md", "sh", [1],
     "asks at a terminal; tests/bench/preflight/test_check_live.py runs it with --yes"),
    ("docs/how-to/check.md", "sh", [4], "takes minutes, in `make study`"),
    ("docs/how-to/design.md", "sh", [1], "takes long; tests/ident/cli/test_design_cli.py has a shorter run"),
    ("docs/how-to/design.md", "sh", [3], "takes an hour; tests/ident/studies/test_study.py runs other studies"),
    ("docs/how-to/diagnose-a-thruster.md", "sh", [1], "takes 20 minutes at a bench"),
    ("docs/how-to/install.md", "console", ALL, SETUP),
    ("docs/how-to/many-logs.md", "console", ALL, SETUP),
    ("docs/how-to/many-logs.md", "sh", [1],
     "needs a cluster; tests/ident/parallel/test_dask.py runs tasks on a local one"),
    ("docs/how-to/study.md", "sh", [2],
     "needs a cluster; tests/ident/parallel/test_dask.py runs tasks on a local one"),
    ("docs/how-to/use-a-model.md", "sh", [8], "needs ROS 2"),
    ("docs/notebooks/README.md", "console", ALL, SETUP),
    ("docs/reference.md", "python", ALL, "signatures, generated from the code"),
    ("docs/tutorials/first-hour.md", "console", ALL,
     "asks at a terminal; tests/daq/new_rig/test_init.py answers the questions"),
    ("docs/tutorials/first-hour.md", "sh", [0],
     "searches the ports of this computer; tests/daq/tools/test_discovery.py searches those of mocks"),
]  # fmt: skip
# Lines that no test runs in a block that is run otherwise.
LEFT_OUT = {
    "seatrial bench": "needs a bench; tests/test_tutorials.py runs it on a mock",
    "seatrial log": "needs devices; tests/test_tutorials.py runs it on a mock",
    "seatrial mission run": "needs a boat; tests/test_tutorials.py runs it on a mock",
    "seatrial ident study horizontal": "takes a minute; tests/ident/studies/test_study.py runs a shorter case",
    "seatrial ident study vehicle/model.toml": "takes long; tests/ident/studies/test_study_own.py runs a small one",
    "seatrial ident vehicle estimation.mcap": "the Python of the README does the same",
    "seatrial ident diagnose vehicle/model.toml estimation.mcap": "the Python of the README does the same",
    "seatrial check rig.toml": "needs devices; test_the_rig_of_the_check_page_passes runs it on a mock",
}


def test_every_block_is_run_or_has_a_reason() -> None:
    listed: list[tuple[str, str, int]] = []
    for page, language, numbers, _ in [*RUN, *NOT_RUN]:
        every = range(len(blocks(ROOT / page, language)))
        listed += [(page, language, k) for k in (every if numbers is None else numbers)]
    found = [
        (name(page), language, k)
        for page in PAGES
        for language in ("sh", "console", "python", "bash", "py", "pycon")
        for k in range(len(blocks(page, language)))
    ]
    assert sorted(listed) == sorted(found)
    fences = sum(
        len(re.findall(r"^ *(?:```|~~~) *(?:sh|console|py)", p.read_text("utf-8"), re.MULTILINE)) for p in PAGES
    )
    assert fences == len(found), "a block that is indented, or has another fence"


@pytest.mark.parametrize("test", sorted({test for *_, test in RUN}))
def test_the_test_of_a_block_exists(test: str) -> None:
    file, _, title = test.partition("::")
    assert f"\ndef {title}(" in (ROOT / file).read_text(encoding="utf-8")


def block(page: str, language: str = "sh", number: int = 0) -> str:
    return blocks(ROOT / page, language)[number]


def offline(text: str) -> str:
    """Return a shell block without the lines of LEFT_OUT. There must be others."""
    lines = [line for line in command_lines(text) if not line.startswith(tuple(LEFT_OUT))]
    assert lines
    return "\n".join(lines)


SEED = 2
MISSIONS = (("estimation", 100.0, 101), ("validation", 190.0, 102))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create logs of a bench and of a boat with a hidden effect."""
    folder = tmp_path_factory.mktemp("demo")
    for k in (1, 2):
        bench_log(folder / f"bench{k}.mcap", draw_bench(SEED), run=k, kind="steps", count=2)
    boat = boat_with("cubic-drag", SEED)
    for k, (title, seconds, mission) in enumerate(MISSIONS, 1):
        boat_log(folder / f"{title}.mcap", boat, seconds, mission, run=k)
    return folder


@pytest.fixture(scope="module")
def thruster(demo: Path) -> Path:
    """Run the page on the diagnosis of a thruster."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(demo)
        edits = {"--out diagnosis": "--max-effects 1 --out diagnosis"}
        run_commands(edited(offline(block("docs/how-to/diagnose-a-thruster.md")), edits))
    return demo


@pytest.fixture(scope="module")
def vehicle(thruster: Path) -> Path:
    """Run the Python of the README, and save its fit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(thruster)
        space = run_python(block("README.md", "python"), "README.md")
        space["fit"].save("vehicle")
        (thruster / "answer.txt").write_text(space["found"].answer, encoding="utf-8")
    return thruster


def work(source: Path, folder: Path, patch: pytest.MonkeyPatch) -> Path:
    """Make a folder with the files of another folder the current one, so that tests do not see each other's files."""
    shutil.copytree(source, folder / "work")
    patch.chdir(folder / "work")
    return folder / "work"


@pytest.fixture
def folder(vehicle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return work(vehicle, tmp_path, monkeypatch)


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_thruster_of_the_page_is_diagnosed(thruster: Path) -> None:
    saved = load_model(thruster / "thruster/model.toml")
    assert abs(saved.model.parameter("c1").value - draw_bench(SEED).thruster.c1) < 5.0 * saved.errors["c1"]
    assert (thruster / "diagnosis/report.html").is_file()


@pytest.mark.slow
def test_the_python_of_the_readme_finds_the_effect(vehicle: Path) -> None:
    assert "cubic" in (vehicle / "answer.txt").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_tables_of_the_devices_page(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work(demo, tmp_path, monkeypatch)
    edits = {"logs/run.mcap": "validation.mcap", "600.0": "60.0", "1200.0": "120.0"}
    found = run_python(edited(block("docs/how-to/devices.md", "python"), edits), "devices.md")
    frame, part = found["frame"], found["ten_minutes"]
    assert len(frame) == pytest.approx(190 * 20, rel=0.05)
    assert set(frame.attrs["units"]) == set(frame.columns)
    assert set(found["data"].data_vars) >= set(frame.columns) - {"t"}
    assert (part.index[-1] - part.index[0]).total_seconds() == pytest.approx(60.0, abs=1.0)


@pytest.mark.slow
def test_the_curves_of_the_result_page_are_plotted(folder: Path) -> None:
    with pd.option_context("plotting.backend", "plotly"):  # matplotlib is not among the packages of the tests
        found = run_python(block("docs/formats/result.md", "python"), "result.md")
    assert len(found["r"]) > 100


@pytest.mark.slow
def test_the_json_of_the_result_page_has_its_fields(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = block("docs/formats/result.md")
    run_commands(edited(text, {"run.mcap": "estimation.mcap", "--out vehicle": "--out one --no-score-tests"}))
    rows = json.loads(capsys.readouterr().out)["fit"]["parameters"]
    (fields,) = re.findall(r"\{(.*?)\}", text)
    assert all({field.strip() for field in fields.split(",")} <= set(row) for row in rows)


@pytest.mark.slow
def test_the_logs_of_the_check_page_pass(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = work(demo, tmp_path, monkeypatch)
    (here / "logs").mkdir()
    shutil.move(here / "estimation.mcap", here / "run.mcap")
    shutil.move(here / "validation.mcap", here / "logs")
    for number in (2, 3):
        run_commands(block("docs/how-to/check.md", number=number))
    assert (here / "check.html").is_file()


@pytest.mark.slow
def test_the_information_of_the_design_page(folder: Path) -> None:
    text = block("docs/how-to/design.md", number=2)
    run_commands(edited(text, {"first.mcap": "estimation.mcap", "second.mcap": "validation.mcap"}))
    assert (folder / "sway/report.html").is_file()


QUICK = "--evaluations 500 --steps 4 --duration 20"


@pytest.mark.slow
def test_the_designs_of_the_page(folder: Path) -> None:
    """The missions are shorter than those of the page, and the log of another mission takes the place of the first."""
    shutil.copy("estimation.mcap", "first.mcap")
    shutil.rmtree("vehicle")
    text = offline(block("docs/how-to/design.md"))
    edits = {"--duration 600": QUICK, "--duration 300": QUICK, "--out vehicle": "--out vehicle --no-score-tests"}
    run_commands(edited(text, edits))
    assert (folder / "second.toml").is_file()


@pytest.mark.slow
def test_the_fleet_of_the_page_is_fitted(folder: Path) -> None:
    (folder / "logs").mkdir()
    for title, *_ in MISSIONS:
        shutil.copy(f"{title}.mcap", "logs")
    run_commands(edited(block("docs/how-to/many-logs.md"), {"--out fleet": "--out fleet --jobs 1 --no-score-tests"}))
    assert set(pd.read_parquet("fleet/fits.parquet")["log"]) == {"logs/estimation.mcap", "logs/validation.mcap"}


@pytest.mark.slow
def test_the_commands_of_the_navigation_page(folder: Path) -> None:
    run_commands(block("docs/how-to/navigate.md"))
    assert all((folder / out / "result.json").is_file() for out in ("navigation", "outage", "filtered"))


@pytest.mark.slow
def test_the_commands_of_the_own_boat_page(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = work(demo, tmp_path, monkeypatch)
    shutil.copy("validation.mcap", "still.mcap")
    for text in blocks(ROOT / "docs/how-to/own-boat.md", "sh"):
        run_commands(offline(text))
    assert (here / "noise/report.html").is_file()
    assert (here / "validation.toml").is_file()


@pytest.mark.slow
def test_the_studies_of_the_page(empty: Path) -> None:
    """Each study has three replicates, and those of the first block have short missions."""
    run_commands(
        edited(offline(block("docs/how-to/study.md")), {"--replicates 500": "--replicates 3 --seconds 60 --jobs 1"})
    )
    edits = {"--replicates 200": "--replicates 3 --jobs 1", "docs/examples": str(ROOT / "docs/examples")}
    run_commands(edited(offline(block("docs/how-to/study.md", number=1)), edits | {"--out study": "--out own"}))
    assert (empty / "study/report.html").is_file()
    assert (empty / "own/report.html").is_file()


@pytest.mark.slow
def test_the_logs_of_the_readme_are_imported_and_fitted(empty: Path) -> None:
    for k in (1, 2):
        r = foreign_runs.run(k)
        titles = {"north_m": "x", "east_m": "y", "heading_rad": "psi", "yaw_rate": "r", "n_left": "n_left"}
        columns = {"t": r.t} | {title: r.columns[key] for title, key in (titles | {"n_right": "n_right"}).items()}
        pd.DataFrame(columns).to_csv(f"run{k}.csv", index=False)
    edits = {"--out vehicle": "--fix c1=40 --fix c2=0 --no-score-tests --out vehicle"}
    run_commands(edited(block("README.md", number=5), edits))
    assert (empty / "vehicle/report.html").is_file()


@pytest.mark.slow
def test_the_bag_of_the_import_page_is_fitted(empty: Path) -> None:
    foreign_runs.write_bag(empty / "bag", foreign_runs.run(1))
    # The fixed values are those of the section on ROS 2 in tests/test_coming_from.py, whose machine code is used again.
    fixed = "--fix c1=40 --fix c2=0 --fix y_left=-0.3 --fix y_right=0.3"
    edits = {"run.bag": "bag", "--out vehicle": f"{fixed} --no-score-tests --out vehicle"}
    run_commands(edited(block("docs/formats/import.md"), edits))
    assert (empty / "vehicle/report.html").is_file()


def test_the_logs_of_an_autopilot_are_imported(empty: Path) -> None:
    shutil.copy(ROOT / "mocks/rigs/mavboat.toml", empty / "autopilot.toml")
    tlog(empty / "flight.tlog")
    foreign_runs.write_dataflash(empty / "00000042.BIN", foreign_runs.run(1))
    for line in command_lines(block("docs/how-to/mavlink.md", number=4)):
        run_commands(line)
        (empty / "flight.mcap").unlink()
