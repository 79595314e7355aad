"""Tests of cached kernels: the same numbers without CasADi, and never a kernel of another model."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import filter_kernels, jit
from seatrial.ident.engine.kernel_cache import kernel_key
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.outlier_density import with_outlier_model
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.models.yaw import yaw_model
from tests.ident.toys import turning, turning_record, values_of

needs_llvm = pytest.mark.skipif(not jit.AVAILABLE, reason="compares compiled code, which needs llvmlite")
ROOT = Path(__file__).resolve().parents[3]
WORK = """
import sys
from seatrial.ident.estimation.likelihood import Likelihood
from tests.ident.toys import turning, turning_record, values_of
likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
value, gradient = likelihood.gradient(record, v)
scores = likelihood.scores(record, v)
print("casadi" in sys.modules, value.hex(), *(float(g).hex() for g in [*gradient, *scores.information.ravel()]))
"""


def scalar_model(rate: Callable[[Any, Any, Any], Any], **more: Any) -> Model:
    parts: dict[str, Any] = {
        "states": (State("a", noise="q", x0=0.1),),
        "inputs": (Input("w"),),
        "sensors": (Sensor("s", (Output("y", noise="e"),)),),
        "parameters": (Parameter("k", 2.0), Parameter("q", 0.1), Parameter("e", 0.2)),
    }
    return plain_model("one", f=lambda x, u, p: {"a": rate(x, u, p)}, h=lambda x, u, p: {"y": x.a}, **parts | more)


def key(model: Model) -> str | None:
    return kernel_key(model, True, False)


KEYS = """
from seatrial.ident.engine.kernel_cache import kernel_key
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.models.components import current_walk, estimator_error
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import SENSORS, horizontal_model
sensors = tuple(SENSORS)
model = with_disturbances(horizontal_model("shaft", sensors) + current_walk() + estimator_error(sensors))
for effect in catalogue().values():
    if model.accepts(effect):
        print(effect.name, kernel_key(model + effect, True, False))
"""


def test_key_is_the_same_in_every_process() -> None:
    """The order of a set of names differs between processes. A rate that was summed in this order was compiled
    again.
    """
    found = [
        subprocess.run([sys.executable, "-c", KEYS], capture_output=True, text=True, check=True,
                       env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed}).stdout
        for seed in ("1", "2", "3")
    ]  # fmt: skip
    assert found[0].count("\n") > 20
    assert found[0] == found[1] == found[2]


@needs_llvm
def test_second_process_has_the_same_numbers_without_casadi(tmp_path: Path) -> None:
    environment = {**os.environ, "SEATRIAL_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT)}
    runs = [
        subprocess.run(
            [sys.executable, "-c", WORK], env=environment, cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert [run[0] for run in runs] == ["True", "False"]
    assert runs[0][1:] == runs[1][1:]
    for path in tmp_path.glob("*.o"):
        path.write_bytes(path.read_bytes()[:-1])  # A damaged file is compiled again.
    again = subprocess.run(
        [sys.executable, "-c", WORK], env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert again == runs[0]


@needs_llvm
def test_cached_kernel_has_its_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))
    plans = []
    for _ in range(2):
        monkeypatch.setattr(filter_kernels, "_known", {})
        likelihood = Likelihood(turning())
        likelihood.value(turning_record(), values_of(turning()))
        plans.append(filter_kernels.filter_kernels_for(turning()).value)
    made, found = plans
    assert made is not found
    assert found.layout == made.layout
    assert found.code == made.code
    assert found.plan.sizes == made.plan.sizes


IR = """
import casadi as ca
from seatrial.ident.engine.llvm_emitter import LlvmEmitter
from seatrial.ident.engine.ekf_graph import EkfGraphs
from seatrial.ident.engine.loop_plan import Plan, stage
from seatrial.ident.engine.filter_plans import Plans
from tests.ident.toys import turning
plans = Plans(EkfGraphs(turning()))
names = [f"carried{k}" for k in range(5)]
around = dict(zip(names, [ca.SX.sym(name) for name in names[1:] + names[:1]]))
made = [getattr(plans, name)() for name in ("value", "forward", "backward", "tangent", "filter")]
for plan in [*made, Plan((stage({str(v): v for v in around.values()}, around),))]:
    print(LlvmEmitter(plan).ir())
"""


def test_every_process_generates_the_same_code() -> None:
    """Otherwise no process would find the code of another in the cache, because the order of sets differs."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    runs = {
        subprocess.run(
            [sys.executable, "-c", IR],
            env={**environment, "PYTHONHASHSEED": seed},
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in "123"
    }
    assert len(runs) == 1
    assert "held.carried4" in runs.pop()


def test_two_models_share_a_key_only_if_they_are_equivalent() -> None:
    base = scalar_model(lambda x, u, p: p.k * x.a + 3.0 * np.sin(u.w))
    assert key(base) is not None
    assert key(base) == key(scalar_model(lambda x, u, p: p.k * x.a + (2.0 + 1.0) * np.sin(u.w)))
    assert key(base) == key(base.with_values({"k": 7.0}))
    others = [
        scalar_model(lambda x, u, p: p.k * x.a + 3.0000001 * np.sin(u.w)),
        scalar_model(lambda x, u, p: p.k * x.a - 3.0 * np.sin(u.w)),
        scalar_model(lambda x, u, p: p.k * x.a + 3.0 * np.cos(u.w)),
        scalar_model(lambda x, u, p: p.e * x.a + 3.0 * np.sin(u.w)),
        # The same sum in another order is compiled again, which is only slower.
        scalar_model(lambda x, u, p: 3.0 * np.sin(u.w) + p.k * x.a),
        replace(base, states=(State("a", noise=0.3, x0=0.1),)),
        replace(base, sensors=(Sensor("s", (Output("y", noise="e", angle=True),)),)),
        with_outlier_model(base),
    ]
    keys = [key(m) for m in (base, *others)]
    assert len(set(keys)) == len(keys)
    assert kernel_key(base, True, True) != key(base) != kernel_key(base, False, False)


@pytest.mark.parametrize(
    "rate",
    [
        lambda x, u, p: np.sum(np.array([2.0, 1.0]) * x.a),
        lambda x, u, p: p.k * x.a if x.a else 0.0,
        lambda x, u, p: x.nothing,
        lambda x, u, p: float(x.a),
    ],
)
def test_model_that_cannot_be_serialised_has_no_key(rate: Callable[[Any, Any, Any], Any]) -> None:
    assert key(scalar_model(rate)) is None


def test_all_models_and_effects_have_a_key() -> None:
    for model in (
        surge_model(),
        yaw_model(),
        thruster_model(),
        horizontal_model(),
        kinematic_model(),
        with_disturbances(horizontal_model("force")),
    ):
        assert key(model), model.name
    full = with_disturbances(horizontal_model())
    without = [e.name for e in catalogue().values() if full.accepts(e) and key(full + e) is None]
    assert without == []


@needs_llvm
def test_quickly_compiled_kernel_gives_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record, values = turning_record(), values_of(turning())
    found = []
    # Quick compilation is used only for few rows.
    for place, n_rows in (("careful", jit.QUICK_ROWS + 1), ("quick", jit.QUICK_ROWS)):
        monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path / place))
        monkeypatch.setattr(filter_kernels, "_known", WeakValueDictionary())
        with jit.quick_compilation(n_rows):
            found.append(Likelihood(turning()).scores(record, values, double=True))
    careful, quick = found
    np.testing.assert_allclose(quick.value, careful.value, rtol=1e-12)
    np.testing.assert_allclose(quick.gradient, careful.gradient, rtol=1e-9, atol=1e-9)
    codes = [{p.read_bytes() for p in (tmp_path / place).glob("*.o")} for place in ("careful", "quick")]
    assert not codes[0] & codes[1]  # The machine code differs and has another name.


@needs_llvm
def test_later_process_loads_a_quickly_compiled_kernel_only_for_few_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a long record would run on the slower code for as long as the cache exists."""
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))

    def code(n_rows: int) -> str:
        monkeypatch.setattr(filter_kernels, "_known", WeakValueDictionary())
        with jit.quick_compilation(n_rows):
            return filter_kernels.FilterKernels(turning(), True, False).value.code

    quick = code(100)
    assert code(100) == quick
    careful = code(jit.QUICK_ROWS + 1)
    assert careful != quick
    assert code(jit.QUICK_ROWS + 1) == careful
    assert code(100) == careful  # It is there already, and it is faster.


def test_cache_has_a_size_limit_and_keeps_recently_used_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))
    monkeypatch.setattr(jit, "LARGEST_CACHE", 10_000)
    for k in range(9):
        jit.write_cache(f"{k}.o", bytes(1000))
        os.utime(tmp_path / f"{k}.o", (k, k))
    assert jit.read_cache("0.o") == bytes(1000)  # This is the oldest file, but it was used now.
    jit.write_cache("9.o", bytes(1000))
    kept = {p.name for p in tmp_path.iterdir()}
    assert {"0.o", "9.o"} <= kept
    assert "1.o" not in kept
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) <= 7_000


def test_entry_that_cannot_be_deleted_does_not_keep_the_cache_from_shrinking(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))
    monkeypatch.setattr(jit, "LARGEST_CACHE", 20_000)
    (tmp_path / "folder").mkdir()  # no file, so that it cannot be deleted like one
    os.utime(tmp_path / "folder", (0, 0))
    for k in range(19):
        jit.write_cache(f"{k}.o", bytes(1000))
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) <= 20_000
    assert (tmp_path / "18.o").exists()


def test_cache_files_are_counted_once_and_then_by_the_written_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path))
    monkeypatch.setattr(jit, "LARGEST_CACHE", 100_000 / jit.COUNT_SHARE)
    counted: list[Path] = []
    monkeypatch.setattr(jit, "_delete_least_recently_used", counted.append)
    for k in range(15):
        jit.write_cache(f"{k}.o", bytes(10_000))
    # The files are counted with the first file, and with the eleventh file after it.
    assert counted == [tmp_path, tmp_path]


@pytest.mark.parametrize("writable", ["folder", "file"])
def test_cache_writable_by_others_is_not_used(writable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path / "kernels"))
    jit.write_cache("a.o", b"code")
    assert jit.read_cache("a.o") == b"code"
    place = tmp_path / "kernels" / ("a.o" if writable == "file" else "")
    for mode in (0o002, 0o020):
        before = place.stat().st_mode
        place.chmod(before | mode)
        assert jit.read_cache("a.o") is None
        place.chmod(before)
    assert jit.read_cache("a.o") == b"code"


def test_only_the_thread_of_a_quick_kernel_compiles_quickly() -> None:
    with ThreadPoolExecutor(1) as pool:
        with jit.quick_kernel():
            assert jit.is_quick()
            assert not pool.submit(jit.is_quick).result()
        assert not jit.is_quick()
        with jit.quick_compilation(jit.QUICK_ROWS):
            assert pool.submit(jit.is_quick).result()
