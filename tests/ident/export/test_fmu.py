"""Tests of exported FMUs: FMPy validates and simulates them, and their motion is that of the Python export."""

from __future__ import annotations

import ctypes
import io
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.export import fmu
from seatrial.ident.export.codegen import collect_content
from seatrial.ident.export.formats import export
from seatrial.ident.export.model_description import base_exponents, variables
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.export.test_simulation import COMMAND, SHAFT, initial, samples
from tests.ident.exported import KNOWN_SCALE, MODELS, compiler, saved, simulate_python
from tests.test_docs import ROOT, blocks

FMUS = {"command": COMMAND, "shaft": SHAFT, "measured attitude": MODELS["measured attitude"], "odd": MODELS["odd"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export the FMUs once, because each is compiled."""
    compiler()
    made = tmp_path_factory.mktemp("fmus")
    for name, model in FMUS.items():
        (made / f"{name}.fmu").write_bytes(exported(model))
    return made


def exported(model: Model, **options: Any) -> bytes:
    content = export(saved(model), "fmu", name="boat", nuisance=True, **options)
    assert isinstance(content, bytes)
    return content


class Instance:
    """FMU instance, with values by name."""

    def __init__(self, path: Path, unpacked: Path, name: str = "one") -> None:
        about = fmpy.read_model_description(path, validate=True)
        if not unpacked.exists():
            fmpy.extract(str(path), unzipdir=str(unpacked))
        self.references = {v.name: v.valueReference for v in about.modelVariables}
        self.fmu = FMU2Slave(
            guid=about.guid,
            unzipDirectory=str(unpacked),
            modelIdentifier=about.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.messages: list[str] = []
        self.fmu.instantiate(callbacks=self._callbacks())

    def _callbacks(self) -> Any:
        """Collect the messages of the FMU."""
        calls = fmpy.fmi2.fmi2CallbackFunctions()

        def logger(_environment: Any, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        calls.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(logger)
        calls.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        calls.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return calls

    def start(self, **values: float) -> Instance:
        self.fmu.setupExperiment(startTime=0.0)
        self.set(**values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        names = [n.replace("__", ".") for n in values]
        self.fmu.setReal([self.references[n] for n in names], list(values.values()))

    def get(self, *names: str) -> list[float]:
        return list(self.fmu.getReal([self.references[n] for n in names]))

    def step(self, t: float, dt: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=dt)


@contextmanager
def instance(folder: Path, name: str, label: str = "one") -> Iterator[Instance]:
    made = Instance(folder / f"{name}.fmu", folder / name, label)
    yield made
    made.fmu.fmi2FreeInstance(made.fmu.component)


def named(model: Model, x: Any, before: Any) -> dict[str, float]:
    """Return the start values of the FMU for states and inputs before the start."""
    content = collect_content(saved(model), nuisance=True)
    starts = dict(zip([f"start__{n}" for n in content.states], map(float, x), strict=True))
    return starts | dict(zip([f"before__{n}" for n in content.physical_inputs], map(float, before), strict=True))


def run_fmu(folder: Path, name: str, values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the states after each step, and the outputs at its end with the inputs of the next one."""
    content = collect_content(saved(FMUS[name]), nuisance=True)
    rows = variables(content)
    states, outputs = ([v.name for v in rows if v.role == role] for role in ("state", "output"))
    found: list[list[float]] = []
    measured: list[list[float]] = []
    with instance(folder, name) as vessel:
        vessel.start(**named(FMUS[name], initial(FMUS[name]), values[0]))
        for k, now in enumerate(values):
            vessel.set(**dict(zip(content.physical_inputs, map(float, now), strict=True)))
            if k:
                measured.append(vessel.get(*outputs))
            vessel.step(k * dt, dt)
            found.append(vessel.get(*states))
    return np.array(found), np.array(measured)


@pytest.mark.parametrize("name", MODELS)
def test_each_kind_of_model_gives_a_valid_fmu(name: str, tmp_path: Path) -> None:
    compiler()
    path = tmp_path / "boat.fmu"
    path.write_bytes(exported(MODELS[name]))
    assert validate_fmu(str(path)) == []
    about = fmpy.read_model_description(path, validate=True)
    assert (about.fmiVersion, about.coSimulation.canGetAndSetFMUstate) == ("2.0", True)
    assert {v.causality for v in about.modelVariables} == {"input", "parameter", "output"}
    assert all(v.description for v in about.modelVariables)
    run = fmpy.simulate_fmu(str(path), stop_time=0.5, step_size=0.1, output_interval=0.1)
    assert all(np.isfinite(run[n]).all() for n in run.dtype.names)


@pytest.mark.parametrize(
    ("name", "dt"),
    [("command", 0.05), ("command", 0.04), ("command", 0.013), ("command", 0.25), ("shaft", 0.1), ("odd", 0.03),
     ("measured attitude", 0.1)],
)  # fmt: skip
def test_motion_equals_that_of_the_python_export(folder: Path, name: str, dt: float) -> None:
    model = FMUS[name]
    values = samples(model)
    states, outputs = run_fmu(folder, name, values, dt)
    text = export(saved(model), "python", nuisance=True)
    wanted, measured = simulate_python(text, initial(model), values[0], values, dt, "zero")
    np.testing.assert_allclose(states, wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(outputs, measured[1:], rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # the slope at zero thrust
def test_thrusts_as_inputs_give_the_motion_of_the_python_export(tmp_path: Path) -> None:
    """The loss of thrust with advance ratio needs the shaft speed, which both compute from the thrust."""
    compiler()
    model = (horizontal_model() + catalogue()["advance-ratio"]).with_values(
        {"c1": 40.0, "c2": 1.5, "y_left": -0.3, "y_right": 0.3, "k_J": 6.0}
    )
    path = tmp_path / "boat.fmu"
    path.write_bytes(exported(model, thrust_input=True))
    found = fmpy.simulate_fmu(
        str(path), stop_time=3.0, step_size=0.1, output_interval=0.1, start_values={"f_left": 12.0, "f_right": -5.0}
    )
    text = export(saved(model), "python", nuisance=True, thrust_input=True)
    thrusts = np.tile([12.0, -5.0], (30, 1))
    wanted, _ = simulate_python(text, np.zeros(6), thrusts[0], thrusts, 0.1, "zero")
    for k, name in enumerate(("x", "y", "psi", "u", "v", "r")):
        assert found[name][-1] == pytest.approx(wanted[-1, k], rel=1e-9)


def test_simulate_fmu_gives_the_motion_of_the_python_export(folder: Path) -> None:
    """The way of most users: one call of FMPy with a table of inputs."""
    t = 0.05 * np.arange(101)
    left, right = np.where(t < 2.0, 0.6, 0.2), np.where(t < 3.0, 0.5, -0.4)
    table = np.array(
        list(zip(t, left, right, strict=True)), dtype=[(n, float) for n in ("time", "n_cmd_left", "n_cmd_right")]
    )
    run = fmpy.simulate_fmu(
        str(folder / "command.fmu"),
        stop_time=5.0,
        step_size=0.05,
        output_interval=0.05,
        input=table,
        output=["u", "r", "n_left"],
        start_values={"start.u": 0.3, "p.m_u": 40.0},
    )
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(export(saved(COMMAND), "python", nuisance=True), "boat.py", "exec"), space)
    start = [0.3 if n == "u" else 0.0 for n in space["STATES"]]
    sim = space["Simulation"](0.05, start, {**space["P"], "m_u": 40.0})
    columns = [space["STATES"].index(n) for n in ("u", "r", "n_left")]
    # FMPy sets the inputs of the start of each step.
    motion = np.array([start, *(sim.step(now) for now in zip(left[:-1], right[:-1], strict=True))])[:, columns]
    np.testing.assert_allclose(np.column_stack([run[n] for n in ("u", "r", "n_left")]), motion, rtol=1e-9, atol=1e-9)


def test_steps_of_any_duration_are_accepted(folder: Path) -> None:
    """Steps shorter than a millisecond keep the mean of the past; long ones are divided."""
    short = np.repeat(samples(COMMAND, 30), 100, axis=0)  # each command for 30 ms, in steps of 0.3 ms
    states, _ = run_fmu(folder, "command", short, 0.0003)
    text = export(saved(COMMAND), "python", nuisance=True)
    wanted, _ = simulate_python(text, initial(COMMAND), short[0], short, 0.0003)
    np.testing.assert_allclose(states, wanted, rtol=1e-4, atol=1e-4)
    durations = np.random.default_rng(5).choice([1e-7, 2e-4, 0.01, 0.3, 1.7], 200)
    with instance(folder, "command") as vessel, instance(folder, "command", "two") as twin:
        t = 0.0
        for some in (vessel, twin):
            some.start(before__n_cmd_left=0.4, before__n_cmd_right=0.4)
            some.set(n_cmd_left=0.4, n_cmd_right=0.4)
        for dt in durations:
            vessel.step(t, dt)
            t += dt
        twin.step(0.0, t)
        # The commands are constant, so that the duration of the steps has no influence but that on the integration.
        np.testing.assert_allclose(vessel.get("u", "n_left"), twin.get("u", "n_left"), rtol=1e-6)
        vessel.step(t, 5000.0)
        assert np.isfinite(vessel.get("u")).all()


def test_two_instances_share_no_state(folder: Path) -> None:
    with instance(folder, "command") as vessel, instance(folder, "command", "two") as twin:
        vessel.start()
        twin.start(p__m_u=80.0)
        for k in range(40):
            vessel.set(n_cmd_left=0.6, n_cmd_right=0.6)
            twin.set(n_cmd_left=-0.2, n_cmd_right=0.2)
            vessel.step(0.05 * k, 0.05)
            twin.step(0.05 * k, 0.05)
        together = vessel.get("u", "r"), twin.get("u", "r")
        assert vessel.get("p.m_u") != twin.get("p.m_u")
    alone = []
    for parameters, left, right in (({}, 0.6, 0.6), ({"p__m_u": 80.0}, -0.2, 0.2)):
        with instance(folder, "command") as vessel:
            vessel.start(**parameters)
            vessel.set(n_cmd_left=left, n_cmd_right=right)
            for k in range(40):
                vessel.step(0.05 * k, 0.05)
            alone.append(vessel.get("u", "r"))
    assert list(together) == alone


def test_saved_state_continues_the_same_motion(folder: Path) -> None:
    with instance(folder, "command") as vessel, instance(folder, "command", "two") as twin:
        vessel.start()
        twin.start()
        vessel.set(n_cmd_left=0.7, n_cmd_right=0.1)
        for k in range(10):
            vessel.step(0.05 * k, 0.05)
        kept = vessel.fmu.getFMUState()
        as_bytes = vessel.fmu.serializeFMUState(kept)

        def onwards(some: Instance) -> list[float]:
            for k in range(10, 30):
                some.set(n_cmd_left=-0.3, n_cmd_right=0.5)
                some.step(0.05 * k, 0.05)
            return some.get("x", "u", "r", "n_left")

        first = onwards(vessel)
        vessel.fmu.setFMUState(kept)
        assert vessel.get("n_cmd_left") == [0.7]
        assert onwards(vessel) == first
        restored = twin.fmu.deSerializeFMUstate(as_bytes)
        twin.fmu.setFMUState(restored)
        assert onwards(twin) == first
        for some, state in ((vessel, kept), (twin, restored)):
            some.fmu.freeFMUState(state)
        with pytest.raises(FMICallException):
            twin.fmu.deSerializeFMUstate(as_bytes[:-8])
        assert "the bytes are not a state of this model" in twin.messages[-1]


def test_reset_returns_to_the_defaults(folder: Path) -> None:
    with instance(folder, "command") as vessel:
        motions = []
        for _ in range(2):
            vessel.start()
            vessel.set(n_cmd_left=0.7, n_cmd_right=0.1)
            for k in range(20):
                vessel.step(0.05 * k, 0.05)
            motions.append(vessel.get("x", "u", "r"))
            vessel.set(p__m_u=99.0)
            vessel.fmu.reset()
            assert vessel.get("p.m_u", "x", "n_cmd_left") == [COMMAND.values["m_u"], 0.0, 0.0]
        assert motions[0] == motions[1]


def run(vessel: Instance, first: int, last: int) -> None:
    for k in range(first, last):
        vessel.step(0.1 * k, 0.1)


def test_errors_are_reported_and_do_not_change_the_state(folder: Path) -> None:
    def refused(vessel: Instance, words: str, call: Any, *arguments: Any, **values: Any) -> None:
        before = vessel.fmu.getReal(list(range(len(vessel.references))))
        with pytest.raises(FMICallException):
            call(*arguments, **values)
        assert words in vessel.messages[-1], vessel.messages
        assert vessel.fmu.getReal(list(range(len(vessel.references)))) == before

    with instance(folder, "command") as vessel:
        refused(vessel, "is not initialised", vessel.step, 0.0, 0.1)
        refused(vessel, "call fmi2EnterInitializationMode before", vessel.fmu.exitInitializationMode)
        vessel.start()
        refused(
            vessel, "fmi2SetReal: n_cmd_left is set to no finite number", vessel.set, n_cmd_right=0.1, n_cmd_left=np.nan
        )
        refused(vessel, "fmi2SetReal: u is a result", vessel.set, u=1.0)
        refused(vessel, "start.u can be set only before the start", vessel.set, start__u=1.0)
        refused(vessel, "p.tau_n is set to a value outside its bounds", vessel.set, p__tau_n=0.9)
        refused(vessel, "p.m_u is set to a value outside its bounds", vessel.set, p__m_u=0.0)
        refused(vessel, "communicationStepSize is not a positive number", vessel.step, 0.0, 0.0)
        refused(vessel, "communicationStepSize is not a positive number", vessel.step, 0.0, np.nan)
        refused(vessel, "currentCommunicationPoint is not the end of the last step", vessel.step, 0.3, 0.1)
        refused(vessel, "there is no variable with this reference", vessel.fmu.getReal, [100000])
        refused(vessel, "only real variables", vessel.fmu.getInteger, [0])
        refused(vessel, "call it once", vessel.fmu.setupExperiment)
        vessel.step(0.0, 0.1)
        vessel.set(n_cmd_left=1e200)
        with pytest.raises(FMICallException):
            run(vessel, 1, 40)
        assert "is no longer finite" in vessel.messages[-1]
        with pytest.raises(FMICallException):
            vessel.step(0.2, 0.1)
        assert "an earlier step failed; reset the model" in vessel.messages[-1]
        vessel.fmu.reset()
        vessel.start()
        vessel.step(0.0, 0.1)
        vessel.fmu.terminate()
        with pytest.raises(FMICallException):
            vessel.step(0.1, 0.1)


def test_binary_of_another_model_is_refused(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "mixed.fmu"
    with zipfile.ZipFile(folder / "command.fmu") as own, zipfile.ZipFile(path, "w") as mixed:
        for name in own.namelist():
            data = own.read(name)
            mixed.writestr(name, data.replace(b'guid="{', b'guid="{0') if name.endswith(".xml") else data)
    with pytest.raises(Exception, match="instantiate"):
        Instance(path, tmp_path / "mixed")


@pytest.mark.parametrize("define", ["", "-DFMI2_OVERRIDE_FUNCTION_PREFIX", "-Dboat_EXPORTS"])
def test_source_compiles_without_warnings_and_exports_all_functions(define: str, tmp_path: Path) -> None:
    """A shared library has the names of FMI, a static one the prefix of the model."""
    with zipfile.ZipFile(io.BytesIO(exported(COMMAND, source_only=True))) as archive:
        assert not [n for n in archive.namelist() if n.startswith("binaries")]
        archive.extractall(tmp_path)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fPIC", "-shared"]
    flags += [define] if define else []
    library = tmp_path / "boat.so"
    command = [compiler(), *flags, str(tmp_path / "sources/boat_fmu.c"), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = ctypes.CDLL(str(library))
    for name in ("GetTypesPlatform", "GetVersion", "Instantiate", "DoStep", "CancelStep", "GetStringStatus", "Reset"):
        assert getattr(loaded, f"fmi2{name}" if define else f"boat_fmi2{name}")


def test_same_model_gives_the_same_bytes() -> None:
    compiler()
    assert exported(MODELS["surge"]) == exported(MODELS["surge"])


def test_missing_or_failing_compiler_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(SeatrialError, match=r"no C compiler was found: install one .* --source-only"):
        exported(MODELS["surge"])
    assert exported(MODELS["surge"], source_only=True).startswith(b"PK")
    monkeypatch.setenv("CC", "nonesuch -m64")
    with pytest.raises(SeatrialError, match=r"the compiler nonesuch \(CC\) is not on the PATH"):
        exported(MODELS["surge"])
    failing = tmp_path / "failing"
    failing.write_text("#!/bin/sh\necho 'x.c:1: error: too old' >&2\nexit 1\n")
    failing.chmod(0o755)
    monkeypatch.setenv("CC", str(failing))
    with pytest.raises(SeatrialError, match=r"cannot compile the FMU: x\.c:1: error: too old; check the compiler"):
        exported(MODELS["surge"])


def test_outputs_depend_only_on_the_inputs_that_act_at_once() -> None:
    rows = {v.name: v for v in variables(collect_content(saved(MODELS["general"]), nuisance=True))}
    assert rows["u"].depends_on == rows["sensor.psi"].depends_on == ()
    assert rows["sensor.ax"].depends_on == (0,)
    assert (rows["p.m_u"].bounds[0], rows["p.d_u"].bounds[0], rows["p.m_u"].unit) == (0.0, 0.0, "kg")


def test_units_have_the_exponents_of_their_base_units() -> None:
    assert base_exponents("kg m2/s") == {"kg": 1, "m": 2, "s": -1}
    assert base_exponents("N/m") == {"kg": 1, "m": 0, "s": -2}
    assert base_exponents("1/s") == {"s": -1}
    assert base_exponents("m/s/s") == {"m": 1, "s": -2}
    assert base_exponents("m/s/sqrt(s)") is None


def test_export_command_writes_an_fmu(tmp_path: Path) -> None:
    compiler()
    source, out = tmp_path / "model.toml", tmp_path / "boat.fmu"
    source.write_text(blocks(ROOT / "docs/formats/model.md", "toml")[0] + KNOWN_SCALE, encoding="utf-8")
    words = ["export", str(source), "--to", "fmu", "--name", "my_boat"]
    done = CliRunner().invoke(ident, [*words, "-o", str(out)], catch_exceptions=False)
    assert done.stdout == f"wrote {out}\n"
    about = fmpy.read_model_description(out, validate=True)
    assert about.coSimulation.modelIdentifier == "my_boat"
    (mass,) = [v for v in about.modelVariables if v.name == "p.m_u"]
    assert (mass.start, mass.variability, mass.unit) == ("35.53", "tunable", "kg")
    assert "surge mass with added mass" in mass.description
    refused = CliRunner().invoke(ident, words)
    assert "an FMU is a binary file: name it with -o" in str(refused.exception)


def test_documentation_and_platform(folder: Path) -> None:
    with zipfile.ZipFile(folder / "command.fmu") as archive:
        names = archive.namelist()
        page = archive.read("documentation/index.html").decode()
    platform_folder, suffix = fmu.target_platform()
    assert f"binaries/{platform_folder}/boat{suffix}" in names
    assert {"sources/boat.h", "sources/boat_fmu.c"} < set(names)
    assert "made by: seatrial ident vehicle a.mcap" in page
    assert shutil.which("cc") is None or len(names) == 5
