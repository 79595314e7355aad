"""Tests of the loss of thrust with inflow in reverse: its equation, and a propeller of another law than the model's."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.prior_knowledge import set_priors
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model

pytestmark = pytest.mark.usefixtures("quick_compilation")

SENSORS = ("attitude", "gyro", "body_velocity")


def model(*names: str, **values: float) -> Model:
    made = horizontal_model("shaft", SENSORS, current=False)
    for name in names:
        made = made + catalogue()[name]
    return made.with_values(values)


def test_only_a_shaft_in_reverse_loses_thrust_with_the_inflow() -> None:
    lossy, plain = model("reverse-advance", k_Ja=4.0), model("reverse-advance", k_Ja=0.0)
    inputs = {i.name: 0.0 for i in lossy.inputs} | {"n_left": -0.5, "n_right": 0.5}
    states = [{"u": 1.5}.get(state.name, 0.0) for state in lossy.states]
    thrusts = [m.signals(states, list(inputs.values()), list(m.values.values())).f for m in (lossy, plain)]
    assert thrusts[0]["left"] == pytest.approx(thrusts[1]["left"] - 4.0 * 0.5 * 1.5)
    assert thrusts[0]["right"] == pytest.approx(thrusts[1]["right"])


def test_a_given_thrust_astern_survives_a_propeller_that_brakes_without_a_loss() -> None:
    """Thrust ahead falls with the inflow, and that astern does not.

    Without the effect, a loss of thrust in reverse (rho) takes its place, since it also reduces the loss with the
    inflow. The estimate of c2 then leaves its true value, and with it the thrust ahead, c1 + c2.
    """
    rng, t = np.random.default_rng(5), np.arange(0.0, 300.0, 0.1)
    n = [np.repeat(rng.choice([-0.8, -0.5, 0.4, 0.7, 1.0], 60), 50)[: t.size] for _ in range(2)]
    both = ("advance-ratio", "reverse-advance", "reverse-mismatch")
    truth = model(*both, k_J=6.0, k_Ja=-6.0, rho_left=0.0, rho_right=0.4)
    channels = {"n_left": Channel(t, n[0]), "n_right": Channel(t, n[1])}
    record: Record = build_record(truth, channels | {o.name: Channel(t, np.zeros(t.size)) for o in truth.outputs})
    y = simulate(truth, record, x0=np.zeros(len(truth.states))).y
    sd = np.array([{"psi": 0.01, "r": 0.005}.get(o.name, 0.03) for o in truth.outputs])
    measured = build_record(
        truth,
        channels | {o.name: Channel(t, y[:, j] + sd[j] * rng.normal(size=t.size)) for j, o in enumerate(truth.outputs)},
    )
    free = ["k_J", "rho_left", "rho_right", "m_u", "d_uu", "c2"]
    found = {}
    for names, own in ((both, ["k_Ja"]), (("advance-ratio", "reverse-mismatch"), [])):
        start = set_priors(model(*names).with_free([*free, *own]), {"c2": (truth.values["c2"], 1.0)})
        found[len(names)] = fit(start, [measured], EstimationOptions())
    for name in ("k_J", "k_Ja", "rho_left", "rho_right", "m_u", "c2"):
        value, error = found[3].estimate(name)
        assert value == pytest.approx(truth.values[name], abs=4.0 * error)
    assert found[3].estimate("c2")[1] < 0.2
    assert found[2].estimate("c2")[0] < truth.values["c2"] - 2.0
