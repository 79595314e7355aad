"""Tests of the thrust scale on a boat in CSV from an independent simulator.

Without thrust and arms, no estimate is in kilograms. With them, all estimates are.
"""

from __future__ import annotations

import json
import math
import re
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import pytest
from click.testing import CliRunner

import seatrial as st
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.import_files import import_files
from seatrial.ident.cli.commands import ident
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.estimation.thrust_scale import PriorDistance, thrust_scale_of
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.results import answers
from seatrial.ident.results.answers import implausible_mass, mass_notes, mass_warnings, prior_notes

if TYPE_CHECKING:
    from seatrial.ident.estimation.maximum_likelihood import Fit

pytestmark = pytest.mark.usefixtures("quick_compilation")

# A boat of 12 kg: masses [kg], inertia [kg m2], damping, full forward thrust [N] and arm [m].
TRUE = {"m_u": 12.0, "m_v": 17.0, "m_r": 1.30, "d_u": 2.0, "d_v": 12.0, "d_r": 1.5}
TRUE |= {"d_uu": 9.0, "d_vv": 25.0, "d_rr": 1.2}
THRUST, ARM = 12.0, 0.2
MAP = """
format = "seatrial-import-csv 1"
[time]
column = "t"
"""
COLUMNS = {"x": "m", "y": "m", "psi": "rad", "r": "rad/s", "vx": "m/s", "vy": "m/s", "n_left": "1", "n_right": "1"}


@cache
def sailed(seconds: float, seed: int, astern: float = THRUST) -> np.ndarray:
    """Return rows of time and COLUMNS at 10 Hz. The simulation uses Euler steps of 5 ms, white accelerations as gusts,
    and white sensor noise. The full thrust in reverse is `astern` [N].
    """
    rng, p, h = np.random.default_rng(seed), TRUE, 0.005
    gusts = (rng.normal(size=(round(seconds / h), 3)) * np.sqrt(h) * [0.02, 0.02, 0.04]).tolist()
    x = y = psi = u = v = r = left = right = told_left = told_right = 0.0
    rows = []
    for k, (du, dv, dr) in enumerate(gusts):
        if k % round(4.0 / h) == 0:
            commanded = rng.uniform(-0.4, 1.0) + rng.uniform(-0.5, 0.5) * np.array([1.0, -1.0])
            told_left, told_right = np.clip(commanded, -1.0, 1.0).tolist()
        left, right = left + h / 0.25 * (told_left - left), right + h / 0.25 * (told_right - right)
        cos, sin = math.cos(psi), math.sin(psi)
        if k % round(0.1 / h) == 0:
            clean = np.array([x, y, psi, r, cos * u - sin * v, sin * u + cos * v])
            noisy = clean + rng.normal(size=6) * [0.02, 0.02, 0.005, 0.003, 0.02, 0.02]
            rows.append([k * h, *noisy, left, right])
        f_left, f_right = ((THRUST if n > 0.0 else astern) * n * abs(n) for n in (left, right))
        surge = (f_left + f_right + p["m_v"] * v * r - p["d_u"] * u - p["d_uu"] * abs(u) * u) / p["m_u"]
        sway = (-p["m_u"] * u * r - p["d_v"] * v - p["d_vv"] * abs(v) * v) / p["m_v"]
        moment = ARM * (f_left - f_right) + (p["m_u"] - p["m_v"]) * u * v
        turn = (moment - p["d_r"] * r - p["d_rr"] * abs(r) * r) / p["m_r"]
        x, y, psi = x + h * (cos * u - sin * v), y + h * (sin * u + cos * v), psi + h * r
        u, v, r = u + du + h * surge, v + dv + h * sway, r + dr + h * turn
    return np.array(rows)


def imported(
    folder: Path,
    name: str,
    tables: str,
    extra: str = "",
    seconds: float = 120.0,
    gap: tuple[float, float] | None = None,
    astern: float = THRUST,
    left: float = 1.0,
) -> Path:
    """Import the boat's run as a log, by a map with these further tables and columns. The gyro may have a gap [s].

    The log has ``left`` times the shaft speed of the left thruster, which then gives more thrust at a logged speed.
    """
    rows = sailed(seconds, 1, astern) * [1.0, *(left if name == "n_left" else 1.0 for name in COLUMNS)]
    if gap is not None:
        rows = rows.copy()
        rows[(rows[:, 0] >= gap[0]) & (rows[:, 0] < gap[1]), 1 + list(COLUMNS).index("r")] = np.nan
    header = ["t", *COLUMNS, *extra.split()]
    rows = np.column_stack([rows, *(rows[:, 1] for _ in extra.split())])
    csv, text = folder / f"{name}.csv", MAP + tables
    lines = [",".join(header), *(",".join(f"{z:.6f}" for z in row) for row in rows)]
    csv.write_text("\n".join(lines), encoding="utf-8")
    for column in header[1:]:
        role = "input" if column.startswith("n_") else "output"
        text += f'[[signal]]\nname = "{column}"\ncolumn = "{column}"\nunit = "{COLUMNS.get(column, "1")}"\n'
        text += f'role = "{role}"\nhold = "linear"\n'
        text += 'nan = "drop"\n' if column == "r" and gap else ""
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return import_files(folder / f"{name}.toml", [csv], out_dir=folder)[0]


def fitted(log: Path, *words: str) -> tuple[dict[str, Any], str, Path]:
    """Return the result of `seatrial ident vehicle`, the screen output, and the folder."""
    out = log.parent / f"vehicle-{log.stem}-{len(words)}"
    arguments = ["vehicle", str(log), *words, "--no-score-tests", "--out", str(out), "--force"]
    done = CliRunner().invoke(ident, arguments, catch_exceptions=False)
    return json.loads((out / "result.json").read_text(encoding="utf-8")), done.output, out


def rows_of(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in result["fit"]["parameters"]}


def codes(result: dict[str, Any]) -> list[str]:
    return [warning["code"] for warning in result["warnings"]]


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str, Path]:
    """Fit the model to a log without thrust and arms, whose import map has a weight that is much too large."""
    return fitted(imported(tmp_path_factory.mktemp("bare"), "run", "[geometry]\nmass = 500.0\n", "u lat mystery"))


def test_without_thrust_and_arms_no_estimate_is_in_kilograms(bare: tuple[dict[str, Any], str, Path]) -> None:
    result, output, out = bare
    assert codes(result)[:2] == ["thrust-scale-unknown", "arm-unknown"]
    assert "if only the thrust ahead is known, give it as c1 and leave c2 out." in result["warnings"][0]["text"]
    scale = result["fit"]["scale"]
    assert (scale["thrust"], scale["relative"]) == ("built-in", True)
    assert (scale["arm"], scale["relative_yaw"]) == ("estimated", True)
    free_of_force = {row["unit"] for row in rows_of(result).values() if "kg" in row["unit"] or "N" in row["unit"]}
    assert all("/N" in unit or "N)" in unit or "N m)" in unit for unit in free_of_force), free_of_force
    assert output.index("The thrust was not given") < output.index(result["answer"][:30])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("<h1") < page.index("The thrust was not given") < page.index("<h2")
    text = (out / "model.toml").read_text(encoding="utf-8")
    assert 'thrust = "built-in"' in text
    assert load_model(out / "model.toml").model.parameter("c1").origin == "built-in"


def test_score_tests_can_be_left_out(bare: tuple[dict[str, Any], str, Path]) -> None:
    result, _, _ = bare  # with --no-score-tests
    assert result["common_errors"] is None
    assert not any("uncertainty of the model" in note for note in result["notes"])
    assert any("Take the estimates as a first look." in note for note in result["notes"])


def test_ratios_to_the_thrust_are_right(bare: tuple[dict[str, Any], str, Path]) -> None:
    rows = rows_of(bare[0])
    for name, true in TRUE.items():
        yaw = name in ("m_r", "d_r", "d_rr")
        row = rows[f"{name}/(T y_arm)" if yaw else f"{name}/T"]
        expected = true / THRUST / (ARM if yaw else 1.0)
        assert abs(row["value"] - expected) < 3 * row["se"], (name, row, expected)
    assert abs(rows["y_arm"]["value"] - ARM) < 3 * rows["y_arm"]["se"]
    assert rows["m_u/T"]["se"] < 0.02
    assert rows["m_r/(T y_arm)"]["se"] < 0.01


def test_unused_signal_is_listed_with_its_reason(bare: tuple[dict[str, Any], str, Path]) -> None:
    result, output, _ = bare
    unused = {s["signal"]: s for s in result["unused_signals"]}
    assert {name: s["code"] for name, s in unused.items()} == {
        "u": "incomplete-sensor",
        "lat": "other-name",
        "mystery": "unknown-name",
    }
    assert "signals not used: u (the model uses it only together with v" in output


TABLES = "[scale]\nc1 = 12.0\nc2 = 0.0\n[geometry]\ny_left = -0.2\ny_right = 0.2\nlength = 1.2\n"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return a log with thrust, arms and a plausible weight, and the result of the fit to it."""
    log = imported(tmp_path_factory.mktemp("given"), "run", TABLES + "mass = 11.0\n", seconds=60.0)
    return log, fitted(log)[0]


def test_scale_and_geometry_in_the_map_give_kilograms(given: tuple[Path, dict[str, Any]]) -> None:
    _, result = given
    rows = rows_of(result)
    assert codes(result) == []
    assert result["fit"]["scale"]["statistical_only"]
    for name, true in TRUE.items():
        assert abs(rows[name]["value"] - true) < 3 * rows[name]["se"], (name, rows[name])
    assert rows["c1"]["origin"] == "given"
    # A correlation time of the sensors is at its bound, and its likelihood is not quadratic.
    assert rows["m_r"]["se"] < 0.05


@pytest.fixture(scope="module")
def different(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of a boat whose right thruster has the given thrust, and whose left one gives 1 / 0.72 times it."""
    folder = tmp_path_factory.mktemp("different")
    return imported(folder, "run", TABLES + "mass = 11.0\n", seconds=60.0, left=math.sqrt(0.72))


def test_a_known_side_with_the_given_thrust_makes_masses_right_and_certain(different: Path) -> None:
    """Without it the masses are 12 / 14.3 of the true ones, with this error in their standard errors."""
    unknown = fitted(different, "--effect", "mismatch")[0]
    right, output, folder = fitted(different, "--effect", "mismatch", "--thrust-of", "right")
    eps = (1.0 / 0.72 - 1.0) / (1.0 / 0.72 + 1.0)
    for result in (unknown, right):
        assert rows_of(result)["eps_LR"]["value"] == pytest.approx(eps, abs=0.01)
    assert "thrust-sides-differ" in codes(unknown)
    assert "thrust-sides-differ" not in codes(right)
    for name, true in TRUE.items():
        row, other = rows_of(right)[name], rows_of(unknown)[name]
        assert row["value"] == pytest.approx(other["value"] / (1.0 - eps), rel=0.02)
        assert abs(row["value"] - true) < 3.5 * row["se"], (name, row)
    assert rows_of(right)["m_u"]["se"] < 0.3 * rows_of(unknown)["m_u"]["se"]
    (note,) = (n for n in right["notes"] if "--thrust-of" in n)
    assert note.startswith("By --thrust-of, the given thrust is that of the right thruster; the left one has 1")
    assert "the given thrust is that of the right thruster" in " ".join(output.split())

    saved = folder / "model.toml"
    assert load_model(saved).model.source == "horizontal:shaft:thrust-of-right"
    again = fitted(different, "--model", str(saved))[0]
    assert rows_of(again)["m_u"]["value"] == pytest.approx(rows_of(right)["m_u"]["value"], rel=1e-3)
    assert "thrust-sides-differ" not in codes(again)
    taken_back = fitted(different, "--model", str(saved), "--thrust-of", "unknown")[0]
    assert rows_of(taken_back)["m_u"]["value"] == pytest.approx(rows_of(unknown)["m_u"]["value"], rel=1e-3)
    assert "thrust-sides-differ" in codes(taken_back)


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
def test_a_diagnosis_that_finds_the_mismatch_keeps_the_side_with_the_given_thrust(different: Path) -> None:
    plain = st.fit(different, thrust_of="right", score_tests=False)
    assert any("so that both have this thrust" in note for note in plain.result.notes)
    found = st.diagnose(plain, different, max_effects=1)
    assert [e.name for e in found.result.effects] == ["mismatch"]
    assert "thrust-sides-differ" not in [w.code for w in found.result.warnings]
    assert any("the given thrust is that of the right thruster; the left" in note for note in found.result.notes)
    rows = {p.name: p for p in found.result.fit.parameters}
    assert rows["m_u"].value == pytest.approx(TRUE["m_u"], rel=0.05)
    told = st.diagnose(st.fit(different, score_tests=False), different, max_effects=1, thrust_of="right")
    assert {p.name: p.value for p in told.result.fit.parameters}["m_u"] == pytest.approx(rows["m_u"].value, rel=0.01)


def test_a_comparison_of_campaigns_does_not_take_the_side_with_the_given_thrust(
    different: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither from an option nor from the model: what has changed may be this side."""
    with pytest.raises(SeatrialError, match="does not assume that one thruster has kept its thrust"):
        st.compare_campaigns(different, different, thrust_of="right")
    arguments = ["changes", "--before", str(different), "--after", str(different), "--thrust-of", "right"]
    assert CliRunner().invoke(ident, arguments).exit_code == 2
    asked = []

    def noted(logs: Any, request: Any, *_: Any) -> Any:
        asked.append(request.vehicle.thrust_of)
        raise SeatrialError("enough")

    monkeypatch.setattr("seatrial.ident.workflows.changes.fit_logs", noted)
    other = imported(tmp_path, "other", TABLES, seconds=60.0)
    for model in ("horizontal:shaft:thrust-of-right", "horizontal:shaft"):
        with pytest.raises(SeatrialError, match="enough"):
            st.compare_campaigns(different, other, model, common_errors=False)
    assert asked == ["unknown", None]


def test_thrust_ahead_alone_is_the_thrust_ahead(tmp_path: Path) -> None:
    """It is not the mean of ahead and astern: the masses would be 1.2 times as large."""
    tables = TABLES.replace("c1 = 12.0\nc2 = 0.0\n", "ahead = 12.0\n")
    result, output, _ = fitted(imported(tmp_path, "run", tables, seconds=90.0, astern=8.0))
    rows = rows_of(result)
    assert codes(result) == []
    assert "The thrust ahead was given, 12 N. By a first fit, that astern is " in " ".join(output.split())
    assert rows["c1"]["origin"] == "given"
    assert rows["c1"]["value"] + rows["c2"]["value"] == pytest.approx(12.0, rel=0.02)
    for name, true in TRUE.items():
        assert abs(rows[name]["value"] - true) < 3 * rows[name]["se"], (name, rows[name])
    assert rows["m_u"]["value"] == pytest.approx(12.0, rel=0.05)
    held, _, _ = fitted(tmp_path / "run.mcap", "--fix", "c2=2")
    assert rows_of(held)["c1"]["value"] == pytest.approx(10.0)


def test_weighed_mass_checks_the_mass_in_surge(given: tuple[Path, dict[str, Any]]) -> None:
    """The true mass in surge is 12 kg. A weighed mass above it, or much below, contradicts the thrust."""
    log, plain = given
    assert codes(plain) == []
    heavy, output, _ = fitted(log, "--mass", "20")
    assert codes(heavy) == ["mass-implausible"]
    assert "and the boat weighs 20 kg: m_u contains the added mass of the water too" in " ".join(output.split())
    assert rows_of(heavy)["m_u"] == rows_of(plain)["m_u"]  # it is no prior
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        light = st.fit(log, mass=4.0, score_tests=False, reml=False, mean_order=1)
        with pytest.raises(SeatrialError, match="mass 0: give a mass above zero, in kg"):
            st.fit(log, mass=0.0, score_tests=False)
    (warning,) = light.result.warnings
    assert warning.code == "mass-implausible"
    assert re.search(r"the added mass of the water would be (1\.[89]\d|2\.[01]\d) times that mass", warning.text)


def test_gap_of_one_sensor_is_a_warning_of_the_fit(tmp_path: Path) -> None:
    """`seatrial check` reported it, and a fit in Python was silent."""
    log = imported(tmp_path, "run", TABLES, seconds=60.0, gap=(20.0, 30.0))
    with pytest.warns(SeatrialWarning) as issued:
        fit = st.fit(log, score_tests=False, reml=False, mean_order=1)
    (text,) = [str(w.message) for w in issued if "sections-missing" in str(w.message)]
    assert "r: data missing: 1 section, 10.1 s in all" in text
    assert [w.code for w in fit.result.warnings] == ["log-check"]
    with pytest.warns(SeatrialWarning, match="r: data missing: 1 section"):
        found = st.diagnose(fit, log, max_effects=1)
    assert [w.code for w in found.result.warnings][:1] == ["log-check"]


def test_weighed_mass_says_nothing_about_ratios_and_within_the_errors(
    bare: tuple[dict[str, Any], str, Path],
) -> None:
    saved = load_model(bare[2] / "model.toml")
    assert thrust_scale_of(saved.model).relative
    assert "mass-implausible" not in codes(bare[0])
    model = saved.model.replace_parameters(saved.model.parameter("c1").known(12.0, 0.0, ParameterOrigin.GIVEN))
    for error, expected in ((0.6, []), (0.2, ["mass-implausible"])):
        estimate = SimpleNamespace(model=model, estimate=lambda _, e=error: (12.0, e))
        assert [w.code for w in mass_warnings(cast("Fit", estimate), 13.0)] == expected
    # Above 1.3 times the weighed mass by two standard errors, or above twice whatever the error is.
    masses = (18.6, 0.9, 1), (18.6, 3.0, 0), (14.6, 0.5, 1), (13.6, 0.4, 0), (13.0, 0.1, 0), (15.0, np.nan, 0)
    for mass, error, n_warned in masses:
        estimate = SimpleNamespace(model=model, estimate=lambda _, m=mass, e=error: (m, e))
        assert len(mass_warnings(cast("Fit", estimate), 10.0)) == n_warned, (mass, error)
    for weighed in (17400.0, 1.0):  # a mass in grams, and one with a lost digit
        estimate = SimpleNamespace(model=model, estimate=lambda _: (17.0, 0.5))
        (warning,) = mass_warnings(cast("Fit", estimate), weighed)
        assert "Check the weighed mass (kilograms of the whole boat as it ran), and the given thrust" in warning.text
    above_twice = SimpleNamespace(model=model, estimate=lambda _: (20.5, np.nan))
    assert [w.code for w in mass_warnings(cast("Fit", above_twice), 10.0)] == ["mass-implausible"]


@pytest.mark.parametrize(
    ("mass", "unit"),
    [(4.2, "kgf, 1 kgf = 9.81 N"), (9.3, "lbf, 1 lbf = 4.448 N"), (4200.0, "gf, 1 gf = 0.00981 N"), (16.0, None)],
)
def test_unit_of_the_thrust_that_explains_a_wrong_mass_is_named(mass: float, unit: str | None) -> None:
    (warning,) = implausible_mass(mass, 0.04 * mass, 32.0)
    assert ("as if the thrust were given in" in warning.text) == (unit is not None)
    assert unit is None or f"the mass is as if the thrust were given in {unit})" in warning.text


@pytest.mark.parametrize(
    ("error", "weighed", "begin", "more"),
    [
        (0.2, 11.0, "The mass in surge, m_u, is 1.09 times the weighed mass of 11 kg", None),
        (np.nan, 8.0, "The mass in surge, m_u, is 1.50 times the weighed mass of 8 kg", "The excess is more here. If"),
        (0.2, 8.0, "", None),  # There is a warning.
        (
            1.0,
            8.0,
            "The mass in surge, m_u, is 1.50 times the weighed mass of 8 kg",
            "by less than two standard errors (1 kg)",
        ),
        (0.6, 12.5, "The mass in surge, m_u, is 0.96 times the weighed mass of 12.5 kg. With the added mass", None),
        (0.2, 13.0, "", None),  # There is a warning.
        (0.2, None, "The mass in surge, m_u, was not compared with a weighed mass, because none was given", None),
    ],
)
def test_weighed_mass_is_compared_in_a_note(
    bare: tuple[dict[str, Any], str, Path],
    error: float,
    weighed: float | None,
    begin: str,
    more: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = load_model(bare[2] / "model.toml").model
    assert mass_notes(cast("Fit", SimpleNamespace(model=model, estimate=lambda _: (12.0, error))), weighed) == []
    model = model.replace_parameters(model.parameter("c1").known(12.0, 0.0, ParameterOrigin.GIVEN))
    notes = mass_notes(cast("Fit", SimpleNamespace(model=model, estimate=lambda _: (12.0, error))), weighed)
    assert [note.startswith(begin) for note in notes] == ([True] if begin else [])
    assert any("The excess is more here" in note for note in notes) == (more is not None)
    monkeypatch.setattr(answers, "sides_compare_mass", lambda *_: True)  # the warning of the thrusts has the ratio
    assert mass_notes(cast("Fit", SimpleNamespace(model=model, estimate=lambda _: (12.0, error))), weighed) == []
    assert more is None or more in notes[0]
    # The weighed mass may be that of another load: the note claims no more than the ratio.
    assert all("look the same" in note for note in notes if "1.09" in note or "1.50" in note)


def test_a_prior_that_only_missing_effects_excuse_has_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    c1 = Parameter("c1", 12.0, "N", "thrust", prior=(12.0, 0.6), origin=ParameterOrigin.PRIOR)
    noise = replace(c1, name="e_r")
    found = [
        PriorDistance(c1, 15.0, 1.5, 4.2, 0.5),
        PriorDistance(replace(c1, name="c2"), 15.0, 3.4, 4.2, 0.5),  # There is a warning.
        PriorDistance(replace(c1, name="y_arm"), 12.5, 0.5, 0.8, 0.5),
        PriorDistance(noise, 15.0, 1.5, 4.2, 0.5),
    ]
    monkeypatch.setattr(answers, "prior_distances", lambda _: found)
    fit = cast("Fit", SimpleNamespace(model=SimpleNamespace(noises=("e_r",), parameters=())))
    (note,) = prior_notes(fit)
    assert note.startswith(
        "The estimate of c1 is 15 N, where 12 ± 0.6 N was given. The data alone give about 18 N: 4.2 standard "
        "deviations of both away if no effect is missing from the model, and 1.5 if the effects that may be missing "
    )
    # An estimate near the given value does not contradict the distance of the data.
    for estimate, sign, direction in ((12.2, 1.0, "larger"), (11.8, -1.0, "smaller")):
        found[:] = [PriorDistance(c1, estimate, 1.5 * sign, 4.2 * sign, 0.98)]
        (note,) = prior_notes(fit)
        assert (
            "The prior has 98 % of the information and holds the estimate near the given value. The data alone give a "
            f"{direction} value: 4.2 standard deviations of both away"
        ) in note


@pytest.mark.parametrize("transform", ["none", "log"])
def test_the_data_alone_and_the_prior_give_the_estimate(transform: Literal["none", "log"]) -> None:
    c1 = Parameter("c1", 12.0, "N", transform=transform, prior=(12.0, 0.6))
    prior, weight, data = c1.to_free(12.0), 0.7, c1.to_free(14.0)
    estimate = c1.from_free(weight * prior + (1.0 - weight) * data)
    assert PriorDistance(c1, estimate, 3.0, 3.0, weight).data_value == pytest.approx(14.0)
    assert PriorDistance(c1, estimate, 3.0, 3.0, 0.85).data_value is None


@pytest.mark.study
def test_uncertainty_of_a_given_scale_is_in_the_standard_errors(tmp_path: Path) -> None:
    uncertain, _, out = fitted(imported(tmp_path, "about", TABLES.replace("c1 = 12.0", "c1 = 12.0\nc1_sd = 0.6")))
    rows = rows_of(uncertain)
    assert not uncertain["fit"]["scale"]["statistical_only"]
    assert rows["m_u"]["value"] == pytest.approx(12.0, abs=1.0)
    assert rows["m_u"]["se"] == pytest.approx(0.05 * 12.0, rel=0.05)  # This follows from dm/dc1 = m/c1.
    assert rows["c1"]["origin"] == "prior"
    saved = load_model(out / "model.toml")
    assert saved.model.parameter("c1").prior == (12.0, 0.6)
