"""Tests of every effect: neutral at its initial values, consistent with its formula, and completely described."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.effects.sensors.gnss_latency import N_PAST, _weights_ago
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.structure import Effect, Model, Signals
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.components import telemetry_age
from seatrial.ident.models.horizontal import SENSORS, horizontal_model, thrust_of, with_thrust_of
from seatrial.ident.models.scaling import scale_priors, size_of
from tests.ident.carriers import carrier

RNG = np.random.default_rng(7)
RECORD_S = 240.0  # Times are within a record of this duration; a change of the payload has a time.


def points(model: Model, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return random states and inputs. Delayed inputs equal the inputs, so delays change nothing."""
    x = RNG.normal(size=(n, len(model.states))) * 0.5
    x[:, [s.name == "dev_behind" for s in model.states]] = 0.0  # A filter without input stays at zero.
    u = RNG.uniform(-1, 1, size=(n, len(model.inputs)))
    names = [i.name for i in model.inputs]
    for j, signal in enumerate(model.inputs):
        if signal.tap:
            u[:, j] = u[:, names.index(signal.tap_of)]
    return x, u


def evaluate(model: Model, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return VectorisedModel(model)(x, u, np.array(list(model.values.values())))


@pytest.mark.parametrize("name", catalogue())
def test_effect_is_neutral_at_its_initial_values(name: str) -> None:
    effect = catalogue()[name]
    base = carrier(effect)
    model = base + effect
    x, u = points(model)
    n, m = len(base.states), len(effect.states)
    with_it = np.delete(evaluate(model, x, u), np.s_[n : n + m], axis=1)
    own = [[i.name for i in model.inputs].index(i.name) for i in base.inputs]
    np.testing.assert_allclose(with_it, evaluate(base, x[:, :n], u[:, own]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "source",
    [
        "horizontal:shaft",
        "horizontal:command",
        "horizontal:force",
        "horizontal:general",
        "nomoto",
        "nomoto:sampled",
        "kinematic:shaft",
        "kinematic:force:yaw",
    ],
)
def test_accepted_effect_is_neutral_for_any_past_inputs(source: str) -> None:
    base = make_model(source, tuple(SENSORS))
    accepted = [e for e in (*catalogue().values(), nothing_late()) if base.accepts(e)]
    assert accepted
    n = len(base.states)
    for effect in accepted:
        model = base + effect
        x, _ = points(model)
        u = RNG.uniform(-1, 1, size=(len(x), len(model.inputs)))
        with_it = np.delete(evaluate(model, x, u), np.s_[n : n + len(effect.states)], axis=1)
        without = evaluate(base, x[:, :n], u[:, : len(base.inputs)])
        np.testing.assert_allclose(with_it, without, rtol=1e-9, atol=1e-9, err_msg=effect.name)


def nothing_late() -> Effect:
    """Return an age of telemetry of zero. The catalogue does not list this component."""
    age = telemetry_age()
    return replace(age, parameters=(age.parameters[0].at(0.0),))


def test_nomoto_model_covers_the_age_of_its_inputs_by_its_delay() -> None:
    assert not make_model("nomoto").accepts(telemetry_age())
    assert make_model("horizontal:shaft").accepts(telemetry_age())


def test_titles_are_distinct() -> None:
    """A list of effects by title, as that of the candidates, is ambiguous otherwise."""
    names = Counter(effect.title for effect in catalogue().values())
    assert not [title for title, number in names.items() if number > 1]


@pytest.mark.parametrize("name", catalogue())
def test_effect_changes_the_model_and_is_described(name: str) -> None:
    effect = catalogue()[name]
    model = carrier(effect) + effect
    x, u = points(model)
    u = RNG.uniform(-1, 1, size=u.shape)  # The delayed inputs differ from the inputs.
    u[:, [i.name == "t" for i in model.inputs]] = np.linspace(0.0, RECORD_S, len(u))[:, None]
    x[:, [s.name == "line_x" for s in model.states]] += 10.0  # A slack line does nothing.
    first = effect.parameters[0]
    stepped = model.replace_parameters(first.at(first.value + first.step))
    assert first.step > 0
    assert np.abs(evaluate(stepped, x, u) - evaluate(model, x, u)).max() > 1e-6
    assert all((effect.title, effect.formula, effect.source, effect.experiment))
    for p in effect.parameters:
        assert p.prior is not None
        assert p.meaning
    for alternative in effect.alternatives:
        assert alternative in catalogue(), f"{name} names an alternative that is not there: {alternative}"


@pytest.mark.parametrize("name", catalogue())
def test_derivative_by_each_speed_is_continuous_where_it_changes_its_sign(name: str) -> None:
    # A kink in a speed makes the likelihood of an extended Kalman filter jump; see smooth_modulus.
    effect = catalogue()[name]
    model = carrier(effect) + effect
    model = model.replace_parameters(*(p.at(p.value + p.step) for p in effect.parameters))
    x, u = points(model)
    for j, state in enumerate(model.states):
        if state.name in ("u", "v", "r"):
            h = 1e-6
            below, at, above = (
                evaluate(model, np.insert(np.delete(x, j, axis=1), j, z, axis=1), u) for z in (-h, 0.0, h)
            )
            np.testing.assert_allclose((above - at) / h, (at - below) / h, atol=1e-3, err_msg=f"kink in {state.name}")


@pytest.mark.parametrize("name", [name for name, effect in catalogue().items() if effect.one_sided])
def test_parameter_of_a_one_sided_effect_is_bounded_by_zero(name: str) -> None:
    assert catalogue()[name].parameters[0].bounds[0] == 0.0


@pytest.mark.parametrize("name", ["pendulum", "sway-slosh"])
def test_sloshing_mass_is_less_than_the_boat(name: str) -> None:
    boat = horizontal_model().with_values({"m_u": 400.0})
    mass = scale_priors(catalogue()[name], size_of(boat)).parameters[0]
    assert 300.0 < mass.bounds[1] < 400.0


def test_past_thrust_covers_every_latency() -> None:
    latest = catalogue()["gnss-latency"].parameters[0].bounds[1]
    past = np.arange(N_PAST + 1.0)
    assert past @ _weights_ago(latest / 2) == pytest.approx(past[-1])
    assert past @ _weights_ago(latest / 4) == pytest.approx(past[-1] / 2)
    assert past @ _weights_ago(0.0) == 0.0


def driven(
    names: Sequence[str], values: dict[str, float], command: Callable[[np.ndarray], np.ndarray], hold: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and surge velocity of a boat with delayed thrust. Shaft speeds drive it; all other signals are
    zero.
    """
    model = horizontal_model("shaft", hold=hold)  # type: ignore[arg-type]
    for name in names:
        model = model + catalogue()[name]
    model = replace(model, stages=tuple((n, f if n != "force" else only_thrust) for n, f in model.stages))
    t = np.arange(0.0, 20.0, 0.1)
    shafts = {f"n_{side}": Channel(t, command(t)) for side in ("left", "right")}
    record = build_record(model, shafts | {"psi": Channel(t, np.zeros(t.size))})
    run = simulate(model.with_values({"d_u": 0.0, "d_uu": 0.0} | values), record)
    return record.t, run.x[:, 3]


def only_thrust(s: Signals) -> None:
    s.X, s.Y, s.N = sum(s.f.values()), 0.0, 0.0


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_delay_dead_band_and_lag_give_the_same_model_in_any_order(hold: str) -> None:
    """In the chain, a command is first delayed, then cut, then smoothed."""
    values = {"tau_delay": 0.23, "T_lag": 0.3, "n_dead": 0.05}
    found = [
        driven(names, values, lambda t: np.where((t > 1.0) & (t < 9.0), 0.8, 0.2), hold)[1]
        for names in permutations(("delay", "lag", "dead-band"))
    ]
    for permuted in found[1:]:
        np.testing.assert_allclose(permuted, found[0], rtol=1e-12)


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize(
    ("names", "values", "late"),
    [
        (("delay",), {"tau_delay": 0.23}, 0.23),
        (("lag",), {"T_lag": 0.3}, 0.3),
        (("lag",), {"T_lag": 0.04}, 0.04),
        (("lag", "delay"), {"tau_delay": 0.5, "T_lag": 0.3}, 0.8),
    ],
)
def test_change_is_late_by_the_sum_of_delay_and_lag(
    names: tuple[str, ...], values: dict[str, float], late: float, hold: str
) -> None:
    """The thrust is linear in the shaft speed about a working point. The lost speed is then the delay times the change
    of acceleration, for any hold.
    """
    small = 0.01

    def step(t: np.ndarray) -> np.ndarray:
        return 0.5 + small * (t > 4.05)

    t, u = driven((), {}, step, hold)
    _, behind = driven(names, values, step, hold)
    settled = t > 12.0
    of_change = 2 * 2 * (40.05 + 1.11) * 0.5 * small / 37.0  # Acceleration that the change of both thrusts adds.
    begun, slow = (driven(n, v, lambda t: 0.5 + 0 * t, hold)[1] for n, v in (((), {}), (names, values)))
    lost = (u - behind - (begun - slow))[settled]
    np.testing.assert_allclose(lost / of_change, late, atol=0.01)


def test_dead_band_has_a_gradient_beyond_it() -> None:
    effect = catalogue()["dead-band"]
    model = carrier(effect) + replace(effect, parameters=(effect.parameters[0].at(0.1),))
    x, u = np.zeros((3, len(model.states))), np.array([[0.05, 0.05], [0.3, 0.3], [-0.3, -0.3]])
    surge = evaluate(model, x, u)[:, 3]
    beyond = np.maximum(np.abs(u[:, 0]) - 0.1, 0) / 0.9  # full speed stays full speed
    thrust = 2 * (40.05 * np.sign(u[:, 0]) * beyond**2 + 1.11 * beyond**2) / 37.0
    np.testing.assert_allclose(surge, thrust, atol=1e-9)


def test_effect_that_the_model_cannot_carry_is_rejected() -> None:
    with pytest.raises(ValueError, match="advance-ratio needs the signal"):
        horizontal_model("general") + catalogue()["advance-ratio"]


def test_effect_whose_states_the_model_has_is_rejected() -> None:
    lag = catalogue()["lag"]
    duplicate = replace(lag, name="other", parameters=(replace(lag.parameters[0], name="T_other"),))
    model = horizontal_model() + lag
    assert model.refusal(duplicate) == "model horizontal has late_left already"


@pytest.mark.parametrize(
    ("eps", "se", "words"),
    [
        (-0.08, 0.01, "the left thruster gives 85 ± 2 % of the thrust of the right one"),
        (0.25, 0.05, "the right thruster gives 60 ± 6 % of the thrust of the left one"),
        (-0.058, 0.0022, "the left thruster gives 89.0 ± 0.4 % of the thrust of the right one"),
        (0.1, math.nan, "the right thruster gives 82 % of the thrust of the left one"),
    ],
)
def test_mismatch_is_given_as_the_share_of_the_weaker_side(eps: float, se: float, words: str) -> None:
    in_words = catalogue()["mismatch"].in_words
    assert in_words is not None
    assert in_words({"eps_LR": (eps, se)}) == words


@pytest.mark.parametrize(
    ("of", "left", "right"),
    [("left", 1.0, 0.8 / 1.2), ("right", 1.2 / 0.8, 1.0), ("both", 1.2, 0.8), ("unknown", 1.2, 0.8)],
)
def test_mismatch_leaves_the_side_with_the_given_thrust_unchanged(of: str, left: float, right: float) -> None:
    """The ratio of both sides is the same, so that the motion is that of a boat with other masses."""
    plain = make_model("horizontal:shaft")
    model = (with_thrust_of(plain, of) + catalogue()["mismatch"]).with_values({"eps_LR": 0.2})
    x, u = [0.0 for _ in model.states], [0.5 for _ in model.inputs]
    thrusts = model.signals(x, u, [p.value for p in model.parameters]).f
    given = plain.signals(x, u, [p.value for p in plain.parameters]).f
    assert thrusts["left"] == pytest.approx(left * given["left"])
    assert thrusts["right"] == pytest.approx(right * given["right"])


@pytest.mark.parametrize("source", ["horizontal:shaft", "horizontal:force:no-current", "kinematic:shaft:yaw"])
@pytest.mark.parametrize("of", ["left", "right", "both"])
def test_the_side_with_the_given_thrust_is_part_of_the_name_of_a_model(source: str, of: str) -> None:
    named = with_thrust_of(make_model(source), of)
    assert named.source == f"{source}:thrust-of-{of}"
    again = make_model(named.source)
    assert (again.source, again.stages, thrust_of(again)) == (named.source, named.stages, of)
    assert with_thrust_of(named, "right").source == f"{source}:thrust-of-right"
    taken_back = with_thrust_of(named, "unknown")
    assert (taken_back.source, taken_back.stages) == (source, make_model(source).stages)
    assert thrust_of(taken_back) == ""


@pytest.mark.parametrize(
    ("source", "of", "message"),
    [
        ("horizontal:general", "left", "has no thrust for each side"),
        ("nomoto", "left", "has no thrust for each side"),
        ("horizontal:shaft", "port", "no such side"),
    ],
)
def test_no_side_is_named_in_a_model_without_two_thrusters(source: str, of: str, message: str) -> None:
    model = make_model(source)
    with pytest.raises(SeatrialError, match=message):
        with_thrust_of(model, of)
    assert with_thrust_of(model, "unknown") is model
