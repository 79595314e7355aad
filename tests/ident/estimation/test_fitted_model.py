"""Tests of the fitted model: validation uses only sensors that the estimation data inform."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.estimation import fitted_model
from seatrial.ident.estimation.fitted_model import fit_and_evaluate, fit_nominal_model
from seatrial.ident.estimation.maximum_likelihood import SearchSettings
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.reports import Kept
from tests.ident.sliders import slide, slider
from tests.missions import boat_with, channels_of, sail

pytestmark = pytest.mark.usefixtures("quick_compilation")


def run(seed: int, *signals: str) -> LogSegment:
    """Return a log of the slider with its force and the given measurements."""
    record = slide(seed)
    channels = {"w": Channel(record.t, record.u[:, 0])}
    for name, y in zip(record.outputs, record.y.T, strict=True):
        if name in signals:
            channels[name] = Channel(record.t[np.isfinite(y)], y[np.isfinite(y)])
    return LogSegment(f"run{seed}", channels)


def with_free_noise(*names: str) -> Model:
    return slider().replace_parameters(*[replace(slider().parameter(n), free=True) for n in names])


@pytest.mark.parametrize(
    ("model", "estimation", "used"),
    [
        (with_free_noise("e_v", "e_s"), ["speed"], False),  # No data inform the noise of the place sensor.
        (with_free_noise("e_v"), ["speed"], True),  # The noise of the place sensor is fixed.
        (with_free_noise("e_v", "e_s"), ["speed", "place"], True),  # The fit estimates the noise of the place sensor.
    ],
)
def test_sensor_that_only_a_validation_run_has_is_not_used(model: Model, estimation: list[str], used: bool) -> None:
    """With its built-in noise, the sensor could reject any model, or hide that a model is wrong."""
    fitted = fit_nominal_model(model, [run(1, *estimation)], [run(2, "speed", "place")])
    (view,) = fitted.validation
    place = view.record.outputs.index("place")
    assert np.isfinite(view.record.y[:, place]).any() == used
    assert np.isfinite(view.record.y[:, 1 - place]).any()
    assert fitted.fit.converged


@pytest.mark.parametrize(
    "lost",
    [
        pytest.param("fails", marks=pytest.mark.study),
        "ends too early",
        pytest.param("never converges", marks=pytest.mark.study),
    ],
)
def test_failed_refit_for_another_vessel_size_restarts_at_the_first_fit(
    lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vehicle of 2 kg in the first fit became one of 14 kg in a second fit that did not converge."""
    found = channels_of(sail(boat_with(None, 1), 60.0, 101)[0])
    for side in ("left", "right"):
        n = found.pop(f"n_{side}")
        found[f"f_{side}"] = Channel(n.t, 0.05 * (40.05 * n.value * abs(n.value) + 1.11 * n.value**2))
    asked, starts, given = list[float](), list[Any](), {"tau_b": 2.0}

    def once_lost(model: Model, *arguments: Any, detail: Callable[[str], None]) -> fitted_model.FittedModel:
        detail("asked")
        asked.append(model.values["m_u"])
        starts.append(arguments[-1])
        if len(asked) == 1 or (len(asked) == 3 and lost != "never converges"):
            return fit_and_evaluate(model, *arguments)
        if lost == "fails":
            raise ValueError("the likelihood cannot be evaluated at the initial values")
        return fit_and_evaluate(model, *arguments[:-2], SearchSettings(max_iterations=1))

    monkeypatch.setattr(fitted_model, "fit_and_evaluate", once_lost)
    fitted = fit_nominal_model(horizontal_model("force"), [LogSegment("light", found)], [], start=given)
    assert fitted.fit.converged
    assert starts == [given, given, None]  # given values would replace the estimates of the first fit
    assert len(asked) == 3
    assert asked[2] == pytest.approx(fitted.fit.model.values["m_u"], rel=0.02)
    assert fitted.fit.model.values["m_u"] == pytest.approx(0.05 * boat_with(None, 1).truth()["m_u"], rel=0.1)


def test_iterations_of_a_fit_are_reported_as_details_of_its_step() -> None:
    reporter = Kept()
    fitted = fit_nominal_model(with_free_noise("e_v"), [run(1, "speed")], [], reporter=reporter)
    assert reporter.lines == [f"fitting {fitted.model.name} to 1 run"]
    n = fitted.fit.iterations
    assert n > 2
    assert reporter.details[:n] == [f"iteration {k + 1}" for k in range(n)]
    assert reporter.details[-1].endswith("evaluation")
