"""Tests of the Nomoto model on an independent plant, sampled like an autopilot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, cont2discrete, freqs_zpk, lfilter

from seatrial.bench.mission_generators import make_mission
from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.loading import LoadedLog
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.prior_knowledge import fix_parameters, set_priors
from seatrial.ident.model import YAW_RATE_WIDTH, smooth_modulus
from seatrial.ident.model.structure import Model, Signals
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.components import current_walk
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.workflows.vehicle_model import considered_notes, with_sampled_inputs

DT = 0.001
GYRO = 2 * np.pi * 4.0  # Corner frequency of the gyro filter [rad/s].
HALF_SPAN = 0.1  # Half of the time [s] between the two fixes that are averaged.
TRUTH = {
    "m_u": 10.0, "d_u": 35.0, "K": np.radians(280.0), "lambda_n": 1.0, "K_u": 0.0, "T_r": np.sqrt(2.0) / GYRO,
    "tau_gnss": 0.1, "sigma_gnss": HALF_SPAN,
}  # fmt: skip


def integral(rate: np.ndarray) -> np.ndarray:
    """Return the integral of a rate that is held for ``DT`` from each of its times."""
    return np.append(0.0, np.cumsum(rate[:-1]) * DT)


def tracked_vehicle(
    seconds: float,
    every: float = 0.04,
    slew: float = np.inf,
    hold: float = 0.02,
    quiet: float = 1.0,
    slide: float = 0.0,
    seed: int = 1,
) -> LogSegment:
    """Simulate a tracked vehicle: u' = 3.5 (4 n - u), r = 140 deg/s (n_left - n_right).

    Outputs are sampled every ``every`` seconds. Commands have the given ``slew`` [1/s] and change after each ``hold``
    [s]. The gyro has a filter of 4 Hz. Fixes are smoothed and 0.1 s late.

    ``quiet`` scales the noise of all sensors except the gyro. ``slide`` [s] adds v' = -u r - v / slide and u' += v r.
    """
    rng = np.random.default_rng(seed)
    mission = make_mission("mixed", seconds, seed, n_max=0.5)
    t = np.arange(0.0, mission.end, DT)
    began, rows = (np.concatenate([getattr(s, name) for s in mission.segments]) for name in ("t", "n"))
    stairs = np.arange(0.0, t[-1] + hold, hold)
    steps = rows[np.maximum(np.searchsorted(began, stairs - 0.007, side="right") - 1, 0)]
    for k in range(1, stairs.size):
        steps[k] = steps[k - 1] + np.clip(steps[k] - steps[k - 1], -slew * hold, slew * hold)
    n = steps[np.searchsorted(stairs, t, side="right") - 1]
    r = np.radians(140.0) * (n[:, 0] - n[:, 1])
    u, v = np.zeros(t.size), np.zeros(t.size)
    kept = np.exp(-DT / slide) if slide else 0.0
    for k in range(1, t.size):
        u[k] = u[k - 1] + DT * (3.5 * (4.0 * n[k - 1].mean() - u[k - 1]) + v[k - 1] * r[k - 1])
        v[k] = v[k - 1] * kept - slide * (1.0 - kept) * u[k - 1] * r[k - 1]
    psi = integral(r)
    velocity = {"vx": u * np.cos(psi) - v * np.sin(psi), "vy": u * np.sin(psi) + v * np.cos(psi)}
    output_times, attitude, fixes = (np.arange(0.5, t[-1], step) for step in (every, 0.04, 0.2))
    clock = np.arange(output_times[0], output_times[-1], 0.01)
    found = {
        f"n_{side}": Channel(
            clock, np.interp(clock + 0.005, output_times, np.interp(output_times, t, n[:, i])), hold="average"
        )
        for i, side in enumerate(("left", "right"))
    }
    ahead, back, _ = cont2discrete(butter(2, GYRO, analog=True), DT, method="zoh")
    seen = {"psi": (attitude, psi, 0.0, 0.005), "r": (attitude, lfilter(np.ravel(ahead), back, r), 0.0, 0.005)}
    for place, name in (("x", "vx"), ("y", "vy")):
        seen |= {place: (fixes, integral(velocity[name]), 0.1, 0.02), name: (fixes, velocity[name], 0.1, 0.01)}
    for name, (times, signal, late, usual) in seen.items():
        noise = usual * (1.0 if name == "r" else quiet)
        ends = (late - HALF_SPAN, late + HALF_SPAN) if times is fixes else (late,)
        seen_then = np.mean([np.interp(times - end, t, signal) for end in ends], axis=0)
        found[name] = Channel(times, seen_then + noise * rng.normal(size=times.size))
    return LogSegment("a", found)


@pytest.mark.study
def test_tracked_vehicle_is_identified_with_its_sensor_delays() -> None:
    model = nomoto_model(current=False, hold="average")
    fixed = [model.parameter(name).at(value).fixed() for name, value in (("c1", 70.0), ("c2", 0.0))]
    fit = fit_nominal_model(model.replace_parameters(*fixed), [tracked_vehicle(90.0)], []).fit
    assert fit.converged
    for name, truth in TRUTH.items():
        value, se = fit.estimate(name)
        if not np.isfinite(se):  # The estimate is at its bound, which is the true value.
            assert value == truth, name
            continue
        assert abs(value - truth) < 4.0 * se, (name, value, se)
        near = 0.1 * truth if name in ("T_r", "tau_gnss", "sigma_gnss") else 0.03 * max(truth, 1.0)
        assert abs(value - truth) < near, name


@pytest.mark.study
def test_outputs_sampled_at_10_hz_have_uncertain_times() -> None:
    """The commands are ramps in steps of 40 ms.

    With linear interpolation (``sigma_n`` nearly zero), the mass was 9 %, or five standard errors, wrong, and
    ``sigma_gnss`` became zero. The standard errors are now six times as large.
    """
    log = tracked_vehicle(90.0, every=0.1, slew=1.0, hold=0.04, quiet=0.1)
    model = nomoto_model(current=False, sampled=True, hold="average")
    fixed = [model.parameter(name).at(value).fixed() for name, value in (("c1", 70.0), ("c2", 0.0))]
    fit = fit_nominal_model(model.replace_parameters(*fixed), [log], []).fit
    assert fit.converged
    for name in ("m_u", "d_u", "lambda_n", "K", "K_u", "T_r", "tau_gnss", "sigma_gnss"):
        value, se = fit.estimate(name)
        assert abs(value - TRUTH[name]) < 3.0 * se, (name, value, se)
    assert fit.estimate("m_u")[1] < 0.06


def test_effects_that_the_model_contains_are_not_accepted() -> None:
    model = make_model("nomoto")
    assert "lambda_n" in model.values
    assert not model.accepts(catalogue()["thrust-linearity"])
    assert model.accepts(catalogue()["dead-band"])
    # The model has a delay already, and it has neither two sides nor a sway state.
    for name in ("delay", "mismatch", "inflow-loss"):
        assert not model.accepts(catalogue()[name])
    assert {"V_x", "V_y"} & set(make_model("nomoto:no-current").values) == set()
    with pytest.raises(SeatrialError):
        make_model("nomoto:general")


@pytest.mark.parametrize(
    ("every", "source"),
    [(0.1, "nomoto:sampled:no-current"), (0.025, "nomoto:sampled:no-current"), (0.01, "nomoto:no-current")],
)
def test_sampled_inputs_are_chosen_by_the_output_rate(every: float, source: str) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    channels = {f"n_{side}": Channel(t, np.sin(t), hold="average", sampled=every) for side in ("left", "right")}
    chosen, notes = with_sampled_inputs("nomoto:no-current", [LoadedLog(LogSegment("a", channels), {}, {}, None)])
    assert chosen == source
    assert len(notes) == (source != "nomoto:no-current")
    assert make_model(chosen).source == source
    assert ("sigma_n" in make_model(chosen).values) == bool(notes)
    assert with_sampled_inputs("horizontal:shaft", [LoadedLog(LogSegment("a", channels), {}, {}, None)])[1] == []


def test_considered_sensor_errors_are_reported_and_can_be_given() -> None:
    model = nomoto_model()
    (note,) = considered_notes(model)
    assert "error of the gyro's scale k_r ± 0.001 (built in), " in note
    (note,) = considered_notes(set_priors(model, {"k_r": (0.0, 0.01)}))
    assert "k_r ± 0.01, error of the inputs' time stamps dt_n ± 0.0003 s (built in), " in note
    exact, _ = fix_parameters(model, None, dict.fromkeys(model.considered, 0.0))
    assert considered_notes(exact) == considered_notes(make_model("horizontal:shaft")) == []


@pytest.mark.parametrize(("name", "like"), [("dt_r", "T_r"), ("dt_gnss", "tau_gnss"), ("dt_n", "tau_n")])
def test_time_stamp_error_acts_like_a_delay(name: str, like: str) -> None:
    """The delay is that of the gyro filter, of the fixes, or of the inputs, which follow a ramp here."""
    model, known = nomoto_model() + current_walk(), {"tau_gnss": 0.2, "T_r": 0.06, "tau_n": 0.01}
    now = {"u": 2.0, "r_gyro": 0.4, "r_gyro_rate": 3.0, "drift_x": 0.3, "drift_y": -0.2}
    x = [now.get(s.name, 0.0) for s in model.states]
    ramp = np.linspace(0.2, 0.9, len(model.inputs)).tolist()

    def found(**more: float) -> list[float]:
        s = model.signals(x, ramp, list(model.with_values(known | more).values.values()))
        return [*s.rate.values(), *s.y.values()]

    off = found(**{name: 0.004})
    assert off == pytest.approx(found(**{like: known[like] + 0.004}), rel=1e-12)
    assert off != pytest.approx(found(), rel=1e-6)


def signals(model: Model, known: dict[str, float], **values: float) -> Signals:
    """Return the signals of a row. States and inputs are given by name, and zero if not named. Delayed inputs equal the
    inputs.
    """
    model = model.with_values({"tau_gnss": 0.2, "sigma_gnss": 0.05} | values)
    x: list[Any] = [known.get(s.name, 0.0) for s in model.states]
    return model.signals(x, [known.get(i.tap_of or i.name, 0.0) for i in model.inputs], list(model.values.values()))


STEADY = {"d_u": 0.0, "d_uu": 25.0, "c1": 40.0, "c2": 0.0}


@pytest.mark.parametrize("psi", [0.0, 2.0])
@pytest.mark.parametrize("drifts", [False, True])
def test_gnss_measures_a_moving_current_like_a_constant_one(psi: float, drifts: bool) -> None:
    now = {"u": 0.5, "v": 0.1, "psi": psi, "n_left": 0.6, "n_right": 0.3}
    constant = signals(nomoto_model(), now, V_x=0.3, V_y=-0.2)
    if drifts:
        moving = signals(nomoto_model() + catalogue()["current-drift"], {**now, "t": 900.0}, V_dx=0.3, V_dy=-0.2)
    else:
        moving = signals(nomoto_model() + current_walk(), {**now, "drift_x": 0.3, "drift_y": -0.2})
    for name in ("x", "y", "vx", "vy", "psi", "r"):
        assert moving.y[name] == pytest.approx(constant.y[name], abs=1e-12), name


@pytest.mark.parametrize(
    ("name", "values", "share"),
    [
        ("dead-band", {"n_dead": 0.1}, (0.5 / 0.9 / 0.6) ** 2),
        ("thruster-interaction", {"kappa": 0.2}, 1 - 0.2 * 0.6),
        ("battery-sag", {"beta_E": 0.3}, 0.7),
        ("turn-loss", {"loss_r": 0.5}, 1 / (1 + 0.5 * smooth_modulus(0.5, YAW_RATE_WIDTH))),
    ],
)
def test_steady_speed_was_the_same_in_the_past(name: str, values: dict[str, float], share: float) -> None:
    """This also holds if an effect takes a share of the thrust, which reduces the thrust of past and present inputs
    equally.
    """
    u = (2 * 40.0 * 0.6**2 * share / 25.0) ** 0.5
    now = {"u": u, "r": 0.5, "n_left": 0.6, "n_right": 0.6, "work": 1.0}
    s = signals(nomoto_model() + catalogue()[name], now, **STEADY, **values)
    assert s.rate["u"] == pytest.approx(0.0, abs=1e-12)
    assert s.y["vx"] == pytest.approx(u, abs=1e-12)
    assert s.y["x"] == pytest.approx(-0.2 * u, abs=1e-12)


def test_sideslip_reduces_speed_and_appears_in_gnss() -> None:
    """The boat moves on a steady circle about the origin. Thrust balances linear damping and the loss by sideslip.

    The velocity points outwards of the heading by atan(tau_s r). A fix has the position on the circle ``tau_gnss`` ago.
    """
    tau, r, age = 0.3, 0.5, 0.2
    u = 40.0 * (0.75**2 + 0.45**2) / (25.0 + 10.0 * tau * r * r)
    course, radius = 0.4 - np.arctan(tau * r), u * np.hypot(1.0, tau * r) / r
    before = course - r * age
    now = {"u": u, "psi": 0.4, "n_left": 0.75, "n_right": 0.45}
    now |= {"x": radius * np.sin(course), "y": -radius * np.cos(course)}
    values = {"d_u": 25.0, "d_uu": 0.0, "m_u": 10.0, "c1": 40.0, "c2": 0.0, "K": r / 0.15, "K_u": 0.0, "k_3": 0.0}
    s = signals(nomoto_model() + catalogue()["sideslip"], now, **values, tau_s=tau, tau_gnss=age, sigma_gnss=0.0)
    assert s.r == pytest.approx(r)
    assert s.rate["u"] == pytest.approx(0.0, abs=1e-12)
    assert (s.rate["x"], s.rate["y"]) == pytest.approx((radius * r * np.cos(course), radius * r * np.sin(course)))
    assert (s.y["vx"], s.y["vy"]) == pytest.approx((radius * r * np.cos(before), radius * r * np.sin(before)))
    # The model takes two steps of the midpoint rule, with an error of third order in r age / 2.
    assert (s.y["x"], s.y["y"]) == pytest.approx((radius * np.sin(before), -radius * np.cos(before)), abs=1e-3 * radius)


def test_late_fix_has_the_sideslip_of_its_own_time() -> None:
    """The difference of the sides grows at a steady rate. With the present yaw rate, or that of half a step later, the
    velocity of 0.2 s ago would be wrong by 2 to 15 cm/s.
    """
    K, tau, age, now, change = 2.4, 0.3, 0.2, 0.3, 1.0

    def turning(t: float, x: np.ndarray) -> list[float]:
        r = K * (now + change * t)
        return [r, -tau * x[1] * r * r]

    psi, u = solve_ivp(turning, (0.0, -age), [0.4, 2.0], rtol=1e-10, atol=1e-12).y[:, -1]
    v = -tau * u * K * (now - change * age)
    model = nomoto_model() + catalogue()["sideslip"]
    values = {"tau_s": tau, "tau_gnss": age, "sigma_gnss": 0.0, "K": K, "K_u": 0.0, "d_u": 0.0, "d_uu": 0.0, "c2": 0.0}
    model = model.with_values(values)
    sides = {"n_left": 1.0, "n_right": -1.0}
    inputs = [sides[i.tap_of or i.name] * (now - change * i.delay) for i in model.inputs]
    known = {"psi": 0.4, "u": 2.0}
    s = model.signals([known.get(x.name, 0.0) for x in model.states], inputs, list(model.values.values()))
    expected = (u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi))
    assert (s.y["vx"], s.y["vy"]) == pytest.approx(expected, abs=5e-3)


@pytest.mark.study
def test_sideslip_is_identified_only_if_it_exists() -> None:
    """The vehicle slips by 0.05 s of its yaw rate.

    The effect has no lag. If sway takes 0.15 s and the yaw rate has steps, it estimates 0.12 s.
    """
    fixed = {"c1": 70.0, "c2": 0.0}
    model = nomoto_model(current=False, hold="average")
    model = model.replace_parameters(*(model.parameter(n).at(value).fixed() for n, value in fixed.items()))
    for slide in (0.05, 0.0):
        log = tracked_vehicle(90.0, slide=slide)
        fit = fit_nominal_model(model + catalogue()["sideslip"], [log], []).fit
        value, se = fit.estimate("tau_s")
        assert value == 0.0 if np.isnan(se) else abs(value - slide) < 3.0 * se, (slide, value, se)
        for name in ("m_u", "d_u", "K"):
            value, se = fit.estimate(name)
            assert abs(value - TRUTH[name]) < 4.0 * se, (slide, name, value, se)


@pytest.mark.parametrize("T_r", [0.05, 0.2])
def test_gyro_filter_is_a_butterworth_filter(T_r: float) -> None:
    """The reference is the filter of SciPy by its corner frequency. The delay of slow motion is sqrt(2) / corner."""

    def rates(**now: float) -> list[float]:
        s = signals(nomoto_model(), {"n_left": 0.0, "n_right": 0.0, **now}, T_r=T_r, K=1.0, K_u=0.0, k_3=0.0)
        return [s.rate["r_gyro"], s.rate["r_gyro_rate"]]

    states = np.column_stack([rates(r_gyro=1.0), rates(r_gyro_rate=1.0)])
    driven = np.array(rates(n_left=1.0, n_right=-1.0))[:, None]
    w = np.array([0.5, 5.0, 25.0, 100.0])
    mine = [np.linalg.solve(1j * frequency * np.eye(2) - states, driven)[0, 0] for frequency in w]
    _, wanted = freqs_zpk(*butter(2, np.sqrt(2.0) / T_r, analog=True, output="zpk"), w)
    np.testing.assert_allclose(mine, wanted, rtol=1e-9)
    gyro = signals(nomoto_model(), {"n_left": 0.6, "n_right": -0.2, "r_gyro": 0.7}, T_r=T_r)
    assert gyro.y["r"] == pytest.approx(0.7)
    at_once = signals(nomoto_model(), {"n_left": 0.6, "n_right": -0.2, "r_gyro": 0.7}, T_r=0.0)
    assert at_once.y["r"] == pytest.approx(at_once.r)


@pytest.mark.parametrize("sampled", [False, True])
def test_thrust_lag_has_its_own_states(sampled: bool) -> None:
    plain = nomoto_model(sampled=sampled)
    now = {"u": 0.5, "n_left": 0.6, "n_right": 0.3, "late_left": 0.4, "late_right": 0.2}
    slow, quick = (signals(plain + catalogue()["lag"], now, T_lag=T) for T in (0.3, 0.0))
    assert slow.rate["late_left"] == pytest.approx(0.2 / 0.3)
    assert slow.n["left"] == pytest.approx(0.4)
    without = signals(plain, now)
    for name, value in without.y.items():
        assert quick.y[name] == pytest.approx(value, abs=1e-12), name
