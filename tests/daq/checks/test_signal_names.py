"""Tests of the names of signals: known ones, those of other programs, and misspelt ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.checks.signal_names import OF_MODELS, unknown_names, unknown_names_text
from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.importers.import_files import import_files
from seatrial.ident.checks.log_checks import LogChecks
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
    assert unknown_names_text(["X", name]) == (f"{name}: no model uses this name; {advice}" if advice else "")


def test_a_name_beside_the_signal_that_it_may_mean_is_not_named() -> None:
    assert unknown_names_text(["pwm_left", "n_left", "heading", "psi", "lat", "x", "sog", "vx"]) == ""
    assert unknown_names_text(["pwm_left", "psi"]).startswith("pwm_left: no model uses this name")


def test_signals_with_the_same_advice_are_joined() -> None:
    text = unknown_names_text(["lat", "lon", "heading"])
    assert text.startswith(
        "lat, lon: no model uses this name; import positions as x, y in metres north and east; heading"
    )


def test_import_and_check_name_a_signal_that_no_model_uses(tmp_path: Path) -> None:
    rows = "\n".join(f"{0.1 * k:.1f},{np.sin(0.1 * k):.4f},{0.01 * k:.3f}" for k in range(300))
    (tmp_path / "run.csv").write_text(f"t,hdg,wind\n{rows}\n")
    wind = '{ name = "wind_angle", column = "wind", unit = "rad", role = "output" }'
    signals = f'{{ name = "heading", column = "hdg", unit = "rad" }}, {wind}'
    text = f'format = "seatrial-import 1"\ntime = {{ column = "t", format = "s" }}\nsignal = [{signals}]\n'
    (tmp_path / "map.toml").write_text(text)
    with pytest.warns(
        SeatrialWarning, match=r"map.toml: heading: no model uses this name; import the heading by .* psi$"
    ):
        (log,) = import_files(tmp_path / "map.toml", [tmp_path / "run.csv"], out=tmp_path / "run.mcap")
    named = [f for f in LogChecks().check(log) if f.code == "signal-name"]
    assert [(f.level, f.where) for f in named] == [("warning", "heading")]
    assert named[0].advice == "import the heading by the name psi"


@pytest.mark.parametrize(
    ("rudder", "wind", "line"),
    [
        ("", "", "rudder, wind: no model uses these names, so they are imported as outputs (measured values); give"),
        ("", 'role = "output"', "rudder: no model uses this name, so it is imported as an output (measured values); "),
        ('role = "input"', 'role = "output"', ""),
    ],
)
def test_an_import_names_the_unknown_signals_that_are_outputs_without_a_word(
    rudder: str, wind: str, line: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """The role of a known signal, such as the heading, is clear without a key."""
    rows = "\n".join(f"{0.1 * k:.1f},{np.sin(0.1 * k):.4f},{0.01 * k:.3f},{0.02 * k:.3f}" for k in range(300))
    (tmp_path / "run.csv").write_text(f"t,psi,rudder,wind\n{rows}\n")
    signals = "".join(
        f'[[signal]]\nname = "{name}"\ncolumn = "{name}"\nunit = "rad"\n{role}\n'
        for name, role in (("psi", ""), ("rudder", rudder), ("wind", wind))
    )
    text = f'format = "seatrial-import 1"\ntime = {{ column = "t", format = "s" }}\n{signals}'
    (tmp_path / "map.toml").write_text(text)
    import_files(tmp_path / "map.toml", [tmp_path / "run.csv"], out=tmp_path / "run.mcap")
    texts = [str(w.message) for w in recwarn]
    assert len(texts) == bool(line)
    assert all(f"map.toml: {line}" in text and 'role = "input"' in text for text in texts)
