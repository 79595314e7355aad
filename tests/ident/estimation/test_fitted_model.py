"""What a fitted model is judged by: only sensors of which the estimation data tell something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.data.record import Channel, LogSegment
from ident.estimation.fitted_model import fit_nominal_model
from ident.model.structure import Model
from tests.ident.sliders import slide, slider


def run(seed: int, *signals: str) -> LogSegment:
    """A log of the slider with its force and these measurements."""
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
        (with_free_noise("e_v", "e_s"), ["speed"], False),  # nothing tells the noise of the tape
        (with_free_noise("e_v"), ["speed"], True),  # somebody gave it
        (with_free_noise("e_v", "e_s"), ["speed", "place"], True),  # the fit does
    ],
)
def test_a_sensor_that_only_a_validation_run_has_is_no_judge(model: Model, estimation: list[str], used: bool) -> None:
    """With its built-in noise it could refute any model, or hide that one is wrong."""
    stage = fit_nominal_model(model, [run(1, *estimation)], [run(2, "speed", "place")])
    (view,) = stage.validation
    place = view.record.outputs.index("place")
    assert np.isfinite(view.record.y[:, place]).any() == used
    assert np.isfinite(view.record.y[:, 1 - place]).any()
    assert stage.fit.converged
