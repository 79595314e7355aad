"""Tests of models driven by commands alone, on an independent simulator. The shafts are states.

``T n' = n_ref(t - tau) - n``, ``f = 12 n|n|``, Runge-Kutta steps of 5 ms, commands held at 5 to 50 Hz.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from seatrial.ident.data.record import Channel, LogSegment, build_record
from seatrial.ident.diagnosis.search import Diagnosis, diagnose
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.model.structure import Model
from seatrial.ident.models.dead_zone import outside_dead_zone as outside_dead_zone_of_width
from seatrial.ident.models.dead_zone import transition_width
from seatrial.ident.models.horizontal import DEAD_ZONE_EDGE, horizontal_model
from tests.machine import cpu_seconds

pytestmark = pytest.mark.usefixtures("quick_compilation")

Array = NDArray[np.float64]
DT, ARM, C1 = 0.005, 0.2, 12.0  # Units: s, m, N
TRUTH = {"m_u": 12.0, "m_v": 17.0, "m_r": 1.3, "d_u": 2.0, "d_uu": 8.0, "d_v": 10.0, "d_vv": 20.0, "d_r": 1.0}
TRUTH |= {"d_rr": 1.5}
CURRENT = (0.05, -0.03)  # Unit: m/s


def commands(seconds: float, rng: np.random.Generator) -> Array:
    """Return commands (n, 2) of an operator: steps of each side, steps of both sides, and oscillations, each for 1 to 5
    s.
    """
    t = DT * np.arange(round(seconds / DT))
    wanted, i = np.zeros((t.size, 2)), 0
    while i < t.size:
        j = min(i + round(rng.uniform(1.0, 5.0) / DT), t.size)
        kind = rng.integers(3)
        wave = np.sin(2 * np.pi * rng.uniform(0.2, 1.2) * t[i:j, None] + np.array([0.0, 2.0]))
        swing = rng.uniform(-0.3, 0.6) + rng.uniform(0.1, 0.45, 2) * wave
        wanted[i:j] = (rng.uniform(-1, 1, 2), rng.uniform(-0.5, 1), swing)[kind]
        i = j
    return np.clip(wanted, -1.0, 1.0)


def rates(x: Array, n_ref: Array, T: float) -> Array:
    """Return the derivatives of the states. Plain numbers take a quarter of the time of short arrays."""
    p, (psi, u, v, r, left, right), (ref_left, ref_right) = TRUTH, x[2:].tolist(), n_ref.tolist()
    f_left, f_right = C1 * left * abs(left), C1 * right * abs(right)
    sin, cos = math.sin(psi), math.cos(psi)
    du = (f_left + f_right - p["d_u"] * u - p["d_uu"] * abs(u) * u + p["m_v"] * v * r) / p["m_u"]
    dv = (-p["d_v"] * v - p["d_vv"] * abs(v) * v - p["m_u"] * u * r) / p["m_v"]
    moment = ARM * (f_left - f_right) - p["d_r"] * r - p["d_rr"] * abs(r) * r + (p["m_u"] - p["m_v"]) * u * v
    north, east = cos * u - sin * v + CURRENT[0], sin * u + cos * v + CURRENT[1]
    return np.array([north, east, r, du, dv, moment / p["m_r"], (ref_left - left) / T, (ref_right - right) / T])


@cache
def sailed(
    seed: int, seconds: float, hertz: float, T: float = 0.25, tau: float = 0.0, dead_zone: float = 0.0
) -> dict[str, Channel]:
    """Return the log of a run: heading, yaw rate and accelerations at 50 Hz, GNSS at 5 Hz, and the commands."""
    rng = np.random.default_rng(seed)
    wanted = commands(seconds, rng)
    n, every = len(wanted), round(1 / hertz / DT)
    held = np.round(wanted[::every], 3)
    n_ref = np.repeat(np.where(np.abs(held) < dead_zone, 0.0, held), every, axis=0)[:n]
    n_ref = np.vstack([np.zeros((round(tau / DT), 2)), n_ref])[:n]
    x, state, accelerations = np.zeros((n, 8)), np.zeros(8), np.zeros((n, 2))
    gusts = np.sqrt(DT) * rng.standard_normal((n, 3)) * np.array([0.02, 0.02, 0.01])
    for k in range(n):
        x[k], k1 = state, rates(state, n_ref[k], T)
        accelerations[k] = k1[3] - state[4] * state[5], k1[4] + state[3] * state[5]
        k2 = rates(state + DT / 2 * k1, n_ref[k], T)
        k3 = rates(state + DT / 2 * k2, n_ref[k], T)
        state = state + DT / 6 * (k1 + 2 * k2 + 2 * k3 + rates(state + DT * k3, n_ref[k], T))
        state[3:6] += gusts[k]
    t, (psi, u, v) = DT * np.arange(n), x[:, 2:5].T
    ground = np.column_stack([np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v])
    seen = {"psi": (psi, 4, 0.01), "r": (x[:, 5], 4, 0.01)}
    seen |= {name: (accelerations[:, j], 4, 0.1) for j, name in enumerate(("ax", "ay"))}
    seen |= {name: (x[:, j], 40, 0.1) for j, name in enumerate(("x", "y"))}
    seen |= {name: (ground[:, j] + CURRENT[j], 40, 0.04) for j, name in enumerate(("vx", "vy"))}
    found = {
        name: Channel(t[::k], value[::k] + sd * rng.standard_normal(value[::k].size))
        for name, (value, k, sd) in seen.items()
    }
    return found | {f"n_cmd_{side}": Channel(t[::every], held[:, j]) for j, side in enumerate(("left", "right"))}


def boat() -> Model:
    model = horizontal_model("command")
    known = {"c1": C1, "c2": 0.0, "y_left": -ARM, "y_right": ARM}
    return model.replace_parameters(*[model.parameter(name).at(value) for name, value in known.items()])


@pytest.mark.parametrize(
    ("hertz", "T", "tau"),
    [
        (50.0, 0.14, 0.345),
        *(pytest.param(*case, marks=pytest.mark.study) for case in (
            (5.0, 0.25, 0.0), (10.0, 0.25, 0.13), (20.0, 0.08, 0.17),
        )),
    ],
)  # fmt: skip
def test_boat_and_shafts_are_identified_from_commands_alone(hertz: float, T: float, tau: float) -> None:
    log = sailed(7, 150.0, hertz, T, tau)
    fit = fit_nominal_model(boat(), [LogSegment("run", log)], []).fit
    assert fit.converged
    for name, true in TRUTH.items():
        value, error = fit.estimate(name)
        assert abs(value - true) < 3 * error, f"{name} {value} +- {error}, not {true}"
    for name, true in (("T_n", T), ("tau_n", tau)):
        assert fit.estimate(name)[0] == pytest.approx(true, abs=0.01)


@pytest.mark.study
def test_dead_zone_is_estimated() -> None:
    """The motors do not turn below it. At the initial value of 0.03, the gradient of the dead zone is zero for all
    commands.
    """
    end = 0.2
    log = sailed(7, 150.0, 10.0, 0.25, 0.13, end)
    fit = fit_nominal_model(boat(), [LogSegment("run", log)], []).fit
    value, error = fit.estimate("dead_zone")
    assert value == pytest.approx(end, abs=0.01)
    assert abs(value - end) < 3 * error


def outside_dead_zone(command: Any, dead_zone: Any) -> Any:
    """Return the command outside the dead zone, as a boat with commands as inputs has it."""
    return outside_dead_zone_of_width(command, dead_zone, transition_width(dead_zone, DEAD_ZONE_EDGE))


@pytest.mark.parametrize("dead_zone", [0.003, 0.02, 0.03, 0.2])
def test_half_of_a_command_at_the_end_of_its_dead_zone_passes(dead_zone: float) -> None:
    for command in (dead_zone, -dead_zone):
        assert float(outside_dead_zone(command, dead_zone)) == pytest.approx(command / 2)
    beyond = min(0.025, dead_zone)
    assert float(outside_dead_zone(1.001 * (dead_zone + beyond), dead_zone)) == 1.001 * (dead_zone + beyond)
    assert float(outside_dead_zone(0.999 * (dead_zone - beyond), dead_zone)) == 0.0


def test_zero_dead_zone_passes_the_command_with_exact_derivatives() -> None:
    command, zone = ca.SX.sym("command"), ca.SX.sym("zone")
    passed = outside_dead_zone(command, zone)
    both = ca.Function("f", [command, zone], [passed, ca.jacobian(passed, ca.vertcat(command, zone))])
    for value in (0.0, 1e-12, -1e-7, 0.004, -0.3, 1.0):
        at, slopes = both(value, 0.0)
        assert float(at) == value
        assert np.asarray(slopes).ravel().tolist() == [1.0, 0.0]


@pytest.mark.study
def test_diagnosis_of_a_nominal_boat_with_commands_alone_finds_no_effect() -> None:
    runs = [LogSegment(str(seed), sailed(seed, seconds, 10.0)) for seed, seconds in ((1, 200.0), (101, 120.0))]
    answers: list[Diagnosis] = []
    assert cpu_seconds(lambda: answers.append(diagnose(boat(), runs[:1], runs[1:])), 60.0) < 60.0
    found = answers[0]
    assert [r.chosen for r in found.rounds if r.chosen is not None] == []
    value, error = found.before.fit.estimate("T_n")
    assert abs(value - 0.25) < 3 * error < 0.02


@pytest.mark.study
def test_number_of_rows_does_not_grow_with_the_command_rate() -> None:
    rows = [build_record(boat(), sailed(7, 150.0, hertz)).n_rows for hertz in (5.0, 50.0)]
    assert rows[1] <= rows[0] + 2
