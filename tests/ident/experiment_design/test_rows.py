"""Tests of the rows of a design: they resolve the fastest state, and a diverging simulation is an error."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.experiment_design.discrimination import separation
from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.optimal_design import design
from seatrial.ident.experiment_design.problem import GRID, DesignProblem
from seatrial.ident.experiment_design.rows import row_spacing
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.toys import follower, values_of


def task_of(model: Model, grid: float) -> DesignProblem:
    return DesignProblem(model, StepInput(4, 1, 10.0, 1.0, GRID), grid=grid)


def test_row_spacing_resolves_the_fastest_state() -> None:
    """A fourth-order Runge-Kutta step is stable up to 2.785 times the time constant."""
    slow, quick, mixed = np.array([[1.0, 0.1]]), np.array([[0.06, 0.1]]), np.array([[1.0, 0.1], [0.06, 0.1]])
    model = follower(1.0)
    assert row_spacing([(model, slow)], GRID) == GRID
    assert row_spacing([(model, mixed)], GRID) == row_spacing([(model, quick)], GRID) == pytest.approx(GRID / 3)
    boat = horizontal_model(current=False)
    lagged = (boat + catalogue()["lag"]).with_values({"T_lag": 0.06})
    assert row_spacing([(boat, values_of(boat)[None])], GRID) == GRID
    assert row_spacing([(lagged, values_of(lagged)[None])], GRID) == pytest.approx(GRID / 3)
    # The delayed inputs are 0.1 s apart.
    both = (boat + catalogue()["delay"] + catalogue()["lag"]).with_values({"T_lag": 0.05})
    spacing = row_spacing([(both, values_of(both)[None])], GRID)
    assert spacing == pytest.approx(0.05)  # Half of the spacing of the delayed inputs, for a pole of 20/s.
    driven = horizontal_model("command")  # The delayed commands are 0.05 s apart.
    assert row_spacing([(driven, values_of(driven)[None])], GRID) == pytest.approx(0.05)


def test_diverging_design_is_an_error() -> None:
    """The rows were twenty time constants apart. The criterion was -1e9, and an infinite T counted as a clear
    separation.
    """
    first_order, second_order = follower(0.01), follower(0.01, 2)
    with pytest.raises(SeatrialError, match=r"informs all of T.*diverges on rows of 0\.2 s"):
        design(task_of(first_order, 0.2), evaluations=500)
    command = np.where(np.arange(51)[:, None] % 10 < 5, 1.0, -1.0)
    with pytest.raises(SeatrialError, match=r"follower1 and follower2 cannot be compared: .* interval of 0\.2 s"):
        separation(first_order, second_order, task_of(first_order, 0.2), command)
