"""Tests of the warning that the residuals contradict Nomoto's structure, and of what it advises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.results import structure_warnings
from seatrial.ident.results.parts import CrossCorrelationRow
from tests.missions import boat_log, boat_with


def row(channel: str, name: str, largest: float, p: float) -> CrossCorrelationRow:
    nothing = np.zeros(0)
    return CrossCorrelationRow(
        record="run", channel=channel, input=name, lags=nothing, z=nothing, p=p, largest=largest, role="estimation"
    )


def test_only_large_and_significant_correlations_with_inputs_contradict_the_structure() -> None:
    model = nomoto_model()
    found = [row("r", "n_left", 0.4, 1e-6), row("r", "n_right", 0.3, 1e-6), row("vx", "n_left", 0.25, 1e-6)]
    (warning,) = structure_warnings(model, found, "estimation")
    assert warning.code == "structure-unfit"
    assert "(yaw rate with n_left by 0.4, velocity north with n_left by 0.25)" in warning.text
    assert "use --model horizontal" in warning.text
    assert "--prior T=0.5:0.5" in warning.text
    (with_lag,) = structure_warnings(model.replace_parameters(model.parameter("T").freed()), found, "estimation")
    assert "--prior" not in with_lag.text
    assert structure_warnings(model, found, "validation") == []
    assert structure_warnings(horizontal_model(), found, "estimation") == []
    for none in (row("r", "n_left", 0.15, 1e-9), row("r", "n_left", 0.4, 0.02), row("r", "psi", 0.4, 1e-6)):
        assert structure_warnings(model, [none], "estimation") == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_boat_that_slides_sideways_contradicts_the_structure(tmp_path: Path) -> None:
    log = boat_log(tmp_path / "run.mcap", boat_with(None, 5), 120.0, 5, 5)
    fits = {name: st.fit(log, name, score_tests=False) for name in ("nomoto", "horizontal")}
    codes = {name: {w.code for w in fit.result.warnings} for name, fit in fits.items()}
    assert "structure-unfit" in codes["nomoto"]
    assert "structure-unfit" not in codes["horizontal"]
    other = boat_log(tmp_path / "other.mcap", boat_with(None, 5), 120.0, 6, 6)
    compared = st.compare({"h": fits["horizontal"], "n": fits["nomoto"]}, other)
    (warning,) = [w for w in compared.result.warnings if w.code == "structure-unfit"]
    assert warning.text.startswith("(b): nomoto: its residuals are correlated with the inputs (yaw rate")
