"""Tests that run the code of the how-tos: an effect, a sensor and a model, each added as a reader would."""

from __future__ import annotations

import csv
import importlib.util
import re
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import seatrial.ident.effects.hull
from seatrial import command_line
from seatrial.daq.config import parse_rig
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.log import open_log
from seatrial.daq.plugins import plugins
from seatrial.daq.protocol import make_decoder, serial_protocols
from seatrial.ident.data.record import Channel, LogSegment, Record
from seatrial.ident.diagnosis.search import diagnose
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.structure import Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import horizontal_model
from tests.missions import boat_log, boat_with
from tests.own_boats import BOATS, HULL, import_map, write_run
from tests.page_runner import run_command, run_commands
from tests.test_docs import shell_commands

pytestmark = [pytest.mark.pages, pytest.mark.usefixtures("quick_compilation")]

ROOT = Path(__file__).resolve().parents[1]


def blocks(title: str, language: str) -> list[str]:
    """Return the fenced blocks of a language in a how-to, in order."""
    text = how_to(title).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def how_to(title: str) -> Path:
    return ROOT / "docs/how-to" / f"{title}.md"


def module_from(text: str, title: str, folder: Path, package: types.ModuleType, patch: pytest.MonkeyPatch) -> None:
    """Put a file into a package, as the reader of a how-to would, for the duration of the test."""
    (folder / f"{title}.py").write_text(text, encoding="utf-8")
    patch.setattr(package, "__path__", [*package.__path__, str(folder)])
    patch.delitem(sys.modules, f"{package.__name__}.{title}", raising=False)
    importlib.invalidate_caches()


def run_tests(text: str) -> int:
    """Run the test functions of a code block and return their number."""
    space: dict[str, object] = {"__name__": "docs"}
    exec(compile(text, "how-to", "exec"), space)
    tests = [f for title, f in space.items() if title.startswith("test_") and callable(f)]
    for test in tests:
        test()
    return len(tests)


@pytest.fixture
def weed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Add the effect of the how-to to the catalogue."""
    module_from(blocks("add-an-effect", "python")[0], "weed", tmp_path, seatrial.ident.effects.hull, monkeypatch)
    catalogue.cache_clear()
    yield
    sys.modules.pop("seatrial.ident.effects.hull.weed", None)
    catalogue.cache_clear()


def test_the_effect_of_the_how_to_passes_its_own_test(weed: None) -> None:
    assert set(catalogue()["weed"].alternatives) <= set(catalogue())
    assert run_tests(blocks("add-an-effect", "python")[1]) == 1


@pytest.mark.slow
def test_an_effect_of_one_boat_is_fitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of the page lead from the file with the effect to an exported model that has it."""
    monkeypatch.chdir(tmp_path)
    example = (ROOT / "docs/examples/skeg.py").read_text(encoding="utf-8")
    assert blocks("add-an-effect", "python")[2] in example
    shutil.copy(ROOT / "docs/examples/skeg.py", tmp_path)
    boat = boat_with(None, 3)
    for k in (1, 2):
        boat_log(Path(f"run{k}.mcap"), boat, 90.0, 7 + k, k)
    run_commands(blocks("add-an-effect", "sh")[2])
    assert "skeg" in [e.name for e in load_model(Path("with-skeg/model.toml")).model.effects]
    assert "d_skeg" in Path("boat.h").read_text(encoding="utf-8")


def steps(rng: np.random.Generator, t: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return a random step signal with a step every five seconds."""
    step = (t // 5.0).astype(int)
    return np.asarray(rng.uniform(low, high, step[-1] + 1)[step])


def voyage(model: Model, seed: int, seconds: float = 300.0) -> LogSegment:
    """Simulate a run of a model with two thrusts [N] as inputs and with sensor noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.1)
    push, turn = steps(rng, t, -15.0, 40.0), steps(rng, t, -12.0, 12.0)
    columns = {"f_left": push + turn, "f_right": push - turn, "t": t}
    u = np.column_stack([columns[i.name] for i in model.inputs])
    names = tuple(o.name for o in model.outputs)
    blank = np.full((t.size, len(names)), np.nan)
    y = simulate(model, Record("voyage", t, u, u, blank, tuple(i.name for i in model.inputs), names)).y
    noise = [model.parameter(o.noise).value for o in model.outputs]
    y = y + rng.normal(size=y.shape) * noise
    found = {n: Channel(t, columns[n]) for n in ("f_left", "f_right")}
    return LogSegment(f"seed {seed}", found | {n: Channel(t, y[:, j]) for j, n in enumerate(names)})


@pytest.mark.slow
@pytest.mark.parametrize("d_weed", [0.0, 15.0])
def test_the_effect_of_the_how_to_is_found_if_and_only_if_present(weed: None, d_weed: float) -> None:
    base = horizontal_model("force", ("attitude", "gyro", "position"), hold="zero")
    truth = (base + catalogue()["weed"]).with_values({"d_weed": d_weed})
    candidates = {n: catalogue()[n] for n in ("weed", "cubic-drag", "coulomb", "turning-resistance")}
    known = base.replace_parameters(*(base.parameter(n).fixed() for n in ("d_vv", "d_v")))
    found = diagnose(known, [voyage(truth, 1)], [voyage(truth, 2)], effects=candidates)
    assert [r.effect.name for r in found.effects] == (["weed"] if d_weed else [])
    if d_weed:
        value, error = found.after.fit.estimate("d_weed")
        assert abs(value - d_weed) < 4.0 * error < 0.5 * d_weed


@pytest.fixture(scope="module")
def lab_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the package of the how-tos, with a sensor, an effect and a model, into a folder."""
    folder = tmp_path_factory.mktemp("lab-boat")
    source, site = folder / "lab-boat", folder / "site"
    (source / "lab_boat").mkdir(parents=True)
    points = [next(b for b in blocks(page, "toml") if "entry-points" in b) for page in ("add-an-effect", "own-model")]
    files = {
        "pyproject.toml": "\n".join([blocks("add-a-sensor", "toml")[0], *points]),
        "lab_boat/__init__.py": "",
        "lab_boat/os5000.py": blocks("add-a-sensor", "python")[0],
        "lab_boat/weed.py": blocks("add-an-effect", "python")[0],
        "lab_boat/rudder.py": (ROOT / "docs/examples/own_model.py").read_text(encoding="utf-8"),
    }
    for name, text in files.items():
        (source / name).write_text(text, encoding="utf-8")
    words = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--target",
        str(site),
    ]
    subprocess.run([sys.executable, *words, str(source)], check=True, capture_output=True, timeout=120)
    return site


@pytest.fixture
def installed(lab_package: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make the package of the how-tos importable in this process and in its child processes."""
    monkeypatch.syspath_prepend(str(lab_package))
    monkeypatch.setenv("PYTHONPATH", str(lab_package))
    plugins.cache_clear()
    catalogue.cache_clear()
    yield lab_package
    for name in [name for name in sys.modules if name.startswith("lab_boat")]:
        del sys.modules[name]
    plugins.cache_clear()
    catalogue.cache_clear()


RIG = 'format = "seatrial-rig 1"\nname = "pool"\n'


def test_the_sensor_of_the_how_to_passes_its_tests(installed: Path) -> None:
    _, tests = blocks("add-a-sensor", "python")
    assert run_tests(tests) == 3
    capture = blocks("add-a-sensor", "text")[1]
    for line in [line for line in capture.splitlines() if not line.startswith("# ")]:
        assert line in tests


def test_a_sensor_of_another_package_is_in_the_rig_and_in_the_commands(installed: Path, tmp_path: Path) -> None:
    rig = parse_rig(RIG + blocks("add-a-sensor", "toml")[1], tmp_path / "rig.toml")
    assert rig.devices[0].settings == {"mount_yaw_deg": 90.0}
    decoder = make_decoder(rig.devices[0], rig)
    (frame,) = decoder.feed(b"$C320.5P1.4R-0.5T20.1*0F\r\n", 0.0)
    assert np.degrees(frame.sample.yaw) == pytest.approx(50.5)
    (tmp_path / "capture.txt").write_text(blocks("add-a-sensor", "text")[1], encoding="utf-8")
    words = f"import raw os5000 {tmp_path}/capture.txt --rate 10 -o {tmp_path}/a.mcap".split()
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert not left.value.code
    with open_log(tmp_path / "a.mcap") as log:
        assert sum(log.counts.values()) >= 2


def test_an_unknown_option_of_a_plugin_is_an_error(installed: Path, tmp_path: Path) -> None:
    text = RIG + blocks("add-a-sensor", "toml")[1].replace("mount_yaw_deg", "mount_yaw")
    with pytest.raises(SeatrialError, match="mount_yaw"):
        parse_rig(text, tmp_path / "rig.toml")


def test_the_rig_of_a_log_is_read_without_the_package(tmp_path: Path) -> None:
    text = RIG + blocks("add-a-sensor", "toml")[1]
    with pytest.raises(SeatrialError, match=r"must be one of .*, not 'os5000'"):
        parse_rig(text, tmp_path / "rig.toml")
    rig = parse_rig(text, tmp_path / "a.mcap:rig.toml", recorded=True)
    assert (rig.devices[0].name, rig.devices[0].rate_hz) == ("compass", 10.0)


def test_an_effect_of_another_package_is_in_the_catalogue(installed: Path) -> None:
    assert catalogue()["weed"].parameters[0].name == "d_weed"
    assert len(catalogue()) > 60


def test_a_model_of_another_package_has_a_name(installed: Path) -> None:
    model = make_model("rudder-boat")
    assert model.source == "rudder-boat"
    assert [i.name for i in model.inputs] == ["n_main", "rudder"]
    with pytest.raises(SeatrialError, match=r"model 'rudder-boat:wide' .*TypeError"):
        make_model("rudder-boat:wide")
    with pytest.raises(SeatrialError, match=r"choose horizontal, .*rudder-boat, or FILE.py:NAME"):
        make_model("sailboat")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            "raise OSError('no such library')",
            r"cannot be imported: OSError: no such library; update or uninstall this package; until then",
        ),
        ("DEVICE = 3", r"has the type int, and seatrial.protocols needs a DeviceType; update or uninstall"),
    ],
)
def test_a_broken_package_is_named_and_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, message: str
) -> None:
    (tmp_path / "broken_lab.py").write_text(source, encoding="utf-8")
    info = tmp_path / "broken_lab-2.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-lab\nVersion: 2.1\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[seatrial.protocols]\nsonar = broken_lab:DEVICE\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.cache_clear()
    with pytest.warns(SeatrialWarning, match=rf"'sonar' of the package broken-lab 2.1 \(broken_lab:DEVICE\) {message}"):
        assert "nmea" in serial_protocols()
    monkeypatch.undo()
    sys.modules.pop("broken_lab", None)
    plugins.cache_clear()


def test_the_models_of_the_how_to_are_the_examples() -> None:
    names = ("own_model", "outboard", "lags", "rolling")
    for text, name in zip(blocks("own-model", "python"), names, strict=True):
        example = (ROOT / f"docs/examples/{name}.py").read_text(encoding="utf-8")
        assert text.strip() in example


def sail(path: Path, seed: int, seconds: float = 120.0) -> None:
    """Write a CSV of the rudder boat, simulated by its own model with sensor noise."""
    spec = importlib.util.spec_from_file_location("own_model", ROOT / "docs/examples/own_model.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    model = module.rudder_boat()
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.1)
    u = np.column_stack([steps(rng, t, -0.5, 1.0), steps(rng, t, -0.6, 0.6)])
    names = [o.name for o in model.outputs]
    record = Record("sail", t, u, u, np.full((t.size, len(names)), np.nan), ("n_main", "rudder"), tuple(names))
    y = simulate(model, record).y
    noise = {"psi": 0.01, "r": 0.005, "x": 0.05, "y": 0.05}
    columns = [y[:, names.index(c)] + sd * rng.normal(size=t.size) for c, sd in noise.items()]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "n_main", "rudder", *noise])
        writer.writerows(np.column_stack([t, u, *columns]).round(6).tolist())


MAP = 'format = "seatrial-import-csv 1"\n[time]\ncolumn = "t"\n' + "".join(
    f'[[signal]]\nname = "{signal}"\ncolumn = "{signal}"\nunit = "{unit}"\nrole = "{role}"\n'
    for signal, unit, role in (
        ("n_main", "1", "input"),
        ("rudder", "rad", "input"),
        ("psi", "rad", "output"),
        ("r", "rad/s", "output"),
        ("x", "m", "output"),
        ("y", "m", "output"),
    )
)


@pytest.mark.slow
def test_a_user_model_works_with_all_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of the page fit and diagnose the first model of the page."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "docs/examples/own_model.py", tmp_path)
    Path("map.toml").write_text(MAP)
    for seed, run in enumerate(("run1", "run2")):
        sail(Path(f"{run}.csv"), seed)
    run_command("seatrial import map.toml run1.csv run2.csv --out-dir .")
    run_commands(blocks("own-model", "sh")[0])
    saved = load_model(Path("vehicle/model.toml"))
    assert [i.name for i in saved.model.inputs] == ["n_main", "rudder"]
    for title, truth in (("m_u", 37.0), ("m_r", 9.69), ("l_r", 0.3)):
        error = saved.errors[title]
        assert 0.0 < error < 0.1 * truth
        assert abs(saved.model.parameter(title).value - truth) < 4.0 * error
    assert Path("diagnosis/report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("own", BOATS)
def test_a_user_model_of_the_how_to_finds_the_truth(own: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command of the page fits the model to runs of a boat that is simulated by separate code."""
    boat = BOATS[own]
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "docs/examples" / own.partition(":")[0], tmp_path)
    Path("map.toml").write_text(import_map(boat))
    for seed in (1, 2):
        write_run(boat, Path(f"run{seed}.csv"), seed)
    (fit,) = [line for line in shell_commands(how_to("own-model")) if f"--model {own} " in line]
    for line in ("seatrial import map.toml run1.csv run2.csv --out-dir .", fit):
        run_command(line)
    saved = load_model(Path("vehicle/model.toml"))
    for name, truth in (HULL | boat.truth).items():
        error = saved.errors[name]
        assert 0.0 < error < 0.05 * abs(truth), name
        assert abs(saved.model.parameter(name).value - truth) < 3.0 * error, name
