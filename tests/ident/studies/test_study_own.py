"""Tests of user studies: of a fitted model.toml, and of a Case in a Python file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation.maximum_likelihood import fit
from seatrial.ident.estimation.model_file import FittedData, SavedModel, save_model
from seatrial.ident.estimation.stochastic_simulation import simulate_stochastic
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.parallel import Workers
from seatrial.ident.studies import cases
from seatrial.ident.studies.cases import make_case, surge_case
from seatrial.ident.studies.monte_carlo import make_record, run_replicates
from seatrial.ident.workflows import study
from tests.ident.reports import Kept

OWN = """
import numpy as np
from seatrial.ident.estimation import SampledInputs
from seatrial.ident.models import surge_model
from seatrial.ident.studies import Case

t = np.arange(0.0, 60.0, 0.1)
push = 40.0 * np.sign(np.sin(2 * np.pi * t / 25))[:, None]

def mine():
    return Case("mine", surge_model().with_values({"d_u": 6.0}), SampledInputs.held(t, push), {"position": 2})

model = surge_model()
number = 3
"""


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Return a saved surge model, fitted to one simulated replicate."""
    case = surge_case(120.0)
    rng = np.random.default_rng(1)
    values = np.array([list(case.model.values.values())])
    y = simulate_stochastic(case.model, case.inputs, values, [rng])[1][0]
    fitted = fit(case.model, [make_record(case, y, "one")])
    path = tmp_path / "boat" / "model.toml"
    path.parent.mkdir()
    name = case.model.inputs[0].name
    save_model(path, fitted, data=FittedData({name: (-30.0, 80.0)}), provenance={})
    return path


def test_fitted_model_is_studied_within_the_ranges_of_its_inputs(saved: Path, tmp_path: Path) -> None:
    case = make_case(str(saved), seconds=60.0)
    assert case.name == "surge-boat"
    assert case.inputs.t[-1] == pytest.approx(60.0)
    assert -30.0 <= case.inputs.u.min() < 0.0 < 40.0 < case.inputs.u.max() <= 80.0
    (row,) = run_replicates(case, [0], seed=1)
    assert "error" not in row
    again = make_case(str(saved), seconds=60.0)
    assert np.array_equal(case.inputs.u, again.inputs.u)


def test_rows_match_the_delayed_inputs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With delayed inputs 0.05 s apart and rows of 0.1 s, only every second input was distinct, and no data informed
    the delay between.
    """
    model = horizontal_model("command").with_values({"tau_n": 0.2})
    ranges = {"n_cmd_left": (-0.5, 1.0), "n_cmd_right": (-0.5, 1.0)}
    monkeypatch.setattr(cases, "load_model", lambda _: SavedModel(model, {}, ranges))
    (tmp_path / "model.toml").touch()
    case = make_case(str(tmp_path / "model.toml"), seconds=20.0)
    step, names = np.diff(case.inputs.t)[0], [i.name for i in model.inputs]
    assert step == pytest.approx(0.05) == pytest.approx(model.max_step)
    for k in range(1, 17):
        now, late = (case.inputs.u[:, names.index(n)] for n in ("n_cmd_left", f"n_cmd_left~{k}"))
        np.testing.assert_array_equal(late[k:], now[:-k])
    assert {name: n * step for name, n in case.every.items()} == {
        s.name: pytest.approx(0.2 if s.name in cases.GNSS else 0.1) for s in model.sensors
    }


def test_fitted_model_is_studied_with_its_own_estimator(saved: Path) -> None:
    case = make_case(str(saved), seconds=60.0)
    assert not case.reml
    assert case.model.second_order
    overridden = make_case(str(saved), seconds=60.0, reml=True, mean_order=1)
    assert overridden.reml
    assert not overridden.model.second_order
    text = saved.read_text(encoding="utf-8")
    saved.write_text(text.replace("second_order = true", "reml = true"), encoding="utf-8")
    restricted = make_case(str(saved), seconds=60.0)
    assert restricted.reml
    assert not restricted.model.second_order


def test_user_case_is_studied_with_the_estimator_of_the_commands(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    case = make_case(f"{tmp_path / 'mine.py'}:mine")
    assert case.reml
    assert case.model.second_order


def test_changed_file_is_another_study(tmp_path: Path) -> None:
    file, out = tmp_path / "mine.py", tmp_path / "out"
    for text, resumed in ((OWN, False), (OWN, True), (OWN + "# changed\n", False)):
        file.write_text(text, encoding="utf-8")
        reporter = Kept()
        result = study.run_studies(study.StudyRequest([f"{file}:mine"], 3, 1, out, workers=Workers(1)), "", reporter)
        assert any("exist already" in line for line in reporter.lines) is resumed
    (part,) = result.studies
    assert part.model == "mine"
    assert {p.name: p.truth for p in part.parameters}["d_u"] == 6.0


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("{file}:model", "is a Model without a mission; give a seatrial.ident.studies.monte_carlo.Case"),
        ("{file}:number", "number is a int, not a seatrial.ident.studies.monte_carlo.Case"),
        ("{file}:nothing", "nothing cannot be loaded"),
        ("{file}.no:mine", "no such Python file"),
        ("nowhere/model.toml", "no such file"),
        ("boat", "no study of 'boat': there are surge"),
    ],
)
def test_source_without_a_case_is_rejected(source: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(OWN, encoding="utf-8")
    with pytest.raises(SeatrialError, match=message):
        make_case(source.format(file=file))


def test_input_without_a_range_is_rejected(saved: Path) -> None:
    name = surge_model().inputs[0].name
    saved.write_text(saved.read_text(encoding="utf-8").replace(f"{name} = [-30.0, 80.0]", ""), encoding="utf-8")
    with pytest.raises(SeatrialError, match=rf"no range of the input '{name}' under \[validity\]"):
        make_case(str(saved))
    file = saved.parent / "mine.py"
    file.write_text(OWN, encoding="utf-8")
    with pytest.raises(SeatrialError, match="--seconds"):
        make_case(f"{file}:mine", seconds=20.0)
