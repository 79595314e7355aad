"""Tests of the thruster command on tables with one row for command and shaft speed."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from seatrial.daq.errors import SeatrialWarning
from seatrial.ident.results.tables import fit_summary

pytestmark = pytest.mark.usefixtures("quick_compilation")

ROW, LAG = 0.05, 0.17  # s
MAP = """format = "seatrial-import 1"
time = {{ column = "t" }}
signal = [
  {{ name = "n_cmd_left", column = "command", unit = "1", role = "input"{shift} }},
  {{ name = "n_left", column = "speed", unit = "1", role = "output" }},
]
"""


def fitted_table(folder: Path, late_rows: int, shift: str = "", second_lag: float = 0.0) -> st.FittedThruster:
    """Return the fit to a table of steps, with the command so many rows late, and an optional second lag [s]."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 90.0, ROW)
    levels = np.append(0.0, rng.permutation(np.linspace(-0.9, 0.9, 17)))
    command = levels[np.minimum((t / 5.0 + 1e-9).astype(int), levels.size - 1)]
    filtered, n = np.zeros(t.size), np.zeros(t.size)
    for k in range(1, t.size):  # the command is constant between two rows
        share = -np.expm1(-ROW / second_lag) if second_lag else 1.0
        filtered[k] = filtered[k - 1] + share * (command[k - 1] - filtered[k - 1])
        n[k] = n[k - 1] - np.expm1(-ROW / LAG) * (filtered[k] - n[k - 1])
    command = np.append(np.zeros(late_rows), command[: t.size - late_rows])
    table = np.column_stack([t + 10.0, command, n + 0.002 * rng.standard_normal(t.size)])
    np.savetxt(folder / "table.csv", table, "%.4f", ",", header="t,command,speed", comments="")
    (folder / "map.toml").write_text(MAP.format(shift=shift), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        (log,) = st.import_log(folder / "table.csv", folder / "map.toml", out_dir=folder)
        found = st.thruster(log)
    assert isinstance(found, st.FittedThruster)
    return found


def test_answer_begins_with_a_command_that_is_one_row_late(tmp_path: Path) -> None:
    late = fitted_table(tmp_path, 1)
    assert late.answer.startswith("In table.mcap command and shaft speed are probably one row apart")
    (warning,) = [w.text for w in late.result.warnings if "command-one-row-late" in w.text]
    assert "moved by 25 % of the step" in warning
    assert "time_shift = -0.05" in warning
    (tmp_path / "right").mkdir()
    right = fitted_table(tmp_path / "right", 1, f", time_shift = -{ROW}")
    assert "one row" not in right.answer
    assert "not white" not in right.answer
    assert 1.0 / right.params["a"] == pytest.approx(LAG, rel=0.05)


def test_residuals_that_are_not_white_and_vague_parameters_are_named(tmp_path: Path) -> None:
    found = fitted_table(tmp_path, 0, second_lag=0.15)
    assert "The residuals are not white: run `seatrial ident diagnose`" in found.answer or "st.diagnose" in found.answer
    fit = found.fitted.fit
    (at,) = (k for k, name in enumerate(fit.names) if name == "a")
    for factor, codes in ((0.9, ()), (1.1, ("not determined",))):
        errors = fit.errors.copy()
        errors[at] = factor * fit.values[at]
        rows = {row.name: row for row in fit_summary(replace(fit, errors=errors), {}).parameters}
        assert rows["a"].flag_codes == codes
