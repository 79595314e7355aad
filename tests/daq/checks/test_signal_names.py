"""Tests of the names of signals: known ones, those of other programs, and misspelt ones."""

from __future__ import annotations

import pytest

from seatrial.daq.checks.signal_names import OF_MODELS, unknown_names, unknown_names_text
from seatrial.ident.models.catalogue import KNOWN_SIGNALS


def test_signals_of_the_models_are_known() -> None:
    """The table of the models in ident has the same names; daq cannot import it."""
    assert unknown_names(KNOWN_SIGNALS) == {}
    assert set(KNOWN_SIGNALS) | {"speed_x", "speed_y", "X_n"} >= OF_MODELS
    assert unknown_names(["n_cmd_port", "voltage_left", "f_2", "speed_x", "X_n"]) == {}


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("heading", "import the heading by the name psi"),
        ("yaw", "import the heading by the name psi"),
        ("yaw_rate", "import the yaw rate by the name r"),
        ("yaw_rate_deg", "import the yaw rate by the name r"),
        ("lat", "import positions as x, y in metres north and east"),
        ("Phi", "did you mean 'phi'?"),
        ("wind_angle", ""),
    ],
)
def test_other_name_has_its_advice(name: str, advice: str) -> None:
    assert unknown_names([name]) == {name: advice}
    assert unknown_names_text(["psi", name]) == (f"{name}: no model uses this name; {advice}" if advice else "")


def test_signals_with_the_same_advice_are_joined() -> None:
    text = unknown_names_text(["lat", "lon", "heading"])
    assert text.startswith("lat, lon: no model uses this name; import positions as x, y in metres north and east; heading")
