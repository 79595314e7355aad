"""Tests of the linearisation: it equals the derivatives of the equations of motion, its step response the simulated
motion after a small step, and its frequency response the simulated motion by a small sine.
"""

from __future__ import annotations

import math
import re
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import pade
from scipy.linalg import expm

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.parameter_covariance import ParameterCovariance
from seatrial.ident.export.linearisation import LinearModel, is_shortest_lag, linearise, sway_slopes
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.yaw import yaw_model

VALUES = {"m_u": 37.0, "m_v": 47.0, "m_r": 9.7, "d_u": 2.0, "d_uu": 25.0, "d_v": 50.0, "d_vv": 20.0, "d_r": 4.1}
VALUES |= {"d_rr": 6.2, "c1": 40.0, "c2": 1.1, "V_x": 0.2, "V_y": -0.1}


def saved(model: Model, values: dict[str, float] | None = None) -> Model:
    return model.with_values(VALUES | (values or {}))


@pytest.fixture(scope="module")
def found() -> LinearModel:
    return linearise(saved(with_disturbances(horizontal_model("shaft"))), 0.7)


def test_matrices_are_the_derivatives_of_the_equations_of_motion(found: LinearModel) -> None:
    """Fossen's surge, sway and yaw with Coriolis terms of the lumped masses, in still water."""
    p, u = VALUES, 0.7
    assert found.states == ("u", "v", "r")
    assert found.inputs == ("n_left", "n_right")
    thrust = (p["d_u"] + p["d_uu"] * u) * u / 2
    n = math.sqrt(thrust / (p["c1"] + p["c2"]))
    np.testing.assert_allclose(found.u0, [n, n], rtol=1e-8)
    assert found.operating_point == {"u": u, "v": 0.0, "r": 0.0, "n_left": found.u0[0], "n_right": found.u0[1]}
    slope, arm = 2 * n * (p["c1"] + p["c2"]), 0.15
    np.testing.assert_allclose(found.B[0], [slope / p["m_u"]] * 2, rtol=1e-6)
    np.testing.assert_allclose(found.B[2], [slope * arm / p["m_r"], -slope * arm / p["m_r"]], rtol=1e-6)
    assert found.A[0, 0] == pytest.approx(-(p["d_u"] + 2 * p["d_uu"] * u) / p["m_u"], rel=1e-6)
    np.testing.assert_allclose(found.A[0, 1:], 0.0, atol=1e-6)
    assert found.A[1, 1] == pytest.approx(-p["d_v"] / p["m_v"], rel=1e-3)  # |v| v has a slope of 1e-5 in the difference
    assert found.A[1, 2] == pytest.approx(-p["m_u"] * u / p["m_v"], rel=1e-6)
    assert found.A[2, 1] == pytest.approx((p["m_u"] - p["m_v"]) * u / p["m_r"], rel=1e-6)
    assert found.A[2, 2] == pytest.approx(-p["d_r"] / p["m_r"], rel=1e-3)
    assert found.delays == {}


@pytest.mark.parametrize(("lag", "shown"), [(0.0, "at most 0.05 s"), (0.02, "at most 0.05 s"), (0.3, "0.3 s, mainly")])
def test_pole_of_a_lag_below_the_shortest_one_says_so(lag: float, shown: str) -> None:
    """The table of parameters has T_n = 0, while the state of the lag has a pole of its own."""
    at = linearise(saved(horizontal_model("command"), {"T_n": lag, "tau_n": 0.1}), 0.7)
    assert repr(at).count(f"time constant {shown}") == 2  # both shafts
    assert is_shortest_lag(0.4)  # of a thruster that lags behind its command
    assert not is_shortest_lag(0.0501)


def test_operating_point_outside_the_data_is_named_with_its_drift(found: LinearModel) -> None:
    """In a wind from the side, straight motion has a drift, which the data may not contain."""
    wind = {"F_wx": -6.0, "F_wy": 8.0, "w_n": 0.4, "V_x": 0.0, "V_y": 0.0}
    inside = {"v": (-1.0, 1.0), "n_left": (-1.0, 1.0)}
    at = replace(linearise(saved(horizontal_model("shaft") + catalogue()["wind"], wind), 0.7), ranges=inside)
    sway = float(at.x0[1])
    assert sway > 0.05
    angle = np.degrees(np.arctan2(sway, 0.7))
    assert f"sway v = {sway:.3g} m/s: the boat drifts to starboard by {angle:.2g} deg" in repr(at)
    assert at.outside == ""
    assert "outside the fitted data" not in repr(at)
    beside = replace(at, ranges={"v": (-0.6, 0.5 * sway), "n_left": (-1.0, 1.0)})
    assert beside.outside == "" if 0.05 * sway + 0.06 > 0.5 * sway else "sway v" in beside.outside
    far = replace(at, ranges={"v": (-0.02, 0.01), "n_left": (0.9, 1.0)})
    left = float(at.u0[0])
    assert (
        far.outside
        == f"sway v = {sway:.3g} m/s (98 % of the data: -0.02 to 0.01 m/s), n_left = {left:.3g} (data: 0.9 to 1)"
    )
    assert f"outside the fitted data: {far.outside}" in repr(far)
    assert found.drift == ""


def test_slope_of_sway_is_its_damping_at_each_speed() -> None:
    """With lift, the damping of sway is d_v + Y_uv u: linear in the speed."""
    model = saved(horizontal_model("shaft") + catalogue()["lift"], {"Y_uv": 80.0, "d_v": 40.0, "V_x": 0.0, "V_y": 0.0})
    speeds = np.array([0.2, 0.45, 1.2])
    found = sway_slopes(model, speeds, np.full((3, 2), 0.3), {})
    np.testing.assert_allclose(found, -(40.0 + 80.0 * speeds) / VALUES["m_v"], rtol=0.01)
    surge = surge_model("shaft")
    assert (
        sway_slopes(
            surge.with_values({n: v for n, v in VALUES.items() if n in surge.values}), speeds, np.full((3, 2), 0.3), {}
        ).size
        == 0
    )


def test_poles_and_time_constants(found: LinearModel) -> None:
    surge = found.A[0, 0]
    assert np.isclose(found.poles, surge).any()
    np.testing.assert_allclose(np.sort(found.poles.real), np.sort(np.linalg.eigvals(found.A).real))
    assert (np.diff(np.abs(found.poles.real)) >= 0).all()
    np.testing.assert_allclose(found.time_constants, -1 / found.poles.real)
    assert found.stable


def test_step_response_is_the_motion_after_a_small_step(found: LinearModel) -> None:
    model = horizontal_model("shaft").with_values(VALUES | {"V_x": 0.0, "V_y": 0.0})
    t, step = np.arange(0.0, 12.0, 0.1), 1e-3
    inputs = {"n_left": found.u0[0] + step + 0 * t, "n_right": found.u0[1] + 0 * t, "psi": 0 * t}
    record = build_record(model, {name: Channel(t, z) for name, z in inputs.items()})
    start = np.zeros(len(model.states))
    names = [s.name for s in model.states]
    start[names.index("u")] = 0.7
    run = simulate(model, record, x0=start)
    expected = found.step_response("n_left", run.t - run.t[0])
    for name in ("u", "v", "r"):
        moved = run.x[:, names.index(name)] - start[names.index(name)]
        np.testing.assert_allclose(moved, step * expected[name], atol=0.01 * np.abs(moved).max())
    with pytest.raises(KeyError, match="the model has no input 'n_top'"):
        found.step_response("n_top", t)


def test_weaker_side_and_the_shafts_of_a_command_model() -> None:
    model = horizontal_model("command") + catalogue()["mismatch"]
    found = linearise(saved(model, {"eps_LR": -0.1}), 0.7)
    assert {"n_left", "n_right"} < set(found.states)
    assert found.inputs == ("n_cmd_left", "n_cmd_right")
    left, right = found.u0
    assert left > right > 0.0
    assert 0.9 * left**2 == pytest.approx(1.1 * right**2, rel=1e-3)
    assert set(found.delays) == {"n_cmd_left", "n_cmd_right"}
    assert found.stable


def test_speed_beyond_full_thrust_is_refused() -> None:
    with pytest.raises(SeatrialError, match=r"3 m/s needs n_left = 1\.\d\d, more than full"):
        linearise(saved(horizontal_model("shaft")), 3.0)
    with pytest.raises(SeatrialError, match="give a number other than zero"):
        linearise(saved(horizontal_model("shaft")), 0.0)
    with pytest.raises(SeatrialError, match="has no forward speed u among its states"):
        linearise(yaw_model(), 0.5)


def test_step_response_begins_after_the_dead_time() -> None:
    found = linearise(saved(horizontal_model("command"), {"tau_n": 0.4}), 0.7)
    assert found.delays == {"n_cmd_left": 0.4, "n_cmd_right": 0.4}
    response = found.step_response("straight", np.array([0.0, 0.39, 0.41, 30.0]))["u"]
    np.testing.assert_array_equal(response[:2], 0.0)
    assert 0.0 < response[2] < 1e-3
    p = VALUES
    slope = 4 * found.u0[0] * (p["c1"] + p["c2"]) / (p["d_u"] + 2 * p["d_uu"] * 0.7)  # of the steady speed
    assert response[3] == pytest.approx(slope, rel=1e-3)


def test_motions_are_sums_of_inputs(found: LinearModel) -> None:
    assert found.motions["turn"] == {"n_left": 1.0, "n_right": -1.0}
    left, right, both = (found.step_response(x)["u"] for x in ("n_left", "n_right", "straight"))
    np.testing.assert_allclose(both, left + right, atol=1e-12)
    half = found.frequency_response({"n_left": 0.5, "n_right": -0.5})["r"]
    np.testing.assert_allclose(half, 0.5 * found.frequency_response("turn")["r"])
    assert found.responding("straight") == ("u",)
    assert found.responding("turn") == ("v", "r")
    np.testing.assert_allclose(half, found.frequency_response({"turn": 0.5, "n_left": 0.0})["r"])
    with pytest.raises(KeyError, match="did you mean 'turn'"):
        found.bode("turns")


def test_names_of_no_input_and_no_state_are_named(found: LinearModel) -> None:
    with pytest.raises(KeyError, match=r"no input 'n_lft'; did you mean 'n_left'\? its inputs are n_left, n_right"):
        found.step_response({"n_lft": 1.0})
    for respond in (found.step_response, found.frequency_response, found.bode):
        with pytest.raises(SeatrialError, match='inputs: give the name of an input, such as "n_left", or weights'):
            respond(["n_left"])  # type: ignore[operator]
        with pytest.raises(KeyError, match=r"there is no state .*'yaw'; the names are u"):
            respond("n_left")["yaw"]  # type: ignore[operator]


def test_frequency_response_is_that_of_scipy_with_the_dead_time() -> None:
    found = linearise(saved(horizontal_model("command"), {"tau_n": 0.3}), 0.7)
    w = np.geomspace(0.01, 20.0, 40)
    for k, name in enumerate(found.inputs):
        response = found.frequency_response(name, w / (2 * np.pi))
        for state in found.responding(name):
            j = found.states.index(state)
            system = signal.StateSpace(found.A, found.B[:, [k]], np.eye(len(found.A))[[j]], np.zeros((1, 1)))
            with warnings.catch_warnings():  # of SciPy, which makes transfer functions with tiny coefficients
                warnings.simplefilter("ignore", signal.BadCoefficients)
                _, expected = signal.freqresp(system, w)
            delayed = expected * np.exp(-0.3j * w)
            np.testing.assert_allclose(response[state], delayed, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("motion", ["straight", "turn"])
def test_frequency_response_is_the_motion_by_a_small_sine(motion: str) -> None:
    """Simulate the non-linear boat with a small sine on the commands, and compare amplitude and phase with the gain."""
    values, state = {"tau_n": 0.25, "V_x": 0.0, "V_y": 0.0}, {"straight": "u", "turn": "r"}[motion]
    model = horizontal_model("command").with_values(VALUES | values)
    found, f, size = linearise(model, 0.7), 0.2, 2e-3
    t = np.arange(0.0, 120.0, 0.05)
    sine = size * np.sin(2 * np.pi * f * t)
    z = {n: u + found.motions[motion][n] * sine for n, u in zip(found.inputs, found.u0, strict=True)}
    record = build_record(model, {n: Channel(t, v) for n, v in (z | {"psi": 0 * t}).items()})
    names = [s.name for s in model.states]
    start = np.zeros(len(names))
    for name, value in zip(found.states, found.x0, strict=True):
        start[names.index(name)] = value
    run = simulate(model, record, x0=start)
    last = run.t > run.t[-1] - 10.0 / f  # ten periods
    at = 2 * np.pi * f * run.t[last]
    waves = np.column_stack([np.sin(at), np.cos(at), np.ones(at.size), at])
    a, b, *_ = np.linalg.lstsq(waves, run.x[last, names.index(state)], rcond=None)[0]
    measured = (a + 1j * b) / size
    expected = found.frequency_response(motion, np.array([f]))[state][0]
    held = np.sinc(f * 0.05) * np.exp(-1j * np.pi * f * 0.05)  # commands are held for a sample
    assert abs(measured) == pytest.approx(abs(expected * held), rel=0.02)
    assert np.angle(measured / (expected * held)) == pytest.approx(0.0, abs=0.02)


def test_bandwidth_and_lag_of_a_shaft() -> None:
    """A first-order lag falls by 3 dB at its corner; with a dead time it lags by 90 deg where both add up to that."""
    found = linearise(saved(horizontal_model("command"), {"tau_n": 0.3, "T_n": 0.2}), 0.7)
    shaft = found.bode("n_cmd_left")["n_left"]
    assert shaft.bandwidth == pytest.approx(1 / (2 * np.pi * 0.2), rel=1e-3)
    w = 2 * np.pi * shaft.lag_90
    assert np.arctan(0.2 * w) + 0.3 * w == pytest.approx(np.pi / 2, rel=1e-3)
    assert np.isnan((*shaft.gain_sd, shaft.bandwidth_sd, shaft.lag_90_sd)).all()


def growth(linear: LinearModel, k: float) -> float:
    """Return the largest real part of the poles with ``command of the turn = -k psi``, the dead time by Pade."""
    n, tau = len(linear.A), linear.delays["n_cmd_left"]
    ahead, behind = pade([(-tau) ** i / math.factorial(i) for i in range(9)], 4)
    late = signal.TransferFunction(ahead.coeffs, behind.coeffs).to_ss()
    m = len(late.A)
    whole = np.zeros((n + 1 + m, n + 1 + m))  # states, heading, dead time
    b = linear.B @ [1.0, -1.0]
    whole[:n, :n], whole[n, linear.states.index("r")] = linear.A, 1.0
    whole[:n, n] = -k * late.D[0, 0] * b
    whole[:n, n + 1 :] = np.outer(b, late.C[0])
    whole[n + 1 :, n + 1 :], whole[n + 1 :, n] = late.A, -k * late.B[:, 0]
    return float(np.linalg.eigvals(whole).real.max())


def test_lag_of_an_unstable_boat_is_that_beyond_its_unstable_pole() -> None:
    """At this frequency the yaw rate lags by 90 deg, not by 270, and a feedback of the heading is at its limit."""
    values = {"d_r": 6.0, "d_v": 5.0, "m_v": 47.0, "tau_n": 0.05, "T_n": 0.1}
    found = linearise(saved(horizontal_model("command"), values), 0.7)
    assert not found.stable
    turn = found.bode("turn")["r"]
    p = found.poles.real.max()
    assert turn.no_lag_90 == ""
    assert turn.lag_90 > 2.0 * p / np.pi
    h = found.frequency_response("turn", np.array([turn.lag_90]))["r"][0]
    assert np.degrees(np.angle(h)) == pytest.approx(-90.0, abs=0.5)
    k = 2 * np.pi * turn.lag_90 / abs(h)  # gain of the heading at which the crossover is there
    assert growth(found, 0.9 * k) < 0.0 < growth(found, 1.1 * k)
    slow = linearise(saved(horizontal_model("command"), values | {"tau_n": 0.1, "T_n": 0.8}), 0.7)
    assert min(growth(slow, g) for g in k * np.geomspace(1e-3, 1e2, 60)) > 0.0  # no feedback of the heading alone
    late = slow.bode("turn")["r"]
    assert np.isnan(late.lag_90)
    assert late.no_lag_90.startswith("The state lags by more than 90 deg at all frequencies")
    # shaft speeds: no lag, no dead time
    shaft = linearise(saved(horizontal_model("shaft"), {k: values[k] for k in ("d_r", "d_v", "m_v")}), 0.7)
    turn = shaft.bode("turn")["r"]
    assert np.isnan(turn.lag_90)
    assert turn.no_lag_90.startswith("An unstable pole makes the phase rise to -90 deg at ")
    assert "never lags by 90 deg up to" in turn.no_lag_90
    own = shaft.bode("turn", np.geomspace(1.0, 2.0, 5))["r"]  # frequencies beyond the rise count from the same phase
    np.testing.assert_allclose(own.phase - own.start, np.interp(own.frequency, *turn[:3:2]) - turn.start, atol=0.01)
    stable = linearise(saved(horizontal_model("shaft")), 0.7).bode("straight")["u"]
    assert np.isnan(stable.lag_90)
    assert stable.no_lag_90.startswith("The state never lags by 90 deg up to")


def test_poles_of_the_boat_come_before_those_of_thrusters_and_waves() -> None:
    """Lightly damped waves are the slowest poles, and stood before those of the boat."""
    values = {"T_n": 0.15, "d_r": 9.7 * 4.0, "d_v": 37.0}
    model = horizontal_model("command") + catalogue()["waves"]
    found = linearise(saved(model, values), 0.7)
    kinds = [2 if "wave" in n else 1 if n.startswith("n_") else 0 for n in found.mainly]
    assert kinds == sorted(kinds)
    assert set(kinds) == {0, 1, 2}
    for k in set(kinds):
        assert (np.diff(np.abs(found.poles.real[np.array(kinds) == k])) >= -1e-12).all()
    slowest = int(np.argmin(np.abs(found.poles.real)))
    assert kinds[slowest] == 2


def test_poles_are_named_by_the_states_that_take_most_part() -> None:
    """A boat without coupling has one state for each pole. A state is named by its own diagonal element."""
    values = {"m_v": VALUES["m_u"], "T_n": 0.15, "d_r": 9.7 * 4.0, "d_v": 37.0}  # equal masses: no moment by sway
    found = linearise(saved(horizontal_model("command"), values), 0.7)
    assert sorted(found.mainly) == ["n_left", "n_right", "r", "u", "v"]
    for pole, name in zip(found.poles, found.mainly, strict=True):
        k = found.states.index(name)
        assert pole.real == pytest.approx(found.A[k, k], rel=1e-3)
    np.testing.assert_allclose(found.participation.sum(axis=1), 1.0, atol=1e-6)
    assert f"1/s, time constant {found.time_constants[0]:.4g} s, mainly {found.mainly[0]}" in repr(found)
    # a pair of complex poles belongs to both of its states, the larger part first
    block = np.array([[-0.5, 0.0, 0.0], [0.0, -1.0, -2.0], [0.0, 1.5, -1.2]])
    pair = replace(linearise(saved(horizontal_model("shaft")), 0.7), A=block)
    assert pair.mainly[0] == "u"
    assert {frozenset(names.split(", ")) for names in pair.mainly[1:]} == {frozenset({"v", "r"})}


def test_frequencies_reach_beyond_the_lag_of_90_deg_and_no_farther_than_needed() -> None:
    """A dead time of milliseconds does not extend them to frequencies of hundreds of hertz."""
    for delay in (1e-4, 3e-3, 0.05, 0.4):
        found = linearise(saved(horizontal_model("command"), {"tau_n": delay, "T_n": 0.15}), 0.7)
        fastest = np.abs(found.poles).max() / (2.0 * np.pi)
        shaft = found.bode("straight")["n_left"]
        assert np.isfinite(shaft.lag_90)
        highest = float(found.frequencies[-1])
        assert highest > 2.0 * shaft.lag_90
        assert highest == pytest.approx(max(10.0 * fastest, 3.0 * math.sqrt(fastest / (2.0 * np.pi * delay))))
    assert float(linearise(saved(horizontal_model("command")), 0.7).frequencies[-1]) < 500.0


def test_standard_errors_follow_from_those_of_the_estimates() -> None:
    """The surge has the time constant m_u / (d_u + 2 d_uu u) and the gain of a first-order lag."""
    sd_m, sd_tau = 1.5, 0.02
    known = ParameterCovariance(("m_u", "V_x@0", "tau_n"), np.diag([sd_m**2, 1.0, sd_tau**2]))
    model = horizontal_model("command").with_values(VALUES | {"tau_n": 0.3, "T_n": 0.2})
    found = linearise(model, 0.7, known)
    drag = VALUES["d_u"] + 2 * VALUES["d_uu"] * 0.7
    f = np.array([0.01, 0.1, 1.0])
    speed, w = found.bode("straight", f)["u"], 2 * np.pi * f
    T, sd = VALUES["m_u"] / drag, sd_m / drag
    np.testing.assert_allclose(speed.gain_sd, sd * T * w**2 / (1 + (T * w) ** 2), rtol=0.02)
    phase = np.hypot(sd * w / (1 + (T * w) ** 2), sd_tau * w)
    np.testing.assert_allclose(speed.phase_sd, phase, rtol=0.02)
    surge = linearise(horizontal_model("shaft").with_values(VALUES), 0.7, known)
    k = int(np.argmin(np.abs(surge.time_constants - T)))
    assert surge.time_constant_errors[k] == pytest.approx(sd, rel=0.02)
    corner = surge.bode("straight")["u"]
    assert corner.bandwidth_sd / corner.bandwidth == pytest.approx(sd_m / VALUES["m_u"], rel=0.03)
    assert f"bandwidth {corner.bandwidth:.3g} ± {corner.bandwidth_sd:.2g} Hz" in repr(corner)
    moved = [m.bode("straight")["u"].lag_90 for m in found.moved]
    lag = found.bode("straight")["u"]
    assert lag.lag_90_sd == pytest.approx(math.hypot(*(m - lag.lag_90 for m in moved)) / 0.05, rel=0.02)


def test_step_response_is_that_of_the_matrix_exponential() -> None:
    """At any times, in any order, with the dead time of each input."""
    found = linearise(saved(horizontal_model("command"), {"tau_n": 0.25}), 0.7)
    n = len(found.states)
    for t in (found.times, np.array([0.0, 5.0, 0.3, 5.0, 2.0]), np.array([30.0]), np.zeros(0)):
        response = found.step_response({"n_cmd_left": 1.0, "n_cmd_right": -0.5}, t)
        expected = np.zeros((t.size, n))
        for k, weight in enumerate((1.0, -0.5)):
            whole = np.zeros((n + 1, n + 1))
            whole[:n, :n], whole[:n, n] = found.A, found.B[:, k]
            expected += [weight * expm(max(at - 0.25, 0.0) * whole)[:n, n] for at in t] if t.size else 0.0
        for k, name in enumerate(found.states):
            np.testing.assert_allclose(response[name], expected[:, k], rtol=1e-10, atol=1e-12)


def test_responses_of_a_model_with_many_estimates_are_quick() -> None:
    """The exponentials of a response must not depend on a threaded library, which takes a thousand times longer."""
    model = horizontal_model("command")
    for effect in ("mismatch", "cubic-drag", "yaw-bias", "battery-sag", "wind", "lift", "payload-shift"):
        model = model + catalogue()[effect]
    model = saved(model)
    free = [p for p in model.parameters if p.free and p.name not in model.noises]
    covariance = np.diag([(0.01 * max(abs(p.value), p.step)) ** 2 for p in free])
    found = linearise(model, 0.7, ParameterCovariance(tuple(p.name for p in free), covariance))
    assert len(found.moved) > 20
    start = time.perf_counter()
    for linear in (found, *found.moved):
        for motion in found.motions:
            linear.step_response(motion, found.times)
    assert time.perf_counter() - start < 1.5


def test_course_pole_is_that_of_sway_and_yaw() -> None:
    """The least stable eigenvalue of the block of sway and yaw, also if a weak thruster couples it with the surge."""
    model = horizontal_model("command") + catalogue()["mismatch"]
    for eps in (0.0, -0.05):
        found = linearise(saved(model, {"eps_LR": eps, "d_r": 0.5, "d_v": 20.0, "m_v": 70.0}), 0.7)
        block = [found.states.index(n) for n in ("v", "r")]
        poles = np.linalg.eigvals(found.A[np.ix_(block, block)])
        k = found.course_pole
        assert k is not None
        assert found.poles[k].real == pytest.approx(poles.real.max(), rel=0.1)
        assert found.poles[k].real > 0.0
        assert not found.stable
    assert linearise(surge_model("shaft", "both"), 0.3).course_pole is None


def test_error_of_a_pole_is_the_change_by_the_parameter() -> None:
    model, sd = saved(horizontal_model("shaft"), {"d_r": 3.0}), 0.2
    found = linearise(model, 0.7, ParameterCovariance(("d_r",), np.array([[sd**2]])))
    k = found.course_pole
    assert k is not None
    ends = [linearise(model.with_values({"d_r": 3.0 + d}), 0.7) for d in (-0.1 * sd, 0.1 * sd)]
    slope = np.diff([np.sort(x.poles.real)[::-1][0] for x in ends])[0] / (0.2 * sd)
    assert np.sort(found.poles.real)[::-1][0] == found.poles[k].real
    assert found.pole_errors[k] == pytest.approx(abs(slope) * sd, rel=0.02)
    np.testing.assert_allclose(found.time_constant_errors, found.pole_errors * found.time_constants**2)


def test_stability_says_which_motion_does_not_decay() -> None:
    """With a sway mass far above that in surge, the Munk moment of this boat makes sway and yaw unstable."""
    stable = linearise(saved(horizontal_model("shaft")), 0.7)
    assert (stable.stability, stable.stability_text) == ("stable", "stable")
    model = saved(horizontal_model("shaft"), {"m_v": 150.0, "d_r": 0.5})

    def known(sd: float) -> ParameterCovariance:
        return ParameterCovariance(("d_r",), np.array([[sd**2]]))

    unstable = linearise(model, 0.7, known(0.001))
    pole = unstable.poles.real.max()
    assert pole > 0.0
    assert unstable.stability == "unstable"
    grows = f"sway speed and yaw rate grow by a factor of e in {1 / pole:.3g} s without a controller"
    assert unstable.stability_text == f"unstable: {grows}"
    assert unstable.stability_text in repr(unstable)
    free = replace(unstable, A=np.diag([-1.0, -0.5, 0.0]), moved=())
    assert free.stability == "free"
    assert free.stability_text == "free: yaw rate is free (pole 0): nothing brings back what a disturbance has changed"
    for boat in (model, saved(horizontal_model("shaft"))):  # the estimate is unstable, and stable
        found = linearise(boat, 0.7, known(50.0))
        assert found.stability == "not shown by the data"
        assert re.match(
            r"stability not shown by the data: [\w ]+ may grow or decay \(pole [-\d.e+]+ ± [\d.e+]+ 1/s\)",
            found.stability_text,
        )
        assert found.stability_text in repr(found)
        assert "surge" not in found.stability_text


def test_time_constant_with_a_large_error_is_not_determined() -> None:
    model = saved(horizontal_model("shaft"))
    for sd, lost in ((0.01, False), (9.0, True)):
        found = linearise(model, 0.7, ParameterCovariance(("d_r",), np.array([[sd**2]])))
        assert ("time constant not determined" in repr(found)) == lost
        assert np.isfinite(found.time_constants).all()  # the number is kept


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.bode("turn", ["a"]), "frequency: give frequencies .* and not"),
        (lambda m: m.bode("turn", [0.0, 1.0]), "frequency 0 Hz: give frequencies above 0"),
        (lambda m: m.step_response("turn", [-1.0, 1.0]), "t -1 s: give times of at least 0"),
        (lambda m: m.step_response("turn", float("nan")), "t: give one number or a list of finite numbers"),
        (lambda m: m.step_response({"turn": "1"}), "inputs: the weight of turn is '1'; give a number"),
        (lambda m: m.lqr({"u": "4"}), "u is '4': give a number, in SI units and radians"),
        (lambda m: m.lqr({"u": 4.0, "r": 1.0})([0.8, 0.0, 0.0]), "x: give a dict of the states by name, .* not a list"),
        (lambda m: m.lqr({"u": 4.0})({"u": None, "v": 0.0, "r": 0.0}), "u is None: give a number"),
        (lambda m: m.bode("yaw"), "^the model has no input 'yaw'; did you mean 'turn'"),
    ],
)
def test_wrong_arguments_are_named_in_one_line(call: Callable[[LinearModel], object], message: str) -> None:
    with pytest.raises(SeatrialError, match=message):
        call(linearise(saved(horizontal_model("shaft")), 0.7))


def test_only_a_growing_motion_has_a_growth_rate() -> None:
    """An integrator, as a heading without a controller, is not stable, but does not grow."""
    stable = linearise(saved(horizontal_model("shaft")), 0.7)
    assert stable.growth == 0.0
    n = len(stable.states)
    assert replace(stable, A=np.diag([0.0, *[-1.0] * (n - 1)])).growth == 0.0
    assert replace(stable, A=np.diag([0.4, *[-1.0] * (n - 1)])).growth == 0.4
