"""Comparison of the independent plants of mocks and ident. With all extras off, they describe the same boat."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.mocks.plant.boat import PLANT_STEP_S, BoatPlant, draw_boat
from tests.missions import sail

SECONDS = 60.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_simulations_of_a_minute_agree_to_a_millimetre(seed: int) -> None:
    boat = draw_boat(seed)
    plant = BoatPlant(boat, disturbed=False)
    t, n = sail(boat, SECONDS, seed)[1].setpoints()
    rows, k = [], 0
    for _ in range(round(SECONDS / PLANT_STEP_S) + 1):
        while k < len(t) and t[k] < plant.t + PLANT_STEP_S:
            for side in (0, 1):
                plant.command(side, t[k], float(n[k, side]))
            k += 1
        rows.append((plant.t, *plant.state[:6], plant.shafts[0].n, plant.shafts[1].n))
        plant.advance()
    table = np.array(rows)
    names = ("x", "y", "psi", "u", "v", "r", "n_left", "n_right")
    truth = {name: Channel(table[:, 0], table[:, j + 1]) for j, name in enumerate(names)}
    true = boat.truth()
    known = {k: true[k] for k in ("m_u", "m_v", "m_r", "d_u", "d_uu", "d_v", "d_vv", "d_r", "d_rr", "c1", "c2")}
    known |= {"V_x": true["current_n"], "V_y": true["current_e"], "y_left": -true["arm"], "y_right": true["arm"]}
    model = horizontal_model(sensors=("attitude", "gyro", "position", "body_velocity")).with_values(known)
    record = build_record(model, truth, rate=1 / PLANT_STEP_S, max_step=PLANT_STEP_S)
    x0 = table[0, 1:7].copy()
    cos, sin = np.cos(x0[2]), np.sin(x0[2])
    x0[3] -= cos * known["V_x"] + sin * known["V_y"]  # The velocities of ident are through the water.
    x0[4] -= cos * known["V_y"] - sin * known["V_x"]
    run = simulate(model, record, x0=x0)
    outputs = [o.name for o in model.outputs]
    for name, column in (("x", 1), ("y", 2), ("psi", 3), ("u", 4), ("v", 5), ("r", 6)):
        wanted = np.interp(run.t, table[:, 0], table[:, column])
        assert np.ptp(wanted) > 0.1, name  # The boat does move.
        np.testing.assert_allclose(run.y[:, outputs.index(name)], wanted, atol=1e-3, err_msg=name)
