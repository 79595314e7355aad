"""Tests of effects with a less obvious formula: their force, and their alternatives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.diagnosis.candidates import wave_peak_score
from seatrial.ident.effects.environment.waves import WAVES
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_and_evaluate, fit_nominal_model, nominal_model
from seatrial.ident.export.linearisation import linearise
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.model.structure import Model, Signals
from seatrial.ident.models.components import telemetry_age
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.diagnosis import in_words
from tests.missions import boat_with, channels_of, sail


def model_with(name: str, **values: float) -> Model:
    return (with_disturbances(horizontal_model()) + catalogue()[name]).with_values(values)


def rates(model: Model, **x: float) -> dict[str, float]:
    """Return rates and outputs by name. States that are not given are zero."""
    names = [s.name for s in model.states]
    state = np.array([[x.get(n, 0.0) for n in names]])
    row = VectorisedModel(model)(state, np.zeros((1, len(model.inputs))), np.array(list(model.values.values())))[0]
    return dict(zip([*names, *(f"y_{o.name}" for o in model.outputs)], row.tolist(), strict=True))


def force(name: str, x: dict[str, float], **values: float) -> float:
    """Return the force X [N] that the effect adds."""
    added = rates(model_with(name, **values), **x)["u"] - rates(model_with(name), **x)["u"]
    return 37.0 * added


def test_hump_is_largest_at_its_speed_and_opposes_the_motion() -> None:
    def hump(u: float) -> float:
        return force("hump", {"u": u}, A_hump=7.0, u_hump=0.8, w_hump=0.15)

    assert hump(0.8) == pytest.approx(-7.0, rel=1e-6)
    assert hump(-0.8) == pytest.approx(7.0, rel=1e-6)
    assert hump(0.65) == pytest.approx(-7.0 * np.exp(-0.5), rel=1e-4)
    assert abs(hump(1.6)) < 1e-5


def test_tether_drag_grows_with_its_length_and_opposes_the_motion_over_ground() -> None:
    def drag(x: float, u: float) -> float:
        return force("tether", {"x": x, "u": u}, k_tether=0.05)

    assert drag(40.0, 1.0) == pytest.approx(-2.0, rel=1e-4)
    assert drag(20.0, 1.0) == pytest.approx(-1.0, rel=1e-4)
    assert drag(40.0, -0.5) == pytest.approx(0.5, rel=1e-4)
    against = force("tether", {"x": 40.0, "u": 1.0}, k_tether=0.05, V_x=-1.0) - force(
        "tether", {"x": 40.0, "u": 1.0}, V_x=-1.0
    )
    assert against == pytest.approx(0.0, abs=1e-4)  # The boat is at rest over ground.


def test_thrust_at_an_angle_pushes_the_stern_to_the_side() -> None:
    model = model_with("thrust-angle", delta_L=0.1, delta_R=-0.05, x_delta=-0.6)
    added = pushed(model, 0.5, 0.8) - pushed(model_with("thrust-angle"), 0.5, 0.8)
    p = model.values
    left, right = (p["c1"] * n * abs(n) + p["c2"] * n * n for n in (0.5, 0.8))
    side = 0.1 * left - 0.05 * right
    np.testing.assert_allclose(added, [0.0, side / p["m_v"], -0.6 * side / p["m_r"]], atol=1e-9)


def test_propellers_walk_to_the_other_side_astern() -> None:
    model = model_with("propeller-walk", k_ahead=0.05, k_astern=0.2, x_walk=-0.6)
    p = model.values
    for n, k in ((0.6, 0.05), (-0.6, 0.2)):
        side = 2 * k * (p["c1"] * n * abs(n) + p["c2"] * n * n)
        added = pushed(model, n, n) - pushed(model_with("propeller-walk"), n, n)
        np.testing.assert_allclose(added, [0.0, side / p["m_v"], -0.6 * side / p["m_r"]], atol=1e-9)


def pushed(model: Model, left: float, right: float) -> np.ndarray:
    """Return the rates of surge, sway and yaw of a boat at rest at these shaft speeds."""
    u = np.array([[{"n_left": left, "n_right": right}.get(i.tap_of or i.name, 0.0) for i in model.inputs]])
    row = VectorisedModel(model)(np.zeros((1, len(model.states))), u, np.array(list(model.values.values())))[0]
    return row[[[s.name for s in model.states].index(name) for name in "uvr"]]


def test_bank_draws_both_ways_and_turns_the_bow_away() -> None:
    def on(psi: float, x: float) -> tuple[float, float]:
        """Return the rates of sway and yaw that a bank in the north adds."""
        at = {"u": 1.0, "psi": psi, "x": x}
        with_it = rates(model_with("bank", Y_bank=4.0, Y_slope=0.2, N_bank=1.0, N_slope=0.05), **at)
        return tuple(with_it[k] - rates(model_with("bank"), **at)[k] for k in "vr")  # type: ignore[return-value]

    east, west = on(np.pi / 2, 10.0), on(-np.pi / 2, 10.0)
    assert east[0] == pytest.approx(-6.0 / model_with("bank").values["m_v"])  # to port, to the north
    assert east == pytest.approx((-west[0], -west[1]))
    assert east[1] > 0.0  # to starboard, away from the bank
    assert on(np.pi / 2, -20.0) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert on(0.0, 10.0) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_current_and_drag_change_with_the_place() -> None:
    moved = rates(model_with("current-shear", V_xy=0.01, V_yx=-0.02), x=10.0, y=30.0)
    assert (moved["x"], moved["y"]) == pytest.approx((0.3, -0.2))
    assert force("shallow-water", {"x": 10.0, "y": -5.0, "u": 2.0}, d_north=0.3, d_east=0.2) == pytest.approx(-8.0)
    assert force("shallow-water", {"x": 10.0, "u": -2.0}, d_north=0.3) == pytest.approx(12.0)


def test_towed_line_pulls_only_if_it_is_taut_and_drawn() -> None:
    def added(**x: float) -> dict[str, float]:
        """Return the rates that a line of 5 m adds, and those of the vector from its end to the tow point."""
        values = {"k_line": 6.0, "l_line": 5.0, "x_line": -0.6}
        with_it, plain = rates(model_with("towed-line", **values), **x), rates(model_with("towed-line"), **x)
        return {n: with_it[n] - plain[n] for n in "uvr"} | {n: with_it[n] for n in ("line_x", "line_y")}

    m = model_with("towed-line").values
    straight = added(u=1.0, line_x=5.0)
    assert straight["u"] == pytest.approx(-6.0 / m["m_u"], rel=5e-3)
    assert (straight["v"], straight["r"], straight["line_x"]) == pytest.approx((0.0, 0.0, 0.0), abs=5e-3)
    c, s = np.cos(0.3), np.sin(0.3)
    aside = added(u=1.0, line_x=5.0 * c, line_y=5.0 * s)
    assert aside["v"] == pytest.approx(-6.0 * c * c * s / m["m_v"], rel=5e-3)
    assert aside["r"] == pytest.approx(0.6 * 6.0 * c * c * s / m["m_r"], rel=5e-3)
    assert (aside["line_x"], aside["line_y"]) == pytest.approx((1.0 - c * c, -c * s), abs=5e-3)
    for x in ({"u": 1.0, "line_x": 4.0}, {"u": -1.0, "line_x": 5.0}):  # slack, and pushed
        loose = added(**x)
        assert [loose[n] for n in "uvr"] == pytest.approx([0.0] * 3, abs=1e-4)
        assert loose["line_x"] == pytest.approx(x["u"], abs=0.01)
    turn = added(r=0.2, line_x=4.0, line_y=1.0)
    assert (turn["line_x"], turn["line_y"]) == pytest.approx((0.2, -0.6 * 0.2 - 0.2 * 4.0), abs=0.01)


def test_payload_that_shifts_equals_a_boat_with_each_centre_of_gravity() -> None:
    at = {"u": 1.0, "v": -0.2, "r": 0.3, "psi": 0.4}
    nominal = horizontal_model()
    places = {"x_before": 0.02, "y_before": 0.01, "x_shift": 0.1, "y_shift": -0.03, "t_shift": 100.0}
    model = (nominal + catalogue()["payload-shift"]).with_values(places)
    before, after = (
        (nominal + catalogue()["cg-offset"]).with_values({"x_g": x_g, "y_g": y_g})
        for x_g, y_g in ((0.02, 0.01), (0.12, -0.02))
    )

    def motion(model: Model, t: float) -> np.ndarray:
        x = np.array([[at.get(s.name, 0.0) for s in model.states]])
        u = np.array([[t if i.name == "t" else 0.5 for i in model.inputs]])
        return VectorisedModel(model)(x, u, np.array(list(model.values.values())))[0, : len(model.states)]

    np.testing.assert_allclose(motion(model, 60.0), motion(before, 0.0), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(motion(model, 130.0), motion(after, 0.0), rtol=1e-9, atol=1e-12)


def test_accelerometer_scale_acts_on_the_specific_force() -> None:
    x = {"u": 1.0, "r": 0.3, "v": 0.1}
    plain = rates(model_with("accelerometer-scale"), **x)
    scaled = rates(model_with("accelerometer-scale", k_acc=0.1), **x)
    for axis in ("y_ax", "y_ay"):
        assert scaled[axis] == pytest.approx(1.1 * plain[axis])
    assert scaled["u"] == plain["u"]


def test_waves_have_the_size_of_their_parameters() -> None:
    """The stationary covariance of the filter (Lyapunov's equation) is compared with A."""
    model = model_with("waves", A_X=3.0, f_wave=0.4, zeta_wave=0.07)
    names = [s.name for s in model.states]
    at = [names.index(n) for n in ("wave_X", "wave_X_rate")]
    values = np.array(list(model.values.values()))
    jacobian = VectorisedModel(model).rate_jacobian(
        np.zeros((1, len(names))), np.zeros((1, len(model.inputs))), values
    )[0]
    A = jacobian[np.ix_(at, at)]
    noise = np.array([model.states[i].noise for i in at], dtype=float)
    P = solve_continuous_lyapunov(A, -np.diag(noise**2))
    gain = 37.0 * jacobian[names.index("u"), at[0]]
    assert gain * np.sqrt(P[0, 0]) == pytest.approx(3.0, rel=1e-6)
    frequency = np.abs(np.linalg.eigvals(A))[0] / (2 * np.pi)
    assert frequency == pytest.approx(0.4)


@pytest.mark.study
def test_waves_are_found_in_the_innovations_and_fitted() -> None:
    """No waves are found on a boat without waves."""
    runs = {name: LogSegment("run", channels_of(sail(boat_with(name, 4), 130.0, 3)[0])) for name in ("waves", None)}
    assert wave_peak_score(fit_nominal_model(horizontal_model(), [runs[None]], [])) is None
    before = fit_nominal_model(horizontal_model(), [runs["waves"]], [])
    score = wave_peak_score(before)
    assert score is not None
    assert score.p < 1e-6
    assert score.scan["f_wave"] == pytest.approx(0.45, abs=0.15)
    start = replace(
        WAVES, parameters=tuple(p.at(score.scan.get(p.name, score.step.get(p.name, p.value))) for p in WAVES.parameters)
    )
    model = nominal_model(horizontal_model()) + start
    after = fit_and_evaluate(model, [make_record(model, runs["waves"], 10.0)], [])
    assert after.fit.log_posterior - before.fit.log_posterior > 100.0
    assert after.fit.estimate("f_wave")[0] == pytest.approx(0.45, abs=0.1)


def test_every_vehicle_effect_names_its_alternatives() -> None:
    for name, effect in catalogue().items():
        if "bench" not in effect.requires:
            assert effect.alternatives, name
            assert name not in effect.alternatives


def test_towed_line_keeps_its_length_on_a_straight_tow() -> None:
    """A boat tows at a steady speed: the line has its length, and the time constants of the linear model are short."""
    model = model_with("towed-line", k_line=6.0, l_line=5.0, x_line=-0.6)
    for speed in (0.3, 1.0):
        linear = linearise(model, speed)
        at = dict(zip(linear.states, linear.x0, strict=True))
        assert np.hypot(at["line_x"], at["line_y"]) == pytest.approx(5.0, rel=0.01)
        assert np.abs(linear.poles).min() > 1e-3  # no creeping length
        assert (linear.poles.real < 0.0).all()


def test_a_leak_is_a_payload_that_grows_with_time() -> None:
    model = model_with("leak", w_before=0.05, w_rate=1e-3)
    t = [i.name for i in model.inputs].index("t")
    p = np.array(list(model.values.values()))
    state, u = np.zeros((1, len(model.states))), np.zeros((1, len(model.inputs)))
    state[0, [s.name for s in model.states].index("u")], u[0, t] = 0.8, 150.0
    row = [s.name for s in model.states].index("u")
    plain = rates(model_with("leak"), u=0.8)["u"]
    assert VectorisedModel(model)(state, u, p)[0, row] == pytest.approx(plain / 1.2, rel=1e-9)


def thrusts(model: Model, **u: float) -> dict[str, float]:
    """Return the thrust of each thruster at rest. Inputs that are not given are zero."""
    inputs = [u.get(i.name, 0.0) for i in model.inputs]
    return dict(model.signals([0.0] * len(model.states), inputs, list(model.values.values())).f)


def test_reverse_mismatch_reduces_the_thrust_of_each_side_in_reverse_only() -> None:
    plain, weak = model_with("reverse-mismatch"), model_with("reverse-mismatch", rho_left=0.2, rho_right=0.6)
    for n, share in ((0.5, (1.0, 1.0)), (-0.5, (0.8, 0.4))):
        before, after = thrusts(plain, n_left=n, n_right=n), thrusts(weak, n_left=n, n_right=n)
        assert [after[side] / before[side] for side in ("left", "right")] == pytest.approx(share, rel=1e-12)


def test_a_limit_of_the_shaft_speed_acts_on_commands_above_it() -> None:
    """A boat with measured shaft speeds shows the limit in them."""
    effect = catalogue()["shaft-limit"]
    assert not horizontal_model().accepts(effect)
    command = with_disturbances(horizontal_model("command"))
    at_rest = [0.0] * len(command.states)
    for n, share in ((0.3, 0.3), (0.9, 0.5)):
        limited = (command + effect).with_values({"n_top": 0.5, "k_top": 1.0, "T_n": 0.0, "dead_zone": 0.0})
        inputs = [n if i.name.startswith("n_cmd") else 0.0 for i in limited.inputs]
        found = limited.signals(at_rest, inputs, list(limited.values.values())).n
        assert list(found.values()) == pytest.approx([share, share], rel=0.01)


def test_a_swinging_mount_pushes_sideways_only_astern() -> None:
    model = model_with("swinging-mount", swing_L=0.4, swing_R=0.0, x_swing=-0.7)
    plain = model_with("swinging-mount")
    at_rest = [0.0] * len(model.states)
    for left, right, astern in ((0.5, -0.5, False), (-0.5, 0.5, True)):
        inputs = [{"n_left": left, "n_right": right}.get(i.name, 0.0) for i in model.inputs]
        turned, straight = (m.signals(at_rest, inputs, list(m.values.values())) for m in (model, plain))
        sideways = 0.4 * straight.f["left"] if astern else 0.0
        assert pytest.approx(sideways, abs=1e-9) == turned.Y - straight.Y
        assert pytest.approx(-0.7 * sideways, abs=1e-9) == turned.N - straight.N
    words = catalogue()["swinging-mount"].in_words
    assert words is not None
    assert words({"swing_L": (0.4, 0.02), "swing_R": (-0.1, float("nan"))}) == (
        "astern the left thruster turns 22.9 ± 1.1 deg to starboard and the right thruster turns 5.7 deg to port"
    )


def test_fouling_reduces_the_thrust_of_each_side_after_its_time() -> None:
    model = model_with("fouling", foul_left=0.1, foul_right=0.4, t_foul=100.0)
    plain = thrusts(model, n_left=0.5, n_right=0.5, t=0.0)
    fouled = thrusts(model, n_left=0.5, n_right=0.5, t=200.0)
    assert fouled["left"] / plain["left"] == pytest.approx(0.9, rel=1e-9)
    assert fouled["right"] / plain["right"] == pytest.approx(0.6, rel=1e-9)


def run_of(model: Model, x: dict[str, float], u: dict[str, float]) -> Signals:
    """Return the signals of the model with the states and inputs given. All others are zero."""
    states, inputs = [x.get(s.name, 0.0) for s in model.states], [u.get(i.tap_of or i.name, 0.0) for i in model.inputs]
    return model.signals(states, inputs, list(model.values.values()))


@pytest.mark.parametrize(
    ("name", "source", "inputs"), [("lag-mismatch", "n", "n"), ("force-lag-mismatch", "f", "f")], ids=["shaft", "force"]
)
def test_each_side_has_its_own_lag(name: str, source: str, inputs: str) -> None:
    base = horizontal_model("shaft" if source == "n" else "force")
    model = (base + catalogue()[name]).with_values({"T_lag_left": 0.5, "T_lag_right": 1.4})
    s = run_of(model, {"slow_left": 0.1, "slow_right": 0.3}, {f"{inputs}_left": 0.8, f"{inputs}_right": 0.8})
    assert [s.rate[f"slow_{side}"] for side in ("left", "right")] == pytest.approx([0.7 / 0.5, 0.5 / 1.4])
    assert getattr(s, source)["left"] == pytest.approx(0.1)
    assert getattr(s, source)["right"] == pytest.approx(0.3)
    short = run_of(model.with_values({"T_lag_left": 0.1}), {"slow_left": 0.1}, {f"{inputs}_left": 0.8})
    assert short.rate["slow_left"] == pytest.approx(0.7 / 0.4)  # a quarter of the signal passes a lag of 0.4 s
    assert getattr(short, source)["left"] == pytest.approx(0.8 - 0.7 / 4)


def test_lag_of_each_side_follows_the_common_lag() -> None:
    base = horizontal_model()
    values = {"T_lag": 0.5, "T_lag_left": 0.0, "T_lag_right": 1.0}
    for order in (("lag", "lag-mismatch"), ("lag-mismatch", "lag")):
        model = (base + catalogue()[order[0]] + catalogue()[order[1]]).with_values(values)
        s = run_of(model, {"late_right": 0.4, "slow_right": 0.1}, {"n_right": 0.8})
        assert (s.rate["late_right"], s.rate["slow_right"]) == pytest.approx((0.8, 0.3))


def test_shafts_follow_their_commands_with_time_constants_that_differ() -> None:
    model = (horizontal_model("command") + catalogue()["shaft-lag-mismatch"]).with_values(
        {"T_n": 0.775, "dT_n": 1.25, "dead_zone": 0.0}
    )
    x, u = {"n_left": 0.1, "n_right": 0.3}, {"n_cmd_left": 0.8, "n_cmd_right": 0.8}
    s = run_of(model, x, u)
    assert [s.rate[f"n_{side}"] for side in ("left", "right")] == pytest.approx([0.7 / 0.15, 0.5 / 1.4])
    assert (s.n["left"], s.n["right"]) == pytest.approx((0.1, 0.3))
    at_once = run_of(model.with_values({"T_n": 0.3}), x, u)  # the left time constant would be -0.325 s
    assert at_once.n["left"] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("name", "estimates", "words"),
    [
        (
            "yaw-bias",
            {"N_uu": (-10.21, 0.46), "N_0": (0.068, 1.39)},
            "10.2 ± 0.5 N m to port at 1 m/s ahead, growing with the squared speed, and 0 ± 1 N m at any speed",
        ),
        (
            "yaw-bias",
            {"N_uu": (0.5, 0.2), "N_0": (-3.0, 0.3)},
            "0.5 ± 0.2 N m to starboard at 1 m/s ahead, growing with the squared speed, and 3.0 ± 0.3 N m to port at "
            "any speed",
        ),
        ("steady-force", {"X_0": (3.12, 0.4), "Y_0": (-0.2, 0.3)}, "3.1 ± 0.4 N forward and 0.2 ± 0.3 N to port"),
        (
            "steady-pull",
            {"F_north": (-3.0, 0.2), "F_east": (1.0, 0.0)},
            "3.0 ± 0.2 N to the south and 1.00 N to the east",
        ),
        (
            "towed-line",
            {"k_line": (12.3, 2.0), "l_line": (8.0, 1.0), "x_line": (-0.5, 0.1)},
            "a pull of 12 ± 2 N at 1 m/s, a length of 8 ± 1 m, tow point 0.5 ± 0.1 m aft",
        ),
        ("delay", {"tau_delay": (0.213, 0.01)}, "the thrust is 0.21 ± 0.01 s late"),
        ("force-lag", {"T_lag": (0.4, 0.03)}, "with a time constant of 0.40 ± 0.03 s"),
        ("heading-lag", {"T_psi": (0.1, 0.02)}, "the heading is 0.10 ± 0.02 s late"),
        (
            "wind",
            {"F_wx": (-6.0, 0.5), "F_wy": (-8.0, 0.5), "k_air": (0.28, 0.1)},
            "10.0 ± 0.5 N on the broadside, from 53 deg",
        ),
        ("wind", {"F_wx": (0.0, 0.5), "F_wy": (0.0, 0.5), "k_air": (0.0, 0.1)}, "0.00 N on the broadside"),
        ("battery-sag", {"beta_E": (0.083, 0.012)}, "the thrust falls by 8 ± 1 % in 75 s of full power"),
        (
            "lever-arm",
            {"l_x": (-0.34, 0.1), "l_y": (0.05, 0.02)},
            "the antenna is 0.3 ± 0.1 m farther aft and 0.05 ± 0.02 m farther to starboard than was given",
        ),
        (
            "lever-arm-attitude",
            {"l_x": (0.34, 0.02), "l_y": (-0.05, 0.02), "l_z": (-0.2, 0.03)},
            "the antenna is 0.34 ± 0.02 m farther forward, 0.05 ± 0.02 m farther to port and 0.20 ± 0.03 m farther up "
            "than was given",
        ),
        ("filter-lag", {"T_r": (0.12, 0.02)}, "the yaw rate is 0.12 ± 0.02 s late"),
        ("velocity-lag", {"T_uv": (0.12, 0.02)}, "the body velocities are 0.12 ± 0.02 s late"),
        (
            "heading-moment",
            {"N_s": (-3.0, 0.4), "N_c": (0.0, 0.2), "N_2s": (0.0, 0.2), "N_2c": (0.0, 0.3)},
            "at most 3.0 ± 0.5 N m to port, on heading 90 deg",
        ),
        (
            "compass",
            {"dev_s": (0.14, 0.009), "dev_c": (0.0, 0.01), "dev_2s": (0.0, 0.01), "dev_2c": (0.0, 0.009)},
            "the heading reads at most 8.0 ± 0.7 deg too high, on heading 90 deg",
        ),
        (
            "compass-filtered",
            {
                "dev_f1s": (0.0, 0.01),
                "dev_f1c": (-0.14, 0.0),
                "dev_f2s": (0.0, 0.01),
                "dev_f2c": (0.0, 0.0),
                "T_head": (3.0, 0.1),
            },
            "the heading reads at most 8.02 deg too low, on heading 0 deg",
        ),
        ("mount", {"psi_mount": (-0.05, 0.005)}, "the heading reads 2.9 ± 0.3 deg too low"),
        (
            "mount-attitude",
            {"psi_mount": (0.05, 0.005), "phi_mount": (-0.02, 0.01), "theta_mount": (0.02, 0.01)},
            "the AHRS is mounted 2.9 ± 0.3 deg clockwise, 1.1 ± 0.6 deg in roll to port and 1.1 ± 0.6 deg in pitch "
            "upwards",
        ),
        ("velocity-course", {"chi_0": (0.05, 0.005)}, "the course over ground reads 2.9 ± 0.3 deg too high"),
        ("velocity-scale", {"k_V": (-0.05, 0.005)}, "the velocity over ground reads 5.0 ± 0.5 % too low"),
        ("gyro-scale", {"k_gyro": (0.03, 0.01)}, "the yaw rate reads 3 ± 1 % too high"),
        ("accelerometer-scale", {"k_acc": (0.03, 0.01)}, "the accelerations read 3 ± 1 % too high"),
        (
            "velocity-point",
            {"b_x": (0.3, 0.02), "b_y": (-0.1, 0.03)},
            "the velocity is measured 0.30 ± 0.02 m forward of and 0.10 ± 0.03 m to port of the origin",
        ),
        ("reverse-loss", {"rho_astern": (0.2, 0.03)}, "at full reverse the thrust falls by 20 ± 3 %"),
        (
            "reverse-thrust",
            {"rho_rev": (0.2, 0.03)},
            "in reverse a thruster gives 80 ± 3 % of the thrust of the estimated curve (c1 - c2)",
        ),
        ("load-sag", {"beta_P": (0.25, 0.05)}, "with all thrusters at full speed, 80 ± 3 % of the thrust is left"),
        ("supply-sag", {"k_sag": (0.1, 0.01)}, "the shaft speed falls by 10 ± 1 % in 30 s of full power"),
        (
            "thruster-interaction",
            {"kappa": (0.2, 0.02)},
            "a thruster loses 20 ± 2 % of its thrust while the other one runs at full speed",
        ),
        ("dead-band", {"n_dead": (0.1, 0.01)}, "no thrust below 10 ± 1 % of full speed"),
        ("thrust-dead-band", {"n_band": (0.1, 0.01)}, "no thrust below 10 ± 1 % of full speed"),
        ("controller-dead-band", {"b_cmd": (0.1, 0.01)}, "the shaft stands still up to 10 ± 1 % of full command"),
        (
            "current-drift",
            {"V_dx": (0.1, 0.02), "V_dy": (-0.2, 0.02)},
            "in 600 s the current changes by 0.10 ± 0.02 m/s to the north and 0.20 ± 0.02 m/s to the west",
        ),
        ("thrust-power", {"p_n": (-0.3, 0.05)}, "the thrust grows with the power 1.70 ± 0.05 of the shaft speed"),
        ("thrust-exponent", {"p_n": (0.3, 0.05)}, "the thrust grows with the power 2.30 ± 0.05 of the shaft speed"),
        (
            "recirculation",
            {"k_wash": (0.2, 0.02), "T_wash": (6.0, 0.5)},
            "at steady full speed the thrust falls by 20 ± 2 %, with a time constant of 6.0 ± 0.5 s",
        ),
        ("turn-loss", {"loss_r": (0.5, 0.1)}, "at 30 deg/s of yaw rate, 79 ± 3 % of the thrust is left"),
        ("inflow-loss", {"loss_v": (0.5, 0.1)}, "at 0.5 m/s of sway, 80 ± 3 % of the thrust is left"),
        ("gnss-latency-command", {"tau_gnss": (0.184, 0.011)}, "the fix is 0.18 ± 0.01 s old at its time stamp"),
    ],
)
def test_sizes_with_a_natural_unit_are_told_in_words(
    name: str, estimates: dict[str, tuple[float, float]], words: str
) -> None:
    told = catalogue()[name].in_words
    assert told is not None
    assert told(estimates) == words


@pytest.mark.parametrize(("work", "run"), [([0.5], "the run"), ([0.2, 0.5, 0.1], "the run with the most work")])
def test_the_loss_by_the_battery_is_that_of_the_data(work: list[float], run: str) -> None:
    """The user wants to know what was lost in these logs, and not in a time at full power."""
    told = catalogue()["battery-sag"].in_words_of_data
    assert told is not None
    words = f"at the end of {run}, after the work of 38 s at full power, the thrust is 4.2 ± 0.6 % smaller than at its"
    assert told({"beta_E": (0.083, 0.012)}, {"work": work}) == f"{words} start"


@pytest.mark.parametrize(("age", "words"), [(0.08, "0.08 ± 0.01 s late"), (-0.02, "0.02 ± 0.01 s early")])
def test_the_age_of_telemetry_is_told_in_words(age: float, words: str) -> None:
    told = telemetry_age().in_words
    assert told is not None
    assert told({"tau_age": (age, 0.01)}) == f"the shaft speeds are logged {words}"


def test_effects_of_the_thrusters_are_told_in_words() -> None:
    told = catalogue()["lag-mismatch"].in_words
    assert told is not None
    assert told({"T_lag_left": (0.15, 0.02), "T_lag_right": (1.4, 0.1)}) == (
        "the left thruster follows with 0.15 ± 0.02 s, the right one with 1.4 ± 0.1 s"
    )
    assert told({"T_lag_left": (-0.0001, 0.004), "T_lag_right": (0.9, 0.0)}) == (
        "the left thruster follows with 0.000 ± 0.004 s, the right one with 0.90 s"
    )
    told = catalogue()["shaft-lag-mismatch"].in_words
    assert told is not None
    assert told({"T_n": (0.775, 0.03), "dT_n": (1.25, 0.06)}) == (
        "the left thruster follows its command with 0.15 s, the right one with 1.40 s, a difference of 1.25 ± 0.06 s"
    )
    told = catalogue()["wash"].in_words
    assert told is not None
    assert told({"k_wash": (0.4, 0.03)}) == (
        "astern a propeller gives 60 ± 3 % of its thrust while the other one runs ahead"
    )
    told = catalogue()["derating"].in_words
    assert told is not None
    assert told({"k_heat": (0.3, 0.02), "tau_heat": (42.0, 3.0)}) == (
        "at continuous full power the thrust falls by 30 ± 2 %, with a time constant of 42 s, and at rest it comes "
        "back in the same time"
    )


def test_hot_thrusters_lose_thrust_and_cool_at_rest() -> None:
    model = model_with("derating", k_heat=0.4, tau_heat=50.0)
    hot, cold = ({"heat_left": heat, "heat_right": 0.0} for heat in (0.5, 0.0))
    n = {"n_left": 0.8, "n_right": -0.8}
    assert run_of(model, hot, n).f["left"] / run_of(model, cold, n).f["left"] == pytest.approx(0.8)
    assert run_of(model, hot, n).f["right"] == run_of(model, cold, n).f["right"]
    rate = run_of(model, cold, n).rate  # the power does not depend on the direction
    assert (rate["heat_left"], rate["heat_right"]) == pytest.approx((0.512 / 50.0, 0.512 / 50.0))
    assert run_of(model, hot, {}).rate["heat_left"] == pytest.approx(-0.5 / 50.0)


def test_wash_weakens_a_propeller_astern_only_while_the_other_one_runs_ahead() -> None:
    plain, washed = model_with("wash"), model_with("wash", k_wash=0.5)

    def shares(left: float, right: float) -> list[float]:
        before, after = (thrusts(model, n_left=left, n_right=right) for model in (plain, washed))
        return [after[side] / before[side] for side in ("left", "right")]

    assert shares(0.6, 0.6) == shares(-0.6, -0.6) == shares(-0.6, 1e-9) == [1.0, 1.0]
    reached = (0.6**2 / (0.6**2 + 0.15**2)) ** 2
    assert shares(-0.6, 0.6) == pytest.approx([1.0 - 0.5 * reached, 1.0])
    assert shares(0.6, -0.6) == pytest.approx([1.0, 1.0 - 0.5 * reached])


def test_losses_of_thrust_are_told_by_side() -> None:
    told = catalogue()["reverse-mismatch"].in_words
    assert told is not None
    assert told({"rho_left": (0.02, 0.04), "rho_right": (0.55, 0.03)}) == (
        "in reverse the left thruster gives 98 ± 4 % of the thrust of the estimated curve (c1 - c2), the right one "
        "45 ± 3 %"
    )
    model = horizontal_model("shaft") + catalogue()["reverse-thrust"]
    for origin, curve in ((ParameterOrigin.MEASURED, "given"), (ParameterOrigin.BUILT_IN, "estimated")):
        known = (replace(model.parameter(n).known(x, 0.1, origin), free=True) for n, x in (("c1", 40.0), ("c2", 1.0)))
        fit = SimpleNamespace(model=model.replace_parameters(*known), estimate=lambda name: (0.2, 0.03), flags=())
        words = in_words(catalogue()["reverse-thrust"], SimpleNamespace(fit=fit))  # type: ignore[arg-type]
        assert words == f"in reverse a thruster gives 80 ± 3 % of the thrust of the {curve} curve (c1 - c2)"
    told = catalogue()["fouling"].in_words
    assert told is not None
    assert told({"foul_left": (0.01, 0.03), "foul_right": (0.4, 0.02), "t_foul": (210.0, 2.0)}) == (
        "from 210 s of the first log on, the left thruster gives 99 ± 3 % of its thrust before, the right one 60 ± 2 %"
    )


def test_growing_drag_multiplies_the_surge_damping() -> None:
    model = model_with("growing-drag", g_before=0.1, g_rate=2e-3)
    t = [i.name for i in model.inputs].index("t")
    state, u = np.zeros((1, len(model.states))), np.zeros((1, len(model.inputs)))
    names = [s.name for s in model.states]
    state[0, names.index("u")], state[0, names.index("r")], u[0, t] = 0.8, 0.2, 150.0
    p = np.array(list(model.values.values()))
    found = dict(zip(names, VectorisedModel(model)(state, u, p)[0], strict=False))
    plain = rates(model_with("growing-drag"), u=0.8, r=0.2)
    assert found["u"] == pytest.approx(1.4 * plain["u"], rel=1e-9)
    assert found["r"] == pytest.approx(plain["r"], rel=1e-9)
